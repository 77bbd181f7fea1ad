"""Common data of figures and recordings: poses of the arm, via points, limits near the curves."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.fast_calls import buffered_call
from microbot_ocp.limits import JOINT_QUANTITIES, LimitFamily
from microbot_ocp.motion import Motion
from microbot_ocp.robot import JointLimits, Robot, frame_origins, link_poses as link_kinematics

if TYPE_CHECKING:
    from microbot_ocp.tasks import Comparison, Entry

# Factor by which a limit may stretch an axis; a limit beyond it is named, not drawn.
LARGEST_STRETCH = 2.0
AXIS_MARGIN = 0.06  # margin of an axis, relative to its data
QUANTITIES = ("q", "qd", "tau")
POSITIONS = ("q", "error")  # drawn in degrees for revolute joints
SIDES = {1: "upper ", -1: "lower ", 0: ""}


def solved_entries(comparison: Comparison) -> list[tuple[Entry, Motion]]:
    """Return the entries with a motion, in the order of the comparison."""
    return [(e, e.motion) for e in comparison.entries if e.motion is not None]


def link_origins(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the origins [N,links+2,3] of base, link frames and tool at q [N,n], m."""
    columns = buffered_call(frame_origins(robot).map(len(q)))(q.T)
    return columns.T.reshape(len(q), robot.link_count + 2, 3)


