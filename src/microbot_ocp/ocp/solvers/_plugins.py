"""How to solve a program, and the plugins of CasADi that do it: fatrop, IPOPT, its warm start, the
SQP method.

All get the derivatives of the stage kernels instead of an automatic differentiation of the whole
program, which would cost more time than the solve; fatrop gets the stages, too.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import InputError
from microbot_ocp.ocp.solution import Watch
from microbot_ocp.ocp.solvers._ldl import as_ipopt_knows, check_linear_solver
from microbot_ocp.ocp.transcription import Program
from microbot_ocp.ocp.transcription._assembly import MadeOnDemand

SOLVERS = ("fatrop", "ipopt", "sqp")
SCALINGS = ("auto", "declared")
CHAIN = ("ipopt", "fatrop")  # of "auto"


@dataclass(frozen=True)
class SolverSettings:
    """How to solve a program.

    Attributes
    ----------
    solver : "auto" (IPOPT, at last fatrop if it does not converge), "fatrop", "ipopt" or
        "sqp", or several of them in turn
    tolerance : optimality and feasibility of the scaled program
    max_iterations : limit for each solver
    initial_barrier : start of the barrier parameter; small for a warm start
    gap : how much the cost may be above that of the local optimum, relative to it (to a thousandth
        of its scale where it is less): a solve that converged goes on until it is known to be
        less; infinite to leave it at that, which ``solve`` then calls "gap left" where it is more
        than ``verify`` lets pass
    options : further options by solver name; "ipopt warm" are those of IPOPT from a solution with
        multipliers alone
    scaling : "auto" (sizes that were not declared are found, see
        ``ocp/starts/_scaling.py``) or "declared" (one where no scale was declared)
    time_limit : wall time after which a solve is stopped, s; of all solvers together
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
        """Return solvers to try in turn."""
        if not isinstance(self.solver, str):
            if not self.solver:
                raise InputError("solver must name at least one solver, or be 'auto'")
            return tuple(checks.one_of("solver", name, SOLVERS) for name in self.solver)
        checks.one_of("solver", self.solver, ("auto", *SOLVERS))
        return CHAIN if self.solver == "auto" else (self.solver,)

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return {**asdict(self), "options": {k: dict(v) for k, v in self.options.items()}}


@dataclass(frozen=True)
class PluginSettings:
    """What solvers are given in the place of numbers that are none, and how they start warm.

    Attributes
    ----------
    far : value and violation that fatrop gets where they are not finite
    largest : number that counts as finite
    cold_barrier : barrier parameter of a start without multipliers: IPOPT's own
    warm_barrier : of a start with them
    warm_push : distance from the bounds of such a start, relative
    """

    far: float = 1e10
    largest: float = 1e300
    cold_barrier: float = 0.1
    warm_barrier: float = 1e-7
    warm_push: float = 1e-4


SETTINGS = PluginSettings()

# Barrier parameters lowered gently: with the default jumps fatrop stalls on the flat minima that
# time-optimal problems have.
FATROP_OPTIONS = {
    "mu_superlinear_decrease_power": 1.05,
    "mu_linear_decrease_factor": 0.5,
    "print_level": 0,
}
# MUMPS pairs pivots by default before it orders them, which fills the factors of linked phases:
# 0.4 s instead of 0.06 s for three iterations (delta_launch of benchmarks/suite), or minutes. With
# the default, eleven times the memory that a factorisation is expected to take, the system hands
# out pages anew for each: 13 % of the time of a free motion of six joints. Where twice is too
# little IPOPT asks for more.
IPOPT_OPTIONS = {
    "print_level": 0,
    "sb": "yes",
    "mumps_pivtol": 1e-7,
    "mumps_permuting_scaling": 0,
    "mumps_pivot_order": 0,
    "mumps_mem_percent": 100,
    "acceptable_iter": 0,  # an acceptable level is no optimum
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
    """Return a solver of a program, with its derivatives and options; IPOPT stops itself after
    seconds of processor time, or where the wall time is over.
    """
    _keep_to_one_thread()
    common: dict[str, Any] = {
        "print_time": False,
        "calc_lam_p": False,
        "calc_lam_x": False,
        "error_on_fail": False,
        "show_eval_warnings": False,  # the advice reports it
    }
    make = {"fatrop": _fatrop, "ipopt": _ipopt, "sqp": _sqp}[name]
    functions = _with_scaled_cost(program)
    plugin, options, cache = make(program, functions, settings, variant)
    cache["nlp_grad"] = functions["lagrangian"]
    if name == "ipopt" and np.isfinite(seconds):
        wall = max(deadline.until() - time.perf_counter(), 1e-3)
        timed = {"max_cpu_time": max(seconds, 1e-3), **options["ipopt"]}
        if np.isfinite(wall):
            timed = {"max_wall_time": wall, **timed}
        options = {**options, "ipopt": timed}
    if watch is not None:
        options, cache = watch.hooked(options, cache)
    nlp = {**program.nlp, "f": program.nlp["f"] / program.cost_scale}
    if name == "fatrop":  # which would try steps for ever where values are not finite
        nlp = {**nlp, "f": ca.fmin(nlp["f"], SETTINGS.far), "g": ca.fmin(nlp["g"], SETTINGS.far)}
    return ca.nlpsol(name, plugin, nlp, {**common, **options, "cache": cache})


@lru_cache(maxsize=1)
def _keep_to_one_thread() -> None:
    """Let the OpenBLAS that IPOPT brings along work in one thread, unless the user says otherwise.

    Vectors of a few thousand entries are too short to be shared: its other threads wait in a loop,
    which is a tenth of the processor time on two cores. Its name is known on Linux alone, where the
    others beside it are copies that nothing uses.
    """
    if "OPENBLAS_NUM_THREADS" not in os.environ:
        library = Path(ca.GlobalOptions.getCasadiPath()) / "libcasadi-tp-openblas.so.0"
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(str(library)).openblas_set_num_threads(1)


Functions = Mapping[str, ca.Function]
Plugin = tuple[str, dict[str, Any], dict[str, ca.Function]]

# how many outputs of a function are of the cost: the first
_OF_COST = {"lagrangian": 1, "gradient": 2, "gradient_only": 1, "hessian": 0, "hessian_upper": 0}


def _with_scaled_cost(program: Program) -> Functions:
    """Return the functions of a program as solvers get them."""
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
    return MadeOnDemand({**changed, "jacobian": lambda: functions["jacobian"]})


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
    """Return the function with zeros where it has no value."""
    inputs, outputs = function.mx_in(), []
    for value in function.call(inputs):
        entries = value.nz[:]
        # the smaller of a number and what is none is the number
        bounded = ca.fmax(ca.fmin(entries, SETTINGS.largest), -SETTINGS.largest)
        bounded = ca.if_else(ca.fabs(bounded) < SETTINGS.largest, bounded, 0)
        outputs.append(ca.MX(value.sparsity(), bounded))
    return ca.Function(function.name(), inputs, outputs)


def _ipopt(_: Program, functions: Functions, settings: SolverSettings, warm: bool) -> Plugin:
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
        "nlp_jac_g": functions["jacobian"],
        "nlp_grad_f": functions["gradient"],
        "nlp_hess_l": functions["hessian_upper"],
    }
    options |= settings.options.get("ipopt", {})
    if warm:
        start = {
            "warm_start_init_point": "yes",
            "mu_init": SETTINGS.warm_barrier,
            **dict.fromkeys(WARM_PUSHES, SETTINGS.warm_push),
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
