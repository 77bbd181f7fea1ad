"""Solvers in turn until one converges.

The chain of "auto" is: from an earlier solution with multipliers IPOPT, warm; then IPOPT; then
fatrop. The first that converges ends it; from there the solve goes on until the gap is as small as
wanted. The solution lists every attempt. The SQP method is active-set: good for small programs and
for solves from a neighbouring solution, never chosen by itself; it clips the eigenvalues of the
Hessian, and where that fails it tries once more with a regularised one.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.diagnosis import advice, finite_start
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.solution import Attempt, Progress, Solution, StartingPoint, unpack
from microbot_ocp.ocp.solvers._ldl import asks_for_ldl, without_ldl
from microbot_ocp.ocp.solvers._run import Runner, SolverOutcome, Solvers
from microbot_ocp.ocp.solvers._settings import SolverSettings
from microbot_ocp.ocp.solvers._tightening import tightened
from microbot_ocp.ocp.starts import cost_scale, scaled, starting_point
from microbot_ocp.ocp.transcription import Guess, Meshes, Program, Transcription
from microbot_ocp.ocp.transcription.schemes import Scheme

UNSURE = (Status.FAILED, Status.INFEASIBLE)  # without pivots in the linear solver


def solve_on(
    transcription: Transcription,
    mesh: Meshes,
    guess: Mapping[str, Guess] | Solution | str | None,
    settings: SolverSettings,
    until: float | None = None,
    progress: Progress | None = None,
    warm_only: bool = False,
    uneven: bool = False,
) -> Solution:
    """Solve on a mesh from a guess, by the solvers of the settings in turn.

    With ``warm_only`` it ends where the warm start from a solution does not converge. With
    ``uneven`` a guess that is no solution is moved off what is symmetric.
    """
    program, begin, build_time = program_on(transcription, mesh, guess, settings, uneven)
    return run_chain(
        program,
        settings,
        begin,
        progress=progress,
        build_time=build_time,
        until=until,
        warm_only=warm_only,
    )


def program_on(
    transcription: Transcription,
    mesh: Meshes,
    guess: Mapping[str, Guess] | Solution | str | None,
    settings: SolverSettings,
    uneven: bool = False,
) -> tuple[Program, StartingPoint, float]:
    """Return the program on a mesh, where it starts from a guess, and the time it took, s."""
    start = time.perf_counter()
    program = transcription.program(mesh)
    begin = starting_point(program, transcription.problem, guess)
    uneven = uneven and not isinstance(guess, Solution)
    begin = replace(begin, x=finite_start(program, begin.x, uneven=uneven))
    return with_cost_scale(program, begin.x, settings), begin, time.perf_counter() - start


@dataclass(frozen=True, eq=False)
class SolveContext:
    """How a transcription is solved, and until when.

    Attributes
    ----------
    transcription, settings : of every solve
    until : when the time of all is over, by ``time.perf_counter``
    progress : called at every iteration
    """

    transcription: Transcription
    settings: SolverSettings
    until: float
    progress: Progress | None = None

    @property
    def over(self) -> bool:
        """Whether the time is over."""
        return time.perf_counter() >= self.until

    def solve(
        self,
        mesh: Meshes,
        guess: Mapping[str, Guess] | Solution | str | None,
        *,
        uneven: bool = False,
        **settings: Any,
    ) -> Solution:
        """Return one solve, with other settings where these are given."""
        changed = replace(self.settings, **settings)
        how = self.until, self.progress
        return solve_on(self.transcription, mesh, guess, changed, *how, uneven=uneven)


def transcribed(
    problem: OptimalControlProblem | Transcription,
    settings: SolverSettings,
    *,
    scheme: str | Scheme = "radau",
    guess: Mapping[str, Guess] | Solution | str | None = None,
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
    until: float | None = None,
    warm_only: bool = False,
) -> Solution:
    """Try the solvers of the settings in turn until one converges.

    ``solvers`` keeps them for further solves of the same program; ``until`` is when the time of all
    is over, by the clock of ``time.perf_counter``: by default the limit of the settings from now.
    """
    until = time.perf_counter() + settings.time_limit if until is None else until
    until = min(until, deadline.until())
    runner = Runner(program, settings, progress, solvers, until)
    turns = [(name, False) for name in settings.chain()]
    if settings.solver == "sqp":
        turns.append(("sqp", True))
    if start.warm and settings.initial_barrier is None and settings.solver in ("auto", "ipopt"):
        turns = [("ipopt", True), *([] if warm_only else turns)]
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
        if time.perf_counter() >= until or status in (Status.SOLVED, Status.INTERRUPTED):
            break
    assert outcome is not None
    outcome, gap, further = tightened(runner, outcome)
    attempts += further
    ended = [*(a for a in attempts if a is not outcome.attempt), outcome.attempt]
    point = outcome.point
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
        maximize=_maximizes(program),
    )


def _rank(status: Status) -> int:
    """Return the lower, the more it says of a problem."""
    order = (Status.SOLVED, Status.INTERRUPTED, Status.INFEASIBLE, Status.ITERATION_LIMIT)
    return order.index(status) if status in order else len(order)


def _maximizes(program: Program) -> bool:
    problem = program.layouts[0].phase.problem
    return problem is not None and problem.maximize
