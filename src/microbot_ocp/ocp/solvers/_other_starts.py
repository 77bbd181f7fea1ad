"""Whether other starts lead to a cheaper optimum than the one that was found.

A solver ends in the valley that its start lies in. Simulations with controls that are constant, or
change once, are other starts. They are compared on a coarse mesh, on which a solve takes a few
hundredths of a second, with what the answer itself becomes there, or with its own cost where it
becomes nothing there. Where the first few agree that is all. Where they end in optima of nearly the
same cost, more are tried, at random, and the best are solved on the mesh of the answer, for a
coarse one does not tell which is the least.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable, Iterator, Mapping
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
from microbot_ocp.ocp.transcription import (
    Collocation,
    Guess,
    GuessValue,
    Transcription,
    assemble,
    guess_table,
)
from microbot_ocp.ocp.verification import phase_layout

COARSE = 10  # intervals a phase
MESHES = (5, 15)  # others on which the guess is solved: it may end in another valley there
WORTH = 1e-4  # of the cost: less is not looked for
NEAR = 1e-2  # of the cost: optima as near on a coarse mesh may change places on a fine one
FINALISTS = 3  # of these that are solved on the mesh of the answer
RANDOM = 12  # starts more where there are such optima
ITERATIONS = 150  # of one solve
ENOUGH = 500  # iterations of all solves that an answer is compared with
ENOUGH_NEAR = 2000  # the same where there are optima of nearly the same cost
AGREE = 4  # the first starts: where they all lead to the same cost no more are tried
SAME = 1e-3  # of the cost
DURATIONS = (0.6, 2.0, 0.3, 4.0)  # times the usual ones, where they are free
LEAST = 1.0  # s, that a kept solver is given
EACH = 3  # simulations of these
WAY = "from another start"
Given = Mapping[str, Guess] | Solution | str | None


def cheaper_elsewhere(
    solution: Solution,
    transcription: Transcription,
    settings: SolverSettings,
    most: int,
    until: float,
    progress: Progress | None,
    guess: Given = None,
) -> tuple[Solution, list[Attempt]]:
    """The solution, or the cheapest on its mesh that one of ``most`` other starts leads to.

    With what was tried, where something was found; its ``rivals`` are the other optima. ``guess``
    is what the solution was found from.
    """
    coarse = _Coarse(transcription, settings, until, progress)
    known = coarse.solved(solution)
    here = known if known.status.solved else solution
    size = cost_size(solution.cost, solution.cost_scale)
    found = [k for k in _until_they_agree(coarse, most, here, guess) if k.status.solved]
    others = _distinct(found, here, WORTH * size)
    near = [k for k in others if abs(k.cost - here.cost) <= NEAR * size]
    finalists = [k for k in others if k.cost < here.cost - WORTH * size][:1]
    finalists += [k for k in near if k not in finalists]
    best, attempts = solution, []
    own = replace(settings, solver="ipopt")
    meshes = [phase.mesh for phase in solution.phases]
    for start in finalists[:FINALISTS]:
        if time.perf_counter() >= until:
            break
        finer = solve_on(transcription, meshes, start, own, until, progress)
        if finer.status.solved and finer.cost < best.cost - WORTH * size:
            best = finer
            attempts = [replace(a, way=WAY) for k in (start, finer) for a in k.attempts]
    least = min([here.cost, *(k.cost for k in others)])
    rivals = (
        tuple((k.cost - least) / size for k in (here, *others)) if near and here is known else ()
    )
    return replace(best, rivals=tuple(sorted(rivals))), attempts


def _distinct(found: list[Solution], here: Solution, worth: float) -> list[Solution]:
    """Solutions of other costs than ``here`` and each other, the cheapest first."""
    kept = [here]
    for one in sorted(found, key=lambda k: k.cost):
        if all(abs(one.cost - k.cost) > worth for k in kept):
            kept.append(one)
    return kept[1:]


def on_any_mesh(guess: Given, problem: OptimalControlProblem) -> Given:
    """A guess whose tables over the points of a mesh are functions, as if these were even."""
    if not isinstance(guess, Mapping):
        return guess
    sizes = {p.name: {v.name: v.size for v in p.variables} for p in problem.phases}
    return {
        name: replace(
            own, values={k: _as_function(v, sizes[name].get(k, 1)) for k, v in own.values.items()}
        )
        for name, own in guess.items()
    }


def _as_function(value: GuessValue, size: int) -> GuessValue:
    if callable(value) or np.ndim(value) == 0:
        return value
    table = guess_table(value, size, np.zeros(1))
    table = table.reshape(-1, table.shape[-1])
    places = np.linspace(0.0, 1.0, table.shape[0])
    return lambda s: np.column_stack([np.interp(s, places, column) for column in table.T])


def cheapest_of_starts(
    transcription: Transcription,
    settings: SolverSettings,
    most: int,
    until: float,
    progress: Progress | None,
) -> tuple[Solution | None, list[Attempt]]:
    """The cheapest answer on a coarse mesh that any of ``most`` simulations leads to."""
    return _cheapest(_answers(_Coarse(transcription, settings, until, progress), most))


def _answers(
    coarse: _Coarse, most: int, here: Solution | None = None, guess: Given = None
) -> Iterator[Solution]:
    if here is not None and most > EACH:
        own, guess = coarse.settings, on_any_mesh(guess, coarse.transcription.problem)
        for intervals in MESHES:
            with contextlib.suppress(NotFinite):
                made = solve_on(
                    coarse.transcription, intervals, guess, own, coarse.until, coarse.progress
                )
                yield coarse.solved(made) if made.status.solved else made
    starts = _starts(coarse.transcription.problem, most, _ranges(here))
    yield from _solved(coarse, islice(starts, most))


def _solved(coarse: _Coarse, starts: Iterable[dict[str, Guess]]) -> Iterator[Solution]:
    for start in starts:
        if time.perf_counter() >= coarse.until:
            break
        with contextlib.suppress(NotFinite):
            yield coarse.solved(start)


def _iterations(solution: Solution) -> int:
    return sum(max(a.iterations, 0) for a in solution.attempts)


def _until_they_agree(
    coarse: _Coarse, most: int, here: Solution, guess: Given
) -> Iterator[Solution]:
    """Answers until the first few cost what the given one does, or enough was tried."""
    spent, agree, several = 0, True, False
    size = cost_size(here.cost, here.cost_scale)
    for count, found in enumerate(_answers(coarse, most, here, guess), start=1):
        yield found
        spent += _iterations(found)
        off = abs(found.cost - here.cost) / size if found.status.solved else np.inf
        agree = agree and off <= SAME
        several = several or WORTH < off <= NEAR
        if (agree and count == AGREE) or spent > (ENOUGH_NEAR if several else ENOUGH):
            return
    if not several or most < RANDOM:
        return
    simulations = Rollouts(coarse.transcription.problem, *_usual(coarse, here))
    for found in _solved(coarse, simulations.random(RANDOM)):
        yield found
        spent += _iterations(found)
        if spent > ENOUGH_NEAR:
            return


def _usual(coarse: _Coarse, here: Solution) -> tuple[dict[str, Guess], Ranges]:
    """The usual guess with the durations of an answer, and what its controls range over."""
    usual = default_guess(coarse.transcription.problem)
    durations = {phase.name: phase.duration for phase in here.phases}
    return {k: replace(g, duration=durations[k]) for k, g in usual.items()}, _ranges(here)


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
