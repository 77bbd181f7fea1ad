"""Search for a cheaper optimum from other starts.

A solver converges to a local optimum near its start. Further starts are simulations with controls
that are constant or change once. If many starts are wanted, random smooth curves are tried as well,
which are far more successful for chaotic motions. All starts are solved on a coarse mesh, where a
solve takes a few hundredths of a second, and so is the solution, for comparison; if its own coarse
solve fails, the cost of the solution is compared. The coarse mesh is fine enough that the solution
costs about the same there. The search ends when enough starts have reached the cheapest optimum, or
at a limit of iterations, which is lower while all starts agree. The cheapest few optima are solved
on the mesh of the solution, since a coarse mesh does not decide which of them is best.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import cycle, islice, zip_longest

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.diagnosis import NotFinite, finite_start
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.refinement import BARRIER_NEAR_BOUNDS, PASSING, named
from microbot_ocp.ocp.solution import (
    AGREEING_STARTS,
    Attempt,
    Given,
    Solution,
    StartingPoint,
    cost_size,
)
from microbot_ocp.ocp.solvers import SolveContext, Solvers, run_chain, with_cost_scale
from microbot_ocp.ocp.starts import (
    NEGLIGIBLE,
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
    sampled,
)

# Relative differences of cost.
LEAST_SAVING = PASSING.cost  # smaller savings are within the error of a converged cost
SAME = 1e-3  # costs that count as equal on a coarse mesh
NEAR = 1e-2  # optima that may change order on a fine mesh
ABOUT_EQUAL = 0.05  # cost on a coarse mesh that is fine enough for a comparison

MOST_FINALISTS = 3  # optima that are solved on the mesh of the solution
SIMULATIONS_EACH = 3  # simulations for each of DURATION_FACTORS
MOST_CURVES = 24  # random curves, tried if many starts are wanted

WAY = "from another start"
CUT_SHORT = "It was not compared with all other starts for want of time."
Pair = tuple[FloatArray, FloatArray]


def cheapest_of_starts(context: SolveContext, most: int) -> tuple[Solution | None, list[Attempt]]:
    """Return the cheapest solution on a coarse mesh from up to ``most`` simulations."""
    coarse = _CoarseSolver(context)
    answers = list(_solved(coarse, islice(_starts(coarse, most), most)))
    attempts = named(WAY, [a for answer in answers for a in answer.attempts])
    solved = (answer for answer in answers if answer.solved)
    return min(solved, key=lambda answer: answer.cost, default=None), attempts


def cheaper_elsewhere(
    solution: Solution, context: SolveContext, most: int, guess: Given = None
) -> tuple[Solution, list[Attempt]]:
    """Return the solution, or a cheaper one on its mesh from one of ``most`` other starts.

    The attempts are empty unless a cheaper one is found. ``rivals`` of the result are the relative
    extra costs of all optima, if they compete. ``guess`` is the guess of the solution.
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
    others = _distinct(answers, here, LEAST_SAVING * size)
    # The coarse mesh does not order optima nearer than NEAR: the mesh of the solution decides.
    near = [k for k in others if abs(k.cost - here.cost) <= NEAR * size]
    finalists = [k for k in others if k.cost < here.cost - LEAST_SAVING * size]
    finalists += [k for k in near if k not in finalists]
    best, attempts = _cheapest_finalist(solution, finalists, context, LEAST_SAVING * size)
    least = min([here.cost, *(k.cost for k in others)])
    met = sum(k.cost - least <= SAME * size for k in (here, *answers))
    # An optimum that only few starts reach may not be the least: the others count as rivals.
    several = here is comparable and (near or (others and met <= ENOUGH_AGREE))
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
    """Return the cheapest of a solution and its finalists on its mesh, and the attempts."""
    best, attempts = solution, []
    meshes = [phase.mesh for phase in solution.phases]
    for start in finalists[:MOST_FINALISTS]:
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
    """Return solutions whose costs differ from ``here`` and each other, cheapest first."""
    distinct = [here]
    for one in sorted(answers, key=lambda k: k.cost):
        if all(abs(one.cost - k.cost) > worth for k in distinct):
            distinct.append(one)
    return distinct[1:]


def on_any_mesh(guess: Given, problem: OptimalControlProblem) -> Given:
    """Return a guess with functions in place of tables, whose rows count as evenly spaced."""
    if not isinstance(guess, Mapping):
        return guess
    guesses = {}
    for phase in problem.phases:
        if phase.name in guess:
            given, known = guess[phase.name], {v.name: v for v in phase.variables}
            values = {k: partial(sampled, v, known[k]) for k, v in given.values.items()}
            guesses[phase.name] = replace(given, values=values)
    return guesses


def _solved(coarse: _CoarseSolver, starts: Iterable[dict[str, Guess]]) -> Iterator[Solution]:
    for start in starts:
        if coarse.context.over:
            break
        with contextlib.suppress(NotFinite):
            yield coarse.solved(start)


