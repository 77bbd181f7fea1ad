"""Refinement of motions from coarse to fine, with splits where constraints are exceeded.

Every finer mesh starts from the coarser solution. A finer mesh with a worse optimum is not
accepted: a solver may report success at a worse local optimum. Costs are compared only with
solutions that keep their limits between the mesh points: a coarse mesh that exceeds them may be
cheaper.
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
from microbot_ocp.ocp.solvers import SolveContext, SolverSettings
from microbot_ocp.ocp.transcription import Guess, Meshes, MeshLike, Transcription

GuessFrom = Callable[[Solution], Mapping[str, Guess]]
Excess = Callable[[Solution], Sequence[FloatArray]]
Fitted = Callable[[Transcription, Meshes, Mapping[str, Guess] | Solution], Transcription]
Switching = Callable[[Solution], Sequence[np.ndarray]]

WORSE = 1e-3  # accepted increase of the cost on a finer mesh, relative


# Barrier parameter of warm starts; IPOPT's default of 0.1 would move a good guess far away
WARM_BARRIER = 1e-4
STUBBORN = 6  # usual number of meshes without halving the least excess
GROSS = 1.0  # excess above which a solution satisfies its equations only within their tolerance
POLISHED = 0.1  # fraction of the wanted gap below which no polishing is needed
POLISHING_ITERATIONS = 60  # limit of the polishing solve
# Least foresight after polishing: few excesses remain, and each new interval costs
FORESIGHT = 0.5


@dataclass(eq=False)
class Refiner:
    """Solver of one transcription on successively finer meshes, with a history.

    Parameters
    ----------
    transcription : Transcription
    guess_from : callable
        Function that converts a solution to guesses for another mesh.
    excess : callable
        Function of a solution that returns the largest relative excess of any constraint in every
        interval, or at K evenly spaced points of it with both ends: one array [N] or [N, K] per
        phase.
    limit_tolerance : float
        Accepted excess.
    tolerance : float
    rounds : int
        Largest number of local refinements.
    progress : callable
        Function called with a line of text at every step, and with every iteration of the solvers.
    settings : SolverSettings
        Further settings of the solvers.
    rough : float, optional
        Tolerance of all solves until :meth:`polished`: on a flat minimum most iterations improve
        digits that the next mesh changes.
    polishing : int
        Iteration limit of the polishing solve; 0 for none.
    foresight : float
        Fraction of the accepted excess above which intervals are split together with those that
        exceed it: the next optimum would exceed it there.
    fitted : callable, optional
        Function that sets parameters of the kernels for a mesh and a start.
    once : bool
        True to give up a mesh after the first failed start.
    worth : float
        Relative gain of the last mesh above which a failed mesh is solved from other starts; by
        default always.
    stubborn : int
        Number of meshes without halving the least excess after which refinement ends.
    enough : callable, optional
        Function of a solution that exceeds constraints; True ends its refinement.
    """

    transcription: Any  # a Transcription or an object with its interface
    guess_from: GuessFrom
    excess: Excess
    limit_tolerance: float
    tolerance: float = 1e-8
    rounds: int = 10
    progress: StepProgress = quiet
    settings: SolverSettings = field(default_factory=SolverSettings)
    rough: float | None = None
    polishing: int = POLISHING_ITERATIONS
    foresight: float = 1.0
    fitted: Fitted | None = None
    once: bool = False
    worth: float = -np.inf
    stubborn: int = STUBBORN
    enough: Callable[[Solution], bool] | None = None
    history: list[dict[str, Any]] = field(default_factory=list)

    def solve(
        self,
        mesh: Meshes,
        guesses: Mapping[str, Guess] | Solution,
        *,
        tolerance: float | None = None,
        barrier: float | None = None,
    ) -> Solution:
        """Return one solve, recorded in the history."""
        tolerance = tolerance or self.rough
        settings = replace(
            self.settings,
            solver="ipopt",
            tolerance=tolerance or self.tolerance,
            initial_barrier=barrier,
            gap=self.settings.gap if tolerance is None else np.inf,  # rough solves accept any gap
        )
        kernels = self.transcription
        if self.fitted is not None:
            kernels = self.fitted(kernels, mesh, guesses)
        progress = None if self.progress is quiet else self.progress
        context = SolveContext(kernels, settings, progress)
        solution = context.solve(mesh, guesses, once=self.once)
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

    def is_finished(self, solution: Solution) -> bool:
        """Return True if a solution needs no polishing, or none is possible."""
        if not (self.rough and self.polishing and solution.status.solved) or deadline.over():
            return True
        wanted = self.settings.gap
        # A solve with the wanted gap is polished already.
        polished = cast("float", solution.settings.get("gap", np.inf)) <= wanted
        near = solution.gap.total <= POLISHED * wanted * abs(solution.cost)
        return self._is_enough(solution) or polished or near

    def polished(self, solution: Solution) -> Solution:
        """Return a solution at full tolerance on its mesh, followed by refinement rounds.

        The solve starts from its multipliers. The solution is returned unchanged if this takes too
        long or does not keep the limits.
        """
        most = min(self.settings.max_iterations, self.polishing)
        settings = replace(self.settings, max_iterations=most)
        meshes = [phase.mesh for phase in solution.phases]
        given = {"rough": None, "once": True, "foresight": FORESIGHT}
        exact = replace(self, settings=settings, **given)
        finer = exact.solve(meshes, solution)
        if finer.status is Status.GAP_LEFT and finer.gap.total < solution.gap.total:
            # Rough solves accept any gap, so a smaller one than theirs is an improvement.
            finer = replace(finer, status=Status.SOLVED)
        accepted = self.history[-1]["accepted"] = self._accepts(solution, finer)
        self.progress(f"the last digits: {finer.duration:.6f} s, {finer.status}")
        if not accepted:
            return solution
        finer = exact.refine(finer)
        within = self._worst(finer) <= max(self.limit_tolerance, self._worst(solution))
        return finer if within else solution

    def finer(self, before: Solution, meshes: Sequence[MeshLike]) -> Solution:
        """Solve on another mesh from a solution; return the old one if the new one is worse."""
        if deadline.over():
            return before
        guesses = self.guess_from(before)
        starts: list[tuple[float | None, Mapping[str, Guess] | Solution]]
        if before.status.solved and before.variable_multipliers is not None:
            # Multipliers save a third of the iterations of this start.
            starts = [(None, before)]
        else:
            starts = [(WARM_BARRIER, guesses)]
        again = not self.once and self._last_gain() > self.worth
        if again:
            starts.append((None, guesses))
        after, dearer, gain = before, None, self._cost_of_excess(before)
        solve = replace(self, once=not again).solve
        for barrier, start in starts:
            after = solve(meshes, start, barrier=barrier)
            accepted = self.history[-1]["accepted"] = self._accepts(before, after)
            sizes = " + ".join(str(phase.mesh.size - 1) for phase in after.phases)
            note = "" if accepted else ", not accepted"
            self.progress(f"mesh {sizes}: {after.duration:.6f} s, {after.status}{note}")
            if accepted:
                return after
            if after.status is Status.INTERRUPTED or deadline.over():
                break
            honest = after.status.solved and gain > 0 and not self._exceeds_grossly(before, after)
            if honest and (dearer is None or after.cost < dearer.cost):
                dearer = after
        if dearer is not None:
            self.progress(f"{dearer.duration:.6f} s accepted: the cheaper one exceeds its limits")
            return dearer
        return before if before.status.solved else after

    def _last_gain(self) -> float:
        """Return the relative gain of the last accepted mesh; infinite for the first."""
        costs = [entry["cost"] for entry in self.history if entry.get("accepted")]
        return np.inf if len(costs) < 2 else (costs[-2] - costs[-1]) / abs(costs[-1])

    def _worst(self, solution: Solution) -> float:
        return max(float(e.max()) for e in self.excess(solution))

    def _cost_of_excess(self, before: Solution) -> float:
        """Return the relative cost that a solution may gain by excess between mesh points.

        Slowing down by the excess of a speed limit keeps that limit; limits of second derivatives
        cost less.
        """
        if not before.status.solved:
            return 0.0
        worst = self._worst(before)
        return worst if worst > self.limit_tolerance else 0.0

    def _exceeds_grossly(self, before: Solution, after: Solution) -> bool:
        """Return True if a new solution exceeds limits grossly, and more than the known one."""
        return self._worst(after) > max(GROSS, self._worst(before))

    def _accepts(self, before: Solution, after: Solution) -> bool:
        if not after.status.solved or not before.status.solved:
            return after.status.solved
        if self._exceeds_grossly(before, after):
            return False
        more = WORSE + self._cost_of_excess(before)
        return after.cost - before.cost <= more * abs(before.cost)

    def refine(
        self,
        solution: Solution,
        switching: Switching | None = None,
        *,
        worth: float = 0.0,
        most: float = np.inf,
    ) -> Solution:
        """Split intervals until no constraint exceeds its limit between mesh points.

        Intervals in which a control switches are split too, as long as a mesh lowers the cost by
        more than ``worth``, relative, on the first ``most`` meshes.
        """
        return self._refined(
            solution,
            partial(self._exceeded, switching, worth, most),
            self._split_where_exceeded,
            lambda before, after: after is not before,
            self._keeps_limits,
        )

    def sharpen(self, solution: Solution, switching: Switching, *, worth: float) -> Solution:
        """Split the intervals in which a control switches, while that lowers the cost.

        A control that is constant over the interval of a switch takes a mean value there; the
        additional cost is proportional to the square of the interval's length.
        """

        def done(rounds: _Rounds, _: list[FloatArray]) -> Status | None:
            last, cost = rounds[-1], rounds[-1].solution.cost
            gained = rounds[-2].solution.cost - cost if len(rounds) > 1 else np.inf
            worthless = gained < worth * abs(cost)
            return Status.SOLVED if worthless or not last.measure.switched else None

        return self._refined(
            solution,
            lambda _, answer: _MeshExcess([], switching(answer)),
            lambda rounds: _split_all(rounds[-1].solution, rounds[-1].measure.switches),
            lambda before, after: after.cost < before.cost,
            done,
        )

    def _refined(
        self,
        solution: Solution,
        measure: Callable[[_Rounds, Solution], _MeshExcess],
        split: Callable[[_Rounds], list[FloatArray]],
        accept: Callable[[Solution, Solution], bool],
        done: Callable[[_Rounds, list[FloatArray]], Status | None],
    ) -> Solution:
        """Return the last solution of the refinement loop, which ends by limits or by ``done``.

        A motion that may not be slowed down is the last one within its limits, if there is one.
        """

        def ended(rounds: _Rounds, meshes: list[FloatArray]) -> Status | None:
            if deadline.over() or not rounds[-1].solution.status.solved:
                return Status.TIME_LIMIT
            return Status.ROUND_LIMIT if len(rounds) > self.rounds else done(rounds, meshes)

        if deadline.over() or not solution.status.solved:
            return solution
        *_, last = refined(solution, self.finer, measure, split, accept, ended)
        if self.enough is None:
            within = [k.solution for k in last.rounds if k.measure.worst <= self.limit_tolerance]
            return within[-1] if within else last.solution
        return last.solution

    def _exceeded(
        self,
        switching: Switching | None,
        worth: float,
        most: float,
        rounds: _Rounds,
        solution: Solution,
    ) -> _MeshExcess:
        worst = self.history[-1]["excess"] = self._worst(solution)
        self.progress(f"largest excess of a limit between mesh points: {100 * worst:.3g} %")
        gained = rounds[-1].solution.cost - solution.cost if rounds else np.inf
        sharp = gained > worth * abs(solution.cost) and len(rounds) < most
        switches = switching(solution) if switching and sharp else []
        return _MeshExcess(self.excess(solution), switches, worst)

    def _split_where_exceeded(self, rounds: _Rounds) -> list[FloatArray]:
        solution, measure = rounds[-1].solution, rounds[-1].measure
        marked = [e > self.foresight * self.limit_tolerance for e in measure.excess]
        if measure.switches:
            tables = [marks.reshape(marks.shape[0], -1) for marks in marked]
            pairs = zip(tables, measure.switches, strict=True)
            marked = [marks | switch.reshape(-1, 1) for marks, switch in pairs]
        return _split_all(solution, marked)

    def _keeps_limits(self, rounds: _Rounds, _: list[FloatArray]) -> Status | None:
        """Return a reason to stop: limits kept, ``enough``, or no progress; None to continue."""
        measure = rounds[-1].measure
        within = measure.worst <= self.limit_tolerance
        if not measure.switched and (within or self._is_enough(rounds[-1].solution)):
            return Status.SOLVED
        idle = _meshes_without_progress([each.measure.worst for each in rounds])
        stubborn = idle >= self.stubborn
        return Status.NO_PROGRESS if stubborn and not within else None

    def _is_enough(self, solution: Solution) -> bool:
        return self.enough is not None and self.enough(solution)


@dataclass(frozen=True, eq=False)
class _MeshExcess:
    """Excess of the intervals over limits, and intervals in which a control switches."""

    excess: Sequence[FloatArray]
    switches: Sequence[np.ndarray]
    worst: float = 0.0

    @property
    def switched(self) -> bool:
        return any(marks.any() for marks in self.switches)


_Rounds = tuple[Round[Solution, _MeshExcess], ...]


def _meshes_without_progress(excess: Sequence[float]) -> int:
    """Return the number of meshes since the least excess was last halved."""
    least, last = np.inf, 0
    for number, worst in enumerate(excess):
        if worst < 0.5 * least:
            least, last = worst, number
    return len(excess) - 1 - last


def _split_all(solution: Solution, marked: Sequence[np.ndarray]) -> list[FloatArray]:
    return [split(phase.mesh, marks) for phase, marks in zip(solution.phases, marked, strict=True)]


def split(mesh: FloatArray, bad: np.ndarray) -> FloatArray:
    """Split marked intervals at their marked points, and halve their neighbours.

    Parameters
    ----------
    mesh : array [N+1]
    bad : array of bool [N] or [N, K]
        Marked intervals, which are halved, or K evenly spaced points of each with both ends: the
        marked part is cut out and halved. A sudden change, such as dry friction where a joint
        reverses, is enclosed much faster than by halving.
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
