"""How to solve a program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError

SOLVERS = ("fatrop", "ipopt", "sqp")
SCALINGS = ("auto", "declared")
CHAIN = ("fatrop", "ipopt")  # of "auto"


@dataclass(frozen=True)
class SolverSettings:
    """How to solve a program.

    Attributes
    ----------
    solver : "auto" (fatrop, then IPOPT if it does not converge), "fatrop", "ipopt" or "sqp"
    tolerance : optimality and feasibility of the scaled program
    max_iterations : limit for each solver
    initial_barrier : start of the barrier parameter; small for a warm start
    gap : how much the cost may be above that of the local optimum, relative to it (to a thousandth
        of its scale where it is less): a solve that converged goes on until it is known to be
        less; infinite to leave it at that
    options : further options by solver name
    scaling : "auto" (sizes that were not declared are found, see
        ``ocp/solution/_scaling.py``) or "declared" (one where no scale was declared)
    """

    solver: str = "auto"
    tolerance: float = 1e-7
    gap: float = 1e-6
    max_iterations: int = 300
    initial_barrier: float | None = None
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    scaling: str = "auto"

    def __post_init__(self) -> None:
        checks.one_of("scaling", self.scaling, SCALINGS)
        checks.number("tolerance", self.tolerance, above=0.0)
        if not self.gap > 0:
            raise InputError(f"gap must be above 0, not {self.gap}")
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
