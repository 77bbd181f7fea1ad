"""Limits of the joints: as users give them, and as arrays of a robot."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, NamedTuple, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.foreign_words import HintingOfArms
from microbot_ocp.limits._limit import Limit

TORQUES_OF_A_BOX = ("largest_torque", "least_torque")  # keys of limits that bound torques, too
LimitArgument = ArrayLike | tuple[ArrayLike, ArrayLike]
"""A number, one value per joint, or a pair (lower, upper) of either."""


class JointQuantity(NamedTuple):
    """A quantity of every joint: its key, name, and unit for either type of joint."""

    key: str
    name: str
    revolute: str
    prismatic: str

    @property
    def either_unit(self) -> str:
        """Both units, for messages about joints of any type."""
        return f"{self.revolute} (prismatic: {self.prismatic})"


JOINT_QUANTITIES = {
    quantity.key: quantity
    for quantity in (
        JointQuantity("q", "position", "rad", "m"),
        JointQuantity("qd", "velocity", "rad/s", "m/s"),
        JointQuantity("qdd", "acceleration", "rad/s^2", "m/s^2"),
        JointQuantity("qddd", "jerk", "rad/s^3", "m/s^3"),
        JointQuantity("tau", "torque", "N m", "N"),
        JointQuantity("taud", "torque rate", "N m/s", "N/s"),
    )
}


def quantity_name(key: str) -> str:
    """Return the name of a quantity by its key: "torque" of "tau", "tool speed" of "tool_speed"."""
    quantity = JOINT_QUANTITIES.get(key)
    return key.replace("_", " ") if quantity is None else quantity.name


class LimitChanges(TypedDict, total=False):
    """Limits by name, as arguments of :meth:`~microbot_ocp.Robot.with_limits`."""

    q_min: ArrayLike | None
    q_max: ArrayLike | None
    qd_max: LimitArgument | None
    qdd_max: LimitArgument | None
    qddd_max: LimitArgument | None
    tau_max: LimitArgument | None
    taud_max: LimitArgument | None
    qd_min: ArrayLike | None
    qdd_min: ArrayLike | None
    qddd_min: ArrayLike | None
    tau_min: ArrayLike | None
    taud_min: ArrayLike | None
    also: Iterable[Limit] | None


@dataclass(frozen=True, eq=False)
class Limits(HintingOfArms):
    """Limits of every joint; a quantity without a value is unlimited.

    Each argument is a scalar (for all joints) or a list or array [n] (one value per joint).
    ``qd_max``, ``qdd_max``, ``qddd_max`` (jerk), ``tau_max`` and ``taud_max`` (torque rate) bound
    both directions, unless given as a tuple ``(lower, upper)``, or together with ``qd_min`` and so
    on. A robot holds its limits as arrays [n]:
    ``robot.limits.q_min``, ``q_max``, ``qd_min``, ``qd_max``, ``qdd_min``, ... in rad, rad/s,
    rad/s^2, rad/s^3, N m, N m/s (prismatic joints: m, m/s, m/s^2, m/s^3, N, N/s).

    ``also`` holds limits of other quantities, such as ``mo.limits.tool_speed(1.0)`` or any
    :class:`~microbot_ocp.Limit`.

    Examples
    --------
    >>> limits = Limits(qd_max=2.0, tau_max=[400.0, 500.0, 200.0]).for_joints(3)
    >>> limits.tau_min.tolist()
    [-400.0, -500.0, -200.0]
    """

    q_min: LimitArgument = -np.inf
    q_max: LimitArgument = np.inf
    qd_max: LimitArgument = np.inf
    qdd_max: LimitArgument = np.inf
    qddd_max: LimitArgument = np.inf
    tau_max: LimitArgument = np.inf
    taud_max: LimitArgument = np.inf
    qd_min: ArrayLike | None = None
    qdd_min: ArrayLike | None = None
    qddd_min: ArrayLike | None = None
    tau_min: ArrayLike | None = None
    taud_min: ArrayLike | None = None
    also: Iterable[Limit] = ()

    def for_joints(self, count: int) -> JointLimits:
        """Return the limits as checked arrays [count].

        Raises
        ------
        InputError
            Wrong length, NaN, a lower limit above the upper one, a range of a rate or torque that
            excludes zero, or two limits of one name.
        """
        arrays: dict[str, FloatArray] = {}
        for key, quantity in JOINT_QUANTITIES.items():
            unit = quantity.either_unit
            lower, upper = self._pair(key, unit, count)
            # + 0.0 turns -0.0 into 0.0.
            arrays[f"{key}_min"], arrays[f"{key}_max"] = lower + 0.0, upper
            for j in np.flatnonzero((lower > upper) | (lower == np.inf) | (upper == -np.inf)):
                raise InputError(
                    f"{key}_min of joint {j + 1} must be finite or -inf and at most its "
                    f"{key}_max of {upper[j]:g} {unit}, not {lower[j]:g}"
                )
            for j in np.flatnonzero((lower > 0) | (upper < 0)) if key != "q" else ():
                raise InputError(
                    f"{key}_max of joint {j + 1} must leave room for zero, not "
                    f"[{lower[j]:g}, {upper[j]:g}] {unit} (a tuple means "
                    "(lower, upper); give one value per joint as a list)"
                )
        return JointLimits(**arrays, also=_further(self.also))

    def _pair(self, key: str, unit: str, count: int) -> tuple[FloatArray, FloatArray]:
        low, high = f"{key}_min", f"{key}_max"
        lower, upper = getattr(self, low), getattr(self, high)
        if key == "q":
            for side, value in ((low, lower), (high, upper)):
                if isinstance(value, tuple):
                    raise InputError(
                        f"{side} must be a number or a list with one value per joint, not the "
                        f"tuple {value}: q_min and q_max are the pair"
                    )
        elif isinstance(upper, tuple):
            if len(upper) != 2:
                raise InputError(
                    f"{high} as a tuple must be (lower, upper), not {len(upper)} entries; give "
                    "one value per joint as a list"
                )
            if lower is not None:
                raise InputError(f"{low} is given twice: as {lower!r} and in the tuple {high}")
            low, (lower, upper) = high, upper
        values = _per_joint(high, upper, count)
        if lower is not None:
            return _per_joint(low, lower, count), values
        for j in np.flatnonzero(values < 0):
            raise InputError(
                f"{high} of joint {j + 1} must be at least 0 {unit}, not {values[j]:g}"
            )
        return -values, values


@dataclass(frozen=True, eq=False)
class JointLimits(HintingOfArms):
    """Limits of every joint as arrays [n], and further limits; see :meth:`Limits.for_joints`."""

    q_min: FloatArray
    q_max: FloatArray
    qd_min: FloatArray
    qd_max: FloatArray
    qdd_min: FloatArray
    qdd_max: FloatArray
    qddd_min: FloatArray
    qddd_max: FloatArray
    tau_min: FloatArray
    tau_max: FloatArray
    taud_min: FloatArray
    taud_max: FloatArray
    also: tuple[Limit, ...] = ()

    def bounds(self, quantity: str) -> tuple[FloatArray, FloatArray]:
        """Return the lower and upper array [n] of a joint quantity, such as ``"tau"``."""
        checks.one_of("quantity", quantity, JOINT_QUANTITIES)
        return getattr(self, f"{quantity}_min"), getattr(self, f"{quantity}_max")

    def changed(self, changes: Mapping[str, Any]) -> Limits:
        """Return the limits with some replaced by name; ``qd_max`` alone bounds both directions."""
        given: dict[str, Any] = {"also": changes.get("also", self.also)}
        for quantity in JOINT_QUANTITIES:
            low, high = f"{quantity}_min", f"{quantity}_max"
            lower, upper = self.bounds(quantity)
            if quantity == "q" or low in changes:
                given[low], given[high] = changes.get(low, lower), changes.get(high, upper)
            else:
                given[high] = changes.get(high, (lower, upper))
        return Limits(**given)

    def tightened(self, other: JointLimits) -> JointLimits:
        """Return the tighter of two limits for every bound, and the further limits of both.

        If both have a further limit of one name, the bounds are compared only where they are
        numbers for one expression; otherwise the limit of ``other`` is used.
        """
        bounds: dict[str, Any] = {}
        for key in JOINT_QUANTITIES:
            (low, high), (lower, upper) = self.bounds(key), other.bounds(key)
            bounds[f"{key}_min"] = np.maximum(low, lower)
            bounds[f"{key}_max"] = np.minimum(high, upper)
        further = {limit.key: limit for limit in self.also}
        for limit in other.also:
            further[limit.key] = _tighter(further.get(limit.key, limit), limit)
        return Limits(**bounds, also=tuple(further.values())).for_joints(self.q_min.size)

    def with_reserve(self, reserve: ArrayLike) -> JointLimits:
        """Return the limits with a share of every torque reserved for feedback.

        Parameters
        ----------
        reserve : float or array_like [n]
            Share of the torque limits, at least 0 and below 1.

        Raises
        ------
        InputError
            The share is outside of this range, or has another number of joints.

        Examples
        --------
        >>> Limits(tau_max=100.0).for_joints(1).with_reserve(0.25).tau_max.tolist()
        [75.0]
        """
        share = _per_joint("reserve", reserve, self.tau_max.size)
        if np.any((share < 0.0) | (share >= 1.0)):
            raise InputError(
                f"reserve must be a share of the torque, at least 0 and below 1, not {reserve}"
            )
        left = 1.0 - share

        def reserved(limit: Limit) -> Limit:
            if limit.key not in TORQUES_OF_A_BOX:
                return limit
            sides = {side: limit.constant(side) for side in ("lower", "upper")}
            return replace(limit, **{k: left * v for k, v in sides.items() if v is not None})

        also = tuple(map(reserved, self.also))
        return replace(self, tau_min=left * self.tau_min, tau_max=left * self.tau_max, also=also)

    def for_joints(self, count: int) -> JointLimits:
        """Return these limits, checked; with arrays if numbers replaced some of them.

        Raises
        ------
        InputError
            The limits are of another number of joints; errors of :meth:`Limits.for_joints`.
        """
        if np.size(self.q_min) not in (1, count):
            raise InputError(
                f"limits are for {np.size(self.q_min)} joints, but the robot has {count}"
            )
        values = vars(self)
        checked = Limits(**values).for_joints(count)
        as_they_are = all(
            isinstance(values[name], np.ndarray) and np.array_equal(values[name], value)
            for name, value in checked.as_dict().items()
        )
        return self if as_they_are else checked

    def as_dict(self) -> dict[str, list[float]]:
        """Return the joint limits as plain lists, for JSON and TOML."""
        return {
            f"{key}_{side}": bound.tolist()
            for key in JOINT_QUANTITIES
            for side, bound in zip(("min", "max"), self.bounds(key), strict=True)
        }


def with_reserve(
    usual: JointLimits, limits: Limits | JointLimits | None, reserve: ArrayLike
) -> Limits | JointLimits | None:
    """Return the given limits, or a robot's own, with a share of the torques reserved."""
    if not np.any(np.asarray(reserve, dtype=object)):
        return limits
    count = usual.tau_max.size
    return (usual if limits is None else limits.for_joints(count)).with_reserve(reserve)


