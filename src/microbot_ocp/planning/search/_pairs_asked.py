"""The pairs that are in a problem among obstacles, and the distances that are asked of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import Limit, LimitFamily
from microbot_ocp.planning.task import Task, reach_of
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


@dataclass(frozen=True, eq=False)
class Around:
    """What is around the arm on every segment of a task, and what is asked of it.

    Attributes
    ----------
    scenes : tuple of Scene
        On every segment.
    asked : tuple of PairsAsked
        Of the segments on which the arm is the same in the same scene.
    places : tuple of int
        Which of these it is on every segment.
    """

    scenes: tuple[Scene, ...]
    asked: tuple[PairsAsked, ...]
    places: tuple[int, ...]

    @classmethod
    def along(
        cls,
        robots: Sequence[Robot],
        scenes: tuple[Scene, ...],
        tolerance: float,
        poses: Sequence[FloatArray],
        ends: Sequence[FloatArray],
        near: float,
    ) -> Around:
        """Return what is asked where a way has poses [N,n] on every segment, [2,n] at its ends."""
        kinds = list(zip(robots, scenes, strict=True))
        different = list(dict.fromkeys(kinds))
        places = tuple(map(different.index, kinds))
        asked = []
        for k, (robot, scene) in enumerate(different):
            held = scene.without_parts_of(robot)
            way, via = (_of_place(rows, places, k) for rows in (poses, ends))
            asked.append(PairsAsked.along(robot, held, tolerance, way, via, near))
        return cls(scenes, tuple(asked), places)

    def on(self, task: Task) -> Task:
        """Return a task with what is asked."""
        if not task.is_plain:
            return replace(task, around=self)
        (asked,) = self.asked
        also = (*asked.robot.limits.also, *asked.limits)
        return replace(task, family=LimitFamily.of(asked.robot.with_limits(also=also)))

    def limits(self, index: int) -> tuple[Limit, ...]:
        """Return the distances that are asked on a segment."""
        return self.asked[self.places[index]].limits

    def after(self, poses: Sequence[FloatArray], near: float = 0.0) -> AskedAfter:
        """Return what is asked once a motion with these poses [N,n] on every segment is known, as
        :meth:`PairsAsked.after`.
        """
        asked, touch, left_out = [], False, False
        for k, before in enumerate(self.asked):
            more, touching = before.after(_of_place(poses, self.places, k), near)
            asked.append(more)
            touch = touch or bool(touching.any())
            left_out = left_out or bool((touching & ~before.near).any())
        return AskedAfter(replace(self, asked=tuple(asked)), touch, left_out)

    def asks_more_than(self, before: Around) -> bool:
        """Return whether anything is asked that was not."""
        if self.scenes != before.scenes:
            return True
        pairs = zip(self.asked, before.asked, strict=True)
        return any(now.asks_more_than(then) for now, then in pairs)


class AskedAfter(NamedTuple):
    """What is asked once a motion is known; whether links come too near on it, and whether any that
    were left out do.
    """

    around: Around
    touch: bool
    were_left_out: bool


def _of_place(rows: Sequence[FloatArray], places: Sequence[int], place: int) -> FloatArray:
    return np.concatenate([row for row, at in zip(rows, places, strict=True) if at == place])
