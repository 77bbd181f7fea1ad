"""How far controllers let an arm stray from its reference, and with which torques."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from microbot_ocp._base.checks import InputError
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.simulation import Tracking
from microbot_ocp.views.plots._curve import Curve
from microbot_ocp.views.plots._curves import curves
from microbot_ocp.views.plots._page import AxesGrid


def tracking(
    robot: Robot,
    trackings: Tracking | Sequence[Tracking] | Mapping[str, Tracking],
    axes: GivenAxes | None = None,
    *,
    quantities: Sequence[str] = ("error", "tau"),
    joints: Sequence[int] | None = None,
    title: str = "",
) -> AxesGrid:
    """Errors and torques of one controller, or of several over each other.

    Parameters
    ----------
    robot : Robot
    trackings : Tracking, sequence of Tracking or mapping from a label to Tracking
        Named by their own ``label`` where no other is given.
    axes : array of Axes [quantities, joints], optional
        Default a new figure.
    quantities : sequence of str
        Of "error" (reference less position, deg, prismatic: mm), "tau", "q", "qd", "qdd", or the
        key of another limit, such as "tool_speed".
    joints : sequence of int, optional
        Indices from 0; default all.
    title : str
        Of a new figure; default the robot and its controller.

    Returns
    -------
    AxesGrid [quantities, joints]
        The torque limits are those of the drives, dotted in the colour of the curve where the
        curves have different ones. Where a torque is at its limit the axes are shaded in the colour
        of the curve; several share the height.

    Raises
    ------
    InputError
        No tracking, one of another number of joints, a quantity or joint that is not there, axes
        of another shape.
    """
    if isinstance(trackings, Tracking):
        runs = [(trackings.label, trackings)]
    elif isinstance(trackings, Mapping):
        runs = list(trackings.items())
    else:
        runs = [(run.label, run) for run in trackings]
    if not runs:
        raise InputError("trackings must hold at least one tracking")
    for label, run in runs:
        if run.q.shape[1] != robot.joint_count:
            raise InputError(
                f"tracking {label!r} has {run.q.shape[1]} joints, "
                f"but the robot has {robot.joint_count}"
            )
    return curves(
        robot,
        [Curve.of(run, label, robot=robot, quantities=quantities) for label, run in runs],
        quantities,
        axes,
        joints=joints,
        limits=_common_limits(robot, [run for _, run in runs]),
        title=title or f"{robot.name}: tracking" + (f", {runs[0][0]}" if len(runs) == 1 else ""),
    )


def _common_limits(robot: Robot, runs: Sequence[Tracking]) -> JointLimits:
    """The robot's, with the torque limits of the drives; none of torque where they differ."""
    lower, upper = runs[0].torque_limits
    if any(not np.array_equal(run.torque_limits, (lower, upper)) for run in runs):
        lower, upper = np.full_like(lower, -np.inf), np.full_like(upper, np.inf)
    return replace(robot.limits, tau_min=lower, tau_max=upper)
