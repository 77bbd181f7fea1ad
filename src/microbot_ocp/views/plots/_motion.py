"""One motion or one simulation against time."""

from __future__ import annotations

from collections.abc import Sequence

from microbot_ocp._base.checks import InputError
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.motion import Motion
from microbot_ocp.robot import JointLimits, Limits, Robot
from microbot_ocp.simulation import Simulation
from microbot_ocp.views.plots._curve import Curve
from microbot_ocp.views.plots._curves import curves
from microbot_ocp.views.plots._page import AxesGrid


def motion(
    robot: Robot,
    motion: Motion | Sequence[Motion],
    axes: GivenAxes | None = None,
    *,
    quantities: Sequence[str] = ("q", "qd", "tau"),
    joints: Sequence[int] | None = None,
    limits: Limits | JointLimits | None = None,
) -> AxesGrid:
    """Position, velocity and torque of one motion, or of several over each other.

    Parameters
    ----------
    robot : Robot
    motion : Motion or sequence of Motion
    axes : array of Axes [quantities, joints], optional
        Default a new figure.
    quantities : sequence of str
        Of "q", "qd", "qdd", "tau", or the key of another limit, such as "taud" or "tool_speed".
    joints : sequence of int, optional
        Indices from 0; default all.
    limits : Limits, optional
        Default the robot's own.

    Returns
    -------
    AxesGrid [quantities, joints]
        Dots are at the times of marks; a motion that was not solved is named in red.

    Raises
    ------
    InputError
        A motion of another number of joints, a quantity or joint that is not there, axes of
        another shape.
    """
    motions = [motion] if isinstance(motion, Motion) else list(motion)
    for each in motions:
        _same_joints("motion", each.joint_count, robot)
    robot = robot if limits is None else robot.with_limits(limits)
    return curves(
        robot,
        [Curve.of(each, robot=robot, quantities=quantities) for each in motions],
        quantities,
        axes,
        joints=joints,
        limits=robot.limits,
        title=f"{robot.name}: {motions[0].label}" if len(motions) == 1 else robot.name,
    )


def simulation(
    robot: Robot,
    simulation: Simulation,
    axes: GivenAxes | None = None,
    *,
    quantities: Sequence[str] = ("q", "qd", "tau"),
    joints: Sequence[int] | None = None,
) -> AxesGrid:
    """What a simulated arm did, with the limits of the robot.

    Parameters and result as :func:`motion`.
    """
    _same_joints("simulation", simulation.q.shape[1], robot)
    return curves(
        robot,
        [Curve.of(simulation, robot=robot, quantities=quantities)],
        quantities,
        axes,
        joints=joints,
        limits=robot.limits,
        title=f"{robot.name}: {getattr(simulation, 'label', '') or 'simulation'}",
    )


def _same_joints(name: str, count: int, robot: Robot) -> None:
    if count != robot.joint_count:
        raise InputError(f"{name} has {count} joints, but the robot has {robot.joint_count}")
