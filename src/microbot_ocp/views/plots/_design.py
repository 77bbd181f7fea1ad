"""The map of a design: quick looks over the free quantities, the solves, start and end."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.layout import Design
from microbot_ocp.views._style import ROW_HEIGHT
from microbot_ocp.views.plots._charts import row
from microbot_ocp.views.plots._page import AxesGrid, styled


@styled()
def design(design: Design, axes: GivenAxes | None = None) -> AxesGrid:
    """Draw the map of a design.

    Parameters
    ----------
    design : Design
        Result of :func:`microbot_ocp.design`.
    axes : array of Axes [1] or [d], optional
        Default a new figure.

    Returns
    -------
    AxesGrid [1] or [d]
        Two quantities share a panel, coloured by the time from rest to rest; else each has a panel
        with the times over it. Quantities without effect are left out. Crosses have no motion; dots
        are solves; the start is a square, the end a star.
    """
    shown = [k for k, worth in enumerate(design.worth) if not worth.idle]
    two, title = len(shown) == 2, "time over the free quantities"
    panels = row(axes, 1 if two else len(shown), title, 2 * ROW_HEIGHT)
    looks = np.array([node.values[shown] for node in design.nodes])
    times = np.array([node.estimate for node in design.nodes])
    solves = np.array([solved.values[shown] for solved in design.solved])
    quantities, best = [design.quantities[k] for k in shown], design.values[shown]
    labels = [f"{q.name} [{q.unit}]" if q.unit else q.name for q in quantities]
    start = np.array([quantity.start for quantity in quantities])
    if two:
        _plane(panels[0], looks, times, solves, np.array([start, best]))
        panels[0].set(xlabel=labels[0], ylabel=labels[1])
        return panels
    periods = [solved.period for solved in design.solved]
    for k, panel in enumerate(panels):
        panel.plot(looks[:, k], times, "o", color="0.7", label="from rest to rest")
        panel.plot(solves[:, k], periods, ".", color="C0", label="solved")
        if design.before is not None:
            panel.plot(start[k], design.period_before, "s", color="C1", label="before")
        panel.plot(best[k], design.period, "*", color="C3", markersize=12, label="after")
        panel.set(xlabel=labels[k], ylabel="duration [s]")
    panels[0].legend()
    return panels


def _plane(panel, looks, times, solves, ends) -> None:
    """Draw a map of two quantities with the solves and both ends [2,2]."""
    known = np.isfinite(times)
    dots = panel.scatter(*looks[known].T, c=times[known], s=120, marker="s", cmap="viridis_r")
    panel.figure.colorbar(dots, ax=panel, label="time from rest to rest [s]")
    panel.plot(*looks[~known].T, "x", color="0.7")
    panel.plot(*solves.T, ".", color="k", label="solved")
    panel.plot(*ends[0], "s", color="C1", label="before")
    panel.plot(*ends[1], "*", color="C3", markersize=14, label="after")
    panel.legend()
