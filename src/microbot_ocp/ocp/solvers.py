"""Solvers of staged programs: fatrop, IPOPT and an SQP method, with a fallback chain.

All get the derivatives of the stage kernels instead of an automatic differentiation of the whole
program, which would cost more time than the solve; fatrop gets the stages, too.

The chain of "auto" is: from an earlier solution with multipliers IPOPT, warm; then fatrop; then
IPOPT; the other way round where there are no inequalities. The first that converges ends it, and
the solution lists every attempt. The SQP method is
active-set: good for small programs and for solves from a neighbouring solution, never chosen by
itself; it clips the eigenvalues of the Hessian, and where that fails it tries once more with a
regularised one.
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp import checks
from microbot_ocp.checks import FloatArray, InputError
from microbot_ocp.ocp.acceptance import accepted
from microbot_ocp.ocp.advice import advice
from microbot_ocp.ocp.assembly import Program, assemble
from microbot_ocp.ocp.finiteness import check_start
from microbot_ocp.ocp.mesh import Meshes
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.progress import Progress, Watch, violation, watching
from microbot_ocp.ocp.scaling import cost_scale, scaled
from microbot_ocp.ocp.schemes import Scheme
from microbot_ocp.ocp.solution import Attempt, Solution, Start, Status, unpack
from microbot_ocp.ocp.start import default_guess, start_from
from microbot_ocp.ocp.transcription import Guess, Transcription

__all__ = ["SOLVERS", "SolverSettings", "default_guess", "solve"]

SOLVERS = ("fatrop", "ipopt", "sqp")
SCALINGS = ("auto", "declared")
CHAIN = ("fatrop", "ipopt")  # of "auto"
FAR = 1e10  # value and violation that fatrop sees where there is none
LARGEST = 1e300
FEASIBLE = 1e-4  # largest violation, scaled, at which a solver's success is believed

# Barrier parameters lowered gently: with the default jumps fatrop stalls on the flat minima that
# time-optimal problems have.
FATROP_OPTIONS = {
    "mu_superlinear_decrease_power": 1.05,
    "mu_linear_decrease_factor": 0.5,
    "print_level": 0,
}
IPOPT_OPTIONS = {"print_level": 0, "sb": "yes", "mumps_pivtol": 1e-7}
# From a neighbouring solution: little is lost of what is known (15 to 21 iterations against 51 to
# 62 on the Microbot task with its torque limits changed by 5 %; a barrier of 1e-5 ends too early).
WARM_BARRIER = 1e-7
WARM_PUSH = 1e-4
SQP_OPTIONS = {
    "qpsol": "qrqp",
    "qpsol_options": {"print_iter": False, "print_header": False, "error_on_fail": False},
    "convexify_strategy": "eigen-clip",
    "print_header": False,
    "print_iteration": False,
    "print_status": False,
}


@dataclass(frozen=True)
class SolverSettings:
    """How to solve a program.

    Attributes
    ----------
    solver : "auto" (fatrop, then IPOPT if it does not converge), "fatrop", "ipopt" or "sqp"
    tolerance : optimality and feasibility of the scaled program
    max_iterations : limit for each solver
    initial_barrier : start of the barrier parameter; small for a warm start
    options : further options by solver name
    scaling : "auto" (sizes that were not declared are found, see
        :mod:`microbot_ocp.ocp.scaling`) or "declared" (one where no scale was declared)
    """

    solver: str = "auto"
    tolerance: float = 1e-7
    max_iterations: int = 300
    initial_barrier: float | None = None
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    scaling: str = "auto"

    def __post_init__(self) -> None:
        checks.one_of("scaling", self.scaling, SCALINGS)
        checks.number("tolerance", self.tolerance, above=0.0)
        checks.number("max_iterations", self.max_iterations, at_least=0)
        if self.max_iterations != int(self.max_iterations):
            raise InputError(f"max_iterations must be a whole number, not {self.max_iterations}")
        if self.initial_barrier is not None:
            checks.number("initial_barrier", self.initial_barrier, above=0.0)

    def chain(self) -> tuple[str, ...]:
        """Solvers to try in turn."""
        checks.one_of("solver", self.solver, ("auto", *SOLVERS))
        return CHAIN if self.solver == "auto" else (self.solver,)

    def as_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        return {**asdict(self), "options": {k: dict(v) for k, v in self.options.items()}}


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
        Called with an :class:`~microbot_ocp.ocp.progress.Iteration` at every iteration. It may
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
    program = assemble(transcription.problem, layouts)
    begin = start_from(program, transcription.problem, guess)
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


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one solver left."""

    attempt: Attempt
    x: FloatArray
    row_multipliers: FloatArray
    variable_multipliers: FloatArray


