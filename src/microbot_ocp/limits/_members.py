"""Further limits: a line in :data:`MEMBERS` makes one known to files and the command line."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from microbot_ocp._base.checks import InputError, shown
from microbot_ocp.limits._limit import Bound, Limit, above_zero


def tool_speed(upper: Bound) -> Limit:
    """Limit the speed of the tool's origin in the base frame.

    Parameters
    ----------
    upper : float or callable
        m/s, or an expression of the motion's state: a lower speed in a zone, for example.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot").with_limits(also=[mo.limits.tool_speed(upper=1.0)])
    """
    return _of_tool("tool speed", "tool_velocity", upper, "m/s")


def tool_acceleration(upper: Bound) -> Limit:
    """Limit the size of the acceleration of the tool's origin in the base frame.

    Parameters
    ----------
    upper : float or callable
        m/s^2, or an expression of the motion's state.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot").with_limits(also=[mo.limits.tool_acceleration(20.0)])
    """
    return _of_tool("tool acceleration", "tool_acceleration", upper, "m/s^2")


def tool_jerk(upper: Bound) -> Limit:
    """Limit the size of the jerk of the tool's origin in the base frame.

    Parameters
    ----------
    upper : float or callable
        m/s^3, or an expression of the motion's state.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot").with_limits(also=[mo.limits.tool_jerk(500.0)])
    """
    return _of_tool("tool jerk", "tool_jerk", upper, "m/s^3")


def _of_tool(name: str, quantity: str, upper: Bound, unit: str) -> Limit:
    return Limit(name, _Size(quantity), upper=above_zero(name, upper, unit), unit=unit)


@dataclass(frozen=True)
class _Size:
    """The size of the linear part of a quantity of the tool."""

    quantity: str

    def __call__(self, state: Any) -> Any:
        linear = getattr(state, self.quantity)[:3]
        return (linear.T @ linear) ** 0.5


def power(upper: Bound = None, lower: Bound = None) -> Limit:
    """Limit the mechanical power ``tau qd`` of every joint.

    Parameters
    ----------
    upper, lower : float, array_like [n] or callable, optional
        W; a lower bound limits what a joint feeds back when it brakes.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot").with_limits(also=[mo.limits.power([300.0, 400.0, 150.0])])
    """
    return Limit("power", _power, lower=lower, upper=upper, unit="W")


def total_power(upper: Bound = None, lower: Bound = None) -> Limit:
    """Limit the sum of the mechanical powers of all joints.

    Parameters
    ----------
    upper, lower : float or callable, optional
        W; a lower bound limits what the arm feeds back when it brakes.
    """
    return Limit("total power", _total_power, lower=lower, upper=upper, unit="W")


def _power(state):
    return state.tau * state.qd


def _total_power(state):
    return state.tau.T @ state.qd


def rms_torque(upper: Bound, dwell: float = 0.0) -> Limit:
    """Limit the root mean square of every joint's torque over a motion and a rest after it.

    An integral over the whole motion: :func:`microbot_ocp.time_optimal` through joint poses keeps
    it and certificates judge it; every other planner refuses it.

    Parameters
    ----------
    upper : float or array_like [n]
        N m (N).
    dwell : float
        Rest at the end in each cycle, s; the arm is held against gravity.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> robot = robot.with_limits(also=[mo.limits.rms_torque([150.0, 250.0, 120.0], dwell=1.0)])
    """
    return Limit("rms torque", _torque, upper=upper, unit="N m", rms=True, dwell=dwell)


def _torque(state):
    return state.tau


MEMBERS: dict[str, Callable[..., Limit]] = {
    member.__name__: member
    for member in (tool_speed, tool_acceleration, tool_jerk, power, total_power, rms_torque)
}
# Keys in files: "tool_speed_max", and "power_min" where there may be a lower bound.
MEMBER_KEYS = {
    f"{name}_{end}": (name, side)
    for name, member in MEMBERS.items()
    for side, end in (("lower", "min"), ("upper", "max"))
    if side in inspect.signature(member).parameters
}


def limits_from_table(table: Mapping[str, Any]) -> tuple[Limit, ...]:
    """Read further limits from the keys of :data:`MEMBER_KEYS`, with numbers or lists of them."""
    bounds: dict[str, dict[str, Any]] = {}
    for key, value in table.items():
        name, side = MEMBER_KEYS[key]
        bounds.setdefault(name, {})[side] = value
    return tuple(MEMBERS[name](**sides) for name, sides in bounds.items())


def changes_by_name(limits: Iterable[Limit], named: Mapping[str, Any]) -> dict[str, Any]:
    """Return what ``robot.with_limits`` takes of limits of joints and further ones.

    Those of :data:`MEMBER_KEYS` are added to ``limits``, or stand in the place of the same names.
    """
    changes = {key: value for key, value in named.items() if key not in MEMBER_KEYS}
    if further := limits_from_table({k: v for k, v in named.items() if k in MEMBER_KEYS}):
        names = {limit.key for limit in further}
        changes["also"] = (*(limit for limit in limits if limit.key not in names), *further)
    return changes


def limits_to_table(limits: Iterable[Limit]) -> dict[str, Any]:
    """Return the keys and numbers that :func:`limits_from_table` reads back.

    Raises
    ------
    InputError
        A limit of the user's own, or a bound that is an expression: files hold numbers only.
    """
    table: dict[str, Any] = {}
    for limit in limits:
        if not isinstance(limit, Limit):
            raise InputError(f"limits must be a list, each entry a Limit, not {shown(limits)}")
        sides = {side: limit.constant(side) for side in ("lower", "upper")}
        given = {side: value for side, value in sides.items() if value is not None}
        written = {
            key: given[side].item() if given[side].size == 1 else given[side].tolist()
            for key, (name, side) in MEMBER_KEYS.items()
            if name == limit.key and side in given
        }
        if not written or limits_from_table(written) != (limit,):
            raise InputError(
                f"limit {limit.name!r} is an expression of its own, which a file cannot hold: "
                "add it in Python after loading"
            )
        table |= written
    return table
