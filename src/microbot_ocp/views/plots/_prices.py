"""What data of a motion are worth: limits in milliseconds, a reserve in millimetres."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.execution import Reserve
from microbot_ocp.motion import DurationLine, Sensitivities
from microbot_ocp.views._style import STYLE
from microbot_ocp.views.plots._page import AxesGrid, axes_page, styled


@styled()
def prices(sensitivities: Sensitivities, axes: GivenAxes | None = None) -> AxesGrid:
    """Draw what one percent of each limit saves, the most first.

    Parameters
    ----------
    sensitivities : Sensitivities
    axes : Axes, optional
        Default a new figure.

    Returns
    -------
    AxesGrid [1]
    """
    table = sensitivities.table()
    names, saved = [row[0] for row in table.rows], [row[-1] for row in table.rows]
    size = (STYLE.page[0], 0.8 * STYLE.row + 0.25 * len(names))
    page = axes_page(axes, 1, 1, size=size, title="what one percent of a limit saves")
    panels = page.axes.ravel().view(AxesGrid)
    # what barely binds is hollow: a step may end it
    filled = [row[4] == "yes" for row in table.rows]
    for bar, sure in zip(panels[0].barh(names, saved, edgecolor="C0"), filled, strict=True):
        bar.set_fill(sure)
    panels[0].invert_yaxis()
    panels[0].set(xlabel="time saved [ms]")
    return panels


@styled()
def duration_line(line: DurationLine, axes: GivenAxes | None = None) -> AxesGrid:
    """Draw the shortest duration over one datum of a task, with its slopes.

    Parameters
    ----------
    line : DurationLine
        From :meth:`microbot_ocp.TimeOptimalSolver.along`.
    axes : Axes, optional
        Default a new figure.

    Returns
    -------
    AxesGrid [1]
        Slopes are short lines; values before which other limits bind have a hollow mark.
    """
    page = axes_page(axes, 1, 1, size=(STYLE.page[0], 1.5 * STYLE.row))
    panels = page.axes.ravel().view(AxesGrid)
    half = 0.3 * np.gradient(line.values) if line.values.size > 1 else np.zeros(1)
    ends = np.stack([-half, half])
    panels[0].plot(line.values + ends, line.duration + line.slope * ends, color="C0")
    for changed, fill in ((False, "full"), (True, "none")):
        at = line.changes == changed
        panels[0].plot(line.values[at], line.duration[at], "o", color="C0", fillstyle=fill)
    unit = f" [{line.unit}]" if line.unit else ""
    panels[0].set(xlabel=f"{line.name}{unit}", ylabel="duration [s]")
    return panels


@styled()
def reserve(reserve: Reserve, axes: GivenAxes | None = None) -> AxesGrid:
    """Draw the error of the tool and the duration over the reserve of torque.

    Parameters
    ----------
    reserve : Reserve
        From :func:`microbot_ocp.smallest_reserve`.
    axes : array of Axes [2], optional
        Default a new figure.

    Returns
    -------
    AxesGrid [2]
        The bound is dashed, the least reserve that keeps it dotted.
    """
    size = (STYLE.page[0], 1.5 * STYLE.row)
    page = axes_page(axes, 1, 2, size=size, title="what a reserve of torque does")
    panels = page.axes.ravel().view(AxesGrid)
    share = [100.0 * trial.reserve for trial in reserve.trials]
    error, duration = (
        np.array([getattr(trial, key) for trial in reserve.trials]) for key in ("error", "duration")
    )
    panels[0].semilogy(share, np.where(np.isfinite(error), 1e3 * error, np.nan), marker="o")
    panels[0].axhline(1e3 * reserve.bound, linestyle="--", color="0.4")
    panels[1].plot(share, duration, marker="o")
    for panel, label in zip(panels, ("error of the tool [mm]", "duration [s]"), strict=True):
        panel.set(xlabel="reserve [%]", ylabel=label)
        if reserve.solved:
            panel.axvline(100.0 * reserve.reserve, linestyle=":", color="0.4")
    return panels
