"""Solvers of staged programs: fatrop with the structure handed over, IPOPT, and a fallback chain.

Both get the derivatives of the stage kernels instead of an automatic differentiation of the whole
program, which would cost more time than the solve.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp import checks
from microbot_ocp.checks import FloatArray
from microbot_ocp.ocp.assembly import Program, assemble
from microbot_ocp.ocp.problem import OptimalControlProblem, node_variables
from microbot_ocp.ocp.schemes import Scheme
from microbot_ocp.ocp.solution import Attempt, Solution, Status, pack, unpack
from microbot_ocp.ocp.transcription import Guess, Transcription

SOLVERS = ("fatrop", "ipopt")
FEASIBLE = 1e-4  # largest violation, scaled, at which a solver's success is believed

# Barrier parameters lowered gently: with the default jumps fatrop stalls on the flat minima that
# time-optimal problems have.
FATROP_OPTIONS = {
    "mu_superlinear_decrease_power": 1.05,
    "mu_linear_decrease_factor": 0.5,
    "print_level": 0,
}
IPOPT_OPTIONS = {"print_level": 0, "sb": "yes", "mumps_pivtol": 1e-7}


@dataclass(frozen=True)
class SolverSettings:
    """How to solve a program.

    Attributes
    ----------
    solver : "auto" (fatrop, then IPOPT if it does not converge), "fatrop" or "ipopt"
    tolerance : optimality and feasibility of the scaled program
    max_iterations : limit for each solver
    initial_barrier : start of the barrier parameter; small for a warm start
    options : further options by solver name
    """

    solver: str = "auto"
    tolerance: float = 1e-7
    max_iterations: int = 300
    initial_barrier: float | None = None
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def chain(self) -> tuple[str, ...]:
        """Solvers to try in turn."""
        checks.one_of("solver", self.solver, ("auto", *SOLVERS))
        return SOLVERS if self.solver == "auto" else (self.solver,)


def solve(
    problem: OptimalControlProblem | Transcription,
    mesh: Sequence[int | ArrayLike] | int = 50,
    guess: Mapping[str, Guess] | None = None,
    settings: SolverSettings | None = None,
    *,
    scheme: str | Scheme = "shooting",
) -> Solution:
    """Transcribe a problem on a mesh and solve it.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
        A transcription keeps its kernels from solve to solve.
    mesh : int, or one int or array of fractions [N+1] a phase
    guess : mapping from phase name to Guess, optional
        Default: straight lines between the end conditions.
    settings : SolverSettings, optional
    scheme : str or Scheme
        Of a problem that is not transcribed yet: "shooting", "radau", "gauss", "trapezoidal",
        "hermite_simpson", or one with settings.

    Returns
    -------
    Solution
        Also where no solver converged: look at ``status``.

    Raises
    ------
    InputError
        The declaration, mesh or guess is not complete or not finite.
    """
    settings = settings or SolverSettings()
    start = time.perf_counter()
    transcription = (
        problem if isinstance(problem, Transcription) else Transcription(problem, scheme=scheme)
    )
    layouts = transcription.layouts(mesh)
    program = assemble(transcription.problem, layouts, transcription.kernels)
    x0 = pack(program, guess or default_guess(transcription.problem))
    build_time = time.perf_counter() - start
    attempts: list[Attempt] = []
    best: tuple[Attempt, FloatArray, FloatArray, FloatArray] | None = None
    for name in settings.chain():
        best = _run(program, name, settings, x0)
        attempt = best[0]
        attempts.append(attempt)
        if attempt.status in (Status.SOLVED, Status.INTERRUPTED):
            break
    assert best is not None
    attempt, x, row_multipliers, variable_multipliers = best
    return Solution(
        status=attempt.status,
        cost=attempt.cost,
        phases=unpack(program, x),
        attempts=tuple(attempts),
        row_multipliers=row_multipliers,
        build_time=build_time,
        variable_multipliers=variable_multipliers,
    )


def default_guess(problem: OptimalControlProblem) -> dict[str, Guess]:
    """Straight lines between the end conditions, or the middle of the bounds, or zero."""
    guesses = {}
    for phase in problem.phases:
        values = {}
        for variable in node_variables(phase):
            start, end = (_middle(variable, which) for which in ("initial", "final"))
            values[variable.name] = _line(start, end)
        low, high = phase.duration_bounds
        guesses[phase.name] = Guess(float(np.sqrt(low * min(high, 1e3 * low))), values)
    return guesses


def _middle(variable: Any, which: str) -> FloatArray:
    low, high = variable.lower, variable.upper
    condition = getattr(variable, which)
    if condition is not None:
        low, high = np.maximum(low, condition[0]), np.minimum(high, condition[1])
    both = np.isfinite(low) & np.isfinite(high)
    with np.errstate(invalid="ignore"):
        return np.where(both, (low + high) / 2, np.clip(0.0, low, high))


def _line(start: FloatArray, end: FloatArray) -> Any:
    return lambda s: start + s[:, None] * (end - start)


def _run(
    program: Program, name: str, settings: SolverSettings, x0: FloatArray
) -> tuple[Attempt, FloatArray, FloatArray, FloatArray]:
    begin = time.perf_counter()
    solver = _create(program, name, settings)
    created = time.perf_counter()
    result = solver(
        x0=x0,
        lbx=program.variable_lower,
        ubx=program.variable_upper,
        lbg=program.row_lower,
        ubg=program.row_upper,
    )
    done = time.perf_counter()
    stats = solver.stats()
    x = np.array(result["x"]).ravel()
    cost, infeasibility = _checked(program, x)
    attempt = Attempt(
        solver=name,
        status=_status(name, stats, settings, infeasibility),
        message=str(stats.get("return_status", "")),
        iterations=int(stats.get("iter_count", -1)),
        cost=cost,
        infeasibility=infeasibility,
        wall_time=done - created,
        create_time=created - begin,
        function_time=sum(v for k, v in stats.items() if k.startswith("t_wall_nlp_")),
    )
    # both solvers hand over the multipliers of their own bounds, though CasADi computes none
    return attempt, x, np.array(result["lam_g"]).ravel(), np.array(result["lam_x"]).ravel()


def _checked(program: Program, x: FloatArray) -> tuple[float, float]:
    """Cost and largest violation of a bound or row at x, whatever the solver reports of them."""
    cost = float(program.functions["gradient"](x, [])[0])
    g = np.array(program.functions["jacobian"](x, [])[0]).ravel()
    worst = 0.0
    for value, low, high in (
        (g, program.row_lower, program.row_upper),
        (x, program.variable_lower, program.variable_upper),
    ):
        excess = np.maximum(low - value, value - high)
        worst = max(worst, float(np.max(np.nan_to_num(excess, nan=np.inf), initial=0.0)))
    return cost, worst if np.isfinite(cost) else np.inf


def _create(program: Program, name: str, settings: SolverSettings) -> ca.Function:
    functions = program.functions
    common: dict[str, Any] = {
        "print_time": False,
        "calc_lam_p": False,
        "calc_lam_x": False,
        "error_on_fail": False,
    }
    extra = dict(settings.options.get(name, {}))
    if name == "fatrop":
        options = {**FATROP_OPTIONS, "tolerance": settings.tolerance}
        options["max_iter"] = settings.max_iterations
        if settings.initial_barrier is not None:
            options["mu_init"] = settings.initial_barrier
        equal = program.row_lower == program.row_upper
        return ca.nlpsol(
            "fatrop",
            "fatrop",
            dict(program.nlp),
            {
                **common,
                "fatrop": {**options, **extra},
                "structure_detection": "manual",
                "N": len(program.nodes) - 1,
                "nx": list(program.nodes),
                "nu": list(program.controls),
                "ng": list(program.constraints),
                "equality": equal.tolist(),
                "cache": {
                    "nlp_grad": functions["lagrangian"],
                    "nlp_jac_g": functions["jacobian"],
                    "nlp_grad_f": functions["gradient_only"],
                    "nlp_hess_l": functions["hessian"],
                },
            },
        )
    options = {**IPOPT_OPTIONS, "tol": settings.tolerance, "max_iter": settings.max_iterations}
    if settings.initial_barrier is not None:
        options["mu_init"] = settings.initial_barrier
        options["warm_start_init_point"] = "no"
        options["bound_push"] = options["bound_frac"] = settings.initial_barrier
    return ca.nlpsol(
        "ipopt",
        "ipopt",
        dict(program.nlp),
        {
            **common,
            "ipopt": {**options, **extra},
            "cache": {
                "nlp_grad": functions["lagrangian"],
                "nlp_jac_g": functions["jacobian"],
                "nlp_grad_f": functions["gradient"],
                "nlp_hess_l": functions["hessian_upper"],
            },
        },
    )


def _status(
    name: str, stats: Mapping[str, Any], settings: SolverSettings, infeasibility: float
) -> Status:
    message = str(stats.get("return_status", ""))
    limit = settings.options.get(name, {}).get("max_iter", settings.max_iterations)
    if stats.get("success"):  # fatrop says so of points that are not even numbers, too
        return Status.SOLVED if infeasibility <= FEASIBLE else Status.FAILED
    if stats.get("unified_return_status") == "SOLVER_RET_LIMITED" or "Maximum" in message:
        return Status.ITERATION_LIMIT
    if name == "fatrop" and stats.get("iter_count", -1) >= limit:  # it has no word for it
        return Status.ITERATION_LIMIT
    if "Infeasible" in message or "Restoration" in message:
        return Status.INFEASIBLE
    if "User" in message:
        return Status.INTERRUPTED
    return Status.FAILED