def _tighter(one: Limit, other: Limit) -> Limit:
    """Return the second limit, with the tighter bounds of both if they are comparable."""
    what, like = ((each.expression, each.rms, each.dwell) for each in (one, other))
    bounds: dict[str, Any] = {}
    for side, tighter in (("lower", np.maximum), ("upper", np.minimum)):
        given = [b for each in (one, other) if (b := getattr(each, side)) is not None]
        if what != like or any(map(callable, given)):
            return other
        bounds[side] = reduce(tighter, given) if given else None
    return replace(other, **bounds)


def _per_joint(name: str, value: Any, count: int) -> FloatArray:
    if np.ndim(np.asarray(value, dtype=object)) == 0:
        value = [value] * count
    return checks.array(name, value, (count,), finite=False)


def _further(limits: Any) -> tuple[Limit, ...]:
    if isinstance(limits, Limit):
        raise InputError("also must be a list of limits: write also=[limit]")
    entries = tuple(limits)
    for limit in entries:  # the entries of an iterator are not checked before
        if not isinstance(limit, Limit):
            raise InputError(f"also must hold limits, such as mo.Limit(...), not {limit!r}")
    keys = [*JOINT_QUANTITIES, *(limit.key for limit in entries)]
    for limit in entries:
        if keys.count(limit.key) > 1:
            raise InputError(f"also holds two limits named {limit.name!r}: names must differ")
    return entries
