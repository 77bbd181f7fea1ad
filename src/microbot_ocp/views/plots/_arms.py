"""The arm itself: its links at one or several joint positions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from mpl_toolkits.mplot3d import Axes3D
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.robot import Robot
from microbot_ocp.views import _scene as scene
from microbot_ocp.views._style import STYLE, look
from microbot_ocp.views.plots._page import ShownAxes3D, axes_page, halo, styled
from microbot_ocp.views.plots._paths import azimuth, set_space


@styled()
def arms(
    robot: Robot,
    poses: Mapping[str, ArrayLike],
    axes: GivenAxes | None = None,
    *,
    title: str = "",
    target: ArrayLike | None = None,
) -> Axes3D:
    """The arm in space at several joint positions, with one scale for all three directions.

    Parameters
    ----------
    robot : Robot
    poses : mapping from a label to array_like [n]
        Joint positions, rad (prismatic: m). Of poses that give one shape the first is wide, and the
        others lie dashed over it.
    axes : Axes3D, optional
        Default a new figure.
    title : str
        Of a new figure; default the robot's name.
    target : array_like [3], optional
        A point to mark, in the base frame, m.

    Returns
    -------
    Axes3D

    Raises
    ------
    InputError
        No pose, or one of another width or not finite; axes without a third dimension.
    """
    if not poses:
        raise checks.InputError("poses must hold at least one pose")
    shape = (robot.joint_count,)
    q = np.array([checks.array(f"pose {k!r}", v, shape, "rad") for k, v in poses.items()])
    drawn_arms = scene.link_origins(robot, q)
    point = None if target is None else checks.array("target", target, (3,), "m")
    size, space = (STYLE.width, 2.7 * STYLE.row), {"axes_class": ShownAxes3D}
    page = axes_page(axes, 1, 1, size=size, title=title or robot.name, subplot_kw=space)
    panel: Any = page.axes[0, 0]
    if not isinstance(panel, Axes3D):
        raise checks.InputError("axes must be three-dimensional, projection='3d'")
    alike = np.abs(drawn_arms[:, None] - drawn_arms).max(axis=(2, 3)) < 1e-3 * scene.reach(robot)
    for place, (label, arm) in enumerate(zip(poses, drawn_arms, strict=True)):
        line = look(place)
        if not alike[place, :place].any():  # else it lies dashed over another one
            line["linestyle"] = "solid"
        hidden = int(alike[place, place + 1 :].sum())  # arms of the same shape that lie over it
        line |= {"linewidth": 2.5 + 4.0 * hidden, "markersize": 6.0 + 3.0 * hidden}
        panel.plot(*arm.T, marker="o", label=label, zorder=3 + place, **line)
    drawn = drawn_arms.reshape(-1, 3)
    if point is not None:
        panel.plot(*point[:, None], "k*", markersize=13, zorder=8, label="target")
        drawn = np.vstack([drawn, point])
    x, y, z = drawn_arms[0, 0]
    panel.text(x, y, z, "  base", path_effects=halo(), zorder=8)
    set_space(panel, drawn)
    spans, each = np.ptp(drawn, axis=0), ("x", "y", "z")
    for axis, span in zip(each, spans, strict=True):  # six ticks along the longest axis
        ticks: Any = {"axis": axis, "nbins": max(2, round(6 * span / spans.max()))}
        panel.locator_params(**ticks)
    panel.view_init(elev=22, azim=azimuth(drawn_arms[:, -1]) - 40)
    page.legend(panel.get_legend_handles_labels()[0], 3)
    return panel
