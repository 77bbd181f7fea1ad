"""Time against effort."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.comparison import Front
from microbot_ocp.views._style import STYLE
from microbot_ocp.views.plots._page import AxesGrid, axes_page, styled


@styled()
def front(front: Front, axes: GivenAxes | None = None) -> AxesGrid:
    """Effort and peak torque of the motions of a front over their durations.

    Parameters
    ----------
    front : Front
        From :func:`microbot_ocp.time_effort_front`.
    axes : array of Axes [2], optional
        Default a new figure.

    Returns
    -------
    AxesGrid [2]
        Open circles are motions that are not certified.
    """
    size = (STYLE.page[0], 1.5 * STYLE.row)
    page = axes_page(axes, 1, 2, size=size, title="time against effort and peak torque")
    panels = page.axes.ravel().view(AxesGrid)
    time = np.array([point.duration for point in front.points])
    good = [point.motion.solved and point.certificate.ok for point in front.points]
    columns = {
        "effort [s]": [point.effort for point in front.points],
        "peak torque [share of its limit]": [point.peak_torque for point in front.points],
    }
    for panel, (label, values) in zip(panels, columns.items(), strict=True):
        (line,) = panel.plot(time, values)
        faces = [line.get_color() if certified else "none" for certified in good]
        panel.scatter(time, values, facecolors=faces, edgecolors=line.get_color())
        panel.locator_params(axis="x", nbins=5)
        panel.set(xlabel="duration [s]", ylabel=label, ylim=(0.0, 1.08 * float(np.max(values))))
    return panels
