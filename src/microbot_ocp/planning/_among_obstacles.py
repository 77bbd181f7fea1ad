"""Free time-optimal motions among obstacles.

Ways around the obstacles come from a planner of joint paths; each, with its best timing, is a
motion that keeps every limit but those of jerk and torque rate, from which the search for the
fastest motion starts. Only pairs that can come close are in the problem; one that was left out and
is too near afterwards is put in, and the problem is solved again. What is returned is never slower
than the best of the timed paths, where that keeps all limits.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import Mark, Motion, PiecewisePolynomial, pieces_of
from microbot_ocp.ocp import Solution
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.planning._fast_timing import time_path
from microbot_ocp.planning._free_problem import phase_names
from microbot_ocp.planning._free_search import FreeSearch, TimeOptimalSettings, Trial
from microbot_ocp.planning._initial_guesses import InitialGuess, guesses_along
from microbot_ocp.planning._task import ROUGH_TOLERANCE, check_rest, length_text, reach_of
from microbot_ocp.robot import Robot
from microbot_ocp.scene import (
    Clearance,
    Detour,
    Pair,
    Scene,
    Surroundings,
    clearance,
    clearances,
    detours,
    with_arm_capsules,
)

SEEDS = 4  # of the planner, for each segment
MOST_GUESSES = 3  # timed paths that the search starts from
DIFFERENT = 0.02  # share of the duration by which timed paths must differ to count as two
NEAR = 0.1  # of the arm's reach: pairs that come so near on a timed path are in the problem
MESH = 60  # intervals a phase of the first full solve where nobody says how many
AGAIN = 3  # times that pairs may be put in
MOST_ITERATIONS = 300  # of a solve; from a timed path 20 to 60 are usual
RATES = 1.2  # times a timed path, whose torques jump: what limits of their rates may cost
NEAR_PATH = 1e-3  # barrier parameter of a solve that stays near the path that it starts from
SAMPLES = 200  # poses along a motion at which pairs are looked at


@dataclass(frozen=True, eq=False)
class TimedPath:
    """A path around the obstacles with its best timing.

    Attributes
    ----------
    name : str
    motion : Motion
    via_times : array [m], s
    """

    name: str
    motion: Motion
    via_times: FloatArray


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
        kept = not family.jerk_matters  # timed paths leave jumps
        self.known: float = (1.0 if kept else RATES) * min(map(_duration, guided))

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
    paths, failed = timed_paths(around, via, settings.seed, progress)
    if not paths:
        return _no_way(family, around, via, failed, time.perf_counter() - begin)
    planned = time.perf_counter() - begin
    chain = paths[0]
    best = _solved(family, via, scene, settings, progress, paths)
    spent = time.perf_counter() - begin
    found = clearance(robot, best, scene) if best.solved else None
    more = {
        "scene": list(scene.names),
        "paths": [{"start": p.name, "duration": p.motion.duration} for p in paths],
        "planning_time": planned,
        "wall_time": spent,
    }
    kept = not family.jerk_matters  # by the timed path: its torques and accelerations jump
    slower = kept and best.duration >= chain.motion.duration
    if found is None or not found.proved or slower:
        why = best.provenance["advice"] if found is None else found.sentence
        if found is not None and found.proved:
            why = "the search found nothing faster"
        of_path = clearance(robot, chain.motion, scene)
        if not kept:
            why = f"it does not keep the limits of jerk and torque rate. {why}"
        status = Status.SOLVED if kept else Status.LIMITS_EXCEEDED
        more |= {"advice": why, "status": str(status), "clearance": as_plain(of_path)}
        return replace(
            chain.motion,
            label="time-optimal",
            provenance={**chain.motion.provenance, **more},
            note=f"the best timing of a path around the obstacles: {why}",
        )
    more["clearance"] = as_plain(found)
    return replace(best, provenance={**best.provenance, **more})


def check_apart(around: Surroundings, via: FloatArray) -> None:
    """Raise InputError where the arm touches something at a via point [m,n]."""
    for number, q in enumerate(via, start=1):
        name = _name_of(number, len(via))
        found = around.collision(q)
        if found is not None:
            raise InputError(f"{name} {touching(found, around.scene.clearance)}")
        if not around.is_free(q):
            nearest = around.model.nearest(q)
            raise InputError(
                f"{name} is too near to {nearest.pair.other.name!r} for planning: "
                f"{1e3 * nearest.distance:.3g} mm at link {nearest.pair.capsule.name!r}"
            )


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


def timed_paths(
    around: Surroundings, via: FloatArray, seed: int, progress: StepProgress
) -> tuple[list[TimedPath], list[tuple[int, Detour]]]:
    """Ways through via points with their best timing, fastest first, and searches that failed.

    A failed search stands there with the number of its segment, from 0.
    """
    first = seed * SEEDS
    legs: list[list[Detour]] = []
    failed: list[tuple[int, Detour]] = []
    for index, (start, end) in enumerate(pairwise(via)):
        tried = []
        for found in detours(around, start, end, range(first, first + SEEDS)):
            tried.append(found)
            if found.path is None and len(tried) == 2 and not any(d.path for d in tried):
                break  # a third search as long would not find one either
        legs.append([d for d in tried if d.path is not None])
        failed += [(index, d) for d in tried if d.path is None]
        if not legs[-1]:
            return [], failed
    found = []
    for choice in range(max(map(len, legs))):
        timed = _timed(around.robot, [leg[min(choice, len(leg) - 1)] for leg in legs])
        if timed is not None:
            found.append(timed)
            progress(f"path {timed.name}: {timed.motion.duration:.4f} s with its best timing")
    found.sort(key=lambda path: path.motion.duration)
    kept: list[TimedPath] = []
    for path in found:
        durations = [other.motion.duration for other in kept]
        if all(path.motion.duration > (1 + DIFFERENT) * other for other in durations):
            kept.append(path)
    return kept[:MOST_GUESSES], failed


def _timed(robot: Robot, legs: Sequence[Detour]) -> TimedPath | None:
    """The best timing of a way, at rest at every via point; None where it cannot be travelled."""
    motions = []
    for leg in legs:
        assert leg.path is not None
        timing = time_path(robot, leg.path)
        if not timing.solved:
            return None
        motions.append(timing.motion("timed path"))
    name = "path " + ", ".join("straight" if leg.seed < 0 else str(leg.seed) for leg in legs)
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
    return TimedPath(name, replace(whole, marks=marks), times)


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
    near = np.zeros(len(pairs), dtype=bool)
    for path in paths:
        near |= _apart(robot, pairs, path.motion).min(axis=0) < NEAR * reach_of(robot)
    guesses = [InitialGuess(p.name, _along(names, p.motion, p.via_times)) for p in paths]
    motion: Motion | None = None
    for _ in range(AGAIN + 1):
        limit = scene.limit(robot, [p for p, is_near in zip(pairs, near, strict=True) if is_near])
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
    """Distances [N,k] of pairs along a motion, m."""
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


def _no_way(
    family: LimitFamily,
    around: Surroundings,
    via: FloatArray,
    failed: Sequence[tuple[int, Detour]],
    wall: float,
) -> Motion:
    """What is said where no way was found: the arm stands at the start, and the status tells."""
    index, nearest = min(failed, key=lambda item: item[1].left) if failed else (0, None)
    said = "no path around the obstacles can be travelled within the limits"
    if nearest is not None:
        start, end = (_name_of(k, len(via)) for k in (index + 1, index + 2))
        said = (
            f"no path from the {start} to the {end} was found in {nearest.checks} poses; the "
            f"search came within {np.degrees(nearest.left):.3g} deg (in joint space) of the {end}"
        )
    check_rest(family, "start", via[0])
    t, still = np.array([0.0, 1e-3]), np.zeros((2, via.shape[1]))
    robot: Robot = family.robot
    held = PiecewisePolynomial(t, np.stack([via[0], still[0]])[None])
    return Motion.from_polynomial(
        robot,
        held,
        label="time-optimal",
        provenance={
            "method": "free time-optimal motion among obstacles",
            "status": str(Status.NOT_POSSIBLE),
            "advice": said,
            "scene": list(around.scene.names),
            "wall_time": wall,
        },
        note=f"not solved: {said}",
    )
