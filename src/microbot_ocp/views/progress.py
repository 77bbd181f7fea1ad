"""Progress of a comparison: a live bar on a terminal, plain lines anywhere else."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from microbot_ocp.comparison import Step


class Report:
    """Takes the steps of a comparison and shows them."""

    def __init__(self, console: Console, bar: Progress | None, task: TaskID | None) -> None:
        self.console, self.bar, self.task = console, bar, task

    def __call__(self, step: Step) -> None:
        self._show(step.stage, step.text, step.done, step.total)

    def tell(self, stage: str, text: str) -> None:
        """Show a step of no counted length."""
        self._show(stage, text, None, None)

    def _show(self, stage: str, text: str, done: int | None, total: int | None) -> None:
        if self.bar is None or self.task is None:
            self.console.print(f"{stage:8s}{text}", markup=False, soft_wrap=True)
        elif done is None:
            self.bar.update(self.task, description=f"{stage}: {text}")
        else:
            self.bar.update(self.task, description=f"{stage}: {text}", completed=done, total=total)


@contextmanager
def show_progress(console: Console) -> Iterator[Report]:
    """A callable for ``compare(progress=...)``; the bar is gone when the block ends."""
    if not console.is_terminal:
        yield Report(console, None, None)
        return
    columns = (SpinnerColumn(), BarColumn(bar_width=20), TimeElapsedColumn(), TextColumn(_TEXT))
    with Progress(*columns, console=console, transient=True) as bar:
        yield Report(console, bar, bar.add_task("build", total=None))


_TEXT = "{task.description}"
