"""What commands print: text and tables for people, one strict JSON document for machines."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from microbot_ocp._base.checks import shortened
from microbot_ocp._base.writing import NotWritten
from microbot_ocp.cli import _interrupt as interrupt

if TYPE_CHECKING:
    from rich.console import Console

    from microbot_ocp.comparison import Progress, Step
    from microbot_ocp.robot import Robot

PIPE_WIDTH = 120  # columns where there is no terminal to ask


def make_console(*, errors: bool = False) -> Console:
    """Console on standard output or error; plain in a pipe or where ``NO_COLOR`` is set."""
    from rich.console import Console

    stream = sys.stderr if errors else sys.stdout
    known = stream.isatty() or "COLUMNS" in os.environ
    return Console(
        file=stream,
        width=None if known else PIPE_WIDTH,
        color_system=None if os.environ.get("NO_COLOR") else "auto",
        highlight=False,
        markup=False,
        emoji=False,
    )


@dataclass
class Written:
    """Files that a command wrote, and those that it could not; its result is printed anyway."""

    files: list[str] = field(default_factory=list)
    missing: list[dict[str, str]] = field(default_factory=list)

    def add(self, path: Path | None, save: Callable[[Path], Any]) -> None:
        """Call ``save`` with the path, if there is one; it may return the files that it made."""
        if path is None:
            return
        try:
            made = save(path)
        except NotWritten as problem:
            self.missing.append({"file": problem.path, "reason": problem.reason})
        except Exception as problem:
            interrupt.check()
            reason = str(problem) or type(problem).__name__
            self.missing.append({"file": str(path), "reason": shortened(reason, 120)})
        else:
            self.files += map(str, made) if isinstance(made, list) else [str(path)]


def answer(
    as_json: bool,
    document: Mapping[str, Any],
    show: Callable[[Console], None],
    code: int = 0,
    written: Written | None = None,
    folder: Path | None = None,
) -> int:
    """Print the document as JSON, or let ``show`` print it for people; return the exit code.

    Files come last, those in ``folder`` as a count. One that is missing makes the exit code 1.
    """
    interrupt.check()
    if written is not None:
        document = {**document, "written": written.files, "not_written": written.missing}
        code = 1 if written.missing else code
    if as_json:
        utf8 = (sys.stdout.encoding or "").lower().replace("-", "") == "utf8"
        print(json.dumps(plain(document), indent=2, ensure_ascii=not utf8, allow_nan=False))
    else:
        console = make_console()
        show(console)
        if written is not None:
            _show_written(console, written, folder)
    return code


def plain(value: Any) -> Any:
    """Plain JSON values; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value + 0.0 if math.isfinite(value) else None  # no -0.0
    return value


def number(value: float, digits: int = 4) -> str:
    """A number with so many decimals, without those that say nothing; a dash for none."""
    if not math.isfinite(value):
        return "–"
    return f"{round(value, digits) + 0.0:.{digits}f}".rstrip("0").rstrip(".")


def span(lower: float, upper: float, digits: int = 4) -> str:
    """A range: ± where it is symmetric, a dash where there is none."""
    if math.isinf(lower) and math.isinf(upper):
        return "–"
    if math.isclose(lower, -upper):
        return f"±{number(upper, digits)}"
    return f"{number(lower, digits)} to {number(upper, digits)}"


def point_text(place: Any) -> str:
    """A place as (x, y, z)."""
    return f"({', '.join(number(float(x)) for x in place)})"


def joint_text(robot: Robot, q: Any, digits: int = 4) -> str:
    """Joint positions with their unit: degrees, or degrees and metres."""
    shown = in_degrees(robot, q)
    unit = "deg" if "prismatic" not in robot.joint_types else "deg, prismatic m"
    return f"({', '.join(number(float(v), digits) for v in shown)}) {unit}"


def in_degrees(robot: Robot, q: Any) -> np.ndarray:
    """Joint values [..., n] in degrees; those of prismatic joints stay as they are."""
    turns = np.array(robot.joint_types) == "revolute"
    return np.round(np.asarray(q, dtype=float) * np.where(turns, 180.0 / np.pi, 1.0), 10)


def _show_written(console: Console, written: Written, folder: Path | None) -> None:
    inside = [path for path in written.files if folder and Path(path).is_relative_to(folder)]
    if len(inside) > 1:
        console.print(f"written: {len(inside)} files in {folder}", soft_wrap=True)
    for path in written.files:
        if len(inside) < 2 or path not in inside:
            console.print(f"written: {path}", soft_wrap=True)
    for missing in written.missing:
        console.print(f"not written: {missing['file']}: {missing['reason']}", soft_wrap=True)


@contextmanager
def shown_progress(as_json: bool) -> Iterator[Progress]:
    """Progress as a bar on standard error if that is a terminal; every step heeds Ctrl-C."""
    if as_json or not sys.stderr.isatty():
        yield lambda step: interrupt.check()
        return
    from microbot_ocp.views.live import show_progress

    with show_progress(make_console(errors=True)) as report:

        def show(step: Step) -> None:
            interrupt.check()
            report(step)

        yield show
