"""Solutions of optimal-control problems: every state and control against time, by its own name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.ocp.problem import Variable
from microbot_ocp.ocp.solution import PhaseSolution, Solution
from microbot_ocp.views.plots._page import (
    A4_LANDSCAPE,
    LIMIT_COLOR,
    AxesGrid,
    axes_page,
    styled,
)
from microbot_ocp.views.plots._style import look

COLUMNS = 3
ROW_HEIGHT = 2.4  # inches
POINTS = 400  # of a curve a phase
STRETCH = 1.5  # a limit that would stretch the curves' axis by more is not drawn
CONTROLS = ("constant", "linear", "polynomial")


@styled()
def solution(
    solution: Solution | Mapping[str, Solution],
    axes: GivenAxes | None = None,
    *,
    names: Sequence[str] | None = None,
    title: str = "",
) -> AxesGrid:
    """States and controls of one solution, or of several over each other.

    Parameters
    ----------
    solution : Solution, or a mapping from a label to Solution
        Made by a solve, with the same phases.
    axes : array of Axes [variables], optional
        Default a new figure.
    names : sequence of str, optional
        Which states, controls and algebraic variables; default all.
    title : str
        Of a new figure.

    Returns
    -------
    AxesGrid [variables]
        In the units of the declaration; limits are dashed where they are near. The phases follow
        each other on one time axis, with a line between them. A solution that was not
        solved is named in red.

    Raises
    ------
    InputError
        No solution, one that was not made by a solve, a name that is not there.
    """
    given = {"": solution} if isinstance(solution, Solution) else dict(solution)
    if not given:
        raise InputError("solution must hold at least one solution")
    known = _variables(next(iter(given.values())))
    chosen = [checks.one_of("name", name, known) for name in names or known]
    columns = min(COLUMNS, len(chosen))
    rows = -(-len(chosen) // columns)
    if axes is None:
        size = (A4_LANDSCAPE[0], ROW_HEIGHT * rows + 0.9)
        page = axes_page(None, rows, columns, size=size, title=title, sharex=True)
    else:
        page = axes_page(axes, 1, len(chosen), size=(1.0, 1.0))
    panels = page.axes.ravel()[: len(chosen)].view(AxesGrid)
    for empty in page.axes.ravel()[len(chosen) :]:
        empty.remove()
    for name, panel in zip(chosen, panels, strict=True):
        for place, each in enumerate(given.values()):
            _draw(panel, each, name, place)
        _draw_limits(panel, known[name])
        panel.set_title(name, fontweight="bold")
        panel.set_ylabel(f"[{known[name].unit}]" if known[name].unit else "")
        panel.margins(x=0.01)
    for panel in panels[-columns:]:
        panel.set_xlabel("t [s]")
        panel.tick_params(labelbottom=True)
    handles = []
    for place, label in enumerate(given):
        handles.append(Line2D([], [], **_line(place), label=label))
    handles = [handle for handle in handles if handle.get_label()]
    failures = [
        f"{label or 'solution'}: not solved: {each.advice}"
        for label, each in given.items()
        if not each.status.solved
    ]
    page.legend(handles, 4, warning="\n".join(failures))
    return panels


def _variables(solution: Solution) -> dict[str, Variable]:
    found: dict[str, Variable] = {}
    for part in solution.phases:
        if part.layout is None:
            raise InputError(f"phase {part.name!r} was not made by a solve: it cannot be drawn")
        phase = part.layout.phase
        for variable in (*phase.states, *phase.controls, *phase.algebraics):
            found.setdefault(variable.name, variable)
    return found


def _draw(axes: Axes, solution: Solution, name: str, place: int) -> None:
    begin = 0.0
    for part in solution.phases:
        if name in part.values:
            t = _times(part)
            axes.plot(begin + t, part.sample(t)[name], **_line(place))
        begin += part.duration
        if part is not solution.phases[-1]:
            axes.axvline(begin, color="0.8", linewidth=0.8, zorder=1)


def _line(place: int) -> dict[str, Any]:
    color, dashes = look(place)
    return {"color": color, "linestyle": dashes, "linewidth": 1.8}


def _times(part: PhaseSolution) -> FloatArray:
    """Even times and both sides of every mesh point, where controls may jump."""
    edges = part.t[1:-1]
    gap = 1e-9 * part.duration
    even = np.linspace(0.0, part.duration, POINTS)
    return np.unique(np.concatenate([even, edges - gap, edges + gap]))


def _draw_limits(axes: Axes, variable: Variable) -> None:
    low, high = axes.get_ylim()
    span = max(high - low, 1e-12)
    for bound in {*variable.lower.tolist(), *variable.upper.tolist()}:
        reach = max(high, bound) - min(low, bound)
        if np.isfinite(bound) and reach <= STRETCH * span:
            axes.axhline(bound, color=LIMIT_COLOR, linestyle="--", linewidth=1.0, zorder=2)