Made = dict[tuple[str, bool, float], ca.Function]


def run_chain(
    program: Program,
    settings: SolverSettings,
    start: Start,
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
        given = start if variant or name == "sqp" else Start(start.x)
        outcome = _run(program, name, settings, given, variant, progress, made)
        attempts.append(outcome.attempt)
        if outcome.attempt.status in (Status.SOLVED, Status.INTERRUPTED):
            break
    assert outcome is not None
    return Solution(
        status=outcome.attempt.status,
        cost=outcome.attempt.cost,
        phases=unpack(program, outcome.x),
        attempts=tuple(attempts),
        row_multipliers=outcome.row_multipliers,
        build_time=build_time,
        variable_multipliers=outcome.variable_multipliers,
        variables=outcome.x,
        settings=settings.as_dict(),
        cost_scale=program.cost_scale,
        start=start,
        said=advice(program, start, outcome.x, attempts),
    )


def _has_inequalities(program: Program) -> bool:
    return any(
        bool(np.any((low < high) & (np.isfinite(low) | np.isfinite(high))))
        for low, high in (
            (program.row_lower, program.row_upper),
            (program.variable_lower, program.variable_upper),
        )
    )


def _run(
    program: Program,
    name: str,
    settings: SolverSettings,
    start: Start,
    variant: bool,
    progress: Progress | None,
    made: Made | None,
) -> Outcome:
    begin = time.perf_counter()
    watch = Watch(program, name, progress) if progress is not None else None
    key = (name, variant, program.cost_scale)
    solver = None if made is None or watch is not None else made.get(key)
    broken = ""
    if solver is None:
        try:
            solver = _create(program, name, settings, variant=variant, watch=watch)
        except RuntimeError as problem:
            broken = _first_cause(problem)
        if made is not None and watch is None and solver is not None:
            made[key] = solver
    created = time.perf_counter()
    arguments: dict[str, Any] = {
        "x0": start.x,
        "p": program.parameters,
        "lbx": program.variable_lower,
        "ubx": program.variable_upper,
        "lbg": program.row_lower,
        "ubg": program.row_upper,
    }
    if start.warm:
        for key, value in (
            ("lam_x0", start.variable_multipliers),
            ("lam_g0", start.row_multipliers),
        ):
            arguments[key] = np.asarray(value) / program.cost_scale
    result: Mapping[str, Any] = {}
    with watching(name) as interrupted:
        if watch is not None:
            watch.asked = interrupted
        # what stops the SQP method takes its result along
        try:
            result = {} if solver is None else solver(**arguments)
        except (KeyboardInterrupt, RuntimeError) as problem:
            asked = interrupted() or (watch is not None and watch.stopped)
            if isinstance(problem, KeyboardInterrupt) and not asked:
                raise
            broken = "" if asked else _first_cause(problem)
    if broken and settings.options.get(name) and "option" in broken.lower():
        raise InputError(f"options of {name} were refused: {broken}")
    done = time.perf_counter()
    stopped = interrupted() or (watch is not None and watch.stopped)
    if watch is not None and watch.failure is not None:
        raise watch.failure
    stats = _stats(solver) if solver is not None and result else {}
    last = start.x if watch is None or watch.x is None else watch.x
    x = np.array(result["x"]).ravel() if result else last
    if stopped and watch is not None:
        x = last
    cost, infeasibility = _checked(program, x)
    attempt = Attempt(
        solver=name,
        status=Status.INTERRUPTED if stopped else _status(name, stats, settings, infeasibility),
        message=broken or str(stats.get("return_status", "")),
        iterations=int(stats.get("iter_count", -1 if watch is None else watch.count)),
        cost=cost,
        infeasibility=infeasibility,
        wall_time=done - created,
        create_time=created - begin,
        function_time=sum(v for k, v in stats.items() if k.startswith("t_wall_nlp_")),
        broke_down=bool(broken),
    )
    # the solvers hand over the multipliers of their own bounds, though CasADi computes none
    rows, variables = (
        np.array(result[key]).ravel() * program.cost_scale if result else np.zeros(size)
        for key, size in (("lam_g", program.row_lower.size), ("lam_x", x.size))
    )
    if name == "fatrop" and attempt.status in (Status.ITERATION_LIMIT, Status.FAILED) and result:
        passed = accepted(program, x, rows, variables, settings.tolerance)
        if passed is not None:
            said = f"stopped, but its point is an optimum to {passed.error:.1e}"
            attempt = replace(attempt, status=Status.SOLVED, message=said)
            rows, variables = passed.row_multipliers, passed.variable_multipliers
    return Outcome(attempt, x, rows, variables)


def _first_cause(problem: BaseException) -> str:
    """The innermost line of an error of CasADi, without the places in its source."""
    lines = [line.strip() for line in str(problem).splitlines() if line.strip()]
    own = [line for line in lines if not line.startswith("Error in ")] or lines or [repr(problem)]
    return re.sub(r"^\S+\.\w+:\d+: | (at: /|\[\.\.\./).*$", "", own[-1])


def _stats(solver: ca.Function) -> Mapping[str, Any]:
    try:
        return solver.stats()
    except RuntimeError:  # the SQP method's, where its quadratic program had no answer
        return {}


def _checked(program: Program, x: FloatArray) -> tuple[float, float]:
    """Cost and largest violation of a bound or row at x, whatever the solver reports of them."""
    cost = float(program.functions["gradient"](x, program.parameters)[0])
    g = np.array(program.functions["jacobian"](x, program.parameters)[0]).ravel()
    worst = violation(program, x, g)
    return cost, worst if np.isfinite(cost) else np.inf


def _create(
    program: Program,
    name: str,
    settings: SolverSettings,
    *,
    variant: bool = False,
    watch: Watch | None = None,
) -> ca.Function:
    common: dict[str, Any] = {
        "print_time": False,
        "calc_lam_p": False,
        "calc_lam_x": False,
        "error_on_fail": False,
        "show_eval_warnings": False,  # the advice says it once
    }
    plugin, options, cache = {
        "fatrop": _fatrop,
        "ipopt": _warm_ipopt if variant else _ipopt,
        "sqp": _regularised_sqp if variant else _sqp,
    }[name](program, settings)
    if watch is not None:
        hook = watch.hook(cache)
        options, cache = {**options, **hook.options}, {**cache, **hook.cache}
    nlp = {**program.nlp, "f": program.nlp["f"] / program.cost_scale}
    if name == "fatrop":  # which tries steps for ever where the values there are no numbers
        nlp = {**nlp, "f": ca.fmin(nlp["f"], FAR), "g": ca.fmin(nlp["g"], FAR)}
    return ca.nlpsol(name, plugin, nlp, {**common, **options, "cache": cache})


Plugin = tuple[str, dict[str, Any], dict[str, ca.Function]]


def _with_scaled_cost(program: Program) -> Mapping[str, ca.Function]:
    """The functions of a program as solvers get them."""
    functions, scale = program.functions, program.cost_scale
    if scale == 1.0:
        return functions
    whole = functions["lagrangian"]
    x, p, lam_f, lam_g = (ca.MX.sym(k, whole.sparsity_in(i)) for i, k in enumerate("xpfg"))
    cost, g, stationarity, slope_of_p = whole(x, p, lam_f / scale, lam_g)
    f, slope = functions["gradient"](x, p)
    made = {
        "lagrangian": ca.Function(
            "nlp_grad", [x, p, lam_f, lam_g], [cost / scale, g, stationarity, slope_of_p]
        ),
        "gradient": ca.Function("nlp_grad_f", [x, p], [f / scale, slope / scale]),
        "gradient_only": ca.Function("nlp_grad_f", [x, p], [slope / scale]),
    }
    for name in ("hessian", "hessian_upper"):
        outputs = functions[name].call([x, p, lam_f / scale, lam_g])
        made[name] = ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], outputs)
    return {**functions, **made}


