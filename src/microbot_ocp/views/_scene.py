"""What figures and recordings both draw: the arm, its via points, the limits near its curves."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.fast_calls import buffered_call
from microbot_ocp.comparison import Comparison, Entry
from microbot_ocp.limits import JOINT_QUANTITIES, LimitFamily
from microbot_ocp.motion import Motion
from microbot_ocp.planning import reach_of
from microbot_ocp.robot import JointLimits, Robot, forward_kinematics, frame_origins

VIA_TOLERANCE = 0.02  # rad or m: how near a mark's position must be to its via point
LIMIT_STRETCH = 2.0  # a limit that would stretch the data's axis by more is named, not drawn
QUANTITIES = ("q", "qd", "tau")
POSITIONS = ("q", "error")  # drawn in degrees for revolute joints


class Passage(NamedTuple):
    """A via point (index from 0) and when a motion passes it, s."""

    via: int
    time: float


class SolvedEntry(NamedTuple):
    """An entry together with the motion that it has."""

    entry: Entry
    motion: Motion


def solved_entries(comparison: Comparison) -> list[SolvedEntry]:
    """The entries that have a motion, in their order."""
    return [SolvedEntry(e, e.motion) for e in comparison.entries if e.motion is not None]


def link_origins(robot: Robot, q: FloatArray) -> FloatArray:
    """Origins [N,n+2,3] of the base, every link frame and the tool at positions q [N,n], m."""
    columns = buffered_call(frame_origins(robot).map(len(q)))(q.T)
    return columns.T.reshape(len(q), robot.joint_count + 2, 3)


def link_poses(robot: Robot, q: FloatArray) -> FloatArray:
    """Poses [N,n+2,4,4] of the base, every link frame and the tool in the base frame at q [N,n]."""
    count = robot.joint_count + 2
    columns = buffered_call(_poses(robot).map(len(q)))(q.T)
    return columns.T.reshape(len(q), count, 4, 4).transpose(0, 1, 3, 2)


@lru_cache(maxsize=64)
def _poses(robot: Robot) -> ca.Function:
    """``(q[n]) -> T[4, 4 (n+2)]``, all poses side by side."""
    q = ca.SX.sym("q", robot.joint_count)
    poses = [forward_kinematics(robot, frame)(q) for frame in range(robot.joint_count + 2)]
    return ca.Function("poses", [q], [ca.cse(ca.densify(ca.horzcat(*poses)))])


def reach(robot: Robot) -> float:
    """Length of the chain stretched out, m: the scale of everything that is drawn."""
    return reach_of(robot)


def via_passages(comparison: Comparison, motion: Motion) -> list[Passage]:
    """When the motion passes each via point: its ends, and the marks at which it is at a via point.

    A via point without a mark near it is left out.
    """
    last = len(comparison.via_q) - 1
    inner = []
    times = np.clip([mark.time for mark in motion.marks], 0.0, motion.duration)
    if times.size:
        q = motion.sample(times).q
        for via in range(1, last):
            distance = np.abs(q - comparison.via_q[via]).max(axis=1)
            nearest = int(distance.argmin())
            if distance[nearest] < VIA_TOLERANCE:
                inner.append(Passage(via, float(times[nearest])))
    return [Passage(0, 0.0), *inner, Passage(last, motion.duration)]


def display_factor(robot: Robot, quantity: str, joint: int) -> float:
    """Factor from stored to drawn units: revolute positions in degrees, linear errors in mm."""
    if _in_degrees(robot, quantity, joint):
        return 180.0 / np.pi
    return 1000.0 if quantity == "error" else 1.0


def display_unit(robot: Robot, quantity: str, joint: int) -> str:
    """Unit in which a quantity of a joint (0-based) is drawn."""
    if _in_degrees(robot, quantity, joint):
        return "deg"
    if quantity == "error":
        return "mm"
    if quantity in JOINT_QUANTITIES:
        return robot.unit(quantity, joint)
    return LimitFamily.of(robot)[quantity].units[joint]


def of_joints(robot: Robot, quantity: str) -> bool:
    """Whether a quantity has one value a joint, not one for the arm."""
    family = LimitFamily.of(robot)
    return quantity not in family or family[quantity].labels == robot.joint_names


def limit_texts(robot: Robot, quantity: str) -> list[str]:
    """A robot's limits of a quantity by joint or component, with units; "" for none.

    Such as "±2 rad/s", "at most 1 m/s", "varies".
    """
    family = LimitFamily.of(robot)
    if quantity not in family:
        return [""] * robot.joint_count
    texts = []
    for k, bounds in enumerate(zip(family[quantity].lower, family[quantity].upper, strict=True)):
        low, high = np.multiply(bounds, display_factor(robot, quantity, k))
        unit = display_unit(robot, quantity, k)
        if np.isnan(low) or np.isnan(high):
            texts.append("varies")
        elif np.isinf(low) and np.isinf(high):
            texts.append("")
        elif np.isinf(low):
            texts.append(f"at most {high:.4g} {unit}")
        elif np.isinf(high):
            texts.append(f"at least {low:.4g} {unit}")
        else:
            both = f"±{high:.4g}" if np.isclose(low, -high) else f"{low:.4g} to {high:.4g}"
            texts.append(f"{both} {unit}")
    return texts


def _in_degrees(robot: Robot, quantity: str, joint: int) -> bool:
    return quantity in POSITIONS and robot.joint_types[joint] == "revolute"


class AxisLimits(NamedTuple):
    """Limits of one quantity of one joint in drawn units, and the range of an axis that shows them.

    ``lower`` and ``upper`` are None where there is no limit or it is far from the data; ``far``
    names the far ones, such as "limits ±360 deg".
    """

    lower: float | None
    upper: float | None
    axis: tuple[float, float]
    far: str


def near_limits(
    robot: Robot, limits: JointLimits | None, quantity: str, joint: int, values: FloatArray
) -> AxisLimits:
    """Range of values [N] in stored units with the limits near enough to be drawn beside them.

    What is not finite is left out; a bound that varies along the motion is a curve of its own.
    """
    factor = display_factor(robot, quantity, joint)
    low, high = _data_range(values * factor)
    lower, upper = -np.inf, np.inf
    if limits is not None and quantity in (family := LimitFamily.of(robot, limits)):
        bounds = family[quantity].lower[joint], family[quantity].upper[joint]
        lower, upper = (float(bound) * factor for bound in bounds)
    span = max(high - low, 1e-9)
    near_lower = np.isfinite(lower) and high - lower <= LIMIT_STRETCH * span
    near_upper = np.isfinite(upper) and upper - low <= LIMIT_STRETCH * span
    axis_low = min(low, lower) if near_lower else low
    axis_high = max(high, upper) if near_upper else high
    margin = 0.06 * max(axis_high - axis_low, 1e-6)
    return AxisLimits(
        lower if near_lower else None,
        upper if near_upper else None,
        (axis_low - margin, axis_high + margin),
        _far_limits(
            None if near_lower else lower,
            None if near_upper else upper,
            display_unit(robot, quantity, joint),
        ),
    )


def _data_range(values: FloatArray) -> tuple[float, float]:
    values = values[np.isfinite(values)]
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    if high - low > 1e-6 * max(1.0, abs(low)):
        return low, high
    return low - 0.5, high + 0.5  # a joint at rest: an axis needs some height


def _far_limits(lower: float | None, upper: float | None, unit: str) -> str:
    known = [
        (side, value)
        for side, value in (("lower", lower), ("upper", upper))
        if value is not None and np.isfinite(value)
    ]
    if len(known) == 2 and np.isclose(known[0][1], -known[1][1]):
        return f"limits ±{known[1][1]:.4g} {unit}"
    if len(known) == 2:
        return f"limits {known[0][1]:.3g} to {known[1][1]:.3g} {unit}".replace("-", "−")
    named = " and ".join(f"{side} limit {value:+.4g} {unit}" for side, value in known)
    return named.replace("-", "−")
