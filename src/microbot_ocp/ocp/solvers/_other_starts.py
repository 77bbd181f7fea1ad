"""Whether other starts lead to a cheaper optimum than the one that was found.

A solver ends in the valley that its start lies in. Simulations with controls that are constant, or
change once, are other starts. They are compared on a coarse mesh, on which a solve takes a few
hundredths of a second, with what the answer itself becomes there, or with its own cost where it
becomes nothing there.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from microbot_ocp.ocp.diagnosis import NotFinite, check_start
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.solution import (
    Attempt,
    Progress,
    Ranges,
    Rollouts,
    Solution,
    cost_size,
    default_guess,
    starting_point,
)
from microbot_ocp.ocp.solvers._chain import run_chain, solve_on, with_cost_scale
from microbot_ocp.ocp.solvers._run import Made
from microbot_ocp.ocp.solvers._settings import SolverSettings
from microbot_ocp.ocp.transcription import Collocation, Guess, Transcription, assemble
from microbot_ocp.ocp.verification import phase_layout

COARSE = 10  # intervals a phase
WORTH = 1e-4  # of the cost: less is not looked for
ITERATIONS = 150  # of one solve
ENOUGH = 500  # iterations of all solves that an answer is compared with
AGREE = 4  # the first starts: where they all lead to the same cost no more are tried
SAME = 1e-3  # of the cost
DURATIONS = (0.6, 2.0, 0.3, 4.0)  # times the usual ones, where they are free
LEAST = 1.0  # s, that a kept solver is given
EACH = 3  # simulations of these
WAY = "from another start"


def cheaper_elsewhere(
    solution: Solution,
    transcription: Transcription,
    settings: SolverSettings,
    most: int,
    until: float,
    progress: Progress | None,
) -> tuple[Solution, list[Attempt]]:
    """The solution, or a cheaper one on its mesh that one of ``most`` other starts leads to.

    With what was tried, where something was found.
    """
    coarse = _Coarse(transcription, settings, until, progress)
    known = coarse.solved(solution)
    here = known if known.status.solved else solution
    worth = WORTH * cost_size(solution.cost, solution.cost_scale)
    found = _until_they_agree(coarse, most, here)
    least, attempts = _cheapest(found)
    if least is None or not least.cost < here.cost - worth:
        return solution, []
    meshes = [phase.mesh for phase in solution.phases]
    own = replace(settings, solver="ipopt")
    finer = solve_on(transcription, meshes, least, own, until, progress)
    if finer.status.solved and finer.cost < solution.cost - worth:
        return finer, [*attempts, *(replace(a, way=WAY) for a in finer.attempts)]
    return solution, []


def cheapest_of_starts(
    transcription: Transcription,
    settings: SolverSettings,
    most: int,
    until: float,
    progress: Progress | None,
) -> tuple[Solution | None, list[Attempt]]:
    """The cheapest answer on a coarse mesh that any of ``most`` simulations leads to."""
    return _cheapest(_answers(_Coarse(transcription, settings, until, progress), most))


def _answers(coarse: _Coarse, most: int, here: Solution | None = None) -> Iterator[Solution]:
    starts = _starts(coarse.transcription.problem, most, _ranges(here))
    for start in islice(starts, most):
        if time.perf_counter() >= coarse.until:
            break
        with contextlib.suppress(NotFinite):
            yield coarse.solved(start)


def _until_they_agree(coarse: _Coarse, most: int, here: Solution) -> Iterator[Solution]:
    """Answers until the first few cost what the given one does, or enough was tried."""
    spent, agree = 0, True
    same = SAME * cost_size(here.cost, here.cost_scale)
    for count, found in enumerate(_answers(coarse, most, here), start=1):
        yield found
        spent += sum(max(a.iterations, 0) for a in found.attempts)
        agree = agree and found.status.solved and abs(found.cost - here.cost) <= same
        if (agree and count == AGREE) or spent > ENOUGH:
            break


def _cheapest(answers: Iterable[Solution]) -> tuple[Solution | None, list[Attempt]]:
    least: Solution | None = None
    attempts: list[Attempt] = []
    for found in answers:
        attempts += [replace(a, way=WAY) for a in found.attempts]
        if found.status.solved and (least is None or found.cost < least.cost):
            least = found
    return least, attempts


def _ranges(solution: Solution | None) -> Ranges:
    """What the controls of a solution range over."""
    if solution is None:
        return {}
    return {
        phase.name: {
            control.name: (table.min(axis=0), table.max(axis=0))
            for control in phase_layout(phase).phase.controls
            for table in [phase.values[control.name].reshape(-1, control.size)]
        }
        for phase in solution.phases
    }


def _starts(
    problem: OptimalControlProblem, most: int, ranges: Ranges
) -> Iterator[dict[str, Guess]]:
    ordinary = default_guess(problem)
    simulations = Rollouts(problem, ordinary, ranges)
    found = simulations.nearest_first(steps=most > EACH) or [ordinary]
    if all(low == high for low, high in (p.duration_bounds for p in problem.phases)):
        yield from found
        return
    yield from found[: max(1, most // 2)]
    for factor in DURATIONS:
        durations = {
            p.name: float(np.clip(factor * (ordinary[p.name].duration or 1.0), *p.duration_bounds))
            for p in problem.phases
        }
        yield from simulations.nearest_first(durations, steps=True)[:EACH]


class _Coarse:
    """Solves of one coarse program, by a solver that is kept."""

    def __init__(
        self,
        transcription: Transcription,
        settings: SolverSettings,
        until: float,
        progress: Progress | None,
    ) -> None:
        if not isinstance(transcription.scheme, Collocation):
            # a simple rule has optima of its own where intervals are as long
            duration_scale = transcription.duration_scale
            transcription = Transcription(transcription.problem, duration_scale=duration_scale)
        self.transcription, self.until, self.progress = transcription, until, progress
        self.program = assemble(transcription.layouts(COARSE))
        self.made: Made = {}
        self.settings = replace(
            settings,
            solver="ipopt",
            gap=np.inf,
            max_iterations=min(settings.max_iterations, ITERATIONS),
            time_limit=max(until - time.perf_counter(), LEAST),
        )

    def solved(self, guess: dict[str, Guess] | Solution) -> Solution:
        begin = starting_point(self.program, self.transcription.problem, guess)
        check_start(self.program, begin.x)
        return run_chain(
            with_cost_scale(self.program, begin.x, self.settings),
            self.settings,
            begin,
            progress=self.progress,
            made=self.made,
            until=self.until,
        )
