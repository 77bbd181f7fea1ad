"""Whether other starts lead to a cheaper optimum than the one that was found.

A solver ends in the valley that its start lies in. Simulations with controls that are constant, or
change once, are other starts. They are compared on a coarse mesh, on which a solve takes a few
hundredths of a second, with what the answer itself becomes there, or with its own cost where it
becomes nothing there; the mesh is so fine that the answer costs about the same on it. Where the
first few agree that is all. Where they end in different optima, more are tried: smooth curves at
random, which where motion is chaotic lead to an optimum far more often.
That ends when the cheapest was met as often as the first few. The cheapest are solved on the mesh
of the answer, for a coarse one does not tell which is the least.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle, islice, zip_longest

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.diagnosis import NotFinite, finite_start
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.refinement import IMPROVEMENT, named
from microbot_ocp.ocp.solution import RIVALS, Attempt, Solution, StartingPoint, cost_size
from microbot_ocp.ocp.solvers import SolveContext, Solvers, run_chain, with_cost_scale
from microbot_ocp.ocp.starts import (
    Ranges,
    Rollouts,
    default_guess,
    driving_ranges,
    starting_point,
    within,
)
from microbot_ocp.ocp.transcription import (
    Collocation,
    Guess,
    GuessValue,
    Transcription,
    guess_table,
)


@dataclass(frozen=True)
class StartComparison:
    """How an answer is compared with what other starts lead to.

    Attributes
    ----------
    coarse : intervals a phase of meshes of comparison; the first on which the answer costs
        about the same is used
    fewest : of every phase of a problem of many
    about : share of the cost that is about the same
    meshes : intervals of others on which the guess is solved: it may end in another valley
        there
    worth : share of the cost: less is not looked for
    near : share of the cost: optima as near on a coarse mesh may change places on a fine one
    finalists : of these that are solved on the mesh of the answer
    random : curves where there are different optima
    waves : half waves of a random curve, at most
    heights : standard deviations of them, in turn, times what a state ranges over
    push : share of the way from the usual controls to random ones on such a curve
    stretch : standard deviation of the logarithm of a random duration
    iterations : of one solve
    enough : iterations of all solves that an answer is compared with
    enough_different : the same where there are different optima
    enough_alone : the same where only one start led to the least, or to any
    agree : starts that led to the least cost: where as many did no more are tried
    simulated : simulations that are tried before that counts: curves are near what is known
    same : share of the cost that is no difference
    durations : times the usual ones, where they are free
    least_time : s, that a kept solver is given
    each : simulations of each of these durations
    """

    coarse: tuple[int, ...] = (10, 20, 40)
    fewest: int = 3
    about: float = 0.05
    meshes: tuple[int, ...] = (5, 15)
    worth: float = 1e-4
    near: float = 1e-2
    finalists: int = 3
    random: int = 24
    waves: int = 3
    heights: tuple[float, ...] = (0.6, 0.1)
    push: float = 0.2
    stretch: float = 0.3
    iterations: int = 100
    enough: int = 500
    enough_different: int = 2000
    enough_alone: int = 3000
    agree: int = 8
    simulated: int = 5
    same: float = 1e-3
    durations: tuple[float, ...] = (0.6, 2.0, 0.3, 4.0)
    least_time: float = 1.0
    each: int = 3


COMPARISON = StartComparison()

WAY = "from another start"
CUT_SHORT = "It was not compared with all other starts for want of time."
Given = Mapping[str, Guess] | Solution | str | None
Pair = tuple[FloatArray, FloatArray]


def cheapest_of_starts(context: SolveContext, most: int) -> tuple[Solution | None, list[Attempt]]:
    """Return the cheapest answer on a coarse mesh that any of ``most`` simulations leads to."""
    coarse = _Coarse(context)
    answers = list(_solved(coarse, islice(_starts(coarse, most), most)))
    attempts = named(WAY, [a for answer in answers for a in answer.attempts])
    solved = (answer for answer in answers if answer.solved)
    return min(solved, key=lambda answer: answer.cost, default=None), attempts


def cheaper_elsewhere(
    solution: Solution, context: SolveContext, most: int, guess: Given = None
) -> tuple[Solution, list[Attempt]]:
    """Return the solution, or the cheapest on its mesh that one of ``most`` other starts leads to.

    With what was tried, where something was found; its ``rivals`` are the other optima. ``guess``
    is what the solution was found from.
    """
    size = cost_size(solution.cost, solution.cost_scale)
    coarse, comparable = _comparable(solution, context)
    here = comparable if comparable.status.solved else solution
    answers = [comparable]
    if comparable.status is not Status.INTERRUPTED:
        answers = list(_until_they_agree(coarse, most, here, guess))
    if answers and answers[-1].status is Status.INTERRUPTED:
        return solution.ended(Status.INTERRUPTED), []
    answers = [k for k in answers if k.status.solved]
    others = _distinct(answers, here, COMPARISON.worth * size)
    near = [k for k in others if abs(k.cost - here.cost) <= COMPARISON.near * size]
    finalists = [k for k in others if k.cost < here.cost - COMPARISON.worth * size]
    finalists += [k for k in near if k not in finalists]
    best, attempts = _cheapest_finalist(solution, finalists, context, COMPARISON.worth * size)
    least = min([here.cost, *(k.cost for k in others)])
    met = sum(k.cost - least <= COMPARISON.same * size for k in (here, *answers))
    several = here is comparable and (near or (others and met <= COMPARISON.agree))
    rivals = sorted((k.cost - least) / size for k in (here, *others)) if several else ()
    best = replace(best, agreed=met, compared=len(answers))
    if best.status is Status.INTERRUPTED:
        return best, []
    if context.over:
        best = best.remarked(CUT_SHORT)
    return replace(best, rivals=tuple(rivals)), attempts


def _cheapest_finalist(
    solution: Solution, finalists: Sequence[Solution], context: SolveContext, worth: float
) -> tuple[Solution, list[Attempt]]:
    """Return the cheapest of a solution and what finalists lead to on its mesh, and how it was
    found.
    """
    best, attempts = solution, []
    meshes = [phase.mesh for phase in solution.phases]
    for start in finalists[: COMPARISON.finalists]:
        if context.over:
            break
        finer = context.solve(meshes, start, solver="ipopt")
        if finer.status is Status.INTERRUPTED:
            return solution.ended(Status.INTERRUPTED), []
        if finer.status.solved and finer.cost < best.cost - worth:
            best = finer
            attempts = named(WAY, [*start.attempts, *finer.attempts])
    return best, attempts


def _distinct(answers: list[Solution], here: Solution, worth: float) -> list[Solution]:
    """Return solutions of other costs than ``here`` and each other, the cheapest first."""
    distinct = [here]
    for one in sorted(answers, key=lambda k: k.cost):
        if all(abs(one.cost - k.cost) > worth for k in distinct):
            distinct.append(one)
    return distinct[1:]


def on_any_mesh(guess: Given, problem: OptimalControlProblem) -> Given:
    """Give a guess whose tables over the points of a mesh are functions, as if these were even."""
    if not isinstance(guess, Mapping):
        return guess
    sizes = {p.name: {v.name: v.size for v in p.variables} for p in problem.phases}
    guesses = {}
    for name, each in guess.items():
        values = {k: _as_function(v, sizes[name].get(k, 1)) for k, v in each.values.items()}
        guesses[name] = replace(each, values=values)
    return guesses


def _as_function(value: GuessValue, size: int) -> GuessValue:
    if callable(value) or np.ndim(value) == 0:
        return value
    table = guess_table(value, size, np.zeros(1))
    table = table.reshape(-1, table.shape[-1])
    places = np.linspace(0.0, 1.0, table.shape[0])
    return lambda s: np.column_stack([np.interp(s, places, column) for column in table.T])


def _solved(coarse: _Coarse, starts: Iterable[dict[str, Guess]]) -> Iterator[Solution]:
    for start in starts:
        if coarse.context.over:
            break
        with contextlib.suppress(NotFinite):
            yield coarse.solved(start)


def _answers(
    coarse: _Coarse, most: int, here: Solution, guess: Given
) -> Iterator[tuple[Solution, bool]]:
    """Yield answers from the guess on other meshes, simulations, and curves if many are wanted.

    Each with whether it is the answer of a simulation. Kinds of starts take turns; the one that
    leads to an optimum more often comes more often.
    """
    problem = coarse.context.transcription.problem
    simulated = _solved(coarse, islice(_starts(coarse, most, here), most))
    if most <= COMPARISON.each + 1:
        yield from ((answer, True) for answer in simulated)
        return
    guess = on_any_mesh(guess, problem)
    # the first barrier may outweigh a cost and leave what runs to infinity where that is flat
    for intervals, barrier in zip(COMPARISON.meshes, (IMPROVEMENT.barrier, None), strict=True):
        with contextlib.suppress(NotFinite):
            mesh = per_phase(problem, intervals)
            elsewhere = coarse.context.solve(mesh, guess, initial_barrier=barrier)
            yield (coarse.solved(elsewhere) if elsewhere.status.solved else elsewhere), False
    curves = islice(_curves(problem, here, driving_ranges(problem, here)), COMPARISON.random)
    kinds = {True: simulated, False: _solved(coarse, curves)}
    solved, tried = dict.fromkeys(kinds, 0), dict.fromkeys(kinds, 0)
    while kinds:
        kind = max(kinds, key=lambda k: (solved[k] + 1) / (tried[k] + 1) ** 2)
        answer = next(kinds[kind], None)
        if answer is None:
            del kinds[kind]
            continue
        solved[kind] += answer.solved
        tried[kind] += 1
        yield answer, kind


def _until_they_agree(
    coarse: _Coarse, most: int, here: Solution, guess: Given
) -> Iterator[Solution]:
    """Yield answers until as many as ``AGREE`` cost what the cheapest does, or enough was tried."""
    size = cost_size(here.cost, here.cost_scale)
    costs, spent, simulations = [here.cost], 0, 0
    for answer, simulated in _answers(coarse, most, here, guess):
        yield answer
        if answer.status is Status.INTERRUPTED:
            return
        spent += sum(max(a.iterations, 0) for a in answer.attempts)
        simulations += simulated
        costs += [answer.cost] if answer.status.solved else []
        off = (np.array(costs) - min(costs)) / size
        met = int(np.sum(off <= COMPARISON.same))
        enough = COMPARISON.enough
        if met < RIVALS.agreed:
            enough = COMPARISON.enough_alone
        elif np.any(off > COMPARISON.worth):
            enough = COMPARISON.enough_different
        if (met > COMPARISON.agree and simulations >= COMPARISON.simulated) or spent > enough:
            return


def _curves(
    problem: OptimalControlProblem, here: Solution, ranges: Ranges
) -> Iterator[dict[str, Guess]]:
    """Smooth random curves of the states about an answer, whose ends move where they are free."""
    usual, draw, draw_ends = (
        default_guess(problem),
        np.random.default_rng(0),
        np.random.default_rng(1),
    )
    parameters = _parameters(problem, ranges)
    for share in cycle(COMPARISON.heights):
        guesses = {}
        drawn = next(parameters)
        for phase, solved in zip(problem.phases, here.phases, strict=True):
            ordinary = usual[phase.name]
            duration = solved.duration * float(np.exp(COMPARISON.stretch * draw.standard_normal()))
            values: dict[str, GuessValue] = dict(ordinary.values)
            for state in phase.states:
                table = solved.values[state.name].reshape(-1, state.size)
                least, size = COMPARISON.worth * state.scale, np.abs(table).max(axis=0)
                size = np.where(size > least, size, state.scale)
                reached = np.ptp(table, axis=0)
                height = share * np.where(reached > least, reached, size)
                waves = height * draw.standard_normal((COMPARISON.waves, state.size))
                free = np.array([[side is None] for side in (state.initial, state.final)])
                moved = 2 * share * size * draw_ends.standard_normal((2, state.size)) * free
                ends, bounds = table[[0, -1]] + moved, (state.lower, state.upper)
                values[state.name] = partial(_curve, tuple(ends), waves, bounds)
            for control in phase.controls:
                low, high = ranges[phase.name][control.name]
                usually = np.clip(0.0, low, high)
                pushed = low + (high - low) * draw.random(low.size)
                values[control.name] = (1 - COMPARISON.push) * usually + COMPARISON.push * pushed
            values |= {v.name: drawn[v.name] for v in phase.free_parameters if v.name in drawn}
            guesses[phase.name] = Guess(float(np.clip(duration, *phase.duration_bounds)), values)
        yield guesses


def _parameters(problem: OptimalControlProblem, ranges: Ranges) -> Iterator[dict[str, FloatArray]]:
    """Free parameters, spread over their bounds, or ranges where there are none: Latin
    hypercubes.
    """
    known = {name: pair for of_phase in ranges.values() for name, pair in of_phase.items()}
    pairs = {p.name: within(p, known) for p in problem.free_parameters if p.name in known}
    draw, count = np.random.default_rng(0), COMPARISON.random
    while True:
        strata = {
            name: draw.permuted(np.tile(np.arange(count), (low.size, 1)), axis=1)
            for name, (low, _) in pairs.items()
        }
        for k in range(count):
            drawn = {}
            for name, (low, high) in pairs.items():
                share = (strata[name][:, k] + draw.random(low.size)) / count
                drawn[name] = low + share * (high - low)
            yield drawn


def _curve(ends: Pair, waves: FloatArray, bounds: Pair, s: FloatArray) -> FloatArray:
    """Return a line with sines on it, within bounds [N, size]."""
    (first, last), share = ends, np.asarray(s)[:, None]
    sines = np.sin(np.pi * share * np.arange(1, COMPARISON.waves + 1))
    return np.clip(first + (last - first) * share + sines @ waves, *bounds)


def _starts(coarse: _Coarse, most: int, here: Solution | None = None) -> Iterator[dict[str, Guess]]:
    """Return simulations, where there is an answer with the ranges of its controls and by their
    costs.
    """
    problem = coarse.context.transcription.problem
    ordinary = default_guess(problem)
    ranges = None if here is None else driving_ranges(problem, here)
    cost = None if here is None else coarse.cost
    simulations = Rollouts(problem, ordinary, ranges)
    nearest = simulations.nearest_first(steps=most > COMPARISON.each, cost=cost) or [ordinary]
    corners = [] if here is None else simulations.corners(cost)
    nearest = [one for pair in zip_longest(nearest, corners) for one in pair if one is not None]
    if all(low == high for low, high in (p.duration_bounds for p in problem.phases)):
        yield from nearest
        return
    yield from nearest[: max(1, most // 2)]
    for factor in COMPARISON.durations:
        durations = {
            p.name: float(np.clip(factor * (ordinary[p.name].duration or 1.0), *p.duration_bounds))
            for p in problem.phases
        }
        yield from simulations.nearest_first(durations, steps=True)[: COMPARISON.each]


def _comparable(solution: Solution, context: SolveContext) -> tuple[_Coarse, Solution]:
    """Give the coarsest program on which the answer costs about the same, and its answer there."""
    size = cost_size(solution.cost, solution.cost_scale)
    fewest = min(phase.mesh.size - 1 for phase in solution.phases)
    for intervals in COMPARISON.coarse:
        intervals = per_phase(context.transcription.problem, intervals)
        coarse = _Coarse(context, intervals)
        answer = coarse.solved(solution)
        about = abs(answer.cost - solution.cost) <= COMPARISON.about * size
        if (answer.status.solved and about) or 2 * intervals > fewest:
            break
    return coarse, answer


def per_phase(problem: OptimalControlProblem, intervals: int) -> int:
    """Return intervals of every phase, fewer where there are more than two."""
    return max(COMPARISON.fewest, round(2 * intervals / max(len(problem.phases), 2)))


class _Coarse:
    """Solves of one coarse program, by a solver that is kept."""

    def __init__(self, context: SolveContext, intervals: int = COMPARISON.coarse[0]) -> None:
        transcription = context.transcription
        if not isinstance(transcription.scheme, Collocation):
            # a simple rule has optima of its own where intervals are as long
            duration_scale = transcription.duration_scale
            transcription = Transcription(transcription.problem, duration_scale=duration_scale)
        self.program = transcription.program(intervals)
        self.solvers: Solvers = {}
        settings = replace(
            context.settings,
            solver="ipopt",
            gap=np.inf,
            max_iterations=min(context.settings.max_iterations, COMPARISON.iterations),
            time_limit=max(deadline.left(), COMPARISON.least_time),
        )
        self.context = replace(context, transcription=transcription, settings=settings)

    def start(self, guess: dict[str, Guess] | Solution) -> StartingPoint:
        """Return where a solve starts from a guess."""
        return starting_point(self.program, self.context.transcription.problem, guess)

    def cost(self, guess: dict[str, Guess]) -> float:
        """Return what a guess costs as it stands, or infinity."""
        x = self.start(guess).x
        cost = float(self.program.functions["gradient"](x, self.program.parameters)[0])
        return cost if np.isfinite(cost) else np.inf

    def solved(self, guess: dict[str, Guess] | Solution) -> Solution:
        begin, context = self.start(guess), self.context
        begin = replace(begin, x=finite_start(self.program, begin.x))
        return run_chain(
            with_cost_scale(self.program, begin.x, context.settings),
            context.settings,
            begin,
            progress=context.progress,
            solvers=self.solvers,
        )
