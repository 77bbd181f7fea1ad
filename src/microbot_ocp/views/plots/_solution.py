"""Solutions of optimal-control problems: every state and control against time, by its own name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.ocp.problem import Variable
from microbot_ocp.ocp.solution import Solution
from microbot_ocp.views._scene import is_near
from microbot_ocp.views._style import STYLE, look
from microbot_ocp.views.plots._page import AxesGrid, axes_page, styled


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
    solutions = {"": solution} if isinstance(solution, Solution) else dict(solution)
    if not solutions:
        raise InputError("solution must hold at least one solution")
    variables = _variables(next(iter(solutions.values())))
    chosen = [checks.one_of("name", name, variables) for name in names or variables]
    columns, rows = min(3, len(chosen)), 1
    if axes is None:
        rows = -(-len(chosen) // columns)
    else:
        columns = len(chosen)
    size = (STYLE.landscape[0], STYLE.row * rows + 0.9)
    page = axes_page(axes, rows, columns, size=size, title=title, sharex=True)
    panels = page.axes.ravel()[: len(chosen)].view(AxesGrid)
    for empty in page.axes.ravel()[len(chosen) :]:
        empty.remove()
    for name, panel in zip(chosen, panels, strict=True):
        variable = variables[name]
        for place, each in enumerate(solutions.values()):
            _draw(panel, each, name, look(place))
        low, high = panel.get_ylim()
        for bound in {*variable.lower.tolist(), *variable.upper.tolist()}:
            if is_near(bound, low, high):
                panel.axhline(bound, zorder=2, **STYLE.limit_line)
        panel.set_title(name, fontweight="bold")
        panel.set_ylabel(f"[{variable.unit}]" if variable.unit else "")
        panel.margins(x=0.01)
    for panel in panels[-min(3, columns) :]:
        panel.set_xlabel("t [s]")
        panel.tick_params(labelbottom=True)
    handles = [Line2D([], [], label=s, **look(k)) for k, s in enumerate(solutions) if s]
    failures = [
        f"{label or 'solution'}: not solved: {each.advice}"
        for label, each in solutions.items()
        if not each.status.solved
    ]
    page.legend(handles, 4, failures)
    return panels


def _variables(solution: Solution) -> dict[str, Variable]:
    variables: dict[str, Variable] = {}
    for part in solution.phases:
        if part.layout is None:
            raise InputError(f"phase {part.name!r} was not made by a solve: it cannot be drawn")
        phase = part.layout.phase
        for variable in (*phase.states, *phase.controls, *phase.algebraics):
            variables.setdefault(variable.name, variable)
    return variables


def _draw(axes: Axes, solution: Solution, name: str, line: dict[str, Any]) -> None:
    begin = 0.0
    for part in solution.phases:
        if name in part.values:
            # even times and both sides of every mesh point, where controls may jump
            edges, gap = part.t[1:-1], 1e-9 * part.duration
            even = np.linspace(0.0, part.duration, STYLE.points)
            t = np.unique(np.concatenate([even, edges - gap, edges + gap]))
            axes.plot(begin + t, part.sample(t)[name], **line)
        begin += part.duration
        if part is not solution.phases[-1]:
            axes.axvline(begin, color="0.8", linewidth=0.8, zorder=1)
