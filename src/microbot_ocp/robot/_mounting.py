"""Mounting of an arm: where its base stands, how its tool is turned, how its drives are geared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.limits import JointLimits
from microbot_ocp.robot._links import Link
from microbot_ocp.robot._model import Robot
from microbot_ocp.robot._transforms import rotation_of, transform_of

PLACE = ("x", "y", "z", "yaw")


@dataclass(frozen=True)
class Mounting:
    """Changes of an arm as it is described: another place, another turn of the tool, other gears.

    The frame of the task stays. Stops, obstacles and gravity are in it, and the base stands in it.

    Attributes
    ----------
    x, y, z : float
        Displacement of the base, m.
    yaw : float
        Turn of the base about the Z axis of the frame that it had, rad.
    tool_yaw : float
        Turn of the tool frame about its Z, with all that it holds, rad. Masses of the last link
        stay.
    gear_ratio : mapping of str to float
        Factors of the gear ratios by the names of the joints. Torques and Coulomb friction of a
        drive grow with the factor, viscous friction and the inertia of the rotor with its square;
        the highest velocity falls with it.

    Raises
    ------
    InputError
        A number that is not finite, a factor that is not positive.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    tool_yaw: float = 0.0
    gear_ratio: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key in (*PLACE, "tool_yaw"):
            unit = "rad" if key.endswith("yaw") else "m"
            number = checks.number(f"{key} of the mounting", getattr(self, key), unit)
            object.__setattr__(self, key, number)
        factors = {
            name: checks.number(f"gear_ratio of {name}", value, above=0.0)
            for name, value in self.gear_ratio.items()
        }
        object.__setattr__(self, "gear_ratio", factors)

    @property
    def pose(self) -> FloatArray:
        """Transform [4,4] of the base in the frame of the task, m."""
        return transform_of(rotation_of([0.0, 0.0, self.yaw]), [self.x, self.y, self.z])

    def factors(self, robot: Robot) -> FloatArray:
        """Return the factors of the gear ratios [n].

        Raises
        ------
        InputError
            A joint that the robot does not have, or whose drive moves several.
        """
        for name in self.gear_ratio:
            checks.one_of("joint of gear_ratio", name, robot.joint_names)
        if self.gear_ratio and robot.coupling is not None:
            raise InputError("gear ratios are not offered for arms whose joints follow others")
        return np.array([self.gear_ratio.get(name, 1.0) for name in robot.joint_names])

    def on(self, robot: Robot, before: Mounting | None = None) -> Robot:
        """Return the robot mounted so; ``before`` is the mounting that it has.

        Raises
        ------
        InputError
            As of :meth:`factors`.
        """
        before = before or Mounting()
        if self == before:
            return robot
        factors = self.factors(robot) / before.factors(robot)
        if np.any(factors != 1.0):
            links = tuple(map(_geared, robot.links, factors.tolist()))
            robot = replace(robot, links=links, limits=geared_limits(robot.limits, factors))
        if self.tool_yaw != before.tool_yaw:
            turn = rotation_of([0.0, 0.0, self.tool_yaw - before.tool_yaw])
            robot = replace(robot, tool=robot.tool @ transform_of(turn, np.zeros(3)))
        if all(getattr(self, key) == getattr(before, key) for key in PLACE):
            return robot
        return _moved(robot, self.pose @ np.linalg.inv(before.pose))


def _geared(link: Link, factor: float) -> Link:
    """Return a link whose drive is geared down further by a factor."""
    rotor = link.rotor and replace(link.rotor, gear_ratio=factor * link.rotor.gear_ratio)
    return replace(
        link,
        rotor=rotor,
        armature=factor**2 * link.armature,
        viscous_friction=factor**2 * link.viscous_friction,
        coulomb_friction=factor * link.coulomb_friction,
    )


def geared_limits(limits: JointLimits, factors: FloatArray) -> JointLimits:
    """Return the limits of drives that are geared down further by factors [n]."""
    powers = {"qd": -1, "tau": 1, "taud": 1}
    changes = {
        f"{key}_{side}": getattr(limits, f"{key}_{side}") * factors**power
        for key, power in powers.items()
        for side in ("min", "max")
    }
    return limits.changed(changes).for_joints(factors.size)


def _moved(robot: Robot, step: FloatArray) -> Robot:
    """Return the robot with all that is fixed to its base moved by a transform [4,4]."""
    return replace(
        robot,
        base=step @ robot.base,
        capsules=tuple(
            (frame, capsule if frame else capsule.moved(step)) for frame, capsule in robot.capsules
        ),
        shapes=tuple(
            shape if shape.frame else replace(shape, pose=step @ shape.pose)
            for shape in robot.shapes
        ),
        frames={
            name: (joint, pose if joint else step @ pose)
            for name, (joint, pose) in robot.frames.items()
        },
    )