def tool_places(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the tool positions [N,3] at joint positions q [N,n], m."""
    return link_origins(robot, q)[:, -1]


def link_poses(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the poses [N,links+2,4,4] of base, link frames and tool in the base frame."""
    columns = buffered_call(link_kinematics(robot).map(len(q)))(q.T)
    links = columns.T.reshape(len(q), -1, 4, 4).transpose(0, 1, 3, 2)
    return np.concatenate([links, links[:, -1:] @ robot.tool], axis=1)


def reach(robot: Robot) -> float:
    """Return the length of the stretched chain, m, which is the unit of all drawn sizes."""
    from microbot_ocp.planning.task import reach_of

    return reach_of(robot)


def via_passages(comparison: Comparison, motion: Motion) -> list[float]:
    """Return the times of the via points of a motion, s: its ends, and marks at inner via points.

    An inner via point counts only if the motion at a mark is closer to it than 0.02 rad or m.
    """
    inner, times = [], np.clip([mark.time for mark in motion.marks], 0.0, motion.duration)
    for via in comparison.via_q[1:-1] if times.size else ():
        distance = np.abs(motion.sample(times).q - via).max(axis=1)
        if distance.min() < 0.02:
            inner.append(float(times[distance.argmin()]))
    return [0.0, *inner, motion.duration]


def display_factor(robot: Robot, quantity: str, joint: int) -> float:
    """Return the factor from stored to drawn units: revolute positions in degrees, errors in mm."""
    if _in_degrees(robot, quantity, joint):
        return 180.0 / np.pi
    return 1000.0 if quantity == "error" else 1.0


def display_unit(robot: Robot, quantity: str, joint: int) -> str:
    """Return the unit in which a quantity of a joint (0-based) is drawn."""
    if _in_degrees(robot, quantity, joint):
        return "deg"
    if quantity in JOINT_QUANTITIES:
        return robot.unit(quantity, joint)
    return "mm" if quantity == "error" else LimitFamily.of(robot)[quantity].units[joint]


def _in_degrees(robot: Robot, quantity: str, joint: int) -> bool:
    return quantity in POSITIONS and robot.joint_types[joint] == "revolute"


def of_joints(robot: Robot, quantity: str) -> bool:
    """Return whether a quantity has one value per joint, not one value for the arm."""
    family = LimitFamily.of(robot)
    return quantity not in family or family[quantity].labels == robot.joint_names


def drawn_bounds(
    robot: Robot, limits: JointLimits | None, quantity: str, joint: int
) -> tuple[float, float]:
    """Return the lower and upper limit of a joint or component in drawn units; ±inf without."""
    if limits is None or quantity not in (family := LimitFamily.of(robot, limits)):
        return -np.inf, np.inf
    factor = display_factor(robot, quantity, joint)
    lower, upper = family[quantity].lower[joint], family[quantity].upper[joint]
    return factor * float(lower), factor * float(upper)


def limit_texts(robot: Robot, quantity: str) -> list[str]:
    """Return the limits of a quantity per joint or component as text with units; "" without."""
    family = LimitFamily.of(robot)
    if quantity not in family:
        return [""] * robot.joint_count
    return [
        range_text(
            *drawn_bounds(robot, robot.limits, quantity, k), display_unit(robot, quantity, k)
        )
        for k in range(len(family[quantity].lower))
    ]


def range_text(
    low: float, high: float, unit: str = "", show: Callable[[float], str] = "{:.4g}".format
) -> str:
    """Format a range: "±2 rad/s", "0 to 2 rad/s", "at most 1 m/s"; "" without bounds.

    NaN stands for a bound that varies along the motion and gives "varies".
    """
    if np.isnan(low) or np.isnan(high):
        return "varies"
    if np.isinf(low) and np.isinf(high):
        return ""
    if np.isinf(low) or np.isinf(high):
        text = f"at most {show(high)}" if np.isinf(low) else f"at least {show(low)}"
    else:
        text = f"±{show(high)}" if np.isclose(low, -high) else f"{show(low)} to {show(high)}"
    return f"{text} {unit}".rstrip()


def limit_text(subject: str, side: int, exceeded: bool = False) -> str:
    """Return a text such as "torque of elbow at its upper limit"; side 0 names no side.

    Every figure, table and recording names a quantity at its limit by this text.
    """
    return f"{subject} {'beyond' if exceeded else 'at'} its {SIDES[side]}limit"


def limit_title(column: str, joints: Sequence[str]) -> str:
    """Return the title of a limit by its column of a sweep: "torque of elbow" for "tau_elbow"."""
    titles = {
        f"{key}_" + re.sub(r"\W+", "_", joint): f"{quantity.name} of {joint}"
        for key, quantity in JOINT_QUANTITIES.items()
        for joint in joints
    }
    return titles.get(column, column.replace("_", " "))


class AxisLimits(NamedTuple):
    """Limits of one quantity of one joint in drawn units, and the range of the axis.

    ``lower`` and ``upper`` are None without a limit or if the limit is far from the data; ``far``
    is a text on the far limits, such as "limits ±360 deg".
    """

    lower: float | None
    upper: float | None
    axis: tuple[float, float]
    far: str


def is_near(bound: float, low: float, high: float) -> bool:
    """Return whether a bound is close enough to the range low to high to be drawn."""
    span = max(high - low, ROUNDING)
    return bool(np.isfinite(bound)) and max(high, bound) - min(low, bound) <= LARGEST_STRETCH * span


def near_limits(
    robot: Robot, limits: JointLimits | None, quantity: str, joint: int, values: FloatArray
) -> AxisLimits:
    """Return the axis range for values [N] (stored units) and the limits to draw in it.

    Values that are not finite are ignored. A bound that varies along the motion is not included: it
    is drawn as a curve.
    """
    low, high = data_range(values * display_factor(robot, quantity, joint))
    bounds = drawn_bounds(robot, limits, quantity, joint)
    lower, upper = (bound if is_near(bound, low, high) else None for bound in bounds)
    drawn = [low, high, *(bound for bound in (lower, upper) if bound is not None)]
    margin = AXIS_MARGIN * (max(drawn) - min(drawn))
    far = [np.nan if bound in drawn else bound for bound in bounds]
    unit = display_unit(robot, quantity, joint)
    if np.isfinite(far).all():
        digits = 4 if np.isclose(far[0], -far[1]) else 3
        text = f"limits {range_text(*bounds, unit, lambda bound: f'{bound:.{digits}g}')}"
    else:
        named = (p for p in zip(("lower", "upper"), far, strict=True) if np.isfinite(p[1]))
        text = "".join(f"{side} limit {bound:+.4g} {unit}" for side, bound in named)
    axis = min(drawn) - margin, max(drawn) + margin
    return AxisLimits(lower, upper, axis, text.replace("-", "−"))


def data_range(values: FloatArray) -> tuple[float, float]:
    """Return the least and the largest finite value, apart also for constants or no values."""
    values = values[np.isfinite(values)]
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    if high - low > 1e-6 * max(1.0, abs(low)):
        return low, high
    return low - 0.5, high + 0.5  # constant values still need an axis with a height
