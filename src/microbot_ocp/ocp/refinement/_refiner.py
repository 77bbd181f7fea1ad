"""Coarse to fine: warm starts on finer meshes, splits where constraints are exceeded in between.

A finer mesh whose optimum is worse than the coarser one's is not accepted: success reported by a
solver is not enough. Costs are compared only with answers that keep their limits between the mesh
points, too: what a coarse mesh gains by exceeding them is no reason to refuse an honest answer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, cast

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.mesh import Round, refined
from microbot_ocp.ocp.solution import Solution, StepProgress, quiet
from microbot_ocp.ocp.solvers import SolverSettings, solve_on
from microbot_ocp.ocp.transcription import Guess, Meshes, MeshLike, Transcription

GuessFrom = Callable[[Solution], Mapping[str, Guess]]
Excess = Callable[[Solution], Sequence[FloatArray]]
Fitted = Callable[[Transcription, Meshes, Mapping[str, Guess] | Solution], Transcription]
Switching = Callable[[Solution], Sequence[np.ndarray]]

WORSE = 1e-3  # share of the cost that a finer mesh may cost more


@dataclass(frozen=True)
class RefinerSettings:
    """When a finer mesh is worth it, and how it is solved.

    Attributes
    ----------
    warm_barrier : barrier parameter of warm starts; with the usual start at 0.1 IPOPT leaves the
        good guess and comes back late or elsewhere (146 against 35 iterations on one task with
        four via points)
    stubborn : meshes that do not halve the least excess so far: finer ones will not, either
    gross : excess from which an answer was found by the tolerance of its equations, not by them
    polished : share of the wanted gap that needs no polish
    polishing : iterations for the last digits
    finishing : meshes after that
    """

    warm_barrier: float = 1e-4
    stubborn: int = 6
    gross: float = 1.0
    polished: float = 0.1
    polishing: int = 60
    finishing: int = 2


SETTINGS = RefinerSettings()


@dataclass(eq=False)
class Refiner:
    """Solves one transcription on finer and finer meshes and keeps the history.

    Parameters
    ----------
    transcription : Transcription
    guess_from : callable
        Turns a solution into guesses for another mesh.
    excess : callable
        For a solution, the largest relative excess of any constraint inside every interval, or at K
        evenly spaced places of it with both its ends: one array [N] or [N, K] a phase.
    limit_tolerance : float
        Excess that is accepted.
    solver : str or tuple of str
        For fine meshes; what is not solved by it goes to IPOPT.
    tolerance : float
    rounds : int
        Largest number of local refinements.
    progress : callable
        Called with a line of text at every step, and with every iteration of the solvers.
    settings : SolverSettings
        What else the solvers are told.
    rough : float, optional
        Tolerance of all solves until :meth:`finished`: on a flat minimum most iterations are
        spent on the last digits, which the next mesh changes.
    polishing : int
        Iterations at most for the last digits; none are looked for with zero.
    foresight : float
        Share of the accepted excess from which intervals are split along with those that exceed it:
        the next optimum would exceed it there.
    fitted : callable, optional
        Gives the kernels the parameters that belong to a mesh and a start.
    once : bool
        A mesh is given up where the first start on it fails, which is not repeated by other means.
    enough : callable, optional
        Tells of a solution that exceeds constraints whether it is refined no further all the same.
    """

    transcription: Any  # a Transcription, or what takes its place
    guess_from: GuessFrom
    excess: Excess
    limit_tolerance: float
    solver: str | tuple[str, ...] = "ipopt"
    tolerance: float = 1e-8
    rounds: int = 10
    progress: StepProgress = quiet
    settings: SolverSettings = field(default_factory=SolverSettings)
    rough: float | None = None
    polishing: int = SETTINGS.polishing
    foresight: float = 1.0
    fitted: Fitted | None = None
    once: bool = False
    enough: Callable[[Solution], bool] | None = None
    history: list[dict[str, Any]] = field(default_factory=list)

    def solve(
        self,
        mesh: Meshes,
        guesses: Mapping[str, Guess] | Solution,
        *,
        tolerance: float | None = None,
        solver: str | tuple[str, ...] | None = None,
        barrier: float | None = None,
    ) -> Solution:
        """Return one solve, entered in the history."""
        tolerance = tolerance or self.rough
        settings = replace(
            self.settings,
            solver=solver or self.solver,
            tolerance=tolerance or self.tolerance,
            initial_barrier=barrier,
            gap=self.settings.gap if tolerance is None else np.inf,  # of a first look none is asked
        )
        kernels = self.transcription
        if self.fitted is not None:
            kernels = self.fitted(kernels, mesh, guesses)
        progress = None if self.progress is quiet else self.progress
        solution = solve_on(kernels, mesh, guesses, settings, progress, once=self.once)
        entry = {
            "intervals": [phase.mesh.size - 1 for phase in solution.phases],
            "cost": solution.cost,
            "duration": solution.duration,
            "status": solution.status,
            "accepted": solution.status.solved,
            "build_time": solution.build_time,
            "attempts": [attempt.as_dict() for attempt in solution.attempts],
        }
        self.history.append(entry)
        return solution

    def finished(self, solution: Solution) -> Solution:
        """Return a rough solution to the full tolerance and refined so further.

        As it is where that takes too long or does not keep the limits.
        """
        if not (self.rough and self.polishing and solution.status.solved) or deadline.over():
            return solution
        wanted = self.settings.gap
        polished = cast("float", solution.settings.get("gap", np.inf)) <= wanted  # it was solved so
        near = solution.gap.total <= SETTINGS.polished * wanted * abs(solution.cost)
        if self._is_enough(solution) or polished or near:
            return solution
        return self.polished(solution, SETTINGS.finishing)

    def polished(self, solution: Solution, rounds: int) -> Solution:
        """Return a solution to the full tolerance on its own mesh, from its multipliers, refined
        further in so many rounds; as it is where that takes too long or does not keep the limits.
        """
        most = min(self.settings.max_iterations, self.polishing)
        settings = replace(self.settings, max_iterations=most)
        meshes = [phase.mesh for phase in solution.phases]
        finer = replace(self, settings=settings, rough=None, once=True).solve(meshes, solution)
        accepted = self.history[-1]["accepted"] = self._accepts(solution, finer)
        self.progress(f"the last digits: {finer.duration:.6f} s, {finer.status}")
        if not accepted:
            return solution
        self.rough = None
        finer = replace(self, rounds=rounds).refine(finer)
        within = self._worst(finer) <= max(self.limit_tolerance, self._worst(solution))
        return finer if within else solution

    def finer(self, before: Solution, meshes: Sequence[MeshLike]) -> Solution:
        """Solve on another mesh from a solution; keep the old one where the new one is worse."""
        if deadline.over():
            return before
        guesses = self.guess_from(before)
        warm = self.solver == "ipopt" and before.status.solved
        starts: list[tuple[Any, float | None, Mapping[str, Guess] | Solution]]
        if warm and before.variable_multipliers is not None:
            # with multipliers: 20 against 30 iterations on the Microbot task from 20 to 100
            starts = [("ipopt", None, before)]
        else:
            starts = [(self.solver, SETTINGS.warm_barrier, guesses)]
        if not self.once:
            starts.append(("ipopt", None, guesses))
        after, dearer, owed = before, None, self._owed_to_excess(before)
        for name, barrier, start in starts:
            after = self.solve(meshes, start, solver=name, barrier=barrier)
            accepted = self.history[-1]["accepted"] = self._accepts(before, after)
            sizes = " + ".join(str(phase.mesh.size - 1) for phase in after.phases)
            note = "" if accepted else ", not accepted"
            self.progress(f"mesh {sizes}: {after.duration:.6f} s, {after.status}{note}")
            if accepted:
                return after
            if after.status is Status.INTERRUPTED or deadline.over():
                break
            honest = after.status.solved and owed > 0 and not self._exceeds_grossly(before, after)
            if honest and (dearer is None or after.cost < dearer.cost):
                dearer = after
        if dearer is not None:
            self.progress(f"{dearer.duration:.6f} s accepted: what is cheaper exceeds its limits")
            return dearer
        return before if before.status.solved else after

    def _worst(self, solution: Solution) -> float:
        return max(float(e.max()) for e in self.excess(solution))

    def _owed_to_excess(self, before: Solution) -> float:
        """Return share of its cost that an answer may owe to limits that it exceeds between mesh
        points.

        A motion that is slowed down by as much as it exceeds a limit of its speed keeps it; limits
        of the second derivative cost less.
        """
        if not before.status.solved:
            return 0.0
        worst = self._worst(before)
        return worst if worst > self.limit_tolerance else 0.0

    def _exceeds_grossly(self, before: Solution, after: Solution) -> bool:
        """Return whether what came of a mesh exceeds limits as what was known before does not."""
        return self._worst(after) > max(SETTINGS.gross, self._worst(before))

    def _accepts(self, before: Solution, after: Solution) -> bool:
        if not after.status.solved or not before.status.solved:
            return after.status.solved
        if self._exceeds_grossly(before, after):
            return False
        more = WORSE + self._owed_to_excess(before)
        return after.cost - before.cost <= more * abs(before.cost)

    def refine(
        self, solution: Solution, switching: Switching | None = None, *, worth: float = 0.0
    ) -> Solution:
        """Split intervals until no constraint is exceeded between mesh points by more.

        Those inside which a control switches are split along with them, while a mesh lowers the
        cost by more than a share that is ``worth`` another one.
        """
        return self._refined(
            solution,
            partial(self._exceeded, switching, worth),
            self._split_where_exceeded,
            lambda before, after: after is not before,
            self._keeps_limits,
        )

    def sharpen(self, solution: Solution, switching: Switching, *, worth: float) -> Solution:
        """Split the intervals inside which a control switches, while that lowers the cost.

        What is constant over an interval is a mean of its two values there, which costs in
        proportion to the square of the interval's length.
        """

        def done(rounds: _Rounds, _: list[FloatArray]) -> Status | None:
            last, cost = rounds[-1], rounds[-1].solution.cost
            gained = rounds[-2].solution.cost - cost if len(rounds) > 1 else np.inf
            worthless = gained < worth * abs(cost)
            return Status.SOLVED if worthless or not last.measure.switched else None

        return self._refined(
            solution,
            lambda _, answer: _Exceeded([], switching(answer)),
            lambda rounds: _split_all(rounds[-1].solution, rounds[-1].measure.switches),
            lambda before, after: after.cost < before.cost,
            done,
        )

    def _refined(
        self,
        solution: Solution,
        measure: Callable[[_Rounds, Solution], _Exceeded],
        split: Callable[[_Rounds], list[FloatArray]],
        accept: Callable[[Solution, Solution], bool],
        done: Callable[[_Rounds, list[FloatArray]], Status | None],
    ) -> Solution:
        """Return the last answer of the one loop, which ends where it must or where it is done."""

        def ended(rounds: _Rounds, meshes: list[FloatArray]) -> Status | None:
            if deadline.over() or not rounds[-1].solution.status.solved:
                return Status.TIME_LIMIT
            return Status.ROUND_LIMIT if len(rounds) > self.rounds else done(rounds, meshes)

        if deadline.over() or not solution.status.solved:
            return solution
        *_, last = refined(solution, self.finer, measure, split, accept, ended)
        return last.solution

    def _exceeded(
        self, switching: Switching | None, worth: float, rounds: _Rounds, solution: Solution
    ) -> _Exceeded:
        worst = self.history[-1]["excess"] = self._worst(solution)
        self.progress(f"largest excess of a limit between mesh points: {100 * worst:.3g} %")
        gained = rounds[-1].solution.cost - solution.cost if rounds else np.inf
        sharp = gained > worth * abs(solution.cost)
        switches = switching(solution) if switching and sharp else []
        return _Exceeded(self.excess(solution), switches, worst)

    def _split_where_exceeded(self, rounds: _Rounds) -> list[FloatArray]:
        solution, seen = rounds[-1].solution, rounds[-1].measure
        marked = [e > self.foresight * self.limit_tolerance for e in seen.excess]
        if seen.switches:
            tables = [marks.reshape(marks.shape[0], -1) for marks in marked]
            pairs = zip(tables, seen.switches, strict=True)
            marked = [marks | switch.reshape(-1, 1) for marks, switch in pairs]
        return _split_all(solution, marked)

    def _keeps_limits(self, rounds: _Rounds, _: list[FloatArray]) -> Status | None:
        """Give why no more is split: limits are kept, or enough, or finer meshes come no nearer."""
        seen = rounds[-1].measure
        within = seen.worst <= self.limit_tolerance
        if (within and not seen.switched) or self._is_enough(rounds[-1].solution):
            return Status.SOLVED
        stubborn = _stubborn([each.measure.worst for each in rounds]) >= SETTINGS.stubborn
        return Status.NO_PROGRESS if stubborn and not within else None

    def _is_enough(self, solution: Solution) -> bool:
        return self.enough is not None and self.enough(solution)


@dataclass(frozen=True, eq=False)
class _Exceeded:
    """By what intervals exceed limits, and inside which of them a control switches."""

    excess: Sequence[FloatArray]
    switches: Sequence[np.ndarray]
    worst: float = 0.0

    @property
    def switched(self) -> bool:
        return any(marks.any() for marks in self.switches)


_Rounds = tuple[Round[Solution, _Exceeded], ...]


def _stubborn(excess: Sequence[float]) -> int:
    """Return meshes since the least excess was halved last."""
    least, last = np.inf, 0
    for number, worst in enumerate(excess):
        if worst < 0.5 * least:
            least, last = worst, number
    return len(excess) - 1 - last


def _split_all(solution: Solution, marked: Sequence[np.ndarray]) -> list[FloatArray]:
    return [split(phase.mesh, marks) for phase, marks in zip(solution.phases, marked, strict=True)]


def split(mesh: FloatArray, bad: np.ndarray) -> FloatArray:
    """Split the bad intervals, where they are bad, and halve their neighbours.

    Parameters
    ----------
    mesh : array [N+1]
    bad : array of bool [N] or [N, K]
        Whole intervals, which are halved, or K evenly spaced places of each with both its ends:
        the stretch that is bad is cut out and halved. A sudden change, such as that of dry friction
        where a joint turns back, is so closed in on by much more than a half at a time.
    """
    table = bad.reshape(mesh.size - 1, -1)
    places = table.shape[1]
    rows = np.flatnonzero(table.any(axis=1))
    near = np.zeros(mesh.size - 1, dtype=bool)
    near[np.maximum(rows - 1, 0)] = near[np.minimum(rows + 1, near.size - 1)] = True
    near[rows] = False
    added = [(mesh[:-1] + mesh[1:])[near] / 2]
    for row in rows:
        inside = np.flatnonzero(table[row])
        first, last = max(inside[0] - 1, 0), min(inside[-1] + 1, places - 1)
        cuts = np.array([first, (first + last) / 2, last]) / max(places - 1, 1)
        if places == 1:
            cuts = np.array([0.5])
        cuts = cuts[(cuts > 0) & (cuts < 1)]
        added.append(mesh[row] + cuts * (mesh[row + 1] - mesh[row]))
    return np.unique(np.concatenate([mesh, *added]))
