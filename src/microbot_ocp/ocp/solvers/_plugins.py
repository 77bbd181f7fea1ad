"""Settings of solvers, and CasADi's plugins for fatrop, IPOPT, its warm start, and the SQP method.

All plugins receive the derivatives of the stage kernels: automatic differentiation of the whole
program would cost more time than the solve. fatrop also receives the stage structure.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.ipopt import USUAL, ipopt, time_limits
from microbot_ocp.ocp.solution import Watch
from microbot_ocp.ocp.solvers._ldl import as_ipopt_knows, check_linear_solver
from microbot_ocp.ocp.transcription import Program
from microbot_ocp.ocp.transcription._assembly import LazyFunctions

SOLVERS = ("fatrop", "ipopt", "sqp")
SCALINGS = ("auto", "declared")
CHAIN = ("ipopt", "fatrop")  # meaning of "auto"


@dataclass(frozen=True)
class SolverSettings:
    """Settings of a solve of a program.

    Attributes
    ----------
    solver : "auto" (IPOPT, followed by fatrop if IPOPT does not converge), "fatrop", "ipopt" or
        "sqp", or several of them in order
    tolerance : optimality and feasibility tolerance of the scaled program
    max_iterations : limit for each solver
    initial_barrier : initial barrier parameter; small for a warm start
    gap : allowed cost above the local optimum, relative to the cost (or to a thousandth of its
        scale if that is larger): a converged solve continues until its gap is smaller; infinite
        to accept any gap, which ``solve`` calls "gap left" if it exceeds the threshold of
        ``verify``
    options : further options by solver name; "ipopt warm" holds options of IPOPT for starts with
        multipliers
    scaling : "auto" (determine undeclared scales, see ``ocp/starts/_scaling.py``) or "declared"
        (undeclared scales are one)
    time_limit : wall time limit of a solve, s, all solvers together
    """

    solver: str | tuple[str, ...] = "auto"
    tolerance: float = 1e-7
    gap: float = 1e-6
    max_iterations: int = 1000
    initial_barrier: float | None = None
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    scaling: str = "auto"
    time_limit: float = np.inf

    def __post_init__(self) -> None:
        checks.one_of("scaling", self.scaling, SCALINGS)
        checks.time_limit(self.time_limit)
        self.chain()
        checks.number("tolerance", self.tolerance, above=0.0)
        if not (isinstance(self.gap, float) and self.gap == np.inf):
            checks.number("gap", self.gap, above=0.0)
        most = checks.MOST_ITERATIONS
        checks.whole("max_iterations", self.max_iterations, at_least=0, at_most=most)
        if self.initial_barrier is not None:
            checks.number("initial_barrier", self.initial_barrier, above=0.0)
        if "linear_solver" in self.options.get("ipopt", {}):
            check_linear_solver(self.options["ipopt"]["linear_solver"])

    def chain(self) -> tuple[str, ...]:
        """Return the solvers in the order in which they are tried."""
        if not isinstance(self.solver, str):
            if not self.solver:
                raise InputError("solver must name at least one solver, or be 'auto'")
            return tuple(checks.one_of("solver", name, SOLVERS) for name in self.solver)
        checks.one_of("solver", self.solver, ("auto", *SOLVERS))
        return CHAIN if self.solver == "auto" else (self.solver,)

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return {**asdict(self), "options": {k: dict(v) for k, v in self.options.items()}}


COLD_BARRIER = 0.1  # first barrier parameter without multipliers, the default of IPOPT
LEAST_WARM_BARRIER = 1e-7  # least first barrier parameter with multipliers
WARM_PUSH = 1e-4  # relative distance of a start with multipliers from its bounds
FAR = 1e10  # value and violation that replace infinite ones for fatrop
LARGEST_FINITE = 1e300  # largest number that counts as finite

# The barrier decreases slowly: with the default steps fatrop stalls on the flat minima of
# time-optimal problems.
FATROP_OPTIONS = {
    "mu_superlinear_decrease_power": 1.05,
    "mu_linear_decrease_factor": 0.5,
    "print_level": 0,
}
WARM_PUSHES = (
    "warm_start_bound_push",
    "warm_start_bound_frac",
    "warm_start_slack_bound_push",
    "warm_start_slack_bound_frac",
    "warm_start_mult_bound_push",
)
SQP_OPTIONS = {
    "qpsol": "qrqp",
    "qpsol_options": {"print_iter": False, "print_header": False, "error_on_fail": False},
    "convexify_strategy": "eigen-clip",
    "print_header": False,
    "print_iteration": False,
    "print_status": False,
}


def create(
    program: Program,
    name: str,
    settings: SolverSettings,
    *,
    variant: bool = False,
    watch: Watch | None = None,
    seconds: float = np.inf,
) -> ca.Function:
    """Return a solver of a program with derivatives and options.

    IPOPT stops after ``seconds`` of processor time, or at the wall time of the deadline.
    """
    _keep_to_one_thread()
    make = {"fatrop": _fatrop, "ipopt": _ipopt, "sqp": _sqp}[name]
    functions = _with_scaled_cost(program)
    plugin, options, cache = make(program, functions, settings, variant)
    cache["nlp_grad"] = functions["lagrangian"]
    if watch is not None:
        options, cache = watch.hooked(options, cache)
    nlp = {**program.nlp, "f": program.nlp["f"] / program.cost_scale}
    if name == "fatrop":  # its line search would never end at values that are not finite
        nlp = {**nlp, "f": ca.fmin(nlp["f"], FAR), "g": ca.fmin(nlp["g"], FAR)}
    if name == "ipopt":
        # A solver without a limit of its own is kept for calls with other deadlines.
        timed = time_limits(seconds) if np.isfinite(seconds) else {}
        own = {**timed, **options.pop("ipopt")}
        return ipopt(name, nlp, own, **options, cache=cache)
    return ca.nlpsol(name, plugin, nlp, {**USUAL, **options, "cache": cache})


@lru_cache(maxsize=1)
def _keep_to_one_thread() -> None:
    """Limit IPOPT's OpenBLAS to one thread, unless the user sets the number of threads.

    Vectors of a few thousand entries are too short for several threads: the others wait in a loop,
    which takes a tenth of the processor time on two cores. The name of the library is known on
    Linux; on other systems there are only copies that nothing loads.
    """
    if "OPENBLAS_NUM_THREADS" not in os.environ:
        library = Path(ca.GlobalOptions.getCasadiPath()) / "libcasadi-tp-openblas.so.0"
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(str(library)).openblas_set_num_threads(1)


Functions = Mapping[str, ca.Function]
Plugin = tuple[str, dict[str, Any], dict[str, ca.Function]]

# Number of leading outputs of a function that belong to the cost.
_OF_COST = {"lagrangian": 1, "gradient": 2, "gradient_only": 1, "hessian": 0, "hessian_upper": 0}


def _with_scaled_cost(program: Program) -> Functions:
    """Return the functions of a program with the cost divided by its scale."""
    functions, scale = program.functions, program.cost_scale
    if scale == 1.0:
        return functions

    def divided(name: str, of_cost: int) -> ca.Function:
        function = functions[name]
        inputs = function.mx_in()
        weights = [lam_f / scale for lam_f in inputs[2:3]]
        outputs = function.call([*inputs[:2], *weights, *inputs[3:]])
        outputs[:of_cost] = [output / scale for output in outputs[:of_cost]]
        return ca.Function(function.name(), inputs, outputs)

    changed = {name: partial(divided, name, count) for name, count in _OF_COST.items()}
    return LazyFunctions({**changed, "jacobian": lambda: functions["jacobian"]})


def _fatrop(program: Program, functions: Functions, settings: SolverSettings, _: bool) -> Plugin:
    options: dict[str, Any] = {**FATROP_OPTIONS, "tolerance": settings.tolerance}
    options["max_iter"] = settings.max_iterations
    if settings.initial_barrier is not None:
        options["mu_init"] = settings.initial_barrier
    nodes, controls, constraints = (sizes.tolist() for sizes in program.stage_sizes)
    structure = {
        "structure_detection": "manual",
        "N": len(nodes) - 1,
        "nx": nodes,
        "nu": controls,
        "ng": constraints,
        "equality": (program.row_lower == program.row_upper).tolist(),
        "fatrop": {**options, **settings.options.get("fatrop", {})},
    }
    cache = {
        "nlp_jac_g": _finite(functions["jacobian"]),
        "nlp_grad_f": _finite(functions["gradient_only"]),
        "nlp_hess_l": _finite(functions["hessian"]),
    }
    return "fatrop", structure, cache


def _finite(function: ca.Function) -> ca.Function:
    """Return the function with zeros in place of infinite values and NaN."""
    inputs, outputs = function.mx_in(), []
    for value in function.call(inputs):
        entries = value.nz[:]
        # fmin and fmax of a number and NaN return the number.
        bounded = ca.fmax(ca.fmin(entries, LARGEST_FINITE), -LARGEST_FINITE)
        bounded = ca.if_else(ca.fabs(bounded) < LARGEST_FINITE, bounded, 0)
        outputs.append(ca.MX(value.sparsity(), bounded))
    return ca.Function(function.name(), inputs, outputs)


def _ipopt(_: Program, functions: Functions, settings: SolverSettings, warm: bool) -> Plugin:
    options: dict[str, Any] = {
        "tol": settings.tolerance,
        "max_iter": settings.max_iterations,
    }
    if settings.initial_barrier is not None:
        options["mu_init"] = settings.initial_barrier
        options["warm_start_init_point"] = "no"
        options["bound_push"] = options["bound_frac"] = settings.initial_barrier
    cache = {
        "nlp_jac_g": functions["jacobian"],
        "nlp_grad_f": functions["gradient"],
        "nlp_hess_l": functions["hessian_upper"],
    }
    options |= settings.options.get("ipopt", {})
    if warm:
        start = {
            "warm_start_init_point": "yes",
            "mu_init": LEAST_WARM_BARRIER,
            **dict.fromkeys(WARM_PUSHES, WARM_PUSH),
        }
        options = {**start, **options, **settings.options.get("ipopt warm", {})}
    return "ipopt", {"ipopt": as_ipopt_knows(options)}, cache


def _sqp(_: Program, functions: Functions, settings: SolverSettings, regularised: bool) -> Plugin:
    x, p, lam_f, lam_g = functions["hessian"].mx_in()
    g, jacobian = functions["jacobian"](x, p)
    f, slope = functions["gradient"](x, p)
    hessian = functions["hessian"](x, p, lam_f, lam_g)[1]
    cache = {
        "nlp_jac_fg": ca.Function("nlp_jac_fg", [x, p], [f, slope, g, jacobian]),
        "nlp_hess_l": ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [hessian]),
    }
    options: dict[str, Any] = {
        **SQP_OPTIONS,
        "max_iter": settings.max_iterations,
        "tol_pr": settings.tolerance,
        "tol_du": settings.tolerance,
        **settings.options.get("sqp", {}),
    }
    if regularised:
        options["convexify_strategy"] = "regularize"
    return "sqpmethod", options, cache
