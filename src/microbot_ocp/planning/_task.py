"""What every time-optimal solve checks of its task before a solver starts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LimitUse
from microbot_ocp.motion import State, torque_along
from microbot_ocp.ocp.solution import Solution
from microbot_ocp.robot import JointLimits, Limits, Robot, gravity_torque, torque_and_rate

MOST_EXCESS = 5e-3  # relative, over any limit between mesh points


def verdict(solution: Solution, excess: Sequence[FloatArray], violation: float) -> dict[str, Any]:
    """Status, advice and largest excess of a limit between mesh points, for the provenance.

    A solver that converged on the mesh points is not believed where limits are exceeded in between
    by more than a certificate lets pass.
    """
    worst = max(float(e.max()) for e in excess)
    found = {"status": str(solution.status), "advice": solution.advice, "excess": worst}
    if solution.status.solved and worst > max(violation, MOST_EXCESS):
        found["status"] = str(Status.LIMITS_EXCEEDED)
        found["advice"] = (
            f"limits are exceeded by {100 * worst:.3g} % between mesh points, and refinement ended "
            "there: give a finer mesh, or look for a place that cannot be passed"
        )
    return found


def whole(name: str, value: Any, unit: str = "", *, at_least: int) -> None:
    """Raise InputError where a setting is not a whole number of at least so many."""
    checks.number(name, value, unit, at_least=at_least)
    if not isinstance(value, int | np.integer):
        raise InputError(f"{name} must be a whole number, not {value}")


def check_limits(robot: Robot, limits: Limits | JointLimits | None) -> JointLimits:
    """Limits as arrays; some of them must bound the speed of a motion."""
    chosen = robot.limits if limits is None else limits.for_joints(robot.joint_count)
    for joint in range(robot.joint_count):
        bounded = [
            np.isfinite(chosen.bounds(quantity)[side][joint])
            for quantity in ("qd", "qdd", "tau")
            for side in (0, 1)
        ]
        if not any(bounded):
            raise InputError(
                f"limits leave joint {robot.joint_names[joint]!r} without any bound on its "
                "velocity, acceleration or torque: its shortest time would be zero"
            )
    return chosen


def check_via(robot: Robot, via_q: ArrayLike, limits: JointLimits) -> FloatArray:
    """Via points [m,n], m >= 2, within the position limits, the first and last one holdable.

    Raises
    ------
    InputError
        Wrong width, not finite, a point outside the position limits, two equal points in a row, a
        pose of rest that gravity alone makes impossible.
    """
    via = checks.array("via_q", via_q, (None, robot.joint_count), "rad")
    if via.shape[0] < 2:
        raise InputError(f"via_q must have at least 2 points, not {via.shape[0]}")
    for index, point in enumerate(via):
        check_position(robot, f"via point {index + 1}", point, limits)
        if index and np.array_equal(point, via[index - 1]):
            raise InputError(
                f"via points {index} and {index + 1} are the same: the time between them would "
                "be a duration of zero"
            )
    for index in (0, via.shape[0] - 1):
        check_rest(robot, f"via point {index + 1}", via[index], limits)
    return via


def check_position(robot: Robot, what: str, q: FloatArray, limits: JointLimits) -> None:
    """Raise InputError where a pose is outside the position limits."""
    slack = 1e-9
    for joint, (value, low, high) in enumerate(zip(q, limits.q_min, limits.q_max, strict=True)):
        if value < low - slack or value > high + slack:
            raise InputError(
                f"{what} is outside the position limits: joint {robot.joint_names[joint]!r} at "
                f"{describe(robot, joint, value)}, allowed {describe(robot, joint, low)} to "
                f"{describe(robot, joint, high)}"
            )


def check_rest(robot: Robot, what: str, q: FloatArray, limits: JointLimits) -> None:
    """Raise InputError where gravity alone asks for more torque than a joint has."""
    needed = np.array(gravity_torque(robot)(q)).ravel()
    for joint, (value, low, high) in enumerate(
        zip(needed, limits.tau_min, limits.tau_max, strict=True)
    ):
        if value < low or value > high:
            unit = robot.unit("tau", joint)
            raise InputError(
                f"{what} cannot be held at rest: joint {robot.joint_names[joint]!r} needs "
                f"{value:.6g} {unit} against gravity, allowed {low:.6g} to {high:.6g} {unit}"
            )


def limit_excess(robot: Robot, state: State, qddd: FloatArray) -> FloatArray:
    """Largest relative excess [N] over any limit; negative inside them.

    ``qddd`` [N,n] is the jerk, of interest to torque rates only.
    """
    values = {**state._asdict(), "tau": torque_along(robot, state)}
    if np.isfinite([robot.limits.taud_min, robot.limits.taud_max]).any():
        values["taud"] = np.array(torque_and_rate(robot)(*(v.T for v in (*state, qddd)))[1]).T
    excess = np.full(state.q.shape[0], -1.0)
    for quantity, value in values.items():
        use = LimitUse.of(robot.limits, quantity)
        if use.limited.any():
            excess = np.maximum(excess, use(value).max(axis=1) - 1.0)
    return excess


def finite_scale(lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Sizes [n] of limits, 1 where there is none."""
    size = np.maximum(np.abs(lower), np.abs(upper))
    return np.where(np.isfinite(size) & (size > 0), size, 1.0)


def describe(robot: Robot, joint: int, value: float) -> str:
    """A joint position with its unit: degrees for a revolute joint, metres for a prismatic one."""
    if robot.joint_types[joint] == "prismatic":
        return f"{value:g} m"
    return f"{np.degrees(value):g} deg"