GUESS_MESHES = (5, 15)  # intervals of further meshes on which the guess may lead to other optima


def _answers(
    coarse: _CoarseSolver, most: int, here: Solution, guess: Given
) -> Iterator[tuple[Solution, bool]]:
    """Yield answers from the guess on other meshes, simulations, and curves if many are wanted.

    The second value is False while simulations are still to come. Simulations and curves alternate;
    the kind that leads to optima more often is used more often.
    """
    problem = coarse.context.transcription.problem
    simulated = _solved(coarse, islice(_starts(coarse, most, here), most))
    if most <= SIMULATIONS_EACH + 1:
        yield from ((answer, True) for answer in simulated)
        return
    guess = on_any_mesh(guess, problem)
    # The default barrier may outweigh a flat cost and let variables diverge: use a small one first.
    for intervals, barrier in zip(GUESS_MESHES, (BARRIER_NEAR_BOUNDS, None), strict=True):
        with contextlib.suppress(NotFinite):
            mesh = per_phase(problem, intervals)
            elsewhere = coarse.context.solve(mesh, guess, initial_barrier=barrier)
            yield (coarse.solved(elsewhere) if elsewhere.status.solved else elsewhere), False
    curves = islice(_curves(problem, here, driving_ranges(problem, here)), MOST_CURVES)
    kinds = {True: simulated, False: _solved(coarse, curves)}
    solved, tried = dict.fromkeys(kinds, 0), dict.fromkeys(kinds, 0)
    while kinds:
        # Two kinds whose starts all succeed alternate. A kind whose starts all fail gets about
        # sqrt(n) tries while the other, if it succeeds, gets n.
        kind = max(kinds, key=lambda k: (solved[k] + 1) / (tried[k] + 1) ** 2)
        answer = next(kinds[kind], None)
        if answer is None:
            del kinds[kind]
            continue
        solved[kind] += answer.solved
        tried[kind] += 1
        yield answer, kind or True not in kinds


ENOUGH_AGREE = 8  # starts with the least cost after which the comparison ends
# Simulations before the comparison may end, if there are as many: curves stay near the solution.
LEAST_SIMULATIONS = 5
# Total iterations after which the comparison ends in any case.
ENOUGH = 500  # if all starts so far lead to one cost
ENOUGH_DIFFERENT = 2000  # if there are different optima
ENOUGH_ALONE = 3000  # if no other start led to the least cost


def _until_they_agree(
    coarse: _CoarseSolver, most: int, here: Solution, guess: Given
) -> Iterator[Solution]:
    """Yield answers until enough of them have the least cost, or the iterations are used up."""
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
        met = int(np.sum(off <= SAME))
        enough = ENOUGH
        if met < AGREEING_STARTS:
            enough = ENOUGH_ALONE
        elif np.any(off > LEAST_SAVING):
            enough = ENOUGH_DIFFERENT
        if (met > ENOUGH_AGREE and simulations >= LEAST_SIMULATIONS) or spent > enough:
            return


HEIGHTS = (0.6, 0.1)  # standard deviations of the curves in turn, relative to the range of a state
HALF_WAVES = 3  # largest number of half waves of a curve
STRETCH = 0.3  # standard deviation of the logarithm of a random duration
PUSH = 0.2  # fraction of the way from the usual controls to random ones


def _curves(
    problem: OptimalControlProblem, here: Solution, ranges: Ranges
) -> Iterator[dict[str, Guess]]:
    """Yield smooth random curves of the states around a solution; free ends move as well."""
    usual, draw, draw_ends = (
        default_guess(problem),
        np.random.default_rng(0),
        np.random.default_rng(1),
    )
    parameters = _parameters(problem, ranges)
    for share in cycle(HEIGHTS):
        guesses = {}
        drawn = next(parameters)
        for phase, solved in zip(problem.phases, here.phases, strict=True):
            ordinary = usual[phase.name]
            duration = solved.duration * float(np.exp(STRETCH * draw.standard_normal()))
            values: dict[str, GuessValue] = dict(ordinary.values)
            for state in phase.states:
                table = solved.values[state.name].reshape(-1, state.size)
                least, size = NEGLIGIBLE * state.scale, np.abs(table).max(axis=0)
                size = np.where(size > least, size, state.scale)
                reached = np.ptp(table, axis=0)
                height = share * np.where(reached > least, reached, size)
                waves = height * draw.standard_normal((HALF_WAVES, state.size))
                free = np.array([[side is None] for side in (state.initial, state.final)])
                moved = 2 * share * size * draw_ends.standard_normal((2, state.size)) * free
                ends, bounds = table[[0, -1]] + moved, (state.lower, state.upper)
                values[state.name] = partial(_curve, tuple(ends), waves, bounds)
            for control in phase.controls:
                low, high = ranges[phase.name][control.name]
                usually = np.clip(0.0, low, high)
                pushed = low + (high - low) * draw.random(low.size)
                values[control.name] = (1 - PUSH) * usually + PUSH * pushed
            values |= {v.name: drawn[v.name] for v in phase.free_parameters if v.name in drawn}
            guesses[phase.name] = Guess(float(np.clip(duration, *phase.duration_bounds)), values)
        yield guesses


