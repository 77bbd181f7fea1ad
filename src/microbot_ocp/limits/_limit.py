"""Limits as data: a name, a unit, an expression of the motion's state, and bounds.

A member of :data:`MEMBERS` has keys in files and options of the command line.
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

Expression = Callable[[Any], Any]  # function of a motion's state: a CasADi expression or a number
Bound = ArrayLike | Expression | None


@dataclass(frozen=True)
class Limit:
    """A bound on any quantity of a motion, beside the limits of the joints.

    Parameters
    ----------
    name : str
        Name such as "tool speed", for figures, tables and messages.
    expression : callable
        ``state -> CasADi expression [k]``; ``state`` is a
        :class:`~microbot_ocp.robot.MotionState`.
    lower, upper : float, array_like [k] or callable, optional
        Bounds in ``unit``: numbers, or expressions of the state for a limit that varies along the
        motion. Default unlimited.
    unit : str
        Unit in SI.
    labels : sequence of str, optional
        Names of the components; default the joints' names if there is one component a joint.
    rms : bool
        True for an upper bound of the root mean square over the whole motion. Among the planners,
        only :func:`microbot_ocp.time_optimal` through joint poses keeps such a limit.
    dwell : float
        Rest after the motion, s, which the root mean square includes.

    Raises
    ------
    InputError
        A missing name, an expression that is not callable, no bound, NaN, or a lower bound above
        the upper one.

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
        """Name as one word, for columns and mappings."""
        return self.name.strip().replace(" ", "_")

    @property
    def is_size(self) -> bool:
        """True for the norm of a vector, which is not differentiable at zero."""
        return isinstance(self.expression, _Size)

    @property
    def knows_derivatives(self) -> bool:
        """True if the expression has derivatives of its own; it depends on positions alone."""
        return hasattr(self.expression, "in_poses")

    def constant(self, side: str) -> FloatArray | None:
        """Return the bound [k] or [1] of a side; None if it is missing or an expression."""
        bound = getattr(self, checks.one_of("side", side, ("lower", "upper")))
        return None if bound is None or callable(bound) else np.array(bound)


def tool_speed(upper: Bound) -> Limit:
    """Limit the speed of the tool's origin in the base frame.

    Parameters
    ----------
    upper : float or callable
        Bound, m/s, or an expression of the motion's state, for example a lower speed in a zone.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot").with_limits(also=[mo.limits.tool_speed(upper=1.0)])
    """
    return _of_tool("tool speed", "tool_velocity", upper, "m/s")


def tool_acceleration(upper: Bound) -> Limit:
    """Limit the magnitude of the acceleration of the tool's origin in the base frame.

    Parameters
    ----------
    upper : float or callable
        Bound, m/s^2, or an expression of the motion's state.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot").with_limits(also=[mo.limits.tool_acceleration(20.0)])
    """
    return _of_tool("tool acceleration", "tool_acceleration", upper, "m/s^2")


def tool_jerk(upper: Bound) -> Limit:
    """Limit the magnitude of the jerk of the tool's origin in the base frame.

    Parameters
    ----------
    upper : float or callable
        Bound, m/s^3, or an expression of the motion's state.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot").with_limits(also=[mo.limits.tool_jerk(500.0)])
    """
    return _of_tool("tool jerk", "tool_jerk", upper, "m/s^3")


def _of_tool(name: str, quantity: str, upper: Bound, unit: str) -> Limit:
    limit = Limit(name, _Size(quantity), upper=upper, unit=unit)
    if (bound := limit.constant("upper")) is not None and np.any(bound <= 0.0):
        raise InputError(f"upper bound of limit {name!r} must be above 0 {unit}, not {upper}")
    return limit


@dataclass(frozen=True)
class _Size:
    """Norm of the linear part of a tool quantity."""

    quantity: str

    def __call__(self, state: Any) -> Any:
        linear = getattr(state, self.quantity)[:3]
        return (linear.T @ linear) ** 0.5


def power(upper: Bound = None, lower: Bound = None) -> Limit:
    """Limit the mechanical power ``tau qd`` of every joint.

    Parameters
    ----------
    upper, lower : float, array_like [n] or callable, optional
        Bounds, W; a lower bound limits the power that a braking joint feeds back.

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
        Bounds, W; a lower bound limits the power that the braking arm feeds back.
    """
    return Limit("total power", _total_power, lower=lower, upper=upper, unit="W")


def _power(state):
    return state.tau * state.qd


def _total_power(state):
    return state.tau.T @ state.qd


def rms_torque(upper: Bound, dwell: float = 0.0) -> Limit:
    """Limit the root mean square of every joint's torque over a motion and a rest after it.

    This limit is an integral over the whole motion: :func:`microbot_ocp.time_optimal` through joint
    poses keeps it, certificates verify it, and all other planners refuse it.

    Parameters
    ----------
    upper : float or array_like [n]
        Bound, N m (N).
    dwell : float
        Rest after the motion in each cycle, s, in which the torque holds the arm against gravity.

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
# Files have keys such as "tool_speed_max", and "power_min" for a member with a lower bound.
MEMBER_KEYS = {
    f"{name}_{end}": (name, side)
    for name, member in MEMBERS.items()
    for side, end in (("lower", "min"), ("upper", "max"))
    if side in inspect.signature(member).parameters
}


def limits_from_table(table: Mapping[str, Any]) -> tuple[Limit, ...]:
    """Return limits from a table of numbers, or lists of them, by keys of :data:`MEMBER_KEYS`."""
    bounds: dict[str, dict[str, Any]] = {}
    for key, value in table.items():
        name, side = MEMBER_KEYS[key]
        bounds.setdefault(name, {})[side] = value
    return tuple(MEMBERS[name](**sides) for name, sides in bounds.items())


def changes_by_name(limits: Iterable[Limit], named: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of ``robot.with_limits`` for limits of joints and further limits.

    Values under :data:`MEMBER_KEYS` become limits, which replace those of equal name in ``limits``.
    """
    changes = {key: value for key, value in named.items() if key not in MEMBER_KEYS}
    if further := limits_from_table({k: v for k, v in named.items() if k in MEMBER_KEYS}):
        names = {limit.key for limit in further}
        changes["also"] = (*(limit for limit in limits if limit.key not in names), *further)
    return changes


def limits_to_table(limits: Iterable[Limit]) -> dict[str, Any]:
    """Return the table that :func:`limits_from_table` reads.

    Raises
    ------
    InputError
        A limit is not in :data:`MEMBERS`, or has an expression as bound; files hold numbers only.
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
