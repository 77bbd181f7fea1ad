"""Joints that move together: one coordinate drives several joints of a chain.

The N joints of a chain stand at ``q_chain = S q + offsets``, with one entry in each row of S [N,n].
Their velocities and accelerations are ``S qd`` and ``S qdd``, and by virtual work the torques of
the coordinates are ``S' tau_chain``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.limits import JOINT_QUANTITIES, JointLimits, Limits

Mimic = Mapping[str, tuple[str, float, float]]  # joint -> joint that it follows, factor, offset


@dataclass(frozen=True, eq=False)
class Coupling:
    """All N joints of a chain of which some follow others.

    Attributes
    ----------
    names : names of the joints, outwards
    types : "revolute" or "prismatic"
    drivers : index of the joint that each follows, from 0; its own where it is a coordinate
    factors, offsets : array [N]; 1 and 0 of a coordinate
    """

    names: tuple[str, ...]
    types: tuple[Any, ...]
    drivers: tuple[int, ...]
    factors: FloatArray
    offsets: FloatArray

    @cached_property
    def rows(self) -> list[int]:
        """Indices [n] of the joints that are coordinates."""
        return [row for row, driver in enumerate(self.drivers) if row == driver]

    @cached_property
    def following(self) -> list[int]:
        """Indices of the joints that follow others."""
        return [row for row, driver in enumerate(self.drivers) if row != driver]

    @cached_property
    def matrix(self) -> FloatArray:
        """S [N,n]."""
        return self.factors[:, None] * np.equal.outer(self.drivers, self.rows)

    @property
    def mimic(self) -> dict[str, tuple[str, float, float]]:
        """Joints that follow others: name, to driver, factor and offset."""
        return {
            self.names[k]: (
                self.names[self.drivers[k]],
                float(self.factors[k]),
                float(self.offsets[k]),
            )
            for k in self.following
        }

    def positions(self, q: FloatArray) -> FloatArray:
        """Return positions [...,N] of all joints from coordinates [...,n]."""
        return q @ self.matrix.T + self.offsets

    def joined(self, limits: JointLimits) -> JointLimits:
        """Return limits [n] of the coordinates from those of all joints: the tightest.

        Torques are those of the coordinates alone, whose drives move the joints that follow.

        Raises
        ------
        InputError
            Limits of positions that no coordinate keeps.
        """
        bounds: dict[str, Any] = {}
        for key in JOINT_QUANTITIES:
            shift = self.offsets if key == "q" else 0.0
            ends = (np.array(limits.bounds(key)) - shift) / self.factors
            if key.startswith("tau"):
                ends[:, self.following] = [[-np.inf], [np.inf]]
            groups = [ends[:, np.equal(self.drivers, row)] for row in self.rows]
            low = np.array([group.min(axis=0).max() for group in groups])
            high = np.array([group.max(axis=0).min() for group in groups])
            for row in np.array(self.rows)[low > high].tolist():
                names = [self.names[k] for k, driver in enumerate(self.drivers) if driver == row]
                raise InputError(
                    f"joints {', '.join(map(repr, names))} move together, but no position is "
                    "within the limits of all"
                )
            bounds[f"{key}_min"], bounds[f"{key}_max"] = low, high
        return Limits(**bounds, also=limits.also).for_joints(len(self.rows))

    def spread(self, limits: JointLimits) -> JointLimits:
        """Return limits [N] of all joints from those of the coordinates."""
        bounds: dict[str, Any] = {}
        for key in JOINT_QUANTITIES:
            shift = self.offsets if key == "q" else 0.0
            columns = np.array(limits.bounds(key))[:, [self.rows.index(k) for k in self.drivers]]
            ends = columns * self.factors + shift
            if key.startswith("tau"):
                ends[:, self.following] = [[-np.inf], [np.inf]]
            bounds[f"{key}_min"], bounds[f"{key}_max"] = ends.min(axis=0), ends.max(axis=0)
        return Limits(**bounds).for_joints(len(self.drivers))


def coupling_of(names: Sequence[str], types: Sequence[Any], mimic: Mimic) -> Coupling:
    """Return the coupling of joints that follow others, which may follow others themselves.

    Raises
    ------
    InputError
        A joint that is not one of the chain, a ring, a factor of zero, what is not finite.
    """
    drivers, factors, offsets = [], [], []
    for name in mimic:
        checks.one_of("joint that follows another", name, names)
    for name in names:
        at, factor, offset, passed = name, 1.0, 0.0, set[str]()
        while at in mimic:
            if at in passed:
                raise InputError(f"joint {name!r} follows itself, by way of {sorted(passed)}")
            passed.add(at)
            driver, times, plus = mimic[at]
            checks.one_of(f"joint that {at!r} follows", driver, names)
            times = checks.number(f"factor of joint {at!r}", times)
            if times == 0.0:
                raise InputError(f"factor of joint {at!r}, which follows {driver!r}, must not be 0")
            plus = checks.number(f"offset of joint {at!r}", plus)
            at, factor, offset = driver, factor * times, offset + factor * plus
        drivers.append(names.index(at))
        factors.append(factor)
        offsets.append(offset)
    chain = tuple(names), tuple(types), tuple(drivers)
    return Coupling(*chain, np.array(factors), np.array(offsets))
