"""The arm itself: its links at one or several joint positions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from microbot_ocp import checks
from microbot_ocp.robot import Robot
from microbot_ocp.views import scene
from microbot_ocp.views.joint_plots import LOOKS
from microbot_ocp.views.plots import HALO, SETTINGS, azimuth, equal_box, page

SIZE = (8.6, 6.2)  # inches
TICKS = 6  # along the longest axis


def arms_figure(
    robot: Robot,
    poses: Mapping[str, ArrayLike],
    *,
    title: str = "",
    target: ArrayLike | None = None,
) -> Figure:
    """The arm in space at several joint positions, with one scale for all three directions.

    Parameters
    ----------
    robot : Robot
    poses : mapping from a label to array_like [n]
        Joint positions, rad (prismatic: m).
    title : str
        Default the robot's name.
    target : array_like [3], optional
        A point to mark, in the base frame, m.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        No pose, or one of another width or not finite.
    """
    if not poses:
        raise checks.InputError("poses must hold at least one pose")
    shape = (robot.joint_count,)
    q = np.array([checks.array(f"pose {k!r}", v, shape, "rad") for k, v in poses.items()])
    arms = scene.link_origins(robot, q)
    with matplotlib.rc_context(SETTINGS):
        figure = page(title or robot.name, SIZE)
        axes: Any = figure.add_subplot(projection="3d")
        for place, (label, arm) in enumerate(zip(poses, arms, strict=True)):
            color, dashes = LOOKS[place % len(LOOKS)]
            axes.plot(*arm.T, color=color, linestyle=dashes, linewidth=3.0, marker="o", label=label)
        drawn = arms.reshape(-1, 3)
        if target is not None:
            point = checks.array("target", target, (3,), "m")
            axes.plot(*point[:, None], "k*", markersize=13, zorder=8, label="target")
            drawn = np.vstack([drawn, point])
        axes.text(*arms[0, 0], "  base", path_effects=HALO, zorder=8)
        equal_box(axes, drawn)
        axes.set(xlabel="x [m]", ylabel="y [m]")
        axes.zaxis.set_rotate_label(False)  # matplotlib's own choice may stand on its head
        axes.set_zlabel("z [m]", rotation=90)
        for axis, span in zip("xyz", np.ptp(drawn, axis=0), strict=True):
            ticks = max(2, round(TICKS * span / np.ptp(drawn, axis=0).max()))
            axes.locator_params(axis, nbins=ticks)
        axes.view_init(elev=22, azim=azimuth(arms[:, -1]) - 40)
        figure.legend(loc="outside lower center", ncols=3, frameon=False, handlelength=3.6)
    return figure