def _parameters(problem: OptimalControlProblem, ranges: Ranges) -> Iterator[dict[str, FloatArray]]:
    """Yield free parameters that are spread over their bounds or ranges by Latin hypercubes."""
    known = {name: pair for of_phase in ranges.values() for name, pair in of_phase.items()}
    pairs = {p.name: within(p, known) for p in problem.free_parameters if p.name in known}
    draw, count = np.random.default_rng(0), MOST_CURVES
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
    """Return a straight line plus sines, clipped to bounds [N, size]."""
    (first, last), share = ends, np.asarray(s)[:, None]
    sines = np.sin(np.pi * share * np.arange(1, HALF_WAVES + 1))
    return np.clip(first + (last - first) * share + sines @ waves, *bounds)


DURATION_FACTORS = (0.6, 2.0, 0.3, 4.0)  # simulated durations relative to the usual ones


def _starts(
    coarse: _CoarseSolver, most: int, here: Solution | None = None
) -> Iterator[dict[str, Guess]]:
    """Yield simulations; those that violate end conditions least come early.

    With a solution, controls cover its ranges and their corners, and cost decides between ties.
    """
    problem = coarse.context.transcription.problem
    ordinary = default_guess(problem)
    ranges = None if here is None else driving_ranges(problem, here)
    cost = None if here is None else coarse.cost
    simulations = Rollouts(problem, ordinary, ranges)
    nearest = simulations.nearest_first(steps=most > SIMULATIONS_EACH, cost=cost) or [ordinary]
    corners = [] if here is None else simulations.corners(cost)
    nearest = [one for pair in zip_longest(nearest, corners) for one in pair if one is not None]
    if all(low == high for low, high in (p.duration_bounds for p in problem.phases)):
        yield from nearest
        return
    # Half of the starts have the usual durations; the loop below yields the others.
    yield from nearest[: max(1, most // 2)]
    for factor in DURATION_FACTORS:
        durations = {
            p.name: float(np.clip(factor * (ordinary[p.name].duration or 1.0), *p.duration_bounds))
            for p in problem.phases
        }
        yield from simulations.nearest_first(durations, steps=True)[:SIMULATIONS_EACH]


COARSE_MESHES = (10, 20, 40)  # intervals per phase of the meshes of a comparison
FEWEST_INTERVALS = 3  # per phase of a problem with many phases
MOST_ITERATIONS = 100  # iteration limit of one solve
LEAST_TIME = 1.0  # least time limit of a cached solver, s


def _comparable(solution: Solution, context: SolveContext) -> tuple[_CoarseSolver, Solution]:
    """Return the coarsest solver with about the cost of the solution, and its answer."""
    size = cost_size(solution.cost, solution.cost_scale)
    fewest = min(phase.mesh.size - 1 for phase in solution.phases)
    for intervals in COARSE_MESHES:
        intervals = per_phase(context.transcription.problem, intervals)
        coarse = _CoarseSolver(context, intervals)
        answer = coarse.solved(solution)
        about = abs(answer.cost - solution.cost) <= ABOUT_EQUAL * size
        # The next mesh has twice the intervals: it would be finer than that of the solution.
        if (answer.status.solved and about) or 2 * intervals > fewest:
            break
    return coarse, answer


def per_phase(
    problem: OptimalControlProblem, intervals: int, fewest: int = FEWEST_INTERVALS
) -> int:
    """Return the intervals per phase, fewer for more than two phases."""
    return max(fewest, round(2 * intervals / max(len(problem.phases), 2)))


class _CoarseSolver:
    """Solver of one coarse program; the CasADi solver is cached."""

    def __init__(self, context: SolveContext, intervals: int = COARSE_MESHES[0]) -> None:
        transcription = context.transcription
        if not isinstance(transcription.scheme, Collocation):
            # A scheme of low order may have false optima on long intervals: use collocation.
            duration_scale = transcription.duration_scale
            transcription = Transcription(transcription.problem, duration_scale=duration_scale)
        self.program = transcription.program(intervals)
        self.solvers: Solvers = {}
        # The cached solver keeps its time limit; the deadline ends the loop over the starts.
        settings = replace(
            context.settings,
            solver="ipopt",
            gap=np.inf,
            max_iterations=min(context.settings.max_iterations, MOST_ITERATIONS),
            time_limit=max(deadline.left(), LEAST_TIME),
        )
        self.context = replace(context, transcription=transcription, settings=settings)

    def start(self, guess: dict[str, Guess] | Solution) -> StartingPoint:
        """Return the starting point of a guess."""
        return starting_point(self.program, self.context.transcription.problem, guess)

    def cost(self, guess: dict[str, Guess]) -> float:
        """Return the cost of a guess itself; infinite if it is not finite."""
        cost = self.program.cost(self.start(guess).x)
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
