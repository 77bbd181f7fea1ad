"""The search behind a free time-optimal motion: several starts, the best refined.

Each segment between two via points is a phase (see ``_free_problem.py``); torque limits are kept by
the inverse dynamics, which needs no inverse of the mass matrix. Local optima are real: several
starts are tried on a coarse mesh, and a finer mesh whose optimum is worse than the coarse one is
not accepted.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.child_process import Child, Died, OutOfTime, spare_processor
from microbot_ocp._base.codegen import compiles
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import Mark, Motion, PiecewisePolynomial, pieces_of
from microbot_ocp.ocp import Explanation, PhaseSolution, Solution, SolverSettings
from microbot_ocp.ocp.refinement import WORSE, Refiner
from microbot_ocp.ocp.solution import StepProgress, quiet, unpack
from microbot_ocp.ocp.transcription import Guess, Transcription
from microbot_ocp.planning.free import (
    BUDGET,
    JERK_WEIGHT,
    SMOOTHING,
    InitialGuess,
    Slowed,
    effort_scale,
    excess_between,
    guesses_along,
    guesses_from,
    in_arcs,
    initial_guesses,
    judged,
    known_ways,
    largest_excess,
    least_violation,
    motion_at_mesh,
    phase_names,
    polynomial,
    transcription,
    via_times,
    with_motion,
    within_limits,
)
from microbot_ocp.planning.task import (
    GAP,
    LDL,
    ROUGH_TOLERANCE,
    TaskScale,
    dry_friction,
    has_windows,
    jerk_switches,
    provenance_of,
    rates_at_reversals,
    reversals,
    rounded,
    verdict,
    whole,
    with_locked_joints_held,
    with_windows,
)
from microbot_ocp.robot import Robot


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the search for a free motion.

    Attributes
    ----------
    explore_mesh : intervals a phase for the first look: of other meshes optima are others
    explore_tolerance : of its solves
    explore_sum : intervals of its phases together
    least_explore_mesh : intervals of each of them
    patience : times the iterations of a start that was solved: what takes more is given up
    least_iterations : that a start has in any case
    same : share of the duration by which two solves of the same optimum may differ
    worth : share of the duration: less is not worth another mesh where joints turn back
    polishing : iterations for the last digits: 8 to 10 are usual. None with dry friction, where
        50 to 80 gain 7e-5 of the duration
    most_polished : phases of a motion whose last digits are looked for: 29 of the Microbot need
        more iterations
    most_refined : of the optima on the coarse mesh
    full_mesh : intervals a phase of the first full mesh where accelerations jump
    full_mesh_even : the same elsewhere
    full_mesh_sum : intervals of all phases together where nobody says how many: 30 via points
        need no 3000
    least_mesh : intervals a phase in any case
    graded : share of a mesh's intervals that are where the accelerations change
    far_barrier : barrier parameter from the coarse mesh to the full one, with multipliers: 17,
        14, 14 and 62 iterations on four tasks of the Microbot with 1e-5; 22, 14, 15 and 109
        with 1e-7
    foresight : of the accepted excess: intervals near it are split along with the others
    many_phases : more take over 40 iterations to the full tolerance on a refined mesh
    most_exact : iterations of a refined mesh to the full tolerance, before roughly
    calmer_mesh : even intervals a phase of the solve for less effort, at most
    calmer_barrier : barrier parameter of it, from the fastest motion slowed down
    spared : share of the time limit that is kept for a motion within the limits when the search
        is over
    most_spared : s, at most
    least_time : s, of the search in any case
    large : intervals times joints from which a mesh is refined no further where a motion that
        is slowed down at limits by no more than enough keeps them: meshes that large take 5 to
        30 s each
    enough : share of the duration
    near_way_barrier : barrier parameter of a solve that stays near the way that it starts from
    missed : of the way and the velocity, by which a motion may miss or jump at a via point
    first_iterations : of the first full mesh: 14 to 43 where coarse meshes tell what happens
    tells_nothing : excess of limits between its points from which a coarse mesh does not tell
    smoother : times the usual smoothing of the jerk, in turn, where coarse meshes do not tell
        what happens: four of five chains of seven and eight joints, which took minutes before,
        get to the full mesh in 5 to 14 s so
    smoothest : the same before these, where they lead nowhere
    worth_less : share of the duration: where less smoothing is worth less it ends
    smoother_iterations : of each of these solves
    smoother_barrier : barrier parameter of the first of them
    smoothing_told : share of the duration: where the smoothing costs more it is weaker, and
        what it costs all the same is said. On the UR5e durations are 1.8e-3, 7e-4 and 1.3e-3
        shorter for 1.6 times the work
    less_smoothing : times the usual smoothing, then
    less_smoothing_barrier : barrier parameter of that solve
    """

    explore_mesh: int = 20
    explore_tolerance: float = 1e-5
    explore_sum: int = 160
    least_explore_mesh: int = 6
    patience: int = 4
    least_iterations: int = 100
    same: float = 1e-3
    worth: float = 1e-4
    polishing: int = 15
    most_polished: int = 15
    most_refined: int = 3
    full_mesh: int = 80
    full_mesh_even: int = 100
    full_mesh_sum: int = 400
    least_mesh: int = 25
    graded: float = 0.5
    far_barrier: float = 3e-5
    foresight: float = 0.5
    many_phases: int = 5
    most_exact: int = 40
    calmer_mesh: int = 60
    calmer_barrier: float = 1e-3
    spared: float = 0.2
    most_spared: float = 1.0
    least_time: float = 1e-3
    large: int = 5000
    enough: float = 5e-4
    near_way_barrier: float = 1e-3
    missed: float = 1e-7
    first_iterations: int = 100
    tells_nothing: float = 0.5
    smoother: tuple[float, ...] = (1e4, 1e3, 1e2, 10.0, 1.0)
    smoothest: tuple[float, ...] = (1e6, 1e5)
    worth_less: float = 1e-3
    smoother_iterations: int = 200
    smoother_barrier: float = 1e-2
    smoothing_told: float = 2e-4
    less_smoothing: float = 1e-2
    less_smoothing_barrier: float = 1e-6


