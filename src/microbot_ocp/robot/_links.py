"""Links as data: mass, centre of mass, inertia, and the drive of the joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp.robot._transforms import EXACT

Part = tuple[float, FloatArray, FloatArray]  # mass, centre [3], inertia about the centre [3,3]
INERTIA_ROUNDING = 1e-15  # kg m^2, of 1 mg at 30 um: rounding of an inertia that should be zero


@dataclass(frozen=True, eq=False)
class Rotor:
    """A rotor of a geared drive, which spins on the link that carries it.

    It turns ``gear_ratio`` times as fast as its joint, relative to its carrier: its kinetic energy
    is ``inertia / 2 (axis . omega + gear_ratio qd)^2`` with the angular velocity ``omega`` of the
    carrier. It therefore adds ``inertia gear_ratio^2`` to the joint's own inertia, as ``armature``
    does, and couples the joint with the joints that turn the carrier.

    Parameters
    ----------
    inertia : float
        Inertia about the rotor's axis, kg m^2. The carrier's mass and inertia include the rotor
        at rest.
    gear_ratio : float
        Turns of the rotor for a turn of the joint (rad/m for a prismatic joint); negative for the
        opposite direction.
    axis : array_like [3], optional
        Axis of the rotor in the carrier's link frame (default: Z).
    carrier : int, optional
        Number of the link that carries the rotor: 0 is the base, 1 the first link. Default the
        link before the joint.

    Raises
    ------
    InputError
        A negative inertia, a ratio of zero, an axis of length zero, or a carrier below zero.

    Examples
    --------
    >>> Rotor(1.3e-3, 60.0, axis=[0.0, 0.0, 2.0], carrier=2).axis.tolist()
    [0.0, 0.0, 1.0]
    """

    inertia: float
    gear_ratio: float
    axis: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    carrier: int | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        inertia = checks.number("inertia of the rotor", self.inertia, "kg m^2", at_least=0.0)
        put(self, "inertia", inertia)
        put(self, "gear_ratio", checks.number("gear_ratio of the rotor", self.gear_ratio))
        if self.gear_ratio == 0.0:
            raise InputError("gear_ratio of the rotor must not be 0")
        axis = checks.array("axis of the rotor", self.axis, (3,))
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            raise InputError("axis of the rotor must have a direction, not [0, 0, 0]")
        carrier = self.carrier
        if carrier is not None and (type(carrier) is not int or carrier < 0):  # True is an int, too
            raise InputError(
                f"carrier of the rotor must be the number of a link, 0 for the base, not "
                f"{carrier!r}"
            )
        put(self, "axis", axis if length == 1.0 else axis / length)


@dataclass(frozen=True, eq=False)
class Link:
    """One rigid link with the drive and friction of its joint.

    Parameters
    ----------
    mass : float
        Mass, kg; zero for a link whose mass is neglected. Its inertia is used even so.
    center_of_mass : array_like [3], optional
        Centre of mass in the link frame, m (default: the origin).
    inertia : array_like [3,3], optional
        Inertia tensor about the centre of mass in the link frame, kg m^2 (default: a point mass).
    armature : float
        Inertia of the rotor referred to the joint, kg m^2 (kg for a prismatic joint).
    rotor : Rotor, optional
        Rotor of the joint's drive, an alternative to ``armature``: on a moving link it couples
        the joints.
    viscous_friction : float
        Joint friction proportional to speed, N m s/rad (N s/m).
    coulomb_friction : float
        Joint friction of constant magnitude, N m (N); smoothed over 0.01 rad/s (m/s) around rest.
    name : str, optional
        Name of the link.
    allow_unphysical : bool
        True to accept an inertia that no rigid body has. The mass matrix may be indefinite, and
        results may be meaningless.

    Raises
    ------
    InputError
        A negative mass, an inertia that is not symmetric, not positive semi-definite or violates
        the triangle inequality, negative friction, or a value that is not finite.
    """

    mass: float
    center_of_mass: FloatArray = field(default_factory=lambda: np.zeros(3))
    inertia: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    armature: float = 0.0
    viscous_friction: float = 0.0
    coulomb_friction: float = 0.0
    name: str | None = None
    allow_unphysical: bool = False
    rotor: Rotor | None = None

    def __post_init__(self) -> None:
        label = f"link {self.name!r}" if self.name else "link"
        put = object.__setattr__
        center = checks.array(f"center_of_mass of {label}", self.center_of_mass, (3,), "m")
        put(self, "center_of_mass", center)
        inertia = checks.array(f"inertia of {label}", self.inertia, (3, 3), "kg m^2")
        if np.abs(inertia - inertia.T).max() > ROUNDING * np.abs(inertia).max():
            raise InputError(f"inertia of {label} must be symmetric, not {inertia.tolist()} kg m^2")
        if not isinstance(self.allow_unphysical, bool):
            raise InputError(
                f"allow_unphysical of {label} must be True or False, not {self.allow_unphysical!r}"
            )
        if self.rotor is not None and not isinstance(self.rotor, Rotor):
            raise InputError(f"rotor of {label} must be a Rotor, not {self.rotor!r}")
        fault = None if self.allow_unphysical else inertia_fault(inertia)
        if fault:
            raise InputError(f"inertia of {label} {fault}")
        put(self, "inertia", inertia)
        for name, unit in (
            ("mass", "kg"),
            ("armature", "kg m^2"),
            ("viscous_friction", "N m s/rad"),
            ("coulomb_friction", "N m"),
        ):
            value = checks.number(f"{name} of {label}", getattr(self, name), unit, at_least=0.0)
            put(self, name, value)


def inertia_fault(inertia: FloatArray) -> str | None:
    """Return the reason why no rigid body has this inertia [3,3]; None if one may have it."""
    size = float(np.abs(inertia).max())
    if not 0.0 < size < np.inf:
        return None
    principal = size * np.linalg.eigvalsh(inertia / size)
    if principal[0] < -ROUNDING * size - INERTIA_ROUNDING:
        return (
            f"must be positive semi-definite, but a principal moment is {principal[0]:.6g} kg m^2"
        )
    if principal[0] + principal[1] < principal[2] - EXACT * size - INERTIA_ROUNDING:
        return (
            f"breaks the triangle inequality: principal moments {principal[0]:.6g} + "
            f"{principal[1]:.6g} < {principal[2]:.6g} kg m^2, which no rigid body has"
        )
    return None


def combined(parts: Sequence[Part], origin: FloatArray) -> Part:
    """Return the union of several bodies; ``origin`` [3] is its centre if it has no mass."""
    total = sum(mass for mass, _, _ in parts)
    first = sum((mass * center for mass, center, _ in parts), np.zeros(3))
    center = first / total if total else origin
    # The parallel-axis theorem moves each inertia to the common centre.
    about_center = np.zeros((3, 3))
    for mass, place, inertia in parts:
        arm = place - center
        about_center += inertia + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return total, center, about_center


def checked_links(links: Any, count: int) -> tuple[Link, ...]:
    """Return the links of a chain, one per joint."""
    chain = tuple(links)
    if len(chain) != count:
        raise InputError(f"links has {len(chain)} entries for {count} joints")
    for entry in chain:
        if not isinstance(entry, Link):
            raise InputError(f"links must hold Link objects, not {entry!r}")
        carrier = entry.rotor.carrier if entry.rotor else None
        if carrier is not None and carrier > count:
            raise InputError(
                f"carrier of the rotor must be a link from 0 (the base) to {count}, not {carrier}"
            )
    return chain
