"""Solvers in turn until one converges.

The chain of "auto" is: from an earlier solution with multipliers IPOPT, warm; then fatrop; then
IPOPT; the other way round where there are no inequalities. The first that converges ends it; from
there the solve goes on until the gap is as small as wanted. The solution lists every attempt. The
SQP method is active-set: good for small programs and for solves from a neighbouring solution, never
chosen by itself; it clips the eigenvalues of the Hessian, and where that fails it tries once more
with a regularised one.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.diagnosis import advice, check_start
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.solution import (
    Attempt,
    Progress,
    Solution,
    StartingPoint,
    cost_scale,
    scaled,
    starting_point,
    unpack,
)
from microbot_ocp.ocp.solvers._run import Made, Outcome, run
from microbot_ocp.ocp.solvers._settings import SolverSettings
from microbot_ocp.ocp.solvers._tightening import tightened
from microbot_ocp.ocp.transcription import Guess, Meshes, Program, Transcription, assemble
from microbot_ocp.ocp.transcription.schemes import Scheme


def solve(
    problem: OptimalControlProblem | Transcription,
    mesh: Meshes = 50,
    guess: Mapping[str, Guess] | Solution | None = None,
    settings: SolverSettings | None = None,
    *,
    scheme: str | Scheme = "shooting",
    progress: Progress | None = None,
) -> Solution:
    """Transcribe a problem on a mesh and solve it.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
        A transcription keeps its kernels from solve to solve.
    mesh : int, Mesh, or one int, Mesh or array of fractions [N+1] a phase
    guess : mapping from phase name to Guess, or Solution, optional
        Default: straight lines between the end conditions. A solution may be of another mesh or of
        other phases; with the same phases its multipliers are used as well.
    settings : SolverSettings, optional
    scheme : str or Scheme
        Of a problem that is not transcribed yet: "shooting", "radau", "gauss", "trapezoidal",
        "hermite_simpson", or one with settings.
    progress : callable, optional
        Called with an :class:`~microbot_ocp.ocp.solution.Iteration` at every iteration. It may
        raise KeyboardInterrupt to stop the solve.

    Returns
    -------
    Solution
        Also where no solver converged: look at ``status``. After Ctrl-C it is the last iterate,
        with the status INTERRUPTED; fatrop cannot be stopped and runs to its end first.

    Raises
    ------
    InputError
        The declaration, mesh or guess is not complete or not finite, or the dynamics, constraints
        or costs are not finite at the guess.
    """
    settings = settings or SolverSettings()
    start = time.perf_counter()
    transcription = transcribed(problem, settings, scheme=scheme, guess=guess)
    layouts = transcription.layouts(mesh)
    program = assemble(layouts)
    begin = starting_point(program, transcription.problem, guess)
    check_start(program, begin.x)
    program = with_cost_scale(program, begin.x, settings)
    build_time = time.perf_counter() - start
    return run_chain(program, settings, begin, progress=progress, build_time=build_time)


def transcribed(
    problem: OptimalControlProblem | Transcription,
    settings: SolverSettings,
    *,
    scheme: str | Scheme = "shooting",
    guess: Mapping[str, Guess] | Solution | None = None,
) -> Transcription:
    """A transcription as it is, or that of a problem, with the scales that the settings want."""
    if isinstance(problem, Transcription):
        return problem
    own = scaled(problem, guess) if settings.scaling == "auto" else problem
    return Transcription(own, scheme=scheme)


def with_cost_scale(program: Program, x: FloatArray, settings: SolverSettings) -> Program:
    """The program with the scale of its cost that the settings want, seen from a start."""
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
    made: Made | None = None,
) -> Solution:
    """Try the solvers of the settings in turn until one converges.

    ``made`` keeps solvers for further solves of the same program.
    """
    chain = settings.chain()
    if settings.solver == "auto" and not _has_inequalities(program):
        chain = chain[::-1]  # IPOPT needs two iterations where fatrop does not see that it is done
    turns = [(name, False) for name in chain]
    if settings.solver == "sqp":
        turns.append(("sqp", True))
    if start.warm and settings.initial_barrier is None and settings.solver in ("auto", "ipopt"):
        turns.insert(0, ("ipopt", True))
    attempts: list[Attempt] = []
    outcome: Outcome | None = None
    for name, variant in turns:
        given = start if variant or name == "sqp" else StartingPoint(start.x)
        outcome = run(program, name, settings, given, variant, progress, made)
        attempts.append(outcome.attempt)
        if outcome.attempt.status in (Status.SOLVED, Status.INTERRUPTED):
            break
    assert outcome is not None
    outcome, gap, further = tightened(program, settings, outcome, progress, made)
    attempts += further
    return Solution(
        status=outcome.attempt.status,
        cost=outcome.attempt.cost,
        phases=unpack(program.layouts, outcome.x),
        attempts=tuple(attempts),
        row_multipliers=outcome.row_multipliers,
        build_time=build_time,
        variable_multipliers=outcome.variable_multipliers,
        variables=outcome.x,
        settings=settings.as_dict(),
        cost_scale=program.cost_scale,
        gap=gap,
        start=start,
        advice=advice(program, start, outcome.x, attempts),
        maximize=_maximizes(program),
    )


def _maximizes(program: Program) -> bool:
    problem = program.layouts[0].phase.problem
    return problem is not None and problem.maximize


def _has_inequalities(program: Program) -> bool:
    return any(
        bool(np.any((low < high) & (np.isfinite(low) | np.isfinite(high))))
        for low, high in (
            (program.row_lower, program.row_upper),
            (program.variable_lower, program.variable_upper),
        )
    )
