"""What data of a motion are worth: limits in milliseconds, a reserve in millimetres."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.execution import Reserve
from microbot_ocp.motion import Sensitivities
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
    panels[0].barh(names, saved)
    panels[0].invert_yaxis()
    panels[0].set(xlabel="time saved [ms]")
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
