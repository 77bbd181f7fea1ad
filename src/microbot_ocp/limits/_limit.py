"""Limits as data: a name, a unit, an expression of the motion's state, bounds; and usual ones.

A line in :data:`MEMBERS` makes a limit known to files and the command line.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError

Expression = Callable[[Any], Any]  # a motion's state -> a CasADi expression or a number
Bound = ArrayLike | Expression | None


def above_zero(name: str, bound: Bound, unit: str) -> Bound:
    """Return an upper bound of what is never negative; InputError for one that allows nothing."""
    if bound is None or callable(bound):
        return bound
    if np.any(checks.numbers(f"upper bound of limit {name!r}", bound) <= 0):
        raise InputError(f"upper bound of limit {name!r} must be above 0 {unit}, not {bound}")
    return bound


@dataclass(frozen=True)
class Limit:
    """A bound on any quantity of a motion, beside the limits of the joints.

    Parameters
    ----------
    name : str
        Such as "tool speed"; figures, tables and messages use it.
    expression : callable
        ``state -> CasADi expression [k]``; ``state`` is a
        :class:`~microbot_ocp.robot.MotionState`.
    lower, upper : float, array_like [k] or callable, optional
        Bounds in ``unit``: numbers, or expressions of the state where the limit varies along the
        motion. Default none on that side.
    unit : str
        SI.
    labels : sequence of str, optional
        Of the components; default the names of the joints where there is one a joint.
    rms : bool
        Whether the upper bound is one of the root mean square over the whole motion, not of every
        instant; of planners only :func:`microbot_ocp.time_optimal` through joint poses keeps it.
    dwell : float
        Rest at the end that such a mean is taken over, too, s.

    Raises
    ------
    InputError
        No name, an expression that cannot be called, no bound at all, NaN, a lower bound above the
        upper one.

    Examples
    --------
    >>> import casadi as ca
    >>> height = Limit("tool height", lambda state: state.tool[2, 3], lower=0.2, unit="m")
    >>> height.key, height.lower, height.upper
    ('tool_height', (0.2,), None)
    """

    name: str
    expression: Expression
    lower: Any = None
    upper: Any = None
    unit: str = ""
    labels: tuple[str, ...] = ()
    rms: bool = False
    dwell: float = 0.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        if not isinstance(self.name, str) or not self.name.strip():
            raise InputError(f"name of a limit must be text, not {self.name!r}")
        if not callable(self.expression):
            raise InputError(
                f"expression of limit {self.name!r} must be a function of the motion's state, "
                f"not {type(self.expression).__name__}"
            )
        for side in ("lower", "upper"):
            put(self, side, self._checked(side, getattr(self, side)))
        if self.lower is None and self.upper is None:
            raise InputError(f"limit {self.name!r} must have a lower or an upper bound")
        low, high = self.constant("lower"), self.constant("upper")
        if (
            low is not None
            and high is not None
            and (low.size in (1, high.size) or high.size == 1)
            and np.any(low > high)
        ):
            raise InputError(
                f"lower bound of limit {self.name!r} must be at most its upper bound, not "
                f"{low.tolist()} above {high.tolist()} {self.unit}".rstrip()
            )
        checks.number(f"dwell of limit {self.name!r}", self.dwell, "s", at_least=0.0)
        if self.rms and (low is not None or high is None or not np.all(high > 0.0)):
            raise InputError(
                f"limit {self.name!r} of a root mean square must have an upper bound of numbers "
                "above 0 and no lower one"
            )
        if not isinstance(self.unit, str):
            raise InputError(f"unit of limit {self.name!r} must be text, not {self.unit!r}")
        put(self, "labels", tuple(self.labels))

    def _checked(self, side: str, bound: Any) -> Any:
        if bound is None or callable(bound):
            return bound
        name = f"{side} bound of limit {self.name!r}"
        values = np.atleast_1d(checks.numbers(name, bound))
        values = checks.array(name, values, (None,), self.unit, finite=False)
        return tuple(values.tolist())

    @property
    def key(self) -> str:
        """Its name as one word, as columns and mappings have it."""
        return self.name.strip().replace(" ", "_")

    @property
    def is_size(self) -> bool:
        """Whether it bounds the length of a vector, which has a kink where that vanishes."""
        return isinstance(self.expression, _Size)

    def constant(self, side: str) -> FloatArray | None:
        """Give the bound [k] or [1] of a side; None where there is none or it is an expression."""
        bound = getattr(self, checks.one_of("side", side, ("lower", "upper")))
        return None if bound is None or callable(bound) else np.array(bound)


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
