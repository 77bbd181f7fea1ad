"""Free time-optimal motions among obstacles.

Ways around the obstacles come from planners of joint paths; each, with its best timing, is a motion
that keeps every limit and is proved to keep clear, from which the search for the fastest motion
starts. Only pairs that can come close are in the problem; one that was left out and is too near
afterwards is put in, and the problem is solved again. What is returned is never slower than the
best of the timed paths, and it is one of them where the search found nothing or the time was over.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.codegen import compiles
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LIMIT_TOLERANCE, LimitFamily
from microbot_ocp.motion import (
    Mark,
    Motion,
    PiecewisePolynomial,
    dense_times,
    pieces_of,
    samples_at,
)
from microbot_ocp.ocp import Solution
from microbot_ocp.ocp.solution import StepProgress, quiet
from microbot_ocp.planning._fast_timing import time_path
from microbot_ocp.planning._free_problem import phase_names
from microbot_ocp.planning._free_search import (
    KEEPS_LIMITS,
    FreeSearch,
    TimeOptimalSettings,
    Trial,
    sparing,
)
from microbot_ocp.planning._initial_guesses import InitialGuess, guesses_along
from microbot_ocp.planning._path_limits import LATER
from microbot_ocp.planning._path_timing import PathTimingSettings, best_timing
from microbot_ocp.planning._paths import check_path
from microbot_ocp.planning._scale import TaskScale
from microbot_ocp.planning._task import ROUGH_TOLERANCE, length_text, reach_of
from microbot_ocp.planning._within_limits import known_ways
from microbot_ocp.robot import Robot
from microbot_ocp.scene import (
    Clearance,
    Detour,
    Pair,
    Scene,
    Surroundings,
    clearance,
    clearances,
    detour,
    with_arm_capsules,
)
from microbot_ocp.trajectories import quintic, shortest_duration

SEEDS = 4  # searches of the planner for each segment that are made in any case
MOST_GUESSES = 3  # timed paths that the search starts from
DIFFERENT = 0.02  # share of the duration by which timed paths must differ to count as two
NEAR = 0.1  # of the arm's reach: pairs that come so near on a timed path are in the problem
MESH = 60  # intervals a phase of the first full solve where nobody says how many
AGAIN = 3  # times that pairs may be put in
MOST_ITERATIONS = 300  # of a solve; from a timed path 20 to 60 are usual
NEAR_PATH = 1e-3  # barrier parameter of a solve that stays near the path that it starts from
SAMPLES = 200  # poses along a motion at which pairs are looked at


@dataclass(frozen=True, eq=False)
class TimedPath:
    """A path around the obstacles with a timing that keeps all limits.

    Attributes
    ----------
    name : str
    motion : Motion
    via_times : array [m], s
    clearance : Clearance
        Proved.
    """

    name: str
    motion: Motion
    via_times: FloatArray
    clearance: Clearance


class _GuidedSearch(FreeSearch):
    """The usual search, from guesses that are given, without a polish of the last digits."""

    tries_beside = False  # what is no faster than the best path is not refined
    slows_down = False  # the best path is there for that

    def __init__(
        self,
        family: LimitFamily,
        via: FloatArray,
        settings: TimeOptimalSettings,
        progress: StepProgress,
        guided: Sequence[InitialGuess],
    ) -> None:
        super().__init__(family, via, settings, progress)
        self.guided = guided
        self.refiner.rough, self.refiner.tolerance = None, ROUGH_TOLERANCE
        own = replace(self.refiner.settings, gap=np.inf, max_iterations=MOST_ITERATIONS)
        self.refiner.settings = own
        self.known: float = min(map(_duration, guided))

    @property
    def _mesh(self) -> int:
        usual = super()._mesh
        return usual if self.settings.mesh is not None else min(usual, MESH)

    def _trials(self) -> Iterator[Trial]:
        usual = super()._trials()
        for guess in self.guided:
            _, mesh, solver = next(usual)
            yield guess, mesh, solver

    def _finish(self, found: list[Solution]) -> Solution:
        """Refine the best coarse answers; from the best path itself where none is faster."""
        faster = [s for s in found if s.status.solved and s.duration < self.known]
        if faster or deadline.over():
            return super()._finish(faster or found)
        self.progress("no coarse answer is faster than the best path: solved from there")
        best = min(self.guided, key=_duration)
        meshes, start = [self._mesh] * len(self.names), best.guesses
        if self.refiner.fitted is not None:  # dry friction rounded off at first
            solution = self._coarse_refiner.solve(meshes, start, barrier=NEAR_PATH)
            start = solution if solution.status.solved else start
        solution = self.refiner.solve(meshes, start, barrier=NEAR_PATH)
        if not solution.status.solved and any(s.status.solved for s in found):
            return super()._finish(found)
        return self.refiner.finished(self.refiner.refine(solution))


def _duration(guess: InitialGuess) -> float:
    return sum(float(own.duration or 0.0) for own in guess.guesses.values())


def fastest_among(
    family: LimitFamily,
    via: FloatArray,
    scene: Scene,
    settings: TimeOptimalSettings,
    progress: StepProgress,
) -> Motion:
    """The fastest motion through via points [m,n] that keeps clear of a scene.

    Raises
    ------
    InputError
        A via point in collision; OMPL or coal is not installed.
    """
    begin = time.perf_counter()
    robot: Robot = with_arm_capsules(family.robot)
    family = LimitFamily.of(robot)
    around = Surroundings(robot, scene)
    check_apart(around, via)
    with sparing():
        legs, failed = ways_around(around, via, settings.seed, progress)
    paths = timed_paths(around, legs, settings, progress)
    planned = time.perf_counter() - begin
    if not paths:
        why = _nothing_found(via, legs, failed)
        return _not_found(family, scene, via, settings, why, planned)
    best = _solved(family, via, scene, settings, progress, paths)
    more = {
        "scene": list(scene.names),
        "paths": [{"start": p.name, "duration": p.motion.duration} for p in paths],
        "planning_time": planned,
        "wall_time": time.perf_counter() - begin,
    }
    proof = clearance(robot, best, scene) if best.solved else None
    if proof is not None and proof.proved and best.duration < paths[0].motion.duration:
        more["clearance"] = as_plain(proof)
        return replace(best, provenance={**best.provenance, **more})
    status, advice = best.status, best.provenance["advice"]
    if proof is not None and proof.proved:
        advice = "the search found nothing faster"
    elif proof is not None:
        status, advice = Status.NOT_ACCEPTED, proof.sentence
    elif status in (Status.INFEASIBLE, Status.LIMITS_EXCEEDED):  # there is a motion
        status, advice = Status.FAILED, "The search found no motion within the limits."
    if status.solved and deadline.over():
        status, advice = Status.TIME_LIMIT, Status.TIME_LIMIT.sentence
    chain, made_from = paths[0], "the best timing of a path around the obstacles"
    note = f"{made_from}: {advice}"
    if not status.solved:
        advice += "\n" + KEEPS_LIMITS.format(made_from)
        note = f"not solved: {advice}"
    more |= {"advice": advice, "status": str(status), "made_from": made_from}
    more["clearance"] = as_plain(chain.clearance)
    return replace(
        chain.motion,
        label="time-optimal",
        provenance={**chain.motion.provenance, **more},
        note=note,
    )


def check_apart(around: Surroundings, via: FloatArray) -> None:
    """Raise InputError where the arm touches something at a via point [m,n]."""
    for number, q in enumerate(via, start=1):
        found = around.collision(q)
        if found is not None:
            name = _name_of(number, len(via))
            raise InputError(f"{name} {touching(found, around.scene.clearance)}")


def touching(found: Any, wanted: float) -> str:
    other, link = found.pair.other.name, found.pair.capsule.name
    if found.distance <= 0.0:
        return f"in collision with {other!r} by {length_text(-found.distance)} at link {link!r}"
    return (
        f"too near to {other!r}: {length_text(found.distance)} at link {link!r}, not more than the "
        f"clearance of {length_text(wanted)}"
    )


def _name_of(number: int, count: int) -> str:
    return {1: "start", count: "goal"}.get(number, f"via point {number}")


def ways_around(
    around: Surroundings, via: FloatArray, seed: int, progress: StepProgress
) -> tuple[list[list[Detour]], list[Detour]]:
    """Ways from each via point [m,n] to the next, and the searches that failed.

    Where none of the first searches finds one, further ones follow until one does or the time is
    over; a segment that has none is the last.
    """
    legs: list[list[Detour]] = []
    failed: list[Detour] = []
    for start, end in itertools.pairwise(via):
        legs.append([])
        for number in itertools.count():
            if (number >= SEEDS and legs[-1]) or (number and deadline.over()):
                break
            found = detour(around, start, end, seed, number)
            (failed if found.path is None else legs[-1]).append(found)
            if found.path is None:
                progress(f"search {number}: no path in {found.checks} poses")
            if found.name == "straight":
                break
        if not legs[-1]:
            break
    return legs, failed


def timed_paths(
    around: Surroundings,
    legs: Sequence[Sequence[Detour]],
    settings: TimeOptimalSettings,
    progress: StepProgress,
) -> list[TimedPath]:
    """Ways through via points with a timing that keeps all limits, fastest first.

    At the time limit that of the first way alone.
    """
    found: list[TimedPath] = []
    for choice in range(max(map(len, legs)) if all(legs) else 0):
        if found and deadline.over():
            break
        chosen = [leg[min(choice, len(leg) - 1)] for leg in legs]
        timed = _timed(around, chosen, settings)
        if timed is not None:
            found.append(timed)
            progress(f"path {timed.name}: {timed.motion.duration:.4f} s with its best timing")
    found.sort(key=lambda path: path.motion.duration)
    kept: list[TimedPath] = []
    for path in found:
        durations = [other.motion.duration for other in kept]
        if all(path.motion.duration > (1 + DIFFERENT) * other for other in durations):
            kept.append(path)
    return kept[:MOST_GUESSES]


def _timed(
    around: Surroundings, legs: Sequence[Detour], settings: TimeOptimalSettings
) -> TimedPath | None:
    """A way with its timing, at rest at every via point; None where it cannot be travelled."""
    robot = around.robot
    motions = []
    for leg in legs:
        motion = timed_leg(robot, leg, settings)
        if motion is None:
            return None
        motions.append(motion)
    name = "path " + ", ".join(leg.name for leg in legs)
    times = np.cumsum([0.0, *(m.duration for m in motions)])
    if len(motions) == 1:
        whole = motions[0]
    else:
        shape = PiecewisePolynomial(
            np.concatenate(
                [np.zeros(1), *(t + m.t[1:] for t, m in zip(times, motions, strict=False))]
            ),
            np.concatenate([pieces_of(m) for m in motions]),
        )
        whole = Motion.from_polynomial(
            robot, shape, label="timed path", provenance=motions[0].provenance
        )
    marks = tuple(Mark(float(t), f"via {i + 1}") for i, t in enumerate(times))
    proof = clearance(robot, whole, around.scene)
    return TimedPath(name, replace(whole, marks=marks), times, proof) if proof.proved else None


def timed_leg(robot: Robot, leg: Detour, settings: TimeOptimalSettings) -> Motion | None:
    """The best timing of a way around obstacles that keeps all limits.

    Where none is found in time, or at all, a motion that rests at every corner of its polyline;
    None where limits allow not even that.
    """
    assert leg.path is not None
    assert leg.corners is not None
    family = LimitFamily.of(robot)
    try:
        if not family.jerk_matters:
            timing = time_path(robot, leg.path, compiled=settings.compiled)
            if timing.solved and not timing.limits_kept_by[LATER]:
                return timing.motion("timed path")
        if not deadline.over():
            check_path(family, leg.path)
            own = PathTimingSettings(
                limit_tolerance=settings.limit_tolerance, compiled=settings.compiled
            )
            motion = best_timing(family, leg.path, own, "timed path", quiet)
            if motion.solved and _keeps_limits(family, motion):
                return motion
        ends = list(itertools.pairwise(leg.corners))
        shapes = [quintic(pair, [0.0, 1.0], np.zeros((2, robot.joint_count))) for pair in ends]
        # their own time: without any motion nothing could be returned
        scaled = [shortest_duration(robot, shape).polynomial for shape in shapes]
    except InputError:  # it leaves the position limits, or cannot be held somewhere
        return None
    breaks = np.cumsum([0.0, *(shape.duration for shape in scaled)])
    shape = PiecewisePolynomial(breaks, np.concatenate([s.coefficients for s in scaled]))
    motion = Motion.from_polynomial(
        robot,
        shape,
        label="timed path",
        provenance={"method": "path around obstacles, at rest at its corners"},
    )
    return motion if _keeps_limits(family, motion) else None


def _keeps_limits(family: LimitFamily, motion: Motion) -> bool:
    dense = samples_at(motion, dense_times(motion)[0])
    return bool(family.excess(dense).max() <= LIMIT_TOLERANCE)


def _solved(
    family: LimitFamily,
    via: FloatArray,
    scene: Scene,
    settings: TimeOptimalSettings,
    progress: StepProgress,
    paths: Sequence[TimedPath],
) -> Motion:
    """The fastest motion found from timed paths, with all pairs that matter in the problem."""
    robot: Robot = family.robot
    pairs = scene.pairs(robot)
    names = phase_names(len(via) - 1)
    apart = np.array([_apart(robot, pairs, path.motion).min(axis=0) for path in paths])
    near = apart.min(axis=0) < NEAR * reach_of(robot)
    room = max(apart, key=min) - scene.clearance  # of the way that keeps farthest away
    guesses = [InitialGuess(p.name, _along(names, p.motion, p.via_times)) for p in paths]
    motion: Motion | None = None
    for _ in range(AGAIN + 1):
        limit = scene.limit(
            robot,
            [p for p, is_near in zip(pairs, near, strict=True) if is_near],
            tolerance=settings.limit_tolerance,
            room=room[near],
        )
        also = [*family.robot.limits.also, limit] if near.any() else family.robot.limits.also
        bounded = LimitFamily.of(robot.with_limits(also=also))
        motion = _GuidedSearch(bounded, via, settings, progress, guesses).run()
        if not motion.solved:
            return motion
        bounds = np.array([scene.clearance for _ in pairs])
        missed = (_apart(robot, pairs, motion).min(axis=0) < bounds) & ~near
        if not missed.any():
            return motion
        progress(f"{missed.sum()} more pairs come too near: solved again")
        near |= missed
        times = np.array([mark.time for mark in motion.marks])
        guesses = [InitialGuess("the motion before", _along(names, motion, times)), *guesses]
    assert motion is not None
    return motion


def _along(names: Sequence[str], motion: Motion, times: FloatArray) -> dict[str, Any]:
    return guesses_along(names, PiecewisePolynomial(motion.t, pieces_of(motion)), times)


def _apart(robot: Robot, pairs: Sequence[Pair], motion: Motion) -> FloatArray:
    """Distances [N,k] of pairs along a motion, m, by the functions that solvers see."""
    t = np.linspace(0.0, motion.duration, SAMPLES)
    return clearances(robot, pairs, motion.sample(t).q)


def as_plain(found: Clearance) -> dict[str, Any]:
    return {
        "minimum": found.minimum,
        "time": found.time,
        "pair": found.pair,
        "proved": found.proved,
        "at_least": found.at_least,
    }


def _nothing_found(
    via: FloatArray, legs: Sequence[Sequence[Detour]], failed: Sequence[Detour]
) -> str:
    """Why there is no timed path."""
    if all(legs):
        return "no path around the obstacles that was found can be travelled within the limits"
    nearest = min(failed, key=lambda own: own.left)
    poses = sum(own.checks for own in failed)
    start, end = (_name_of(k, len(via)) for k in (len(legs), len(legs) + 1))
    return (
        f"no path from the {start} to the {end} was found in {poses} poses; the search came within "
        f"{np.degrees(nearest.left):.3g} deg (in joint space) of the {end}"
    )


def _not_found(
    family: LimitFamily,
    scene: Scene,
    via: FloatArray,
    settings: TimeOptimalSettings,
    why: str,
    wall: float,
) -> Motion:
    """What is returned where no way was found: a motion as without obstacles, and what it hits."""
    known = known_ways(family, via, settings.limit_tolerance, compiles(settings.compiled))
    if known is None:
        times = np.cumsum([0.0, *TaskScale.of(family, via).durations])
        shape = quintic(via, times, np.zeros_like(via))
        motion = Motion.from_polynomial(family.robot, shape, label="time-optimal")
    else:
        motion = known.motion
    hit = clearance(family.robot, motion, scene)
    advice = f"{why}. {Status.NOT_FOUND.sentence}\nReturned is a motion that ignores the obstacles."
    return replace(
        motion,
        label="time-optimal",
        provenance={
            "method": "free time-optimal motion among obstacles",
            "status": str(Status.NOT_FOUND),
            "advice": advice,
            "scene": list(scene.names),
            "clearance": as_plain(hit),
            "wall_time": wall,
        },
        note=f"not solved: {advice} {hit.sentence}",
    )
