"""A chain of solvers, tried until one converges, and continued until its gap is small enough.

The chain of "auto" is: IPOPT with a warm start if an earlier solution has multipliers; IPOPT;
fatrop. The first one that converges ends the chain; the solution lists every attempt. The SQP
method is an active-set method for small programs and for solves from a neighbouring solution, and
must be chosen explicitly; it clips the eigenvalues of the Hessian, and repeats a failed solve with
a regularised Hessian.

Solvers stop at a barrier parameter given by their tolerance. On a flat problem with many limits,
this may leave a cost far above the optimum. The gap measures it, and the solve continues from
there with the barrier parameter that the wanted gap requires. In addition, IPOPT's tolerance refers
to rows divided by their gradients, and it relaxes bounds in proportion to their size: a solution
that it accepts may violate a row or bound of the program by a thousand times the tolerance.
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
from microbot_ocp.ocp.solvers._plugins import (
    COLD_BARRIER,
    LEAST_WARM_BARRIER,
    WARM_PUSHES,
    SolverSettings,
)
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

UNSURE = (Status.FAILED, Status.INFEASIBLE)  # doubtful without pivoting in the linear solver


@dataclass(frozen=True, eq=False)
class SolveContext:
    """A transcription with the settings of its solves.

    Attributes
    ----------
    transcription, settings : arguments of every solve
    progress : function called at every iteration
    """

    transcription: Transcription
    settings: SolverSettings
    progress: Progress | None = None

    @property
    def over(self) -> bool:
        """True if the time limit is reached."""
        return deadline.over()

    def solve(
        self,
        mesh: Meshes,
        guess: Given,
        *,
        uneven: bool = False,
        once: bool = False,
        aimed: bool = False,
        **changes: Any,
    ) -> Solution:
        """Solve on a mesh from a guess, with the solvers of the settings in turn.

        Parameters
        ----------
        mesh : int or array of fractions [N+1], or one per phase
        guess : guesses or Solution
        uneven : bool
            True to displace a guess that is no solution from symmetric points.
        once : bool
            True if a failed warm start is not followed by a cold start.
        aimed : bool
            True if a warm start ends at the barrier parameter of the wanted gap.
        **changes
            Settings that replace those of the context.
        """
        begin, settings, kernels = time.perf_counter(), self.settings, self.transcription
        settings = replace(settings, **changes) if changes else settings
        program = kernels.program(mesh)
        own = getattr(kernels, "starting_point", None)
        start = own(program, guess) if own else starting_point(program, kernels.problem, guess)
        uneven = uneven and not isinstance(guess, Solution)
        try:
            with quiet():
                start = replace(start, x=finite_start(program, start.x, uneven=uneven))
                redundant: Sequence[str] = ()
                if not own:
                    program = with_cost_scale(program, start.x, settings)
                    program, redundant = independent(program, start.x, settings.tolerance)
                    settings = _aimed(settings, program, start) if aimed else settings
        except RuntimeError as problem:
            return not_started(program, settings, start, problem)
        spent = time.perf_counter() - begin
        if own:
            barriers = (
                warm_barrier(settings, program, start),
                last_barrier(program, settings, start.x),
            )
            settings = kernels.solver_settings(program, settings, *barriers)  # pyright: ignore
        how: dict[str, Any] = {"progress": self.progress, "build_time": spent, "once": once}
        solution = run_chain(program, settings, start, **how)
        return solution.remarked(f"Left out: {'; '.join(redundant)}." if redundant else "")


def not_started(
    program: Program, settings: SolverSettings, start: StartingPoint, problem: RuntimeError
) -> Solution:
    """Return a failed solution if a function, such as an integrator, fails at the start."""
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


def transcribed(
    problem: AnyProblem,
    settings: SolverSettings,
    *,
    scheme: str | Scheme = "radau",
    guess: Given = None,
) -> Transcription:
    """Return a transcription unchanged, or that of a problem with the scales of the settings."""
    if isinstance(problem, Transcription):
        return problem
    scaled_problem = scaled(problem, guess) if settings.scaling == "auto" else problem
    return Transcription(scaled_problem, scheme=scheme)


def _aimed(settings: SolverSettings, program: Program, start: StartingPoint) -> SolverSettings:
    """Return settings with which a solve from multipliers ends at the barrier of the wanted gap.

    CasADi returns one multiplier for the two bounds of a variable, so a solve that is restarted to
    lower its barrier takes several times the iterations of one that continues.
    """
    if not (begins_warm(settings, start) and np.isfinite(settings.gap)):
        return settings
    wanted = wanted_gap(program, settings, program.cost(start.x))
    warm = {
        "compl_inf_tol": _complementarity(program, wanted),
        **WARM_START,
        **settings.options.get("ipopt warm", {}),
    }
    return replace(settings, options={**settings.options, "ipopt warm": warm})


def with_cost_scale(program: Program, x: FloatArray, settings: SolverSettings) -> Program:
    """Return the program with the cost scale of the settings, determined at a start."""
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
    """Run the solvers of the settings in turn until one converges, and return the solution.

    With ``once``, a warm start is the only run. ``solvers`` caches solvers for further solves of
    the program.
    """
    attempts: list[Attempt] = []
    outcome: SolverOutcome | None = None
    with deadline.within(settings.time_limit):
        runner = Runner(program, settings, progress, solvers)
        for name, variant in _turns(settings, start, once):
            given = start if variant or name == "sqp" else StartingPoint(start.x)
            tried = runner.run(name, given, variant=variant)
            attempts.append(tried.attempt)
            unsure = name == "ipopt" and tried.attempt.status in UNSURE
            if unsure and asks_for_ldl(settings.options):
                usual = replace(settings, options=without_ldl(settings.options))
                runner_there = replace(runner, settings=usual, solvers=None)
                tried = runner_there.run(name, given, variant=variant)
                attempts.append(tried.attempt)
            status = tried.attempt.status
            # A failure does not override that an earlier solver found the program infeasible.
            if outcome is None or _rank(status) <= _rank(outcome.attempt.status):
                outcome = tried
            if deadline.over() or status in (Status.SOLVED, Status.INTERRUPTED):
                break
        assert outcome is not None
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


def _turns(settings: SolverSettings, start: StartingPoint, once: bool) -> list[tuple[str, bool]]:
    """Return the solvers in their order, each with True for its variant."""
    turns = [(name, False) for name in settings.chain()]
    if settings.solver == "sqp":
        turns.append(("sqp", True))
    if begins_warm(settings, start):
        turns = [("ipopt", True), *([] if once else turns)]
    return turns


def begins_warm(settings: SolverSettings, start: StartingPoint) -> bool:
    """Return True if IPOPT starts from the multipliers of a start."""
    return start.warm and settings.initial_barrier is None and settings.solver in ("auto", "ipopt")


def warm_barrier(settings: SolverSettings, program: Program, start: StartingPoint) -> float | None:
    """Return the barrier parameter of a warm start: a power of ten below its complementarity.

    None if the settings give a barrier parameter or there are no multipliers. A smaller barrier
    parameter shortens steps towards limits that were moved; a larger one discards information.
    """
    is_given = "mu_init" in settings.options.get("ipopt", {})
    if is_given or not begins_warm(settings, start):
        return None
    data = arguments_of(program, start)
    multipliers = np.concatenate([data["lam_x0"], data["lam_g0"]])
    mean = complementarity(program, start.x, program.row_values(start.x), multipliers)
    # The mean complementarity is the barrier parameter of the central path through the start.
    barrier = np.clip(mean, LEAST_WARM_BARRIER, COLD_BARRIER)
    return float(10.0 ** np.floor(np.log10(barrier)))


def last_barrier(program: Program, settings: SolverSettings, x: FloatArray) -> float:
    """Return the barrier parameter at which a solve ends.

    It is that of the wanted gap. A solve that accepts any gap ends where a warm start from its
    multipliers begins: a solve on the next mesh from a smaller one takes steps of a few percent.
    """
    size = cost_size(program.cost(x), program.cost_scale)
    if np.isfinite(settings.gap):
        return _complementarity(program, settings.gap * size)
    return _complementarity(program, ROUGH_GAP * size, LEAST_WARM_BARRIER)


def _rank(status: Status) -> int:
    """Return the rank of a status: the lower, the more it says about the problem."""
    order = (Status.SOLVED, Status.INTERRUPTED, Status.INFEASIBLE, Status.ITERATION_LIMIT)
    return order.index(status) if status in order else len(order)


# further solves for a small gap -------------------------------------------------------------------


# Barrier parameters of further solves for a small gap
GAP_SHARE = 0.5  # fraction of the wanted gap that the barrier may take
USUAL_COMPLEMENTARITY = 1e-4  # IPOPT's tolerance by default
LEAST_BARRIER = 1e-15  # least barrier parameter that solvers reach
ROUGH_GAP = 2e-4  # gap left by a solve that accepts any, relative to the cost

# Barrier and distance from the bounds agree: steps are short where products of multipliers and
# slacks differ from the barrier.
WARM_START = dict.fromkeys(("mu_init", *WARM_PUSHES), 1e-6)

# Tolerance and options of each further solve. IPOPT relaxes bounds by 1e-8 of their size by
# default; the second solve reduces this, which needs a larger barrier parameter. Near an optimum of
# zero, residuals at these tolerances may still add up to more than the wanted gap: the third solve
# (tolerance 0) allows each variable its share of the gap.
FURTHER: tuple[tuple[float, dict[str, float]], ...] = (
    (1e-8, {}),
    (1e-10, {"bound_relax_factor": 1e-10, "mu_init": 1e-6}),
    (0.0, {}),
)


def gap_at(program: Program, outcome: SolverOutcome) -> Gap:
    """Return the gap at the point of a solver; NaN if the point is not finite."""
    x, lam_g, lam_x = outcome.point.x, *outcome.point.multipliers
    if not all(np.isfinite(k).all() for k in (x, lam_g, lam_x)):
        return UNKNOWN
    slope, rows = program.stationarity(x, lam_g)
    return gap_of(program, x, rows, slope + lam_x, np.concatenate([lam_x, lam_g]))


def wanted_gap(program: Program, settings: SolverSettings, cost: float) -> float:
    """Return the gap that the settings allow, in the unit of the cost."""
    return settings.gap * cost_size(cost, program.cost_scale)


def tightened(runner: Runner, outcome: SolverOutcome) -> tuple[SolverOutcome, Gap, list[Attempt]]:
    """Return an outcome with the wanted gap, its gap, and the further attempts.

    A failed outcome is returned unchanged. If the gap stays too large, the last attempt has the
    status GAP_LEFT. An infinite wanted gap requires no further solve.
    """
    if outcome.attempt.status is not Status.SOLVED:
        return outcome, UNKNOWN, []
    program, settings = runner.program, runner.settings
    best, gap = outcome, gap_at(program, outcome)
    attempts: list[Attempt] = []
    wanted = wanted_gap(program, settings, best.attempt.cost)
    # One limit of iterations for all solves: a gap that some hundred do not close stays.
    iterations = settings.max_iterations - outcome.attempt.iterations
    for tolerance, options in FURTHER:
        near = not gap.total > wanted and (wanted == np.inf or _keeps_all(best))
        if near or iterations <= 0 or deadline.over():
            break
        given = replace(runner, settings=replace(settings, max_iterations=iterations))
        tried = _further(given, best, min(wanted, gap.slack), wanted, tolerance, options)
        iterations -= tried.attempt.iterations
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


def _complementarity(program: Program, gap: float, most: float = USUAL_COMPLEMENTARITY) -> float:
    """Return the product of multiplier and slack at which all limits together leave a gap."""
    ranges = program.lower < program.upper
    count = sum(int(np.sum(np.isfinite(k) & ranges)) for k in (program.lower, program.upper))
    each = GAP_SHARE * gap / program.cost_scale / max(count, 1)
    return float(np.clip(each, LEAST_BARRIER, most))


def _keeps_all(outcome: SolverOutcome) -> bool:
    """Return True if rows and bounds are kept to the threshold of the verification."""
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
    share = wanted / program.cost_scale / before.point.x.size
    relaxed = {} if tolerance else {"bound_relax_factor": share}
    barrier = _complementarity(program, slack, np.inf)
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
        options={**settings.options, "ipopt": closer, "ipopt warm": {}},
    )
    # Its solver is not cached: the barrier parameter belongs to this solve.
    return replace(runner, settings=finer, solvers=None).run("ipopt", before.point, variant=True)