def _fatrop(program: Program, settings: SolverSettings) -> Plugin:
    functions = _with_scaled_cost(program)
    options: dict[str, Any] = {**FATROP_OPTIONS, "tolerance": settings.tolerance}
    options["max_iter"] = settings.max_iterations
    if settings.initial_barrier is not None:
        options["mu_init"] = settings.initial_barrier
    equal = program.row_lower == program.row_upper
    structure = {
        "structure_detection": "manual",
        "N": len(program.nodes) - 1,
        "nx": list(program.nodes),
        "nu": list(program.controls),
        "ng": list(program.constraints),
        "equality": equal.tolist(),
    }
    cache = {
        "nlp_grad": functions["lagrangian"],
        "nlp_jac_g": _finite(functions["jacobian"]),
        "nlp_grad_f": _finite(functions["gradient_only"]),
        "nlp_hess_l": _finite(functions["hessian"]),
    }
    own = {**options, **settings.options.get("fatrop", {})}
    return "fatrop", {**structure, "fatrop": own}, cache


def _finite(function: ca.Function) -> ca.Function:
    """The function with zeros where it has no value."""
    inputs = [ca.MX.sym(f"i{k}", function.sparsity_in(k)) for k in range(function.n_in())]
    outputs = []
    for value in function.call(inputs):
        entries = value.nz[:]
        # the smaller of a number and what is none is the number
        kept = ca.fmax(ca.fmin(entries, LARGEST), -LARGEST)
        kept = ca.if_else(ca.fabs(kept) < LARGEST, kept, 0)
        outputs.append(ca.MX(value.sparsity(), kept))
    return ca.Function(function.name(), inputs, outputs)


