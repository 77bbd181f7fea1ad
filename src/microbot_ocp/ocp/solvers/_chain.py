"""Solvers in turn until one converges, and on until its answer is as near the optimum as wanted.

The chain of "auto" is: from an earlier solution with multipliers IPOPT, warm; then IPOPT; then
fatrop. The first that converges ends it. The solution lists every attempt. The SQP method is
active-set: good for small programs and for solves from a neighbouring solution, never chosen by
itself; it clips the eigenvalues of the Hessian, and where that fails it tries once more with a
regularised one.

Solvers stop at a barrier parameter that belongs to their tolerance, whatever that costs: on a flat
problem with many limits much more than the tolerance. The gap tells how much, and the solve goes on
from there with the barrier that the wanted gap asks for. IPOPT's tolerance is of rows divided by
their slopes, too, and it moves bounds by a share of their size: what it calls solved may miss a row
or bound of the program by a thousand times the tolerance.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.outcome import Outcome, remark
from microbot_ocp._base.quiet import quiet
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.diagnosis import advice, finite_start, independent
from microbot_ocp.ocp.solution import (
    UNKNOWN,
    Attempt,
    Gap,
    Given,
    Progress,
    Solution,
    StartingPoint,
    complementarity,
    cost_size,
    gap_of,
    unpack,
)
from microbot_ocp.ocp.solvers._ldl import asks_for_ldl, without_ldl
from microbot_ocp.ocp.solvers._plugins import SETTINGS, WARM_PUSHES, SolverSettings
from microbot_ocp.ocp.solvers._run import (
    Runner,
    SolverOutcome,
    Solvers,
    arguments_of,
    first_cause,
)
from microbot_ocp.ocp.starts import cost_scale, scaled, starting_point
from microbot_ocp.ocp.transcription import AnyProblem, Meshes, Program, Transcription
from microbot_ocp.ocp.transcription.schemes import Scheme
from microbot_ocp.ocp.verification import Thresholds

UNSURE = (Status.FAILED, Status.INFEASIBLE)  # without pivots in the linear solver


def solve_on(
    transcription: Transcription,
    mesh: Meshes,
    guess: Given,
    settings: SolverSettings,
    progress: Progress | None = None,
    *,
    uneven: bool = False,
    once: bool = False,
) -> Solution:
    """Solve on a mesh from a guess, by the solvers of the settings in turn.

    With ``uneven`` a guess that is no solution is moved off what is symmetric. With ``once`` a
    solve that begins with multipliers is not repeated without where it does not converge.
    """
    start = time.perf_counter()
    program = transcription.program(mesh)
    own = getattr(transcription, "starting_point", None)
    begin = own(program, guess) if own else starting_point(program, transcription.problem, guess)
    uneven = uneven and not isinstance(guess, Solution)
    try:
        with quiet():
            begin = replace(begin, x=finite_start(program, begin.x, uneven=uneven))
            redundant: Sequence[str] = ()
            if not own:
                program = with_cost_scale(program, begin.x, settings)
                program, redundant = independent(program, begin.x, settings.tolerance)
    except RuntimeError as problem:
        return not_started(program, settings, begin, problem)
    spent = time.perf_counter() - start
    if own:
        barrier = warm_barrier(settings, program, begin)
        settings = transcription.solver_settings(program, settings, barrier)  # pyright: ignore
    how: dict[str, Any] = {"progress": progress, "build_time": spent, "once": once}
    solution = run_chain(program, settings, begin, **how)
    return solution.remarked(f"Left out: {'; '.join(redundant)}." if redundant else "")


def not_started(
    program: Program, settings: SolverSettings, start: StartingPoint, problem: RuntimeError
) -> Solution:
    """Return what there is where a function, such as an integrator, has no answer at the start."""
    sentence = f"A function of the problem has no answer at the guess: {first_cause(problem)}"
    failed = Attempt(settings.chain()[0], Status.FAILED, sentence, 0, np.inf, np.inf, 0.0, 0.0, 0.0)
    return Solution(
        status=Status.FAILED,
        cost=np.inf,
        phases=unpack(program.layouts, start.x),
        attempts=(replace(failed, broke_down=True),),
        row_multipliers=np.zeros(program.row_lower.size),
        build_time=0.0,
        variable_multipliers=np.zeros(start.x.size),
        variables=start.x,
        settings=settings.as_dict(),
        start=start,
        rows=Outcome.of(Status.FAILED).and_(remark(sentence)).advice,
    )


@dataclass(frozen=True, eq=False)
class SolveContext:
    """How a transcription is solved.

    Attributes
    ----------
    transcription, settings : of every solve
    progress : called at every iteration
    """

    transcription: Transcription
    settings: SolverSettings
    progress: Progress | None = None

    @property
    def over(self) -> bool:
        """Whether the time is over."""
        return deadline.over()

    def solve(
        self, mesh: Meshes, guess: Given, *, uneven: bool = False, **settings: Any
    ) -> Solution:
        """Return one solve, with other settings where these are given."""
        changed = replace(self.settings, **settings)
        return solve_on(self.transcription, mesh, guess, changed, self.progress, uneven=uneven)


def transcribed(
    problem: AnyProblem,
    settings: SolverSettings,
    *,
    scheme: str | Scheme = "radau",
    guess: Given = None,
) -> Transcription:
    """Return a transcription as it is, or that of a problem, with the scales that the settings
    want.
    """
    if isinstance(problem, Transcription):
        return problem
    scaled_problem = scaled(problem, guess) if settings.scaling == "auto" else problem
    return Transcription(scaled_problem, scheme=scheme)


def with_cost_scale(program: Program, x: FloatArray, settings: SolverSettings) -> Program:
    """Return the program with the scale of its cost that the settings want, seen from a start."""
    if settings.scaling == "declared":
        return program
    return replace(program, cost_scale=cost_scale(program, x))


def run_chain(
    program: Program,
    settings: SolverSettings,
    start: StartingPoint,
    *,
    progress: Progress | None = None,
    build_time: float = 0.0,
    solvers: Solvers | None = None,
    once: bool = False,
) -> Solution:
    """Try the solvers of the settings in turn until one converges; with ``once`` the first alone
    where that begins with multipliers.

    ``solvers`` keeps them for further solves of the same program.
    """
    with deadline.within(settings.time_limit):
        runner = Runner(program, settings, progress, solvers)
        outcome, attempts = _in_turn(runner, start, once)
        outcome, gap, further = tightened(runner, outcome)
    attempts += further
    ended = [*(a for a in attempts if a is not outcome.attempt), outcome.attempt]
    point, problem = outcome.point, program.layouts[0].phase.problem
    return Solution(
        status=outcome.attempt.status,
        cost=outcome.attempt.cost,
        phases=unpack(program.layouts, point.x),
        attempts=tuple(attempts),
        row_multipliers=point.multipliers[0],
        build_time=build_time,
        variable_multipliers=point.multipliers[1],
        variables=point.x,
        settings=settings.as_dict(),
        cost_scale=program.cost_scale,
        gap=gap,
        start=start,
        rows=advice(program, start, point.x, ended),
        maximize=problem is not None and problem.maximize,
    )


def _in_turn(
    runner: Runner, start: StartingPoint, once: bool
) -> tuple[SolverOutcome, list[Attempt]]:
    """Return what the first solver that converges leaves, or the one that says most."""
    settings = runner.settings
    turns = [(name, False) for name in settings.chain()]
    if settings.solver == "sqp":
        turns.append(("sqp", True))
    if begins_warm(settings, start):
        turns = [("ipopt", True), *([] if once else turns)]
    attempts: list[Attempt] = []
    outcome: SolverOutcome | None = None
    for name, variant in turns:
        given = start if variant or name == "sqp" else StartingPoint(start.x)
        tried = runner.run(name, given, variant=variant)
        attempts.append(tried.attempt)
        if name == "ipopt" and tried.attempt.status in UNSURE and asks_for_ldl(settings.options):
            usual = replace(settings, options=without_ldl(settings.options))
            tried = replace(runner, settings=usual, solvers=None).run(name, given, variant=variant)
            attempts.append(tried.attempt)
        status = tried.attempt.status
        # what one solver finds infeasible is not less so where the next one breaks down
        if outcome is None or _rank(status) <= _rank(outcome.attempt.status):
            outcome = tried
        if deadline.over() or status in (Status.SOLVED, Status.INTERRUPTED):
            break
    assert outcome is not None
    return outcome, attempts


def begins_warm(settings: SolverSettings, start: StartingPoint) -> bool:
    """Return whether IPOPT begins, from the multipliers of a start."""
    return start.warm and settings.initial_barrier is None and settings.solver in ("auto", "ipopt")


def warm_barrier(settings: SolverSettings, program: Program, start: StartingPoint) -> float | None:
    """Return the power of ten below the complementarity of a start with multipliers; None where
    the settings say with which barrier parameter it begins, or there are no multipliers.

    From a smaller barrier parameter steps to limits that were moved are short, from a larger
    one much of what is known is lost.
    """
    is_given = "mu_init" in settings.options.get("ipopt", {})
    if is_given or not begins_warm(settings, start):
        return None
    data = arguments_of(program, start)
    multipliers = np.concatenate([data["lam_x0"], data["lam_g0"]])
    mean = complementarity(program, start.x, program.row_values(start.x), multipliers)
    barrier = np.clip(mean, SETTINGS.warm_barrier, SETTINGS.cold_barrier)
    return float(10.0 ** np.floor(np.log10(barrier)))


def _rank(status: Status) -> int:
    """Return the lower, the more it says of a problem."""
    order = (Status.SOLVED, Status.INTERRUPTED, Status.INFEASIBLE, Status.ITERATION_LIMIT)
    return order.index(status) if status in order else len(order)


# going on until the gap is small ------------------------------------------------------------------


@dataclass(frozen=True)
class Tightening:
    """How far a barrier is lowered for a small gap.

    Attributes
    ----------
    ratio : of the wanted gap that the barrier may take
    least_barrier : parameter below which no solver gets
    """

    ratio: float = 0.5
    least_barrier: float = 1e-15


TIGHTENING = Tightening()

# Tolerance of every further solve and its options. The second moves what the first cannot: IPOPT
# exceeds bounds by 1e-8 of their size unless it is told not to, which takes a larger barrier.
# Of an optimum of zero as much slope, or as much beyond a bound, as these let every variable keep
# is more than the wanted gap in sum: the third lets each keep its share of that.
FURTHER: tuple[tuple[float, dict[str, float]], ...] = (
    (1e-8, {}),
    (1e-10, {"bound_relax_factor": 1e-10, "mu_init": 1e-6}),
    (0.0, {}),
)


def gap_at(program: Program, outcome: SolverOutcome) -> Gap:
    """Return the gap of what a solver left; not a number where it is none."""
    x, lam_g, lam_x = outcome.point.x, *outcome.point.multipliers
    if not all(np.isfinite(k).all() for k in (x, lam_g, lam_x)):
        return UNKNOWN
    slope, rows = program.stationarity(x, lam_g)
    return gap_of(program, x, rows, slope + lam_x, np.concatenate([lam_x, lam_g]))


def wanted_gap(program: Program, settings: SolverSettings, cost: float) -> float:
    """Return the gap that the settings allow, in the unit of the cost."""
    return settings.gap * cost_size(cost, program.cost_scale)


def tightened(runner: Runner, outcome: SolverOutcome) -> tuple[SolverOutcome, Gap, list[Attempt]]:
    """Return an outcome as near its optimum as wanted, its gap, and the further attempts that it
    took.

    What did not converge stays as it is. Where the gap stays larger than wanted, that is the status
    of the last attempt. Where no gap is wanted no more is done.
    """
    if outcome.attempt.status is not Status.SOLVED:
        return outcome, UNKNOWN, []
    program, settings = runner.program, runner.settings
    best, gap = outcome, gap_at(program, outcome)
    attempts: list[Attempt] = []
    wanted = wanted_gap(program, settings, best.attempt.cost)
    for tolerance, options in FURTHER:
        near = not gap.total > wanted and (wanted == np.inf or _keeps_all(best))
        if near or deadline.over():
            break
        tried = _further(runner, best, min(wanted, gap.slack), wanted, tolerance, options)
        attempts.append(tried.attempt)
        if tried.attempt.status is Status.INTERRUPTED:
            return tried, UNKNOWN, attempts
        gap_there = gap_at(program, tried)
        nearer = gap_there.total < gap.total or (gap_there.total <= wanted and not _keeps_all(best))
        allowed = max(settings.tolerance, best.attempt.infeasibility)
        if nearer and tried.attempt.infeasibility <= allowed:
            best = replace(tried, attempt=replace(tried.attempt, status=Status.SOLVED))
            gap, attempts[-1] = gap_there, best.attempt
        wanted = wanted_gap(program, settings, best.attempt.cost)
    if not gap.total <= wanted:
        message = f"at most {gap.total:.2g} above the optimum, {wanted:.2g} is wanted"
        left = replace(
            best.attempt, status=Status.GAP_LEFT, message=message, iterations=0, wall_time=0.0
        )
        return replace(best, attempt=left), gap, [*attempts, left]
    return best, gap, attempts


def _keeps_all(outcome: SolverOutcome) -> bool:
    """Return whether rows and bounds are kept to what passes."""
    return outcome.attempt.infeasibility <= Thresholds().feasibility


def _further(
    runner: Runner,
    before: SolverOutcome,
    slack: float,
    wanted: float,
    tolerance: float,
    options: Mapping[str, Any],
) -> SolverOutcome:
    program, settings = runner.program, runner.settings
    ranges = program.lower < program.upper
    count = sum(int(np.sum(np.isfinite(k) & ranges)) for k in (program.lower, program.upper))
    barrier = max(
        TIGHTENING.ratio * slack / program.cost_scale / max(count, 1), TIGHTENING.least_barrier
    )
    share = wanted / program.cost_scale / before.point.x.size
    relaxed = {} if tolerance else {"bound_relax_factor": share}
    closer: dict[str, Any] = {
        "compl_inf_tol": barrier,
        "constr_viol_tol": settings.tolerance,
        "mu_init": barrier,
        **dict.fromkeys(WARM_PUSHES, 1e-16),
        **options,
        **relaxed,
        **settings.options.get("ipopt", {}),
    }
    finer = replace(
        settings,
        solver="ipopt",
        tolerance=min(settings.tolerance, tolerance or share),
        initial_barrier=None,
        options={**settings.options, "ipopt": closer},
    )
    # not kept for other solves: it has the barrier of this one
    return replace(runner, settings=finer, solvers=None).run("ipopt", before.point, variant=True)