SEARCH = SearchSettings()

TINY = 1e-12
KEEPS_LIMITS = "Returned is {}: it keeps every limit, but others may be faster."

Trial = tuple[InitialGuess, str | tuple[str, ...]]  # with the solver
Tried = tuple[str, Solution]  # name of the start, and what it led to


class Refined(NamedTuple):
    """What a coarse answer was refined into, and with what: kernels and weight of the smoothing."""

    solution: Solution
    refiner: Refiner
    smoothing: float


@dataclass(frozen=True)
class TimeOptimalSettings:
    """How hard to look.

    Attributes
    ----------
    mesh : intervals of each phase in the first full solve; half of them are where the accelerations
        change, except with dry friction, limits of jerk or torque rate and further limits, where
        they are even; by default 80, where even 100, and fewer where there are many phases: 400
        together, but at least 25 each
    starts : how many starting motions to try on the coarse mesh
    tries : how many to try at most, while another is likely to lead to an optimum that none of
        them led to; if it still is in the end the status is "local optimum". Of a single start
        that is solved nothing is known
    slack : share of the shortest duration that may be given for less effort: of all motions at
        most so much slower the one of least effort is returned, the time integral of the squared
        torques, each relative to its limit (of the accelerations where a robot has no masses). Zero
        is the fastest motion but for a smoothing of the jerk, which picks one where many are
        equally fast: it costs 1.3e-5 of the duration of the Microbot task, and is made a hundred
        times weaker where it would cost more than 2e-4 (not with dry friction, limits of jerk or
        torque rate and further ones); about how much it costs is ``smoothing_cost``, s, in the
        provenance, and in the note from 0.02 % on
    limit_tolerance : largest relative excess of a limit between mesh points; the mesh is refined
        until it holds
    switching_times : whether the times at which one limit takes over from another are solved for
        in the end, each arc a phase of free length: the fastest motion to the accuracy of the
        integrator, with accelerations that jump, and its times in the provenance. Where the arcs
        cannot be found it is the motion of the mesh, and the provenance says why
    solver : "auto" (fatrop explores, IPOPT finishes), "fatrop" or "ipopt" for everything
    compiled : compile the kernels to C where there is a compiler
    seed : of the random starts
    time_limit : wall time, s, after which the best so far is returned with the status "time limit":
        by default 120, and 600 where there are stops, a free order or a scene; infinite is none
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
    time_limit: float | None = None

    def __post_init__(self) -> None:
        if self.time_limit is not None:
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

    def within(self, usual: float) -> AbstractContextManager[None]:
        """What is called inside ends at the time limit, s, by default the ``usual`` one."""
        return deadline.within(usual if self.time_limit is None else self.time_limit)


@contextmanager
def sparing() -> Iterator[None]:
    """Inside some of the time is kept for a motion within the limits."""
    left = deadline.left()
    with deadline.within(
        max(left - min(SEARCH.spared * left, SEARCH.most_spared), SEARCH.least_time)
    ):
        yield


class FreeSearch:
    """Several starts on a coarse mesh, the best refined until limits hold between points."""

    slows_down = True  # what exceeds limits in the end
    tries_beside = True  # starts in a process of their own, while the best so far is refined

    def __init__(
        self,
        family: LimitFamily,
        via: FloatArray,
        settings: TimeOptimalSettings,
        progress: StepProgress,
        kernels: Transcription | None = None,
        known: Slowed | None = None,
    ) -> None:
        self.family, self.via, self.settings = family, via, settings
        self.robot: Robot = family.robot
        self.dry: np.ndarray = dry_friction(self.robot) > 0.0
        self.scale = TaskScale.of(family, via)
        self.progress = progress
        self.names = phase_names(len(via) - 1)
        self.calmed: dict[str, Any] = {}
        self.relaxed: Explanation | None = None
        self.likely_more = False  # whether a better optimum may well have been missed
        self.smoothing = SMOOTHING
        self.at_least = known  # what needs no search
        self._excesses: dict[Solution, list[FloatArray]] = {}
        self._slower: dict[Solution, Motion | None] = {}
        self._smoothed_from: dict[float, tuple[Solution | None, bool, Transcription, float]] = {}
        self.ahead: tuple[Solution, Refined] | None = None  # what was refined early, and into what
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
            settings=SolverSettings(gap=GAP, options=LDL),
            rough=ROUGH_TOLERANCE,
            polishing=0
            if has_windows(family) or len(self.names) > SEARCH.most_polished
            else SEARCH.polishing,
            fitted=partial(with_windows, self.dry) if has_windows(family) else None,
            enough=self._is_enough if self.slows_down else None,
        )

    def _kernels(self, budgeted: bool = False) -> Transcription:
        held: Robot = with_locked_joints_held(self.family).robot
        compiled = self.settings.compiled
        return transcription(held, self.via.tobytes(), len(self.via), compiled, budgeted=budgeted)

    @cached_property
    def _budgeted(self) -> Transcription:
        """Kernels of the least effort, for any time that is allowed."""
        return self._kernels(budgeted=True)

    def run(self) -> Motion:
        begin = time.perf_counter()
        with sparing() if self.slows_down else nullcontext():
            starts, solution = self.search()
            if self.settings.slack and self._rank(solution)[0] is False and not deadline.over():
                solution = self._calmer(solution)
            motion = self._motion(solution, starts, time.perf_counter() - begin + self.kernel_time)
        if self.slows_down and solution.status is not Status.INTERRUPTED:
            motion = self._within_limits(motion, solution)
            if motion.solved and self.likely_more:
                motion = _unsettled(motion)
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
        """What every start led to on a coarse mesh.

        Where a processor is spare the second is tried beside the first, and further ones while the
        better of these two is refined. What is found does not depend on it.
        """
        trials, found = self._trials(), list[Tried]()
        alone = self.settings.starts == 1 or self.progress is not quiet
        if alone or not self.tries_beside or not spare_processor():
            self._try(trials, found)
        else:
            first, *second = itertools.islice(trials, 2)
            with closing(Child(lambda _: self._sent(second, []))) as child:
                self._try([first], found)
                if found[0][1].status.solved and not deadline.over():
                    self._receive(child, found, len(self.refiner.history))
            if len(found) == 1:
                trials = itertools.chain(second, trials)
            if not found[0][1].status.solved:
                self._try(trials, found)
            elif not self._ends(found):
                self._refine_beside(trials, found)
        tried = [
            {"start": name, "status": str(s.status), "duration": s.duration} for name, s in found
        ]
        return tried, [solution for _, solution in found]

    def _refine_beside(self, trials: Iterator[Trial], found: list[Tried]) -> None:
        """Try further starts in a process of their own while the best of the first is refined.

        Not where no motion within the limits comes of it: its refinement may take all the time.
        """
        early = self._by_promise([solution for _, solution in found])[0]
        if self._slowed(early) is None:
            self._try(trials, found)
            return
        history = self.refiner.history
        begun = len(history)
        with closing(Child(lambda _: self._sent(trials, found))) as child:
            self.ahead = early, self._refined_anew(early)
            if self.ahead[1].solution.status is Status.INTERRUPTED or deadline.over():
                return
            if self._receive(child, found, begun):
                return
        self._try(trials, found)

    def _sent(self, trials: Iterable[Trial], found: list[Tried]) -> Any:
        """What trials lead to, as plain data, and what they add to the history."""
        known, before = len(self.refiner.history), len(found)
        self._try(trials, found, lone=not found)
        made = []
        for name, solution in found[before:]:
            parameters = {
                own.name: {p.name: p.value for p in own.layout.phase.parameters}
                for own in solution.phases
                if own.layout is not None
            }
            meshes = [own.mesh for own in solution.phases]
            made.append((name, replace(solution, phases=()), meshes, parameters))
        return made, self.refiner.history[known:]

    def _receive(self, child: Child, found: list[Tried], place: int) -> bool:
        """Take in what a child found, with its history at a place; False where it found nothing."""
        try:
            made, history = child.answer(deadline.until())
        except (OutOfTime, Died):
            return False
        for name, plain, meshes, parameters in made:
            kernels = self.refiner.transcription
            if any(parameters.values()):
                kernels = kernels.with_parameters(parameters)
            found.append(
                (name, replace(plain, phases=unpack(kernels.layouts(meshes), plain.variables)))
            )
        self.refiner.history[place:place] = history
        return True

    def _try(self, trials: Iterable[Trial], found: list[Tried], *, lone: bool = False) -> None:
        """Add what further starts lead to, until they are enough.

        A ``lone`` one is the second, beside the first.
        """
        own, refiner = self.refiner.settings, self._coarse_refiner
        mesh = self._explore_mesh
        for guess, solver in trials:
            solved = [s for _, s in found if s.status.solved]
            if solved or lone:  # what takes so much longer than another start is given up
                allowed = [SEARCH.patience * s.attempts[-1].iterations for s in solved]
                most = max(SEARCH.least_iterations, *(allowed if len(found) > 1 else ()), 0)
                refiner = replace(refiner, settings=replace(own, max_iterations=most))
                solver = solver if isinstance(solver, str) else solver[0]
            solution = refiner.solve(
                mesh, guess.guesses, tolerance=SEARCH.explore_tolerance, solver=solver
            )
            found.append((guess.name, solution))
            self.progress(
                f"start {guess.name}: {solution.duration:.4f} s on {mesh} intervals a phase, "
                f"{solution.status}"
            )
            if self._ends(found):
                break

    def _ends(self, found: Sequence[Tried]) -> bool:
        """Whether no further start is tried."""
        if found[-1][1].status is Status.INTERRUPTED or deadline.over():
            return True
        return len(found) >= self.settings.starts and self._enough([s for _, s in found])

    def _enough(self, found: Sequence[Solution]) -> bool:
        """Whether another start would more likely than not lead to what has been seen before.

        After w different outcomes of N starts it leads to a new one with the probability
        w (w + 1) / (N (N - 1)) (Boender and Rinnooy Kan, Math. Programming 37, 1987, 59-80).
        """
        solved, count = sum(solution.status.solved for solution in found), len(found)
        if solved == 0 or self.settings.starts == 1:  # of a single start nothing is asked
            return solved > 0
        different = len(self._by_promise(found)) + (solved < count)
        return 2 * different * (different + 1) <= count * (count - 1)

    def _by_promise(self, found: Sequence[Solution]) -> list[Solution]:
        """The different optima among coarse answers, the fastest first; of the same the first."""
        different = list[Solution]()
        for coarse in found:
            if coarse.status.solved and not any(
                abs(coarse.duration - other.duration) <= SEARCH.same * other.duration
                for other in different
            ):
                different.append(coarse)
        return sorted(different, key=lambda coarse: coarse.duration)

    def _trials(self) -> Iterator[Trial]:
        """Guesses with the solver for each."""
        solver, seed = self.settings.solver, self.settings.seed
        task = self.family, self.via, self.names
        most = max(self.settings.starts, self.settings.tries)
        for index, guess in enumerate(initial_guesses(*task, most, seed)):
            both: str | tuple[str, ...] = ("fatrop", "ipopt")
            if index >= self.settings.starts:  # what one misses the other may find
                both = "ipopt" if index % 3 == 2 else "fatrop"
            yield guess, both if solver == "auto" else solver

    @property
    def _explore_mesh(self) -> int:
        """Intervals a phase of the first look."""
        fewest = max(SEARCH.explore_sum // len(self.names), SEARCH.least_explore_mesh)
        return min(self._mesh, fewest, SEARCH.explore_mesh)

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
        most = SEARCH.full_mesh if self._accelerations_jump else SEARCH.full_mesh_even
        return max(min(most, SEARCH.full_mesh_sum // len(self.names)), SEARCH.least_mesh)

    # refinement -----------------------------------------------------------------------------

    def _finish(self, found: list[Solution]) -> Solution:
        """Refine the most promising coarse answers until none of the others can be better.

        What takes no less time on its coarse mesh than the best that was refined is not better.
        """
        solved = [s for s in found if s.status.solved]
        if not solved:
            nearest = min(found, key=lambda s: (not s.attempts, s.attempts[-1].infeasibility))
            relaxed = self._from_known_ways(nearest)
            if not relaxed.status.solved:
                relaxed = self._relaxed(nearest)
            if not relaxed.status.solved:
                return self.refiner.finished(self._refined(relaxed))
            solved = [relaxed]
        self.likely_more = not self._enough(found)
        best: Refined | None = None
        for count, coarse in enumerate(self._by_promise(solved)):
            if best is not None and (
                deadline.over()
                or count == SEARCH.most_refined
                or self._rank(best.solution) <= (False, coarse.duration)
            ):
                break
            known, refined = self.ahead or (None, None)
            if refined is None or known is not coarse:
                refined = self._refined_anew(coarse)
            best = min(best or refined, refined, key=lambda made: self._rank(made.solution))
        assert best is not None
        _, self.refiner, self.smoothing = best
        return self.refiner.finished(best.solution)

    def _refined_anew(self, coarse: Solution) -> Refined:
        """What a coarse answer leads to, whatever was refined before."""
        usual = self.refiner, self.smoothing
        self.refiner = replace(self.refiner)
        refined = Refined(self._refined(coarse), self.refiner, self.smoothing)
        self.refiner, self.smoothing = usual
        return refined

    def _from_known_ways(self, nearest: Solution) -> Solution:
        """What a way with its best timing leads to where no other start led anywhere."""
        if not self.slows_down or deadline.over() or nearest.status is Status.INTERRUPTED:
            return nearest
        self.at_least = self.at_least or self._known_ways()
        if self.at_least is None:
            return nearest
        motion, name = self.at_least
        guesses = self._guess_along(motion)
        meshes = [phase.mesh for phase in nearest.phases]
        found = self._coarse_refiner.solve(
            meshes, guesses, tolerance=SEARCH.explore_tolerance, barrier=SEARCH.near_way_barrier
        )
        self.progress(f"start {name}: {found.duration:.4f} s, {found.status}")
        return found if found.status.solved else nearest

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
        found = self._coarse_refiner.solve(meshes, guesses, tolerance=SEARCH.explore_tolerance)
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
            best = refiner.sharpen(best, self._reversals, worth=SEARCH.worth)
        best = refiner.refine(best)
        if any(places.any() for places in self._velocity_switches(best)):
            best = refiner.refine(refiner.sharpen(best, self._velocity_switches))
        if "qddd" in self.family:
            best = refiner.refine(refiner.sharpen(best, self._jerk_switches))
        return best

    def _refined_where_they_jump(self, coarse: Solution) -> Solution:
        """As :meth:`_refined`, with a mesh that is finer where the coarse accelerations change."""
        best = self._first_full_mesh(coarse)
        refiner, own = replace(self.refiner, foresight=SEARCH.foresight), self.refiner.settings
        if best is coarse:  # nothing leads on from here: what is tried yet is not tried for long
            own = replace(own, max_iterations=min(own.max_iterations, SEARCH.smoother_iterations))
        refiner = replace(refiner, settings=own)
        if len(self.names) <= SEARCH.many_phases:
            # a refined mesh is seldom refined again: to the last digits at once
            least = replace(own, max_iterations=min(own.max_iterations, SEARCH.most_exact))
            exact = replace(refiner, settings=least, rough=None, once=True)
            best = exact.refine(best, self._velocity_switches)
        return refiner.refine(best, self._velocity_switches)

    def _first_full_mesh(self, coarse: Solution) -> Solution:
        """A mesh that is finer where the coarse accelerations change; ``coarse`` where none is."""
        own = self.refiner.settings
        meshes = [graded(phase, self._mesh) for phase in coarse.phases]
        options = {"ipopt": {**LDL["ipopt"], "mu_init": SEARCH.far_barrier}}
        farther = replace(own, options=options)
        if len(self.names) > SEARCH.many_phases:
            # multipliers of so coarse a mesh mislead: 87 iterations, 65 without
            best = self.refiner.solve(meshes, self._guess_from(coarse))
            if best.status.solved and best.cost <= (1 + WORSE) * coarse.cost:
                return self._smoothed_less(best)
        else:
            if not self._largest_excess(coarse) > SEARCH.tells_nothing:  # nor where it is not known
                patient = replace(
                    farther, max_iterations=min(own.max_iterations, SEARCH.first_iterations)
                )
                refiner = replace(self.refiner, settings=patient, once=True)
                best = refiner.finer(coarse, meshes)
                if best is not coarse:
                    return self._smoothed_less(best)
            smoothed = self._smoothed_at_first(coarse)
            if smoothed is not None:
                return smoothed
        best = replace(self.refiner, settings=farther).finer(coarse, meshes)
        return best if best is coarse else self._smoothed_less(best)

    def _smoothed_at_first(self, coarse: Solution) -> Solution | None:
        """A full mesh from a motion within the limits, smoothed ever less.

        For arms so light or fast that torques change more between the points of a coarse mesh than
        it can tell: what it calls an optimum is none, and finer meshes do not find one from there.
        None where no such motion is known, ``coarse`` where it ends on the way.
        """
        if self._stopped:
            return coarse
        known = None
        if self.slows_down and coarse.status.solved:
            known = self._slowed(coarse) or getattr(self._known_ways(), "motion", None)
        if known is None:
            return None
        if known.duration not in self._smoothed_from:
            last, reached = None, False
            for steps in (SEARCH.smoother, (*SEARCH.smoothest, *SEARCH.smoother)):
                if last is None and not self._stopped:
                    last, reached = self._step_by_step(self._guess_along(known), steps)
            made = last, reached, self.refiner.transcription, self.smoothing
            self._smoothed_from[known.duration] = made
        made = self._smoothed_from[known.duration]
        last, reached, self.refiner.transcription, self.smoothing = made
        if last is None:
            return coarse
        if reached or deadline.over():
            return last
        slower = self._slowed(last)
        if slower is not None:
            self._keep(Slowed(slower, "a smoother motion"))
        self.smoothing = SMOOTHING
        return coarse

    def _step_by_step(
        self, start: Mapping[str, Guess] | Solution, steps: Sequence[float]
    ) -> tuple[Solution | None, bool]:
        """The last motion that was solved, and whether less smoothing is worth nothing.

        Where it is, what follows is smoothed as much.
        """
        settings = replace(self.refiner.settings, max_iterations=SEARCH.smoother_iterations)
        usual, last, barrier = self.refiner.transcription, None, SEARCH.smoother_barrier
        for step in steps:
            weight = {name: {JERK_WEIGHT: step * SMOOTHING} for name in self.names}
            kernels = usual.with_parameters(weight)
            refiner = replace(self.refiner, transcription=kernels, settings=settings)
            found = refiner.solve([self._mesh] * len(self.names), start, barrier=barrier)
            self.progress(f"smoothed {step:g} times: {found.duration:.6f} s, {found.status}")
            if not found.status.solved:
                break
            worth = np.inf if last is None else last.duration / found.duration - 1.0
            start, last, barrier, self.smoothing = found, found, None, step * SMOOTHING
            if step == SEARCH.smoother[-1] or worth < SEARCH.worth_less:
                self.refiner.transcription = kernels
                return last, True
            if deadline.over():
                break
        return last, False

    @property
    def _stopped(self) -> bool:
        """Whether the last solve was interrupted, or the time is over."""
        return self.refiner.history[-1]["status"] is Status.INTERRUPTED or deadline.over()

    def _keep(self, found: Slowed) -> None:
        """What is returned at least, if it is faster than what would be."""
        if self.at_least is None or found.motion.duration < self.at_least.motion.duration:
            self.at_least = found

    def _guess_along(self, motion: Motion) -> dict[str, Guess]:
        """A guess for every phase from a motion whose marks are the via points."""
        shape = PiecewisePolynomial(motion.t, pieces_of(motion))
        return guesses_along(self.names, shape, np.array([mark.time for mark in motion.marks]))

    def _smoothed_less(self, best: Solution) -> Solution:
        """The same mesh, and all that follow, with less smoothing where that costs much."""
        share = self._smoothed(best) / best.duration
        if not best.status.solved or share <= SEARCH.smoothing_told or deadline.over():
            return best
        lower = {JERK_WEIGHT: SEARCH.less_smoothing * SMOOTHING}
        kernels = self.refiner.transcription.with_parameters(dict.fromkeys(self.names, lower))
        # without pivots so little curvature is lost in rounding: 40 iterations in place of 21
        usual = replace(self.refiner.settings, options={})
        options = {"ipopt": {"mu_init": SEARCH.less_smoothing_barrier}}
        settings = replace(usual, options=options, max_iterations=SEARCH.most_exact)
        refiner = replace(self.refiner, transcription=kernels, settings=settings)
        found = refiner.solve([phase.mesh for phase in best.phases], best)
        self.progress(f"smoothed less: {found.duration:.6f} s, {found.status}")
        if not found.status.solved or found.duration >= best.duration:
            return best
        self.refiner.transcription, self.smoothing = kernels, SEARCH.less_smoothing * SMOOTHING
        self.refiner.settings = usual
        return found

    def _rank(self, solution: Solution) -> tuple[bool, float]:
        """What keeps its limits first, then what is faster."""
        kept = solution.status.solved and (
            self._largest_excess(solution) <= self.settings.limit_tolerance
            or self._is_enough(solution)
        )
        return not kept, solution.duration

    def _is_enough(self, solution: Solution) -> bool:
        """Whether a motion on a large mesh is slowed down, by next to nothing, not refined."""
        size = sum(phase.mesh.size - 1 for phase in solution.phases) * self.robot.joint_count
        if size < SEARCH.large or not solution.status.solved or self.settings.slack:
            return False
        if self._largest_excess(solution) <= self.settings.limit_tolerance:
            return False
        slower = self._slowed(solution)
        return slower is not None and slower.duration <= (1.0 + SEARCH.enough) * solution.duration

    def _largest_excess(self, solution: Solution) -> float:
        return max(float(e.max()) for e in self._excess(solution))

    def _calmer(self, fastest: Solution) -> Solution:
        """The motion of least effort that takes at most the slack longer; the fastest if none."""
        slower = 1.0 + self.settings.slack
        allowed = {self.names[-1]: {BUDGET: slower * fastest.duration}}
        kernels = self._budgeted.with_parameters(allowed)
        refiner = replace(
            self.refiner, transcription=kernels, guess_from=self._with_clock, rough=None
        )
        # what is smooth needs no mesh that was made for jumps
        meshes: list[Any] = [
            min(SEARCH.calmer_mesh, phase.mesh.size - 1) for phase in fastest.phases
        ]
        guesses = self._with_clock(fastest, slower)
        calmer = refiner.refine(refiner.solve(meshes, guesses, barrier=SEARCH.calmer_barrier))
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
        if solution not in self._excesses:  # asked for again and again
            self._excesses[solution] = excess_between(self.family, solution)
        return self._excesses[solution]

    # result ---------------------------------------------------------------------------------

    def _within_limits(self, motion: Motion, solution: Solution) -> Motion:
        """A motion that keeps the limits in the place of one that does not, or that is slower.

        A solution slowed down by no more than two meshes may differ counts as solved.
        """
        told, kept = motion.provenance, motion.solved and not self._is_enough(solution)
        # not even time may be left to slow it down
        if not kept and (self.at_least is None or not deadline.over()):
            self._slowed(solution)
        for made, slowed in self._slower.items():
            if slowed is not None:
                name = "the motion found" if made is solution else "a coarser motion"
                self._keep(Slowed(slowed, f"{name}, slowed down at limits"))
        if not kept and self.at_least is None:
            self.at_least = self._known_ways()
        if self.at_least is None:
            return motion
        found, made_from = self.at_least
        slower = found.duration / solution.duration - 1.0
        if kept and (self.calmed or slower >= -WORSE):
            return motion
        status, advice, note = told["status"], told["advice"], motion.note
        if status != Status.TIME_LIMIT and solution.status.solved and abs(slower) <= WORSE:
            status = Status.SOLVED
        elif status in (Status.LIMITS_EXCEEDED, Status.SOLVED):
            status, advice = Status.NOT_ACCEPTED, Status.NOT_ACCEPTED.sentence
        elif status == Status.INFEASIBLE:  # there is a motion
            status, advice = Status.FAILED, "The search found no motion within the limits."
        if status == Status.SOLVED:
            advice = Status.SOLVED.sentence
            note += f"; slowed down by {100 * slower:.2g} % where it exceeded limits"
        else:
            advice += "\n" + KEEPS_LIMITS.format(made_from)
            note = f"not solved: {advice}"
        more = {"status": str(status), "advice": advice, "made_from": made_from}
        more["excess"] = largest_excess(self.family, found)
        return replace(found, provenance={**told, **more}, note=note)

    @property
    def _fast(self) -> bool:
        return compiles(self.settings.compiled)

    def _known_ways(self) -> Slowed | None:
        return known_ways(self.family, self.via, self.settings.limit_tolerance, self._fast)

    def _slowed(self, solution: Solution) -> Motion | None:
        """A solution slowed down until it keeps the limits; None where it is none."""
        if solution not in self._slower:
            self._slower[solution] = self._slowed_anew(solution)
        return self._slower[solution]

    def _slowed_anew(self, solution: Solution) -> Motion | None:
        if not solution.phases or not np.isfinite(solution.duration):
            return None
        shape, times = polynomial(solution), via_times(solution)
        missed = np.abs(shape(times) - self.via).max()
        if not missed <= SEARCH.missed * np.abs(np.diff(self.via, axis=0)).max():
            return None
        velocity, inner = shape.derivative(), times[1:-1]
        jump = np.abs(velocity(inner) - velocity(inner, from_left=True)).max(initial=0.0)
        if (
            not jump <= SEARCH.missed * np.abs(velocity(shape.breaks)).max()
        ):  # where a solve was stopped
            return None
        return within_limits(self.family, shape, times, self.settings.limit_tolerance, self._fast)

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
                self.smoothing,
                smoothing_cost=self._smoothed(solution),
                optima_seen=found,
                starts=starts,
                solves=self.refiner.history,
                kernel_time=self.kernel_time,
                **({"least_effort": self.calmed} if self.calmed else {}),
            ),
            _note(outcome, len(self.via), len(starts), found)
            + self._slack_note(solution)
            + self._smoothing_note(solution),
        )

    def _shaped(self, solution: Solution, provenance: dict[str, Any], note: str) -> Motion:
        return as_motion(self.robot, solution, provenance, note)

    def _smoothed(self, solution: Solution) -> float:
        """What the smoothing of the jerk adds to the cost, s."""
        return 0.0 if self.calmed else max(0.0, solution.cost - solution.duration)

    def _smoothing_note(self, solution: Solution) -> str:
        share = self._smoothed(solution) / solution.duration
        if not solution.status.solved or share < SEARCH.smoothing_told:
            return ""
        return f"; without smoothing of the jerk it could be about {100 * share:.1g} % faster"

    def _slack_note(self, solution: Solution) -> str:
        if not self.calmed:
            return ""
        fastest, before = self.calmed["fastest"], self.calmed["effort_of_the_fastest"]
        if solution.duration == fastest:
            return f"; no motion of less effort was found ({self.calmed['status']})"
        saved, slower = 1.0 - self.calmed["effort"] / before, solution.duration / fastest - 1.0
        return f"; {100 * slower:.3g} % slower than the fastest for {100 * saved:.3g} % less effort"


def as_motion(robot: Robot, solution: Solution, provenance: dict[str, Any], note: str) -> Motion:
    marks = [Mark(float(t), f"via {i + 1}") for i, t in enumerate(via_times(solution))]
    return Motion.from_polynomial(
        robot,
        polynomial(solution),
        label="time-optimal",
        marks=marks,
        provenance=provenance,
        note=note,
    )


def _unsettled(motion: Motion) -> Motion:
    """The motion, which is not the fastest where further starts would lead to better ones."""
    told = motion.provenance
    advice = (
        f"Of {len(told['starts'])} starts nearly every one led to another optimum, so that others "
        "may well be faster: allow more tries, or take another seed."
    )
    told = {**told, "status": str(Status.LOCAL_OPTIMUM), "advice": advice}
    return replace(motion, provenance=told, note=f"not solved: {advice}")


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
    density = (1.0 - SEARCH.graded) * steps + SEARCH.graded * weight / max(weight.sum(), TINY)
    reached = np.concatenate([[0.0], np.cumsum(density)])
    mesh = np.interp(np.linspace(0.0, reached[-1], count + 1), reached, phase.mesh)
    mesh[[0, -1]] = 0.0, 1.0
    return mesh


def _slowed(curve: Any, by: float, s: FloatArray) -> FloatArray:
    return curve(s) / by


def _clock(start: float, end: float, s: FloatArray) -> FloatArray:
    return start + (end - start) * s[:, None]