def _ipopt(program: Program, settings: SolverSettings) -> Plugin:
    functions = _with_scaled_cost(program)
    options: dict[str, Any] = {
        **IPOPT_OPTIONS,
        "tol": settings.tolerance,
        "max_iter": settings.max_iterations,
    }
    if settings.initial_barrier is not None:
        options["mu_init"] = settings.initial_barrier
        options["warm_start_init_point"] = "no"
        options["bound_push"] = options["bound_frac"] = settings.initial_barrier
    cache = {
        "nlp_grad": functions["lagrangian"],
        "nlp_jac_g": functions["jacobian"],
        "nlp_grad_f": functions["gradient"],
        "nlp_hess_l": functions["hessian_upper"],
    }
    return "ipopt", {"ipopt": {**options, **settings.options.get("ipopt", {})}}, cache


def _warm_ipopt(program: Program, settings: SolverSettings) -> Plugin:
    plugin, options, cache = _ipopt(program, settings)
    warm = {
        "warm_start_init_point": "yes",
        "mu_init": WARM_BARRIER,
        **{
            f"warm_start_{what}": WARM_PUSH
            for what in (
                "bound_push",
                "bound_frac",
                "slack_bound_push",
                "slack_bound_frac",
                "mult_bound_push",
            )
        },
    }
    return plugin, {"ipopt": {**warm, **options["ipopt"]}}, cache


def _sqp(program: Program, settings: SolverSettings) -> Plugin:
    functions = _with_scaled_cost(program)
    x, p = (ca.MX.sym(k, functions["jacobian"].sparsity_in(i)) for i, k in enumerate("xp"))
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", program.row_lower.size)
    g, jacobian = functions["jacobian"](x, p)
    f, slope = functions["gradient"](x, p)
    hessian = functions["hessian"](x, p, lam_f, lam_g)[1]
    cache = {
        "nlp_grad": functions["lagrangian"],
        "nlp_jac_fg": ca.Function("nlp_jac_fg", [x, p], [f, slope, g, jacobian]),
        "nlp_hess_l": ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [hessian]),
    }
    options = {
        **SQP_OPTIONS,
        "max_iter": settings.max_iterations,
        "tol_pr": settings.tolerance,
        "tol_du": settings.tolerance,
    }
    return "sqpmethod", {**options, **settings.options.get("sqp", {})}, cache


def _regularised_sqp(program: Program, settings: SolverSettings) -> Plugin:
    plugin, options, cache = _sqp(program, settings)
    return plugin, {**options, "convexify_strategy": "regularize"}, cache


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
