"""How to solve a program."""

from __future__ import annotations

import faulthandler
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError, shown
from microbot_ocp._base.child_process import Died, can_fork, in_child
from microbot_ocp.ocp.solvers._ldl import NAME

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
        ``ocp/solution/_scaling.py``) or "declared" (one where no scale was declared)
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
        """Plain values for JSON."""
        return {**asdict(self), "options": {k: dict(v) for k, v in self.options.items()}}


# linear solvers -----------------------------------------------------------------------------------

# that IPOPT knows, whether they are installed or not
LINEAR_SOLVERS = ("mumps", "ma27", "ma57", "ma77", "ma86", "ma97", "pardiso", "spral")


def check_linear_solver(name: Any) -> None:
    """Refuse one that is not there, with which IPOPT would stop at once, or end the process.

    Raises
    ------
    InputError
    """
    if name in (NAME, LINEAR_SOLVERS[0]):
        return
    if name not in LINEAR_SOLVERS or not _works(name):
        there = [NAME, *(other for other in LINEAR_SOLVERS if _works(other))]
        raise InputError(
            f"linear_solver of the options of ipopt must be one that is installed, "
            f"{', '.join(there)}, not {shown(name)}"
        )


@cache
def _works(name: str) -> bool:
    """Return whether IPOPT solves something by this linear solver; some end the process without
    it.
    """

    def tried() -> bool:
        x = ca.MX.sym("x")
        silent = {"print_level": 0, "sb": "yes", "linear_solver": name}
        options = {"print_time": False, "error_on_fail": False, "ipopt": silent}
        try:
            solver = ca.nlpsol("tried", "ipopt", {"x": x, "f": x**2}, options)
            solver(x0=1.0)
            return bool(solver.stats()["success"])
        except RuntimeError:
            return False

    def quietly(_: object) -> bool:
        faulthandler.disable()
        return tried()

    try:
        return in_child(quietly, np.inf) if can_fork() else tried()
    except Died:
        return False
