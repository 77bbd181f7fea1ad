"""The pairs that are in a problem among obstacles, and the distances that are asked of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import Limit, LimitFamily
from microbot_ocp.planning.task import reach_of
from microbot_ocp.robot import Robot
from microbot_ocp.scene import (
    Pair,
    Scene,
    clearances,
    facing,
    guiding_pairs,
    room_along,
)


@dataclass(frozen=True, eq=False)
class PairsAsked:
    """Pairs of capsules around a path through a scene.

    Attributes
    ----------
    robot, scene
    tolerance : of limits
    pairs : tuple of Pair
        All whose links may not touch.
    most : array [k]
        What they have beyond the clearance at the via points, m: the path may be left where more is
        asked of them, but not these.
    near : array of bool [k]
        Which are in the problem.
    room : array [k]
        What is asked of each beyond the clearance, m.
    """

    robot: Robot
    scene: Scene
    tolerance: float
    pairs: tuple[Pair, ...]
    most: FloatArray
    near: np.ndarray
    room: FloatArray

    @classmethod
    def along(
        cls,
        robot: Robot,
        scene: Scene,
        tolerance: float,
        poses: FloatArray,
        via: FloatArray,
        near: float,
    ) -> PairsAsked:
        """Return those that come near on a path, poses [N,n] through via points [m,n].

        Near is what comes within the clearance and a share of the arm's reach.
        """
        pairs = facing(robot, guiding_pairs(robot, scene), poses)
        room, known, apart = room_along(robot, scene, pairs, poses, tolerance)
        within = scene.clearance + near * reach_of(robot)
        most = clearances(robot, pairs, via).min(axis=0) - scene.clearance
        room = np.minimum(room, known)
        return cls(robot, scene, tolerance, pairs, most, apart < within, room)

    @property
    def limits(self) -> tuple[Limit, ...]:
        """The distances that are asked."""
        if not self.near.any():
            return ()
        chosen = [pair for pair, near in zip(self.pairs, self.near, strict=True) if near]
        room = self.room[self.near].tolist()
        return (self.scene.limit(self.robot, chosen, tolerance=self.tolerance, room=room),)

    @property
    def family(self) -> LimitFamily:
        """The limits of the arm, with the distances that are asked among them."""
        also = (*self.robot.limits.also, *self.limits)
        return LimitFamily.of(self.robot.with_limits(also=also))

    def after(self, poses: FloatArray, near: float = 0.0) -> tuple[PairsAsked, np.ndarray]:
        """Return what is asked once a motion with these poses [N,n] is known, and which pairs [k]
        have their links too near on it.

        These are in the problem, and asked for more, as far as via points allow. With them what is
        ``near`` as for :meth:`along`: on a motion that passes through things that is nearly all.
        """
        come, _, apart = room_along(self.robot, self.scene, self.pairs, poses, self.tolerance)
        touching = apart <= self.scene.clearance
        more = np.minimum(self.most, np.maximum(self.room, come))
        room = np.where(touching, more, self.room)
        if touching.any():
            within = self.scene.clearance + near * reach_of(self.robot)
            return replace(self, near=self.near | (apart <= within), room=room), touching
        return self, touching

    def asks_more_than(self, before: PairsAsked) -> bool:
        """Return whether anything is asked that was not."""
        more = self.near & (~before.near | (self.room > before.room))
        return bool(more.any())
