"""Progress of solvers and comparisons: a live bar on a terminal, plain lines elsewhere.

Iterations of a solver are shown on a terminal only.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, SpinnerColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from microbot_ocp.ocp.solution import Iteration
from microbot_ocp.tasks import Step

Event = Step | Iteration | str
DURATION = re.compile(r"\d s\b")


@contextmanager
def show_progress(console: Console | None = None) -> Iterator[Callable[[Event], None]]:
    """Yield a function for any ``progress=`` that draws a bar until the block ends.

    Parameters
    ----------
    console : rich.console.Console, optional
        Console of the bar; default standard error. In a pipe steps become lines of text and
        iterations are not shown.

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
    >>> solution.solved
    True
    """
    shown = console or Console(file=sys.stderr)
    if not shown.is_terminal:

        def print_step(event: Event) -> None:
            if not _iterates(event):
                stage, text = _words(event)
                shown.print(f"{stage:8s}{text}", markup=False, soft_wrap=True)

        yield print_step
        return
    columns = (SpinnerColumn(), BarColumn(bar_width=30), TimeElapsedColumn(), TimeRemainingColumn())
    with _BarAndText(*columns, console=shown, transient=True) as bar:
        task = bar.add_task("build", total=None)

        def show(event: Event) -> None:
            step = event if isinstance(event, Step) else None
            stage, text = _words(event)
            bar.update(
                task,
                description=text if _iterates(event) else f"{stage}: {text}",
                completed=step and step.done,
                total=step and step.total,
            )

        yield show


def spoken_progress(say: Callable[[str], None], period: float = 30.0) -> Callable[[Event], None]:
    """Return a function for any ``progress=`` that reports the current step from time to time.

    A line without a duration ends with the last known duration. Iterations are not reported.

    Parameters
    ----------
    say : callable
        Called with a line, such as ``print``.
    period : float
        Smallest time between two lines, and before the first line, s.

    Examples
    --------
    >>> import re
    >>> lines = []
    >>> progress = spoken_progress(lines.append, period=0.0)
    >>> progress("the second mesh")
    >>> re.sub(r"[0-9]+ s", "T s", lines[0])
    'T s: solve: the second mesh'
    """
    begin = last = time.monotonic()
    stage = text = duration = ""

    def speak(event: Event) -> None:
        nonlocal last, stage, text, duration
        if not (text and _iterates(event)):
            stage, text = _words(event)
            duration = text if DURATION.search(text) else duration
        now = time.monotonic()
        if now - last >= period:
            last = now
            so_far = f"; so far: {duration}" if duration not in ("", text) else ""
            say(f"{now - begin:.0f} s: {stage}: {text}{so_far}")

    return speak


def _iterates(event: Event) -> bool:
    return isinstance(event.iteration if isinstance(event, Step) else event, Iteration)


def _words(event: Event) -> tuple[str, str]:
    """Return the stage and the text of an event."""
    return (event.stage, event.text) if isinstance(event, Step) else ("solve", str(event))


class _BarAndText(Progress):
    """Progress bar with the current step in a line below."""

    def get_renderables(self) -> Iterable[RenderableType]:
        for task in self.tasks:
            yield self.make_tasks_table([task])
            yield Text(f"  {task.description}", no_wrap=True, overflow="ellipsis")
