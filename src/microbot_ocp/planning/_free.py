"""Free time-optimal motions through via points: path and timing are both found.

Each segment between two via points is a phase (see ``_free_problem.py``); torque limits are kept by
the inverse dynamics, which needs no inverse of the mass matrix. Local optima are real: several
starts are tried, and a finer mesh whose optimum is worse than the coarse one is not accepted.

:func:`time_optimal` explores on a coarse mesh and refines the best; :class:`TimeOptimalSolver`
makes one task ready and solves it again and again, with limits and payload as numbers in it.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LIMIT_TOLERANCE, JointLimits, LimitFamily, Limits
from microbot_ocp.motion import Mark, Motion
from microbot_ocp.ocp import (
    Explanation,
    ParametricSolver,
    PhaseSolution,
    Solution,
    SolverSettings,
)
from microbot_ocp.ocp.refinement import WORSE, Refiner, split
from microbot_ocp.ocp.solution import StepProgress, quiet
from microbot_ocp.ocp.transcription import Guess, Transcription
from microbot_ocp.planning._free_problem import (
    OF_VARIABLES,
    SMOOTHING,
    effort_scale,
    excess_between,
    motion_at_mesh,
    phase_names,
    polynomial,
    transcription,
    via_times,
)
from microbot_ocp.planning._friction import (
    ROUNDED,
    SMOOTHING as FRICTION_SMOOTHING,
    dry_friction,
    has_windows,
    rates_at_reversals,
    reversals,
    rounded,
    with_windows,
)
from microbot_ocp.planning._initial_guesses import (
    InitialGuess,
    guesses_along,
    initial_guesses,
    swings,
)
from microbot_ocp.planning._least_violation import (
    guesses_from,
    judged,
    least_violation,
)
from microbot_ocp.planning._progress import with_motion
from microbot_ocp.planning._scale import TaskScale
from microbot_ocp.planning._segments import Segment
from microbot_ocp.planning._stop_task import is_task
from microbot_ocp.planning._stops import Stop
from microbot_ocp.planning._switching import in_arcs
from microbot_ocp.planning._task import (
    GAP,
    ROUGH_TOLERANCE,
    check_limits,
    check_via,
    jerk_switches,
    locked_joints,
    provenance_of,
    verdict,
    whole,
    with_changes,
    with_locked_joints_held,
)
from microbot_ocp.robot import Robot
from microbot_ocp.scene import Scene

EXPLORE_MESH = 20  # intervals a phase for the first look at every start
SWING_MESH = 30  # the same of swings, which take longer
EXPLORE_TOLERANCE = 1e-5
AGREEING = 3  # starts that end at the same optimum are enough
PATIENCE, LEAST_ITERATIONS = 4, 100  # times the iterations of a start that was solved
MOST_STARTING = 30.0  # s, of one start: fatrop may loop for ever
SAME = 1e-3  # share of the duration by which two solves of the same optimum may differ
TINY = 1e-12
WORTH = 1e-4  # share of the duration: less is not worth another mesh where joints turn back
# Iterations for the last digits: 8 to 10 without dry friction; with it 50 to 80 gain 7e-5
POLISHING = 15
MOST_REFINED = 3  # of the optima found on the coarse mesh
# Intervals of all phases together where nobody says how many: 30 via points need no 3000
FULL_MESH, FULL_MESH_EVEN, FULL_MESH_SUM, LEAST_MESH = 80, 100, 400, 25
GRADED = 0.5  # share of a mesh's intervals that are where the accelerations change
# Barrier parameter from the coarse mesh to the full one, with multipliers: 17, 14, 14 and 62
# iterations on four tasks of the Microbot with 1e-5; 22, 14, 15 and 109 with 1e-7
FAR_BARRIER = 3e-5
FORESIGHT = 0.5  # of the accepted excess: intervals near it are split along with the others
MANY_PHASES = 5  # more take over 40 iterations to the full tolerance on a refined mesh
MOST_EXACT = 40  # iterations of a refined mesh to the full tolerance, before roughly
CALMER_BARRIER = 1e-3  # of the solve for less effort, from the fastest motion slowed down
EXPLORE_SUM, LEAST_EXPLORE_MESH = 160, 6
# Share of the duration, and of the typical ones, up to which a prepared motion leads to the best
NEAR, NEAR_TYPICAL = 0.1, 0.02
# of a prepared solver: somebody waits
PREPARED = SolverSettings("ipopt", tolerance=1e-6, gap=np.inf, max_iterations=150)


@dataclass(frozen=True)
class TimeOptimalSettings:
    """How hard to look.

    Attributes
    ----------
    mesh : intervals of each phase in the first full solve; half of them are where the accelerations
        change, except with dry friction, limits of jerk or torque rate and further limits, where
        they are even; by default 80, where even 100, and fewer where there are many phases: 400
        together, but at least 25 each
    starts : how many starting motions to try on the coarse mesh; fewer where three agree
    tries : how many to try at most: while fewer than ``starts`` are solved, the arm is made to
        swing to and fro at random, as it must where torques are too small to lift it
    slack : share of the shortest duration that may be given for less effort: of all motions at
        most so much slower the one of least effort is returned, the time integral of the squared
        torques, each relative to its limit (of the accelerations where a robot has no masses). Zero
        is the fastest motion; a smoothing of the jerk, which costs 1.3e-5 of the duration of the
        Microbot task, then picks one where many are equally fast
    limit_tolerance : largest relative excess of a limit between mesh points; the mesh is refined
        until it holds
    switching_times : whether the times at which one limit takes over from another are solved for
        in the end, each arc a phase of free length: the fastest motion to the accuracy of the
        integrator, with accelerations that jump, and its times in the provenance. Where the arcs
        cannot be found it is the motion of the mesh, and the provenance says why
    solver : "auto" (fatrop explores, IPOPT finishes), "fatrop" or "ipopt" for everything
    compiled : compile the kernels to C where there is a compiler
    seed : of the random starts
    time_limit : wall time, s, after which the best so far is returned with the status "time limit"
    """

    mesh: int | None = None
    starts: int = 5
    tries: int = 30
    slack: float = 0.0
    limit_tolerance: float = 5e-4
    switching_times: bool = False
    solver: str = "auto"
    compiled: bool = True
    seed: int = 0
    time_limit: float = np.inf

    def __post_init__(self) -> None:
        checks.time_limit(self.time_limit)
        if self.mesh is not None:
            whole("mesh", self.mesh, "intervals", at_least=4)
        whole("starts", self.starts, at_least=1)
        whole("tries", self.tries, at_least=0)
        whole("seed", self.seed, at_least=0, at_most=2**63)
        checks.number("slack", self.slack, at_least=0.0)
        checks.number("limit_tolerance", self.limit_tolerance, above=0.0)
        if self.switching_times and self.slack:
            raise InputError("switching_times are those of the fastest motion: slack must be 0")
        checks.one_of("solver", self.solver, ("auto", "fatrop", "ipopt"))


def time_optimal(
    robot: Robot,
    via_q: ArrayLike | Sequence[Stop],
    limits: Limits | JointLimits | None = None,
    *,
    segments: Sequence[Segment] | None = None,
    cycle: bool = False,
    order: str = "given",
    duration: float | None = None,
    scene: Scene | None = None,
    settings: TimeOptimalSettings | None = None,
    progress: StepProgress | None = None,
    **changes: Any,
) -> Motion:
    """The fastest motion through via points: at rest at both ends, passing the others at any speed.

    Minimises the sum of the phase durations subject to every limit: of positions, velocities,
    accelerations, jerk, torques, their rates, and those of ``limits.also``.

    Parameters
    ----------
    robot : Robot
        Without masses only limits of its motion count, none of torques.
    via_q : array_like [m,n], or sequence of Stop
        Via points, rad (m for prismatic joints). Among them may be stops: tool poses, tolerances,
        velocities, dwells and payloads (:class:`~microbot_ocp.Stop`).
    limits : Limits, optional
        Default the robot's own.
    segments : sequence, optional
        What lies between two stops: a :class:`~microbot_ocp.Line`, :class:`~microbot_ocp.Circle` or
        :class:`~microbot_ocp.JointLine`, or None where the way is free.
    cycle : bool
        Whether the motion returns to its first stop, with the velocity that it has there: the
        shortest period. ``segments`` has one more then.
    order : str
        "free" looks at every order of the stops (of at most 7; the first, and the last unless it is
        a cycle, keep their places): the best, for sure as far as each order's own optimum was
        found. Two stops with a segment between them follow one another in every order.
    duration : float, optional
        Time that may be taken, s: of all motions that take no longer the one of least effort, as
        with ``slack``.
    scene : Scene, optional
        Obstacles that the arm keeps clear of, its links among each other besides; needs the extra
        ``cell``. The provenance holds the proved clearance, and the timed paths that it started
        from; with stops or segments it starts from the motion that heeds no obstacle.
    settings : TimeOptimalSettings, optional
        Single settings may be given as keywords instead: ``mesh``, ``starts``, ``tries``,
        ``slack``, ``limit_tolerance``, ``switching_times``, ``solver``, ``compiled``, ``seed``,
        ``time_limit``.
    progress : callable, optional
        Called with a line of text at every step, and at every iteration of a solver with a
        :class:`~microbot_ocp.planning.MotionIteration`.

    Returns
    -------
    Motion
        ``motion.solved`` tells whether the solver converged, ``motion.provenance`` how it went:
        status, advice, every start with its duration, every mesh.

    Raises
    ------
    InputError
        Bad via points or limits, before any solver starts.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> via_q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
    >>> motion = mo.time_optimal(mo.load_robot("microbot"), via_q, mesh=40, starts=1)
    >>> motion.solved, round(motion.duration, 2)
    (True, 1.92)
    """
    chosen = with_changes(settings or TimeOptimalSettings(), changes)
    checks.one_of("order", order, ("given", "free"))
    if is_task(via_q) or segments is not None or cycle or order != "given" or duration is not None:
        from microbot_ocp.planning._stop_search import solve_stops

        stops = list(cast("Sequence[Any]", via_q))
        plan = stops, segments, cycle, order, duration
        if scene is not None:
            from microbot_ocp.planning._stops_among import stops_among

            with deadline.within(chosen.time_limit):
                return stops_among(robot, limits, plan, scene, chosen, progress or quiet)
        return solve_stops(robot, limits, *plan, chosen, progress or quiet)
    family = check_limits(robot, limits)
    via = check_via(family, cast("ArrayLike", via_q))
    if scene is not None:
        from microbot_ocp.planning._among_obstacles import fastest_among

        with deadline.within(chosen.time_limit):
            return fastest_among(family, via, scene, chosen, progress or quiet)
    return fastest_motion(family, via, chosen, progress or quiet)


def fastest_motion(
    family: LimitFamily, via: FloatArray, settings: TimeOptimalSettings, progress: StepProgress
) -> Motion:
    """As :func:`time_optimal`, of via points that are checked."""
    with deadline.within(settings.time_limit):
        return FreeSearch(family, via, settings, progress).run()


class FreeSearch:
    """Several starts on a coarse mesh, the best refined until limits hold between points."""

    def __init__(
        self,
        family: LimitFamily,
        via: FloatArray,
        settings: TimeOptimalSettings,
        progress: StepProgress,
        kernels: Transcription | None = None,
    ) -> None:
        self.family, self.via, self.settings = family, via, settings
        self.robot: Robot = family.robot
        self.dry: np.ndarray = dry_friction(self.robot) > 0.0
        self.scale = TaskScale.of(family, via)
        self.progress = progress
        self.names = phase_names(len(via) - 1)
        self.calmed: dict[str, Any] = {}
        self.relaxed: Explanation | None = None
        begin = time.perf_counter()
        kernels = kernels or self._kernels()
        if deadline.over():  # they may not be compiled: made again the next time
            transcription.cache_clear()
        self.kernel_time = time.perf_counter() - begin
        self.refiner = Refiner(
            kernels,
            self._guess_from,
            self._excess,
            settings.limit_tolerance,
            solver="ipopt" if settings.solver == "auto" else settings.solver,
            progress=with_motion(progress, self.robot, via, motion_at_mesh),
            settings=SolverSettings(gap=GAP),
            rough=ROUGH_TOLERANCE,
            polishing=POLISHING,
            fitted=partial(with_windows, self.dry) if has_windows(family) else None,
        )

    def _kernels(self, budget: float | None = None) -> Transcription:
        held: Robot = with_locked_joints_held(self.family).robot
        compiled = self.settings.compiled
        return transcription(held, self.via.tobytes(), len(self.via), compiled, budget=budget)

    def run(self) -> Motion:
        begin = time.perf_counter()
        starts, solution = self.search()
        if self.settings.slack and self._rank(solution)[0] is False and not deadline.over():
            solution = self._calmer(solution)
        motion = self._motion(solution, starts, time.perf_counter() - begin + self.kernel_time)
        if not self.settings.switching_times or not motion.solved:
            return motion
        held: Robot = with_locked_joints_held(self.family).robot
        exact = in_arcs(self.family, held, motion, self._guess_from(solution), self.progress)
        spent = time.perf_counter() - begin + self.kernel_time
        return replace(exact, provenance={**exact.provenance, "wall_time": spent})

    def search(self) -> tuple[list[dict[str, Any]], Solution]:
        """What became of every start, and the best solution, refined."""
        starts, found = self._explore()
        return starts, self._finish(found)

    # starts ---------------------------------------------------------------------------------

    def _explore(self) -> tuple[list[dict[str, Any]], list[Solution]]:
        """What every start led to on a coarse mesh."""
        tried: list[dict[str, Any]] = []
        found: list[Solution] = []
        own = replace(self.refiner.settings, time_limit=MOST_STARTING)
        refiner = replace(self._coarse_refiner, settings=own)
        for guess, mesh, solver in self._trials():
            patience = [PATIENCE * s.attempts[-1].iterations for s in found if s.status.solved]
            if patience:  # what takes so much longer than another start is given up
                most = max(LEAST_ITERATIONS, *patience)
                refiner = replace(refiner, settings=replace(own, max_iterations=most))
                solver = solver if isinstance(solver, str) else solver[0]
            solution = refiner.solve(
                mesh, guess.guesses, tolerance=EXPLORE_TOLERANCE, solver=solver
            )
            tried.append(
                {
                    "start": guess.name,
                    "status": str(solution.status),
                    "duration": solution.duration,
                }
            )
            self.progress(
                f"start {guess.name}: {solution.duration:.4f} s on {mesh} intervals a phase, "
                f"{solution.status}"
            )
            found.append(solution)
            if solution.status is Status.INTERRUPTED or deadline.over():
                break
            solved = [s.duration for s in found if s.status.solved]
            best = min(solved, default=0.0)
            if sum(duration <= (1 + SAME) * best for duration in solved) >= AGREEING:
                break
            if len(found) >= self.settings.starts <= len(solved):
                break
        return tried, found

    def _trials(self) -> Iterator[tuple[InitialGuess, int, str | tuple[str, ...]]]:
        """Guesses with the intervals a phase and the solver for each."""
        solver, seed = self.settings.solver, self.settings.seed
        task = self.family, self.via, self.names
        coarse = min(self._mesh, max(EXPLORE_SUM // len(self.names), LEAST_EXPLORE_MESH))
        for guess in initial_guesses(*task, self.settings.starts, seed):
            both = ("fatrop", "ipopt") if solver == "auto" else solver
            yield guess, min(coarse, EXPLORE_MESH), both
        further = max(self.settings.tries - self.settings.starts, 0)
        for index, guess in enumerate(itertools.islice(swings(*task, seed), further)):
            other = "ipopt" if index % 3 == 2 else "fatrop"  # what one misses the other may find
            yield guess, min(coarse, SWING_MESH), other if solver == "auto" else solver

    @property
    def _accelerations_jump(self) -> bool:
        """Whether only velocities, accelerations and smooth torques are limited: bang-bang arcs."""
        plain = all(member.limit is None for member in self.family)
        return (
            plain and self.refiner.fitted is None and not {"qddd", "taud"} & set(self.family.keys)
        )

    @property
    def _mesh(self) -> int:
        if self.settings.mesh is not None:
            return self.settings.mesh
        most = FULL_MESH if self._accelerations_jump else FULL_MESH_EVEN
        return max(min(most, FULL_MESH_SUM // len(self.names)), LEAST_MESH)

    # refinement -----------------------------------------------------------------------------

    def _finish(self, found: list[Solution]) -> Solution:
        """Refine the most promising coarse answers until none of the others can be better.

        What an answer exceeds its limits by between mesh points counts as if it were slower by as
        much, so that none wins by that.
        """
        best: Solution | None = None
        hoped: list[float] = []
        solved = [s for s in found if s.status.solved]
        if not solved:
            nearest = min(found, key=lambda s: (not s.attempts, s.attempts[-1].infeasibility))
            relaxed = self._relaxed(nearest)
            if not relaxed.status.solved:
                return self.refiner.finished(self._refined(relaxed))
            solved = [relaxed]
        for coarse in sorted(solved, key=self._honest_duration):
            honest = self._honest_duration(coarse)
            if any(abs(honest - other) <= SAME * other for other in hoped):
                continue
            if best is not None and (
                deadline.over()
                or len(hoped) == MOST_REFINED
                or self._rank(best) <= (False, (1 - SAME) * honest)
            ):
                break
            hoped.append(honest)
            refined = self._refined(coarse)
            best = refined if best is None else min(best, refined, key=self._rank)
        assert best is not None
        return self.refiner.finished(best)

    def _relaxed(self, nearest: Solution) -> Solution:
        """The nearest of answers that break limits, after a look at what has to give.

        A solution where nothing has to.
        """
        if deadline.over() or nearest.status is Status.INTERRUPTED:
            return nearest
        kernels = self._coarse_refiner.transcription
        meshes = [phase.mesh for phase in nearest.phases]
        own = initial_guesses(self.family, self.via, self.names, 1, self.settings.seed)
        self.relaxed = least_violation(kernels, [next(own).guesses, nearest], meshes)
        self.progress(f"relaxed problem: {self.relaxed}")
        if not (self.relaxed.conclusive and self.relaxed.feasible):
            return nearest
        guesses = guesses_from(self.relaxed)
        found = self._coarse_refiner.solve(meshes, guesses, tolerance=EXPLORE_TOLERANCE)
        return found if found.status.solved else nearest

    @property
    def _coarse_refiner(self) -> Refiner:
        if self.refiner.fitted is None:
            return self.refiner
        kernels = rounded(self.refiner.transcription, self.scale.velocity)
        return replace(self.refiner, transcription=kernels)

    def _refined(self, coarse: Solution) -> Solution:
        """Coarse to fine, then local refinement while limits are exceeded."""
        refiner = self.refiner
        if self._accelerations_jump:
            return self._refined_where_they_jump(coarse)
        best = refiner.finer(coarse, [self._mesh] * len(self.names))
        if refiner.fitted is not None:
            best = refiner.sharpen(best, self._reversals, worth=WORTH)
        best = refiner.refine(best)
        if any(places.any() for places in self._velocity_switches(best)):
            best = refiner.refine(refiner.sharpen(best, self._velocity_switches))
        if "qddd" in self.family:
            best = refiner.refine(refiner.sharpen(best, self._jerk_switches))
        return best

    def _refined_where_they_jump(self, coarse: Solution) -> Solution:
        """As :meth:`_refined`, with a mesh that is finer where the coarse accelerations change."""
        many = len(self.names) > MANY_PHASES
        refiner, own = replace(self.refiner, foresight=FORESIGHT), self.refiner.settings
        meshes = [graded(phase, self._mesh) for phase in coarse.phases]
        best = coarse
        if many:  # multipliers of so coarse a mesh mislead: 87 iterations, 65 without
            best = refiner.solve(meshes, self._guess_from(coarse))
        if not (many and best.status.solved and best.cost <= (1 + WORSE) * coarse.cost):
            farther = replace(own, options={"ipopt": {"mu_init": FAR_BARRIER}})
            best = replace(refiner, settings=farther).finer(coarse, meshes)
        if not many:
            # a refined mesh is seldom refined again: to the last digits at once
            least = replace(own, max_iterations=min(own.max_iterations, MOST_EXACT))
            exact = replace(refiner, settings=least, rough=None)
            best = exact.refine(best, self._velocity_switches)
        return refiner.refine(best, self._velocity_switches)

    def _honest_duration(self, solution: Solution) -> float:
        return solution.duration * (1.0 + max(0.0, self._largest_excess(solution)))

    def _rank(self, solution: Solution) -> tuple[bool, float]:
        """What keeps its limits first, then what is faster."""
        kept = solution.status.solved and self._largest_excess(solution) <= LIMIT_TOLERANCE
        return not kept, solution.duration

    def _largest_excess(self, solution: Solution) -> float:
        return max(float(e.max()) for e in self._excess(solution))

    def _calmer(self, fastest: Solution) -> Solution:
        """The motion of least effort that takes at most the slack longer; the fastest if none."""
        slower = 1.0 + self.settings.slack
        kernels = self._kernels(slower * fastest.duration)
        refiner = replace(
            self.refiner, transcription=kernels, guess_from=self._with_clock, rough=None
        )
        meshes = [phase.mesh for phase in fastest.phases]
        guesses = self._with_clock(fastest, slower)
        calmer = refiner.refine(refiner.solve(meshes, guesses, barrier=CALMER_BARRIER))
        self.progress(f"least effort: {calmer.duration:.6f} s, {calmer.status}")
        solved = self._rank(calmer)[0] is False
        self.calmed = {
            "slack": self.settings.slack,
            "fastest": fastest.duration,
            "effort": self._effort(calmer if solved else fastest),
            "effort_of_the_fastest": self._effort(fastest),
            "status": str(calmer.status),
        }
        return calmer if solved else fastest

    def _effort(self, solution: Solution) -> float:
        motion = self._shaped(solution, {}, "")
        moved = motion.tau if self.robot.has_dynamics else motion.qdd
        scaled = moved / effort_scale(self.family, self.scale.acceleration)
        return float(np.trapezoid((scaled**2).sum(axis=1), motion.t))

    def _with_clock(self, solution: Solution, slower: float = 1.0) -> dict[str, Guess]:
        """Guesses from a solution, with the time that has passed, slowed down evenly."""
        edges = slower * via_times(solution)
        guesses = self._guess_from(solution)
        found = {}
        for name, start, end in zip(self.names, edges[:-1], edges[1:], strict=True):
            rates = {
                key: partial(_slowed, guesses[name].values[key], slower**power)
                for power, key in enumerate(("q", "qd", "qdd"))
            }
            clock = partial(_clock, start, end)
            found[name] = Guess(
                float(end - start), {**guesses[name].values, **rates, "clock": clock}
            )
        return found

    def _velocity_switches(self, solution: Solution) -> list[Any]:
        """Intervals in which a velocity goes through more than half of its limit at once.

        The arm could reach it in far less time than the mesh lets it.
        """
        limit = np.maximum(*(np.abs(b) for b in self.robot.limits.bounds("qd")))
        limit = np.where(limit > 0, limit, np.inf)
        return [
            (np.abs(np.diff(phase["qd"], axis=0)) > 0.5 * limit).any(axis=1)
            for phase in solution.phases
        ]

    def _reversals(self, solution: Solution) -> list[np.ndarray]:
        """Intervals inside which a joint with dry friction turns back, or a limit is exceeded."""
        marked = []
        for phase, excess in zip(solution.phases, self._excess(solution), strict=True):
            turns = reversals(phase["qd"], self.dry)
            steps = np.diff(phase.mesh)
            # the window is as long as the longest of them
            turns &= steps > 0.6 * steps[turns].max(initial=0.0)
            marked.append(turns[:, None] | (excess > self.settings.limit_tolerance))
        return marked

    def _jerk_switches(self, solution: Solution) -> list[np.ndarray]:
        member = self.family["qddd"]
        return [
            jerk_switches(np.diff(phase["qdd"], axis=0) / np.diff(phase.t)[:, None], member)
            for phase in solution.phases
        ]

    def _guess_from(self, solution: Solution) -> dict[str, Guess]:
        return guesses_along(self.names, polynomial(solution), via_times(solution))

    def _excess(self, solution: Solution) -> list[FloatArray]:
        return excess_between(self.family, solution)

    # result ---------------------------------------------------------------------------------

    def _motion(
        self,
        solution: Solution,
        starts: list[dict[str, Any]],
        wall: float,
    ) -> Motion:
        outcome = verdict(
            self.family, solution, self._excess(solution), self.settings.limit_tolerance
        )
        outcome["advice"] += self.scale.active_bounds([p.duration for p in solution.phases])
        outcome["advice"] += rates_at_reversals(self.family, solution)
        if self.relaxed is not None and not (solution.status.solved or deadline.over()):
            outcome |= judged(self.relaxed, self.family, outcome["advice"])
        found = sorted({round(s["duration"], 3) for s in starts if s["status"] == "solved"})
        return self._shaped(
            solution,
            provenance_of(
                "free time-optimal motion, multiple shooting on the inverse dynamics",
                outcome,
                solution,
                wall,
                SMOOTHING,
                optima_seen=found,
                starts=starts,
                solves=self.refiner.history,
                kernel_time=self.kernel_time,
                **({"least_effort": self.calmed} if self.calmed else {}),
            ),
            _note(outcome, len(self.via), len(starts), found) + self._slack_note(solution),
        )

    def _shaped(self, solution: Solution, provenance: dict[str, Any], note: str) -> Motion:
        return _as_motion(self.robot, solution, provenance, note)

    def _slack_note(self, solution: Solution) -> str:
        if not self.calmed:
            return ""
        fastest, before = self.calmed["fastest"], self.calmed["effort_of_the_fastest"]
        if solution.duration == fastest:
            return f"; no motion of less effort was found ({self.calmed['status']})"
        saved, slower = 1.0 - self.calmed["effort"] / before, solution.duration / fastest - 1.0
        return f"; {100 * slower:.3g} % slower than the fastest for {100 * saved:.3g} % less effort"


def _as_motion(robot: Robot, solution: Solution, provenance: dict[str, Any], note: str) -> Motion:
    marks = [Mark(float(t), f"via {i + 1}") for i, t in enumerate(via_times(solution))]
    return Motion.from_polynomial(
        robot,
        polynomial(solution),
        label="time-optimal",
        marks=marks,
        provenance=provenance,
        note=note,
    )


def _note(outcome: dict[str, Any], via_count: int, start_count: int, found: list[float]) -> str:
    if outcome["status"] != "solved":
        return f"not solved: {outcome['advice']}"
    optima = ", ".join(f"{duration:.3f}" for duration in found)
    passed = {2: "", 3: "via point passed at any velocity; "}
    return (
        f"{passed.get(via_count, 'via points passed at any velocity; ')}{start_count} starts ended "
        f"at {optima} s on the coarse mesh, the best was refined"
    )


def graded(phase: PhaseSolution, count: int) -> FloatArray:
    """Mesh [count+1] of a phase: evenly spread, and with it where its accelerations change."""
    steps, change = np.diff(phase.mesh), np.abs(np.diff(phase["qdd"], axis=0))
    change = (change / np.maximum(np.abs(phase["qdd"]).max(axis=0), TINY)).max(axis=1)
    slope = np.pad(change / steps, 1)
    # a change may be anywhere in the interval, or begin in the one beside it
    weight = steps * np.maximum(slope[1:-1], 0.5 * np.maximum(slope[:-2], slope[2:]))
    density = (1.0 - GRADED) * steps + GRADED * weight / max(weight.sum(), TINY)
    reached = np.concatenate([[0.0], np.cumsum(density)])
    mesh = np.interp(np.linspace(0.0, reached[-1], count + 1), reached, phase.mesh)
    mesh[[0, -1]] = 0.0, 1.0
    return mesh


def _slowed(curve: Any, by: float, s: FloatArray) -> FloatArray:
    return curve(s) / by


def _clock(start: float, end: float, s: FloatArray) -> FloatArray:
    return start + (end - start) * s[:, None]


def _solved_near(
    solver: ParametricSolver, start: Solution | Mapping[str, Guess], changes: Mapping[str, Any]
) -> Solution:
    """A solve with other numbers; from afar with friction rounded off at first."""
    parameters = changes["parameters"]
    declared = {p.name for p in solver.transcription.problem.phases[0].parameters}
    if not isinstance(start, Solution) and FRICTION_SMOOTHING in declared:
        rounded = {phase: {**own, FRICTION_SMOOTHING: ROUNDED} for phase, own in parameters.items()}
        near = solver.solve(guess=start, **{**changes, "parameters": rounded})
        start = near if near.status.solved else start
    return solver.solve(guess=start, **changes)


class TimeOptimalSolver:
    """The fastest motion through via points, for one set of limits and payload after another.

    The program, its compiled kernels and the solver are made once; limits and the payload are
    numbers in it. The first call solves the task with the robot's own limits as
    :func:`microbot_ocp.time_optimal` does, from a coarser mesh. Every solve starts from that
    motion with its multipliers, not from the solution before, so the answer does not depend on
    what was asked before; from the scaled cubic where the numbers are far from the robot's own. It
    is refined where a limit is exceeded between mesh points by more than a certificate lets pass.
    Other via points are numbers, too: such a solve starts from their own scaled cubic.

    Parameters
    ----------
    robot : Robot
        With masses and limits. A kind of limit that it does not have at all (say, torque rates)
        cannot be added later.
    via_q : array_like [m,n]
        Via points, rad (prismatic: m).
    mesh : int
        Intervals of each phase, before they are refined.
    starts : int
        How many starting motions a search tries.
    rounds : int
        Largest number of refinements.
    compiled : bool
        Compile the kernels to C where there is a compiler.
    seed : int
        Of the random starts.

    Raises
    ------
    InputError
        As :func:`microbot_ocp.time_optimal`.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> via_q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
    >>> solver = mo.TimeOptimalSolver(mo.load_robot("microbot"), via_q)
    >>> round(solver().duration, 2), round(solver(payload=1.0).duration, 2)
    (1.92, 2.54)
    """

    def __init__(
        self,
        robot: Robot,
        via_q: ArrayLike,
        *,
        mesh: int = 60,
        starts: int = 5,
        rounds: int = 3,
        compiled: bool = True,
        seed: int = 0,
    ) -> None:
        whole("mesh", mesh, "intervals", at_least=4)
        whole("starts", starts, at_least=1)
        whole("rounds", rounds, at_least=0)
        whole("seed", seed, at_least=0, at_most=2**63)
        self.robot = robot
        self.via_q = check_via(check_limits(robot, None), via_q)
        self._rounds = rounds
        self._settings = TimeOptimalSettings(mesh=mesh, starts=starts, compiled=compiled, seed=seed)
        self._reference: Solution | None = None
        self._phases = phase_names(len(self.via_q) - 1)
        held: Robot = with_locked_joints_held(LimitFamily.of(robot)).robot
        self._kernels = transcription(
            held, self.via_q.tobytes(), len(self.via_q), compiled, payload=True
        )
        self._solver: ParametricSolver | None = None
        self._anywhere: ParametricSolver | None = None  # for other via points

    def __call__(
        self,
        limits: Limits | JointLimits | None = None,
        payload: float = 0.0,
        *,
        via_q: ArrayLike | None = None,
        search: bool = False,
        time_limit: float = np.inf,
    ) -> Motion:
        """Solve once more.

        Parameters
        ----------
        limits : Limits, optional
            Default the robot's own.
        payload : float
            Point mass at the tool, kg; the motion is one of ``robot.with_payload(payload)``.
        via_q : array_like [m,n], optional
            Other via points, as many as the solver was made with, rad (prismatic: m).
        search : bool
            Try every start, not only the motion under the robot's own limits: local optima are
            real. The others are tried anyway where that one leads nowhere.
        time_limit : float
            Wall time, s, after which the best so far is returned with the status "time limit".

        Returns
        -------
        Motion
            ``motion.solved`` tells whether the solver converged, ``motion.provenance`` how it
            went.

        Raises
        ------
        InputError
            Bad limits or payload, a via point that cannot be held: before any solver starts.
        """
        with deadline.within(time_limit):
            return self._solved(limits, payload, via_q, search)

    def _solved(
        self,
        limits: Limits | JointLimits | None,
        payload: float,
        via_q: ArrayLike | None,
        search: bool,
    ) -> Motion:
        begin = time.perf_counter()
        family = check_limits(self.robot.with_payload(payload), limits)
        self._check_kinds(family)
        via = check_via(family, self.via_q if via_q is None else via_q)
        if len(via) != len(self.via_q):
            raise InputError(
                f"via_q must have {len(self.via_q)} points, as the solver was made with, "
                f"not {len(via)}"
            )
        changes = self._changes(family, via, float(payload))
        solver = self._prepared() if via_q is None else self._for_any_via()
        tried: list[tuple[str, Solution]] = []
        for name, start in self._starts(family, via, from_own=via_q is None):
            solution = _solved_near(solver, start, changes)
            tried.append((name, solution))
            near = not isinstance(start, Solution) or (
                abs(solution.duration - start.duration) <= NEAR * start.duration
            )
            if (solution.status.solved and near and not search) or deadline.over():
                break
        name, best = min(tried, key=lambda pair: (not pair[1].status.solved, pair[1].duration))
        solution = self._refined(family, best, changes) if best.status.solved else best
        return self._motion(family, solution, tried, name, payload, begin)

    def _prepared(self) -> ParametricSolver:
        """The solver on the mesh of the motion under the robot's own limits, made once."""
        if self._solver is not None:
            return self._solver
        family = LimitFamily.of(self.robot)
        search = FreeSearch(family, self.via_q, self._settings, quiet, self._kernels)
        # as near the optimum as every later solve: to the barrier parameter that it starts with
        search.refiner.settings = replace(search.refiner.settings, gap=np.inf)
        _, found = search.search()
        solver = self._on([phase.mesh for phase in found.phases], found)
        if not deadline.over():
            self._solver = solver
            self._reference = found if found.status.solved else None
        return solver

    def _for_any_via(self) -> ParametricSolver:
        """The solver on an even mesh, its cost scaled at the solver's own via points."""
        if self._anywhere is None:
            mesh = [int(self._settings.mesh or FULL_MESH)] * len(self._phases)
            solver = ParametricSolver(self._kernels, mesh, PREPARED)
            family = LimitFamily.of(self.robot)
            own = initial_guesses(family, self.via_q, self._phases, 1, self._settings.seed)
            solver.scale_cost(next(own).guesses)
            self._anywhere = solver
        return self._anywhere

    def _starts(
        self, family: LimitFamily, via: FloatArray, *, from_own: bool
    ) -> Iterator[tuple[str, Solution | Mapping[str, Guess]]]:
        own, asked = (
            TaskScale.of(known, self.via_q).durations.sum()
            for known in (LimitFamily.of(self.robot), family)
        )
        if from_own and self._reference is not None and abs(asked - own) <= NEAR_TYPICAL * own:
            yield "prepared", self._reference
        task = via, self._phases, self._settings.starts, self._settings.seed
        for start in initial_guesses(family, *task):
            yield start.name, start.guesses

    def _on(self, meshes: Sequence[FloatArray], near: Solution) -> ParametricSolver:
        dry = dry_friction(self.robot) > 0.0
        kernels = with_windows(dry, self._kernels, meshes, near) if dry.any() else self._kernels
        return ParametricSolver(kernels, meshes, PREPARED)

    def _refined(
        self, family: LimitFamily, solution: Solution, changes: dict[str, Any]
    ) -> Solution:
        """Split intervals inside which a limit is exceeded; keep what is no worse."""
        for _ in range(self._rounds):
            excess = excess_between(family, solution)
            if max(float(e.max()) for e in excess) <= LIMIT_TOLERANCE or deadline.over():
                break
            pairs = zip(solution.phases, excess, strict=True)
            meshes = [split(phase.mesh, e > LIMIT_TOLERANCE) for phase, e in pairs]
            finer = self._on(meshes, solution).solve(guess=solution, **changes)
            if not finer.status.solved or finer.cost > solution.cost * (1 + WORSE):
                break
            solution = finer
        return solution

    def _changes(self, family: LimitFamily, via: FloatArray, payload: float) -> dict[str, Any]:
        size = TaskScale.of(family, via)
        family = with_locked_joints_held(family)
        declared = {c.name for c in self._kernels.problem.phases[0].constraints}
        pairs = {key: family.robot.limits.bounds(key) for key in OF_VARIABLES}
        for member in family:
            if member.name in declared:
                pairs[member.name] = (member.lower, member.upper)
        # a locked joint stays where it starts: the program has no other condition for it
        free = np.where(locked_joints(LimitFamily.of(self.robot)), np.inf, 0.0)

        def at(point: FloatArray) -> dict[str, Any]:
            return {"q": (point - free, point + free)} if not free.all() else {}

        initial = dict(zip(self._phases, map(at, via[:-1]), strict=True))
        initial[self._phases[0]] = {"q": via[0]}
        return {
            "initial": initial,
            "final": {self._phases[-1]: at(via[-1])},
            "bounds": dict.fromkeys(self._phases, pairs),
            "parameters": {phase: {"payload": payload} for phase in self._phases},
            "durations": {
                phase: (float(shortest), float(longest))
                for phase, shortest, longest in zip(
                    self._phases, size.shortest, size.longest, strict=True
                )
            },
        }

    def _check_kinds(self, family: LimitFamily) -> None:
        """Only the numbers of limits may change: their expressions are built in."""
        own = LimitFamily.of(self.robot)
        freed = np.flatnonzero(locked_joints(own) & ~locked_joints(family))
        if freed.size:
            raise InputError(
                f"limits let joint {self.robot.joint_names[freed[0]]!r} move, but the solver was "
                "made for a robot that locks it"
            )
        for member in family:
            if member.key in ("q", "qdd"):  # bounds of variables, which are always there
                continue
            if member.key not in own:
                raise InputError(
                    f"limits bound {member.key}, but the solver was made for a robot without any "
                    f"limit of {member.key}: make it with robot.with_limits(...)"
                )
            before = own[member.key].limit
            if member.limit is not None and before is not None:
                built, asked = (
                    (m.expression, *(b for b in (m.lower, m.upper) if callable(b)))
                    for m in (before, member.limit)
                )
                if built != asked:
                    raise InputError(
                        f"limit {member.name!r} has another expression than the one that the "
                        "solver was made with: only its numbers may change"
                    )

    def _motion(
        self,
        family: LimitFamily,
        solution: Solution,
        tried: list[tuple[str, Solution]],
        start: str,
        payload: float,
        begin: float,
    ) -> Motion:
        outcome = verdict(family, solution, excess_between(family, solution), LIMIT_TOLERANCE)
        starts = [
            {
                "start": name,
                "status": str(tries.status),
                "duration": tries.duration,
                "iterations": sum(a.iterations for a in tries.attempts),
            }
            for name, tries in tried
        ]
        return _as_motion(
            family.robot,
            solution,
            provenance_of(
                "free time-optimal motion, solved again with other numbers",
                outcome,
                solution,
                time.perf_counter() - begin,
                SMOOTHING,
                start=start,
                starts=starts,
                payload=float(payload),
            ),
            "" if outcome["status"] == "solved" else f"not solved: {outcome['advice']}",
        )
