"""Limits as data, as users give them and as a robot holds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError

LimitArgument = ArrayLike | tuple[ArrayLike, ArrayLike]

# Quantity name -> (unit for a revolute joint, unit for a prismatic joint).
LIMIT_UNITS: dict[str, tuple[str, str]] = {
    "q": ("rad", "m"),
    "qd": ("rad/s", "m/s"),
    "qdd": ("rad/s^2", "m/s^2"),
    "tau": ("N m", "N"),
    "taud": ("N m/s", "N/s"),
}


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of every joint; whatever is not given is unlimited.

    Each argument is a scalar (all joints alike) or a list or array [n] (one value a joint).
    ``qd_max``, ``qdd_max``, ``tau_max`` and ``taud_max`` mean plus and minus, unless given as a
    tuple ``(lower, upper)`` of such, or with their ``qd_min`` and so on. A robot holds its limits
    as arrays [n]:
    ``robot.limits.q_min``, ``q_max``, ``qd_min``, ``qd_max``, ``qdd_min``, ... in rad, rad/s,
    rad/s^2, N m, N m/s (prismatic joints: m, m/s, m/s^2, N, N/s).

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
    tau_max: LimitArgument = np.inf
    taud_max: LimitArgument = np.inf
    qd_min: ArrayLike | None = None
    qdd_min: ArrayLike | None = None
    tau_min: ArrayLike | None = None
    taud_min: ArrayLike | None = None

    def for_joints(self, count: int) -> JointLimits:
        """Return the limits as arrays [count], checked.

        Raises
        ------
        InputError
            Wrong length, NaN, a lower limit above its upper one, or a rate or torque range
            without zero inside.
        """
        arrays: dict[str, FloatArray] = {}
        for quantity in LIMIT_UNITS:
            lower, upper = self._pair(quantity, count)
            arrays[f"{quantity}_min"], arrays[f"{quantity}_max"] = lower, upper
            unit = _either_unit(quantity)
            crossed = np.flatnonzero((lower > upper) | (lower == np.inf) | (upper == -np.inf))
            if crossed.size:
                j = crossed[0]
                raise InputError(
                    f"{quantity}_min of joint {j + 1} must be finite or -inf and at most its "
                    f"{quantity}_max of {upper[j]:g} {unit}, not {lower[j]:g}"
                )
            if quantity != "q":
                outside = np.flatnonzero((lower > 0) | (upper < 0))
                if outside.size:
                    j = outside[0]
                    raise InputError(
                        f"{quantity}_max of joint {j + 1} must leave room for zero, not "
                        f"[{lower[j]:g}, {upper[j]:g}] {unit} (a tuple means "
                        "(lower, upper); give one value a joint as a list)"
                    )
        return JointLimits(**arrays)

    def _pair(self, quantity: str, count: int) -> tuple[FloatArray, FloatArray]:
        name = f"{quantity}_max"
        if quantity == "q":
            for side, value in (("q_min", self.q_min), (name, self.q_max)):
                if isinstance(value, tuple):
                    raise InputError(
                        f"{side} must be a number or a list with one value a joint, not the tuple "
                        f"{value}: q_min and q_max are the pair"
                    )
            return _per_joint("q_min", self.q_min, count), _per_joint(name, self.q_max, count)
        value = getattr(self, name)
        explicit_lower = getattr(self, f"{quantity}_min")
        if isinstance(value, tuple):
            if len(value) != 2:
                raise InputError(
                    f"{name} as a tuple must be (lower, upper), not {len(value)} entries; give "
                    "one value a joint as a list"
                )
            if explicit_lower is not None:
                raise InputError(
                    f"{quantity}_min is given twice: as {explicit_lower!r} and in the tuple {name}"
                )
            return _per_joint(name, value[0], count), _per_joint(name, value[1], count)
        upper = _per_joint(name, value, count)
        if explicit_lower is not None:
            return _per_joint(f"{quantity}_min", explicit_lower, count), upper
        negative = np.flatnonzero(upper < 0)
        if negative.size:
            j = negative[0]
            raise InputError(
                f"{name} of joint {j + 1} must be at least 0 {_either_unit(quantity)}, "
                f"not {upper[j]:g}"
            )
        return -upper, upper


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of every joint as arrays [n], lower and upper; made by :meth:`Limits.for_joints`."""

    q_min: FloatArray
    q_max: FloatArray
    qd_min: FloatArray
    qd_max: FloatArray
    qdd_min: FloatArray
    qdd_max: FloatArray
    tau_min: FloatArray
    tau_max: FloatArray
    taud_min: FloatArray
    taud_max: FloatArray

    def bounds(self, quantity: str) -> tuple[FloatArray, FloatArray]:
        """Lower and upper arrays [n] of ``q``, ``qd``, ``qdd``, ``tau`` or ``taud``."""
        return getattr(self, f"{quantity}_min"), getattr(self, f"{quantity}_max")

    def for_joints(self, count: int) -> JointLimits:
        """Return itself, once the width is checked."""
        if self.q_min.shape != (count,):
            raise InputError(f"limits are for {self.q_min.size} joints, but the robot has {count}")
        return self

    def as_dict(self) -> dict[str, list[float]]:
        """Plain lists, for JSON and TOML."""
        return {f.name: getattr(self, f.name).tolist() for f in fields(self)}


def changed(limits: JointLimits, changes: Mapping[str, Any]) -> Limits:
    """Limits with some replaced; of a pair that has a new upper one alone, both are new."""
    given: dict[str, Any] = {}
    for quantity in LIMIT_UNITS:
        low, high = f"{quantity}_min", f"{quantity}_max"
        lower, upper = limits.bounds(quantity)
        if quantity == "q" or low in changes:
            given[low], given[high] = changes.get(low, lower), changes.get(high, upper)
        else:
            given[high] = changes.get(high, (lower, upper))
    return Limits(**given)


def _per_joint(name: str, value: Any, count: int) -> FloatArray:
    if np.ndim(np.asarray(value, dtype=object)) == 0:
        value = [value] * count
    return checks.array(name, value, (count,), finite=False)


def _either_unit(quantity: str) -> str:
    revolute, prismatic = LIMIT_UNITS[quantity]
    return f"{revolute} (prismatic: {prismatic})"
