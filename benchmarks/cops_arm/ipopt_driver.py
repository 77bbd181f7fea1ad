"""IPOPT as a driver of OpenMDAO, by cyipopt.

OpenMDAO's own drivers of IPOPT need pyOptSparse or modOpt, which the package index does not have.
OpenMDAO's own drivers of IPOPT need pyOptSparse or modOpt, which the package index does not have.
This driver replaces ``om.pyOptSparseDriver(optimizer="IPOPT")``: one run of the model per point,
one coloured sparse Jacobian per iteration, and the Hessian by limited-memory BFGS, because
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

import cyipopt
import numpy as np
from openmdao.core.driver import Driver, RecordingDebugging

Array = np.ndarray


class IpoptDriver(Driver):
    """Driver that minimises one objective under constraints by IPOPT.

    Attributes
    ----------
    opt_settings : options of IPOPT
    iterations, seconds : iterations and time of IPOPT in the last run
    """

    def __init__(self, **opt_settings: Any) -> None:
        super().__init__()
        self.opt_settings = {"hessian_approximation": "limited-memory", **opt_settings}
        self.supports._read_only = False
        for what in (
            "optimization",
            "gradients",
            "equality_constraints",
            "inequality_constraints",
            "two_sided_constraints",
            "simultaneous_derivatives",
            "total_jac_sparsity",
        ):
            self.supports[what] = True
        self.supports._read_only = True
        self.iterations, self.seconds = 0, 0.0

    def run(self) -> bool:
        """Run the optimisation; return True if IPOPT did not converge."""
        self.result.reset()
        self.iter_count, self._total_jac = 0, None
        self._check_for_missing_objective()
        start = _stacked(self.get_design_var_values()[name] for name in self._designvars)
        self._at: Array | None = None
        self._totals: Array | None = None
        self._evaluate(start)
        coloring = self._problem().get_total_coloring(self._coloring_info, run_model=False)
        rows = self.constraints(start).size
        pattern = (
            np.ones((1 + rows, start.size)) if coloring is None else coloring.get_dense_sparsity()
        )
        self._structure = np.nonzero(pattern[1:])
        lower, upper = self._limits("design_var", self._designvars)
        row_lower, row_upper = self._limits("constraint", self._cons)
        ipopt = cyipopt.Problem(
            start.size, rows, self, lb=lower, ub=upper, cl=row_lower, cu=row_upper
        )
        for name, value in self.opt_settings.items():
            ipopt.add_option(name, value)
        begin = time.perf_counter()
        x, info = ipopt.solve(start)
        self.seconds = time.perf_counter() - begin
        self._evaluate(x)
        return info["status"] not in (0, 1)

    def _limits(self, kind: str, names: Iterable[str]) -> tuple[Array, Array]:
        scaled = self._autoscaler.get_bounds_scaling(kind)
        sizes = {name: meta["size"] for name, meta in (self._designvars | self._cons).items()}
        lows, highs = [], []
        for name in names:
            limits = scaled[name]
            equal = getattr(limits, "equals", None)
            low, high = (limits.lower, limits.upper) if equal is None else (equal, equal)
            lows.append(np.full(sizes[name], -np.inf) if low is None else low)
            highs.append(np.full(sizes[name], np.inf) if high is None else high)
        return _stacked(lows), _stacked(highs)

    def _evaluate(self, x: Array) -> None:
        if self._at is not None and np.array_equal(x, self._at):
            return
        self._at, self._totals = x.copy(), None
        self._vectors["design_var"].set_data(x, driver_scaling=True)
        self._set_design_vars(driver_scaling=True)
        with RecordingDebugging("IPOPT", self.iter_count, self):
            self.iter_count += 1
            self._run_solve_nonlinear()

    def _derivatives(self, x: Array) -> Array:
        self._evaluate(x)
        if self._totals is None:
            self._totals = self._compute_totals(
                of=[*self._objs, *self._cons], wrt=list(self._designvars), return_format="array"
            ).copy()
        return self._totals

    # interface of cyipopt

    def objective(self, x: Array) -> float:
        self._evaluate(x)
        return float(_stacked(self.get_objective_values().values())[0])

    def gradient(self, x: Array) -> Array:
        return self._derivatives(x)[0]

    def constraints(self, x: Array) -> Array:
        self._evaluate(x)
        values = self.get_constraint_values()
        return _stacked(values[name] for name in self._cons)

    def jacobian(self, x: Array) -> Array:
        return self._derivatives(x)[1:][self._structure]

    def jacobianstructure(self) -> tuple[Array, Array]:
        return self._structure

    def intermediate(self, mode: int, iteration: int, *_: float) -> bool:
        self.iterations = iteration
        return True


def _stacked(parts: Iterable[Array]) -> Array:
    return np.concatenate([np.ravel(part) for part in parts])
