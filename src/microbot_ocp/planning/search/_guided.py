"""The search for the fastest motion from a known way around obstacles.

The problem contains only pairs that can come close. If a pair outside of the problem comes too
near, it is added on the coarse mesh, before refinement, and the problem is solved again from the
way. If a pair of the problem comes too near, its required distance is raised and the problem is
solved from the current motion. Via points and stops differ only in the robot and the obstacles of
each segment.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import LIMIT_TOLERANCE, Limit, LimitFamily
from microbot_ocp.motion import Motion, PiecewisePolynomial, polynomial_of
from microbot_ocp.ocp import Solution
from microbot_ocp.planning.free import InitialGuess, excess_along, phase_shapes
from microbot_ocp.planning.search._branches import Way
from microbot_ocp.planning.search._queue import Level
from microbot_ocp.planning.search._refinement import best_of, resumed, search_of
from microbot_ocp.planning.search._result import fastest, is_accepted, motion_from
from microbot_ocp.planning.search._search import NOTHING, MotionAnswer, MotionSearch, SearchState
from microbot_ocp.planning.search._settings import SAME_OPTIMUM
from microbot_ocp.planning.search._starts import explore, explore_mesh, full_mesh
from microbot_ocp.planning.search._stop_motion import (
    motion_of,
    places_along,
    poses_at_stops,
    scenes_of,
    stretches,
    tool_poses,
)
from microbot_ocp.planning.search._through_stops import Front, SolveRequest, problem_of
from microbot_ocp.planning.task import Task, largest, reach_of
from microbot_ocp.robot import Robot
from microbot_ocp.scene import (
    ACCURACY,
    Clearance,
    Pair,
    Scene,
    clearance_along,
    clearances,
    facing,
    guiding_pairs,
    room_along,
)

# Distance beyond the clearance from which a pair enters the problem, share of the reach
NEAR = 0.01
# Distance left between links whose capsules overlap, share of the reach: on the first meshes links
# come nearer between mesh points by about as much
SPARE = 5e-4
MOST_REPEATS = 3  # solves with more pairs or larger distances
SAMPLES = 200  # poses along a segment at which pairs are evaluated
LARGER_DISTANCES = "links come too near: solved again with larger required distances"
FrontFunction = Callable[[MotionSearch, SearchState | None], Front]


# pairs in the problem, and their required distances ----------------------------------------------


@dataclass(frozen=True, eq=False)
class PairDistances:
    """Pairs of capsules around a path through a scene, and their required distances.

    Attributes
    ----------
    robot : Robot
    scene : Scene
    tolerance : float
        Relative tolerance of limits.
    pairs : tuple of Pair
        All k pairs that must not touch.
    most : array [k]
        Distances beyond the clearance at the via points, m: upper bounds of ``room``, because the
        motion may leave the path but not the via points.
    near : array of bool [k]
        Mask of the pairs in the problem.
    room : array [k]
        Required distances beyond the clearance, m; negative where capsules overlap on the path.
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
    ) -> PairDistances:
        """Return the pairs around a path with poses [N,n] through via points [m,n].

        A pair is near within the clearance and a share of the arm's reach.
        """
        pairs = facing(robot, guiding_pairs(robot, scene), poses)
        room, room_left, apart = room_along(robot, scene, pairs, poses, tolerance)
        within = scene.clearance + NEAR * reach_of(robot)
        most = clearances(robot, pairs, via).min(axis=0) - scene.clearance
        room = np.minimum(room, room_left)
        return cls(robot, scene, tolerance, pairs, most, apart < within, room)

    @property
    def limits(self) -> tuple[Limit, ...]:
        """Limits of the required distances."""
        if not self.near.any():
            return ()
        chosen = [pair for pair, near in zip(self.pairs, self.near, strict=True) if near]
        room = self.room[self.near].tolist()
        return (self.scene.limit(self.robot, chosen, tolerance=self.tolerance, room=room),)

    def after(self, poses: FloatArray, near: float = 0.0) -> tuple[PairDistances, np.ndarray]:
        """Return the requirements after a motion with poses [N,n], and a mask [k] of close pairs.

        Pairs whose links are too near enter the problem, with a larger distance as far as via
        points allow. Pairs within ``near``, a share of the reach, enter with them: a motion that
        passes through a body is too near to almost all of its parts.
        """
        come, least, apart = self._along(poses)
        touching = apart <= self.scene.clearance + ACCURACY  # the least that can be proved
        # The new distance is the one seen at the contact, and exceeds it by as much as the motion
        # misses the old one, as far as via points allow.
        missed = np.where(self.near, np.maximum(self.room - least, 0.0), 0.0)
        more = np.minimum(self.most, np.maximum(come, self.room) + missed)
        room = np.where(touching, more, self.room)
        within = self.scene.clearance + near * reach_of(self.robot)
        is_near = self.near | (apart <= within) if touching.any() else self.near
        return replace(self, near=is_near, room=room), touching

    def along_motion(self, poses: FloatArray) -> PairDistances:
        """Return the requirements along a motion with poses [N,n]; pairs that touch keep theirs."""
        room, _, apart = self._along(poses)
        touching = apart <= self.scene.clearance + ACCURACY
        return replace(self, room=np.where(touching, self.room, np.minimum(room, self.most)))

    def _along(self, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        spare = SPARE * reach_of(self.robot)
        return room_along(self.robot, self.scene, self.pairs, poses, self.tolerance, spare)

    def exceeds(self, before: PairDistances) -> bool:
        """Return True if a pair is new or its required distance is larger."""
        more = self.near & (~before.near | (self.room > before.room))
        return bool(more.any())


@dataclass(frozen=True, eq=False)
class RequiredDistances:
    """Obstacles of every segment of a task, and the required distances.

    Attributes
    ----------
    scenes : tuple of Scene
        Scene of every segment.
    distances : tuple of PairDistances
        Requirements of every distinct combination of arm and scene.
    places : tuple of int
        Index into ``distances`` for every segment.
    """

    scenes: tuple[Scene, ...]
    distances: tuple[PairDistances, ...]
    places: tuple[int, ...]

    def on(self, task: Task) -> Task:
        """Return the task with the required distances."""
        if not task.is_plain:
            return replace(task, around=self)
        (distances,) = self.distances
        also = (*distances.robot.limits.also, *distances.limits)
        return replace(task, family=LimitFamily.of(distances.robot.with_limits(also=also)))

    def limits(self, index: int) -> tuple[Limit, ...]:
        """Return the limits of the distances on a segment."""
        return self.distances[self.places[index]].limits

    def pairs(self, index: int) -> list[int]:
        """Return the indices of the pairs with a required distance on a segment.

        They count all pairs whose links may not touch.
        """
        return np.flatnonzero(self.distances[self.places[index]].near).tolist()

    def after(
        self, poses: Sequence[FloatArray], near: float = 0.0
    ) -> tuple[RequiredDistances, bool, bool]:
        """Return the requirements after a motion with poses [N,n] on every segment.

        Returns
        -------
        around : RequiredDistances
            Requirements, as in :meth:`PairDistances.after`.
        touch : bool
            True if links come too near on the motion.
        left_out : bool
            True if links of a pair outside of the problem come too near.
        """
        distances, touch, left_out = [], False, False
        for k, before in enumerate(self.distances):
            more, touching = before.after(_of_place(poses, self.places, k), near)
            distances.append(more)
            touch = touch or bool(touching.any())
            left_out = left_out or bool((touching & ~before.near).any())
        return replace(self, distances=tuple(distances)), touch, left_out

    def along_motion(self, poses: Sequence[FloatArray]) -> RequiredDistances:
        """Return the requirements along a motion with poses [N,n] on every segment."""
        parts = [
            before.along_motion(_of_place(poses, self.places, k))
            for k, before in enumerate(self.distances)
        ]
        return replace(self, distances=tuple(parts))

    def exceeds(self, before: RequiredDistances) -> bool:
        """Return True if a scene, a pair or a required distance is new."""
        if self.scenes != before.scenes:
            return True
        pairs = zip(self.distances, before.distances, strict=True)
        return any(now.exceeds(then) for now, then in pairs)


def _of_place(rows: Sequence[FloatArray], places: Sequence[int], place: int) -> FloatArray:
    return np.concatenate([row for row, at in zip(rows, places, strict=True) if at == place])


# the search ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class CoarseResult:
    """Coarse answers of a problem.

    Attributes
    ----------
    search : MotionSearch
    state : SearchState
    required : tuple of RequiredDistances and int
        Requirements of the problem, and the factor on its number of intervals.
    further : tuple of RequiredDistances and int, optional
        Requirements of the next problem. None if no pair outside of the problem is too near on the
        best answer.
    """

    search: MotionSearch
    state: SearchState
    required: tuple[RequiredDistances, int]
    further: tuple[RequiredDistances, int] | None = None

    @property
    def duration(self) -> float:
        """Duration of the best answer without dwells, s; infinite if none is solved."""
        answer = best_of(self.search, self.state)
        return answer.solution.duration if answer.solved else np.inf

    @property
    def only_refines(self) -> bool:
        """True if the next problem has a finer mesh and no further pairs."""
        return self.further is not None and self.further[1] > self.required[1]

    @property
    def is_finest(self) -> bool:
        """True on a full mesh."""
        return explore_mesh(self.search) == full_mesh(self.search)

    @property
    def level(self) -> Level:
        """Accuracy of the duration: each finer mesh gains less than the one before."""
        if self.is_finest:
            return Level.SPLIT
        return Level.COARSE if self.search.problem.finer == 1 else Level.FULL

    def is_optimum_of(self, other: CoarseResult) -> bool:
        """Return True if another result is the same optimum: as fast, on the same mesh."""
        if explore_mesh(self.search) != explore_mesh(other.search):
            return False
        return abs(self.duration - other.duration) <= SAME_OPTIMUM * self.duration < np.inf


@dataclass(frozen=True, eq=False)
class GuidedSearch:
    """A task among obstacles, and the way from which its search starts.

    Attributes
    ----------
    request : SolveRequest
    task : Task
        Task of an arm with capsules.
    scene : Scene
    way : Way
    start : InitialGuess
        Timed way.
    poses : tuple of array [N,n]
        Joint poses along the way on every segment, rad (m).
    """

    request: SolveRequest
    task: Task
    scene: Scene
    way: Way
    start: InitialGuess
    poses: tuple[FloatArray, ...]

    def around(self, tool: FloatArray) -> RequiredDistances:
        """Return the requirements along the way, with the tool in poses [m,4,4] at the stops."""
        scenes = scenes_of(self.task, self.scene, tool)
        kinds = list(zip(self.task.robots, scenes, strict=True))
        different = list(dict.fromkeys(kinds))
        places = tuple(map(different.index, kinds))
        ends, distances = [self.way.via[k : k + 2] for k in range(len(places))], []
        tolerance = self.request.settings.limit_tolerance
        for k, (robot, scene) in enumerate(different):
            held = scene.without_parts_of(robot)
            way, via = (_of_place(rows, places, k) for rows in (self.poses, ends))
            distances.append(PairDistances.along(robot, held, tolerance, way, via))
        return RequiredDistances(scenes, tuple(distances), places)

    def coarse_step(self, around: RequiredDistances | None = None, finer: int = 1) -> CoarseResult:
        """Return the coarse answer of a problem, and what the next problem requires.

        A pair outside of the problem that comes too near is added on the same mesh. If one of the
        problem comes too near between mesh points, the number of intervals is doubled: constraints
        at points alone let links pass through thin bars. It is doubled, too, if the answer is
        slower than its start: a coarse mesh cannot follow the short accelerations of a slow arm.

        Raises
        ------
        deadline.Over
            The time limit was reached before a search began.
        """
        around = around or self.around(tool_poses(self.task.robot, self.way.via))
        search = self._search(around, finer)
        result = CoarseResult(search, explore(search), (around, finer))
        answer = best_of(search, result.state)
        if not answer.solved:
            return result
        if answer.solution.duration > self._slowest and not result.is_finest:
            return self.coarse_step(around, 2 * finer)
        more, touch, left_out = around.after(_poses_of(answer))
        if not left_out and (not touch or result.is_finest):
            return result
        self.request.progress(LARGER_DISTANCES)
        return replace(result, further=(more, finer if left_out else 2 * finer))

    @property
    def _slowest(self) -> float:
        """Duration of the start, s; infinite if a motion may have to take longer."""
        durations = [guess.duration or np.inf for guess in self.start.guesses.values()]
        # Timings of paths leave out rates.
        slower = self.request.duration is not None or self.task.family.jerk_matters
        return np.inf if slower else sum(durations)

    def next_step(self, result: CoarseResult) -> CoarseResult:
        """Return the coarse answer of the next problem; the present one if that is not solved."""
        assert result.further is not None
        step = self.coarse_step(*result.further)
        return step if np.isfinite(step.duration) else replace(result, further=None)

    def settled(self, result: CoarseResult) -> CoarseResult:
        """Return the coarse answer that needs no further one."""
        while result.further is not None:
            result = self.next_step(result)
        return result

    def motions(
        self, now: CoarseResult, front_of: FrontFunction | None = None, most: float = np.inf
    ) -> tuple[Front, list[Clearance | None]]:
        """Return the requested motions with proofs, by default the fastest or of least effort.

        A proof exists only for a motion that is solved or within the limits. The lists are empty if
        the time limit was reached before the search began. The search ends at a motion that is not
        faster than ``most``, s: a clear one would be slower.
        """
        front: Front = [], ""
        proofs = list[Clearance | None]()
        with suppress(deadline.Over):
            now = self._along_itself(now)
            known: tuple[Motion, Clearance] | None = None  # fastest motion that is proved clear
            for _ in range(MOST_REPEATS + 1):
                answer: MotionAnswer | None = None
                if front_of is None:
                    tried, answer = self._fastest(now)
                    motion, proof = tried[0]
                    clear = [(motion, proof) for motion, proof in tried if is_clear(proof)]
                    known = min([*clear, *([known] if known else [])], key=_duration, default=None)
                    front, proofs = ([(0.0, motion)], ""), [proof]
                    if known and known[0].duration <= (1.0 + SAME_OPTIMUM) * motion.duration:
                        break
                    if motion.duration >= most:
                        break
                else:
                    front = front_of(now.search, now.state)
                    proofs = [self._proof(m) if _is_within(m) else None for _, m in front[0]]
                rows = zip(front[0], proofs, strict=True)
                pairs = [(m, proof) for (_, m), proof in rows if proof and not proof.proved]
                if not pairs:
                    break
                around, finer = now.required
                more, left_out = self._required_after(around, pairs)
                # The solve would repeat itself without a new requirement.
                if not more.exceeds(around):
                    break
                self.request.progress(LARGER_DISTANCES)
                # A missing pair let the motion pass through a body: its neighbourhood is useless.
                again = None if left_out or answer is None else self._resumed(more, finer, answer)
                now = again or self.settled(self.coarse_step(more, finer))
            if known:
                front, proofs = ([(0.0, known[0])], ""), [known[1]]
            proofs = _of_accepted(front, proofs)
        return front, proofs

    def _along_itself(self, now: CoarseResult) -> CoarseResult:
        """Return a coarse answer with the distances that its own motion requires.

        Those that its path requires depend on the path: where capsules overlap, a limit follows
        the links only near the pose in which they were measured.
        """
        around, finer = now.required
        answer = best_of(now.search, now.state)
        if not answer.solved:
            return now
        around = around.along_motion(_poses_of(answer))
        with suppress(deadline.Over):
            return self._resumed(around, finer, answer) or now
        return now

    def _fastest(
        self, now: CoarseResult
    ) -> tuple[list[tuple[Motion, Clearance | None]], MotionAnswer]:
        """Return the fastest motion or that of least effort, with the proof that it keeps clear.

        If it is not proved, the motion before its last digits follows: the last digits move the arm
        nearer to the obstacles.
        """
        best = fastest(now.search, now.state, duration=self.request.duration)
        answers, before = [best.answer], best.answer.before
        if best.answer.level is Level.FINISHED and before is not None:
            answers += [before] if before.solution is not best.answer.solution else []
        tried = list[tuple[Motion, Clearance | None]]()
        for answer in answers:
            motion = motion_from(replace(best, answer=answer))
            kept = _is_within(motion) or self._own_excess(answer.solution) is not None
            tried.append((motion, self._proof(motion) if kept else None))
            if is_clear(tried[-1][1]):
                break
        return tried, best.answer

    def _resumed(
        self, around: RequiredDistances, finer: int, start: MotionAnswer
    ) -> CoarseResult | None:
        """Return an answer solved again under other distances, or None.

        Poses of a redundant arm slide, so that further pairs may come too near.
        """
        left_out = True
        while left_out:
            search, begin = self._search(around, finer), time.perf_counter()
            again = resumed(search, start)
            if not again.solved:
                return None
            result = CoarseResult(search, NOTHING.and_(again, begin), (around, finer))
            around, _, left_out = around.after(_poses_of(again), NEAR)
        return result

    def _search(self, around: RequiredDistances, finer: int) -> MotionSearch:
        with deadline.given_up():
            request = self.request
            given = request.settings, request.duration, (self.way,), self.start, finer
            problem = problem_of(around.on(self.task), *given)
            problem = replace(problem, proved_excess=self._proved_excess)
            return search_of(problem, request.progress)

    def _own_excess(self, solution: Solution) -> list[FloatArray] | None:
        """Return the excess of the task's own limits; None if it is too large."""
        pairs = zip(self.task.families, phase_shapes(solution), strict=True)
        excess = [excess_along(family, shape) for family, shape in pairs]
        return excess if largest(excess) <= self.request.settings.limit_tolerance else None

    def _proved_excess(self, solution: Solution) -> list[FloatArray] | None:
        """Return the excess of the task's own limits if the links are proved to keep clear.

        Exact geometry decides. Capsules stand out from their links, and the nearest points of two
        bodies jump between faces, so their distances would need endless meshes.
        """
        excess = self._own_excess(solution)
        if excess is None:
            return None
        motion = motion_of(self.task, phase_shapes(solution), {})
        return excess if self._proof(motion).proved else None

    def _proof(self, motion: Motion) -> Clearance:
        return clearance_along(places_along(self.task, motion, self.scene), motion)

    def _required_after(
        self, around: RequiredDistances, pairs: Sequence[tuple[Motion, Clearance]]
    ) -> tuple[RequiredDistances, bool]:
        """Return the requirements after motions with links too near, and the need of a new start.

        A new start is needed if a pair outside of the problem is too near, or parts have moved.
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
            around, _, more_left_out = around.after(along, NEAR)
            left_out = left_out or more_left_out
        return around, left_out


def _of_accepted(front: Front, proofs: Sequence[Clearance | None]) -> list[Clearance | None]:
    """Return the proofs of motions that are clear or accepted, and None for the others."""
    rows = zip(front[0], proofs, strict=True)
    return [proof if is_clear(proof) or is_accepted(m) else None for (_, m), proof in rows]


def _is_within(motion: Motion) -> bool:
    return is_accepted(motion) or motion.provenance["excess"] <= LIMIT_TOLERANCE


def _duration(proved: tuple[Motion, Clearance]) -> float:
    return proved[0].duration


def is_clear(proof: Clearance | None) -> TypeGuard[Clearance]:
    """Return True if a motion is proved to keep clear."""
    return proof is not None and proof.proved


def _poses_of(answer: MotionAnswer) -> list[FloatArray]:
    """Return poses [N,n] along every segment of an answer."""
    return [poses_along(shape) for shape in phase_shapes(answer.solution)]


def poses_along(
    shape: PiecewisePolynomial, start: float = 0.0, end: float | None = None, also: float = 0.0
) -> FloatArray:
    """Return poses [N,n] along a motion from start to end, s, and at a further time within them."""
    end = shape.duration if end is None else end
    times = np.linspace(start, end, SAMPLES)
    return shape(np.append(times, np.clip(also, start, end)))
