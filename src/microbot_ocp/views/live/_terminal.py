"""Progress of solves and comparisons: a live line on a terminal, plain lines anywhere else.

Iterations of a solver are shown on a terminal only.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from microbot_ocp.comparison import Step
from microbot_ocp.ocp.solution import Iteration


class Report:
    """Takes what a solve or a comparison tells of itself and shows it."""

    def __init__(self, console: Console, bar: Progress | None, task: TaskID | None) -> None:
        self.console, self.bar, self.task = console, bar, task

    def __call__(self, event: Step | Iteration | str) -> None:
        iteration = event.iteration if isinstance(event, Step) else event
        if isinstance(iteration, Iteration):
            self._iterate(iteration, event if isinstance(event, Step) else None)
        elif isinstance(event, Step):
            self._show(event.stage, event.text, event.done, event.total)
        else:
            self.tell("solve", str(event))

    def tell(self, stage: str, text: str) -> None:
        """Show a step of no counted length."""
        self._show(stage, text, None, None)

    def _show(self, stage: str, text: str, done: int | None, total: int | None) -> None:
        if self.bar is None or self.task is None:
            self.console.print(f"{stage:8s}{text}", markup=False, soft_wrap=True)
        else:
            said = escape(f"{stage}: {text}")
            self.bar.update(self.task, description=said, completed=done, total=total)

    def _iterate(self, iteration: Iteration, step: Step | None) -> None:
        if self.bar is None or self.task is None:
            return
        title = "" if step is None else step.text.removesuffix(str(iteration))
        self.bar.update(
            self.task,
            description=escape(f"{title}{iteration}"),
            completed=None if step is None else step.done,
            total=None if step is None else step.total,
        )


@contextmanager
def show_progress(console: Console | None = None) -> Iterator[Report]:
    """A callable for any ``progress=``; what it draws is gone when the block ends.

    Parameters
    ----------
    console : rich.console.Console, optional
        Default standard error. In a pipe the steps of a task become lines of text, and iterations
        are not told.

    Examples
    --------
    >>> from microbot_ocp.ocp import OptimalControlProblem, solve
    >>> problem = OptimalControlProblem("double integrator")
    >>> phase = problem.phase("move", duration=(0.1, 10.0))
    >>> x = phase.state("x", initial=0.0, final=1.0)
    >>> v = phase.state("v", initial=0.0, final=0.0)
    >>> u = phase.control("u", lower=-1.0, upper=1.0)
    >>> phase.derivative(x, v)
    >>> phase.derivative(v, u)
    >>> phase.end_cost(phase.duration)
    >>> with show_progress() as progress:
    ...     solution = solve(problem, mesh=20, progress=progress)
    >>> solution.status.solved
    True
    """
    shown = console or Console(file=sys.stderr)
    if not shown.is_terminal:
        yield Report(shown, None, None)
        return
    columns = (SpinnerColumn(), BarColumn(bar_width=20), TimeElapsedColumn(), TextColumn(_TEXT))
    with Progress(*columns, console=shown, transient=True) as bar:
        yield Report(shown, bar, bar.add_task("build", total=None))


_TEXT = "{task.description}"
