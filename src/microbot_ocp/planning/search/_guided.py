"""The search for the fastest motion from a way around obstacles that is known.

Only pairs that can come close are in the problem. Where one that was left out comes too near on
what was found it is put in, on the coarse mesh before anything is refined, and the problem is
solved again from the way; where a pair of the problem does, from where the motion is. Via points
and stops are the same here: what differs is the robot on each segment, and what lies around it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import LIMIT_TOLERANCE, Limit, LimitFamily
from microbot_ocp.motion import Motion, PiecewisePolynomial, polynomial_of
from microbot_ocp.planning.free import InitialGuess, phase_shapes
from microbot_ocp.planning.search._branches import Way
from microbot_ocp.planning.search._result import fastest, motion_from
from microbot_ocp.planning.search._search import MotionAnswer, MotionSearch, SearchState
from microbot_ocp.planning.search._starts import FROM_PATHS, explore_mesh, full_mesh
from microbot_ocp.planning.search._stop_motion import (
    places_along,
    poses_at_stops,
    scenes_of,
    stretches,
    tool_poses,
)
from microbot_ocp.planning.search._strategies import best_of, resumed, search_of
from microbot_ocp.planning.search._through_stops import Asked, Front, problem_of
from microbot_ocp.planning.task import Task, reach_of
from microbot_ocp.robot import Robot
from microbot_ocp.scene import (
    Clearance,
    Pair,
    Scene,
    clearance_along,
    clearances,
    facing,
    guiding_pairs,
    room_along,
)


@dataclass(frozen=True)
class GuidedSettings:
    """Settings of the search from a way around obstacles.

    Attributes
    ----------
    near : of the arm's reach, beyond the clearance: pairs that come so near are in the problem.
        With three times as much 30 to 100 pairs of a UR5 are, and an iteration takes two to four
        times as long; with a third too few come in at a time, and ``again`` is not enough
    again : times that a motion may be solved for anew with more pairs, or more asked of them: on
        the coarse mesh, and where its refined motion is not proved to keep clear
    samples : poses along a segment at which pairs are looked at
    """

    near: float = 0.01
    again: int = 3
    samples: int = 200


GUIDED = GuidedSettings()
ASKED_MORE = "links come too near: solved again with more asked of them"
Ask = Callable[[MotionSearch, SearchState | None], Front]


# pairs that are in the problem, and the distances that are asked of them --------------------------


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
        cls, robot: Robot, scene: Scene, tolerance: float, poses: FloatArray, via: FloatArray
    ) -> PairsAsked:
        """Return those that come near on a path, poses [N,n] through via points [m,n].

        Near is what comes within the clearance and a share of the arm's reach.
        """
        pairs = facing(robot, guiding_pairs(robot, scene), poses)
        room, room_left, apart = room_along(robot, scene, pairs, poses, tolerance)
        within = scene.clearance + GUIDED.near * reach_of(robot)
        most = clearances(robot, pairs, via).min(axis=0) - scene.clearance
        room = np.minimum(room, room_left)
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
        within = self.scene.clearance + near * reach_of(self.robot)
        is_near = self.near | (apart <= within) if touching.any() else self.near
        return replace(self, near=is_near, room=room), touching

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

    def after(self, poses: Sequence[FloatArray], near: float = 0.0) -> tuple[Around, bool, bool]:
        """Return what is asked once a motion with these poses [N,n] on every segment is known, as
        :meth:`PairsAsked.after`; whether links come too near on it, and whether any that were left
        out do.
        """
        asked, touch, left_out = [], False, False
        for k, before in enumerate(self.asked):
            more, touching = before.after(_of_place(poses, self.places, k), near)
            asked.append(more)
            touch = touch or bool(touching.any())
            left_out = left_out or bool((touching & ~before.near).any())
        return replace(self, asked=tuple(asked)), touch, left_out

    def asks_more_than(self, before: Around) -> bool:
        """Return whether anything is asked that was not."""
        if self.scenes != before.scenes:
            return True
        pairs = zip(self.asked, before.asked, strict=True)
        return any(now.asks_more_than(then) for now, then in pairs)


def _of_place(rows: Sequence[FloatArray], places: Sequence[int], place: int) -> FloatArray:
    return np.concatenate([row for row, at in zip(rows, places, strict=True) if at == place])


# the search ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Explored:
    """Coarse answers, with all pairs in the problem that come too near on the best of them."""

    search: MotionSearch
    state: SearchState
    around: Around
    finer: int

    @property
    def duration(self) -> float:
        """What the best of them takes, dwells not included, s; infinite where none is solved."""
        answer = best_of(self.search, self.state)
        return answer.solution.duration if answer.solved else np.inf


@dataclass(frozen=True, eq=False)
class GuidedSearch:
    """A task among obstacles, and a way through it from which the search goes on.

    Attributes
    ----------
    asked : Asked
    task : Task
        Of an arm with capsules.
    scene : Scene
    way : Way
    start : InitialGuess
        The way with a timing.
    poses : tuple of array [N,n]
        Along the way on every segment, rad (m).
    """

    asked: Asked
    task: Task
    scene: Scene
    way: Way
    start: InitialGuess
    poses: tuple[FloatArray, ...]

    def around(self, tool: FloatArray) -> Around:
        """Return what is asked along the way, with the tool in poses [m,4,4] at the stops."""
        scenes = scenes_of(self.task, self.scene, tool)
        kinds = list(zip(self.task.robots, scenes, strict=True))
        different = list(dict.fromkeys(kinds))
        places = tuple(map(different.index, kinds))
        ends, asked = [self.way.via[k : k + 2] for k in range(len(places))], []
        tolerance = self.asked.settings.limit_tolerance
        for k, (robot, scene) in enumerate(different):
            held = scene.without_parts_of(robot)
            way, via = (_of_place(rows, places, k) for rows in (self.poses, ends))
            asked.append(PairsAsked.along(robot, held, tolerance, way, via))
        return Around(scenes, tuple(asked), places)

    def explored(self, around: Around | None = None, finer: int = 1) -> Explored:
        """Return the coarse answer of a problem in which all pairs are that come too near on it.

        Where a pair of the problem does, between mesh points, these are twice as many: links pass
        through bars from one point to the next.

        Raises
        ------
        deadline.Over
            The time was over before a search began.
        """
        around = around or self.around(tool_poses(self.task.robot, self.way.via))
        while True:
            search = self._search(around, finer)
            result = Explored(search, search.run(FROM_PATHS), around, finer)
            answer = best_of(search, result.state)
            if not answer.solved:
                return result
            poses = [poses_along(shape) for shape in phase_shapes(answer.solution)]
            around, touch, left_out = around.after(poses)
            if not left_out:
                if not touch or explore_mesh(search) == full_mesh(search):
                    return result
                finer *= 2
            self.asked.progress(ASKED_MORE)

    def motions(
        self, ask: Ask | None = None, explored: Explored | None = None
    ) -> tuple[Front, list[Clearance | None]]:
        """Return the motions that a search is asked for, by default the fastest one or that of
        least effort, and whether each is proved to keep clear.

        Of those alone that are solved, or within the limits though they are not, if so. Nothing
        where the time was over before the search began.
        """
        front: Front = [], ""
        proofs = list[Clearance | None]()
        with suppress(deadline.Over):
            now = explored or self.explored()
            for _ in range(GUIDED.again + 1):
                answer: MotionAnswer | None = None
                if ask is None:
                    motion, proof, answer = self._fastest(now)
                    front, proofs = ([(0.0, motion)], ""), [proof]
                else:
                    front = ask(now.search, now.state)
                    proofs = [self._proof(motion) for _, motion in front[0]]
                rows = zip(front[0], proofs, strict=True)
                pairs = [(m, proof) for (_, m), proof in rows if proof and not proof.proved]
                if not pairs:
                    break
                more, left_out = self._asked_after(now.around, pairs)
                if not more.asks_more_than(now.around):
                    break
                self.asked.progress(ASKED_MORE)
                # where a pair was left out the motion passed through it: from the way again
                now = self._again(more, now.finer, None if left_out else answer)
        return front, proofs

    def _fastest(self, now: Explored) -> tuple[Motion, Clearance | None, MotionAnswer]:
        """Return the fastest motion or the one of least effort, and whether it is proved to keep
        clear; without the last digits where only that is: they take it nearer to what is around.
        """
        best = fastest(now.search, now.state, duration=self.asked.duration)
        answers, before = [best.answer], best.answer.before
        if best.answer.strategy == "last digits" and before is not None:
            answers += [before] if before.solution is not best.answer.solution else []
        for answer in answers:
            motion = motion_from(replace(best, answer=answer))
            proof = self._proof(motion)
            if proof is not None and proof.proved:
                break
        return motion, proof, answer

    def _again(self, around: Around, finer: int, refused: MotionAnswer | None) -> Explored:
        """Return where it goes on with more asked: from a refined answer, or the way."""
        if refused is not None:
            search = self._search(around, finer)
            state = resumed(search, refused)
            if state.answers[0].solved:
                return Explored(search, state, around, finer)
        return self.explored(around, finer)

    def _search(self, around: Around, finer: int) -> MotionSearch:
        with deadline.given_up():
            asked = self.asked
            given = asked.settings, asked.duration, (self.way,), self.start, finer
            return search_of(problem_of(around.on(self.task), *given), asked.progress)

    def _proof(self, motion: Motion) -> Clearance | None:
        """Return how a motion keeps clear, where that matters."""
        if not (motion.solved or motion.provenance["excess"] <= LIMIT_TOLERANCE):
            return None
        proof = clearance_along(places_along(self.task, motion, self.scene), motion)
        return proof if motion.solved or proof.proved else None

    def _asked_after(
        self, around: Around, pairs: Sequence[tuple[Motion, Clearance]]
    ) -> tuple[Around, bool]:
        """Return what is asked once motions are known on which links come too near, and whether
        that is of pairs that were left out, or of parts that lie elsewhere.
        """
        tool = poses_at_stops(self.task, pairs[0][0])
        left_out = scenes_of(self.task, self.scene, tool) != around.scenes
        around = self.around(tool) if left_out else around
        for motion, proof in pairs:
            shape = polynomial_of(motion)
            poses: list[list[FloatArray]] = [[] for _ in self.poses]
            for part in stretches(self.task, motion):
                poses[part.segment].append(poses_along(shape, part.start, part.end, proof.time))
            along = list(map(np.concatenate, poses))
            around, _, more_left_out = around.after(along, GUIDED.near)
            left_out = left_out or more_left_out
        return around, left_out


def poses_along(
    shape: PiecewisePolynomial, start: float = 0.0, end: float | None = None, also: float = 0.0
) -> FloatArray:
    """Return poses [N,n] along a motion from start to end, s, at a further time, too, if that is
    between them.
    """
    end = shape.duration if end is None else end
    times = np.linspace(start, end, GUIDED.samples)
    return shape(np.append(times, np.clip(also, start, end)))
