"""Figures of solutions of optimal-control problems: every state and control over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.ocp.solution import Solution
from microbot_ocp.views._scene import is_near
from microbot_ocp.views._style import LANDSCAPE, LIMIT_LINE, ROW_HEIGHT, THIN, look
from microbot_ocp.views._variables import BoundedCurve, Key, dense_times, variable_curves
from microbot_ocp.views.plots._page import AxesGrid, axes_page, styled


@styled()
def solution(
    solution: Solution | Mapping[str, Solution],
    axes: GivenAxes | None = None,
    *,
    names: Sequence[str] | None = None,
    title: str = "",
) -> AxesGrid:
    """Draw states and controls of one or several solutions over time.

    Parameters
    ----------
    solution : Solution, or a mapping from a label to Solution
        Solutions of a solver, with equal phases.
    axes : array of Axes [variables], optional
        Default a new figure.
    names : sequence of str, optional
        Names of states, controls and algebraic variables; default all.
    title : str
        Title of a new figure.

    Returns
    -------
    AxesGrid [variables]
        Curves in the units of the declaration; bounds near the curves are dashed. The phases follow
        each other on one time axis, separated by a line. A red text names a failed solution.

    Raises
    ------
    InputError
        No solution, a solution that no solver computed, an unknown name.
    """
    solutions = {"": solution} if isinstance(solution, Solution) else dict(solution)
    if not solutions:
        raise InputError("solution must hold at least one solution")
    every = [variable_curves(each.phases, dense_times) for each in solutions.values()]
    units = {name: unit for name, _, unit in every[0]}
    chosen = [checks.one_of("name", name, units) for name in names or units]
    columns = min(3, len(chosen)) if axes is None else len(chosen)
    rows = -(-len(chosen) // columns)
    size = (LANDSCAPE[0], ROW_HEIGHT * rows + 1)
    page = axes_page(axes, rows, columns, size=size, title=title, sharex=True)
    panels = page.axes.ravel()[: len(chosen)].view(AxesGrid)
    for empty in page.axes.ravel()[len(chosen) :]:
        empty.remove()
    for name, panel in zip(chosen, panels, strict=True):
        _draw(panel, every, name)
        panel.set_title(name, fontweight="bold")
        panel.set_ylabel(f"[{units[name]}]" if units[name] else "")
        panel.margins(x=0)
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


def _draw(panel: Axes, every: Sequence[Mapping[Key, Sequence[BoundedCurve]]], name: str) -> None:
    """Draw a variable of every solution with its near bounds and the ends of the phases."""
    shown = [
        (place, curve)
        for place, table in enumerate(every)
        for key, curves in table.items()
        for curve in (curves if key[0] == name else ())
    ]
    for place, curve in shown:
        panel.plot(curve.t, curve.values, **look(place))
    low, high = panel.get_ylim()
    for _, curve in shown:
        for bound in (curve.lower, curve.upper):
            if is_near(bound, low, high):
                panel.plot(curve.t[[0, -1]], [bound] * 2, zorder=2, **LIMIT_LINE)
    for begin in sorted({curve.t[0] for place, curve in shown if place == 0})[1:]:
        panel.axvline(begin, color="0.8", zorder=1, **THIN)
