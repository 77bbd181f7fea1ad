"""Live progress of a solve, and its interruption by Ctrl-C.

IPOPT and the SQP method call back at every iteration. fatrop has no callback: there the gradient of
the cost, evaluated once per iteration, reports. fatrop cannot be stopped either: it runs to its
end, and the iterate at the time of the request is returned. Without a progress function there are
no callbacks, except to keep the last iterate of a solver that may have to be killed.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.quiet import aloud
from microbot_ocp.ocp.problem import PythonFunction
from microbot_ocp.ocp.solution._solution import PhaseSolution, unpack
from microbot_ocp.ocp.transcription import Program


@dataclass(frozen=True, eq=False)
class Iteration:
    """State of a solve at an iteration.

    Attributes
    ----------
    solver : name of the solver
    number : number of iterations so far
    cost : cost of the iterate
    """

    solver: str
    number: int
    cost: float
    program: Program = field(repr=False)
    x: FloatArray = field(repr=False)

    def __str__(self) -> str:
        """Return one line of text."""
        return (
            f"{self.solver} {self.number}: cost {self.cost:.6g}, "
            f"infeasibility {self.infeasibility:.1e}"
        )

    @cached_property
    def infeasibility(self) -> float:
        """Largest violation of a bound or constraint, scaled."""
        return float(self.program.violations(self.x, self.program.row_values(self.x)).max())

    @property
    def phases(self) -> tuple[PhaseSolution, ...]:
        """Values by phase and name, like those of a solution."""
        return unpack(self.program.layouts, self.x)


Options = dict[str, Any]
Functions = dict[str, ca.Function]
Progress = Callable[[Iteration], object]
# Progress of several solves: their iterations, and a line of text for every step between them.
StepProgress = Callable[[Iteration | str], object]


def quiet(_: Iteration | str) -> None:
    """Report no progress; solves run without callbacks."""


@dataclass(eq=False)
class Watch:
    """Recorder of the last iterate, which also calls the progress function.

    Attributes
    ----------
    x : last iterate
    count : iterations so far
    stopped : True if the progress function or Ctrl-C requested a stop
    failure : other exception of the progress function, to be raised outside the solver
    """

    program: Program
    solver: str
    progress: Progress
    x: FloatArray | None = None
    count: int = -1
    stopped: bool = False
    failure: BaseException | None = None
    interrupted: Callable[[], bool] = bool  # returns True after Ctrl-C
    callback: ca.Callback | None = None  # kept alive here: CasADi holds no reference

    def hooked(self, options: Options, functions: Functions) -> tuple[Options, Functions]:
        """Return solver options and functions with the callbacks added."""
        if self.solver == "fatrop":
            self.callback = _GradientCall(self, functions["nlp_grad_f"])
            return options, {**functions, "nlp_grad_f": self.callback}
        self.callback = _IterationCall(self)
        return {**options, "iteration_callback": self.callback}, functions

    def report(self, x: FloatArray, cost: float | None = None) -> bool:
        """Record an iterate; return False if the solve should stop."""
        self.stopped = self.stopped or self.interrupted()
        if self.stopped or (self.x is not None and np.array_equal(x, self.x)):
            return not self.stopped
        self.x, self.count = x, self.count + 1
        if cost is None:
            cost = self.program.cost(x)
        try:
            with aloud():
                self.progress(Iteration(self.solver, self.count, cost, self.program, x))
        except BaseException as problem:  # raised by the caller: solvers would suppress it
            self.stopped = True
            if not _interrupts(problem):
                self.failure = problem
        return not self.stopped

    def record(self, x: Any, cost: Any = None) -> bool:
        """Record an iterate and scaled cost from a solver, keeping interrupts inside."""
        try:
            whole = None if cost is None else float(cost) * self.program.cost_scale
            return self.report(np.array(x).ravel(), whole)
        except BaseException as problem:
            if not _interrupts(problem):
                raise
            self.stopped = True  # raised by a signal: CasADi would print a traceback
            return False


class LastIterate(Watch):
    """Recorder of the last iterate in memory that is shared with a forked process."""

    def __init__(self, program: Program, solver: str) -> None:
        super().__init__(program, solver, quiet)
        memory = mmap.mmap(-1, 8 * (1 + program.variable_lower.size))
        self.count_and_x = np.frombuffer(memory)

    def report(self, x: FloatArray, cost: float | None = None) -> bool:
        """Record an iterate; return True."""
        self.count_and_x[1:] = x
        self.count_and_x[0] += 1.0
        return True

    def look(self) -> int:
        """Copy the iterate that the forked process wrote; return the iterations so far."""
        count = int(self.count_and_x[0])
        if count:
            self.x, self.count = self.count_and_x[1:].copy(), count - 1
        return count


class _IterationCall(PythonFunction):
    """Callback of IPOPT and the SQP method at every iteration; its value 1 stops them."""

    def __init__(self, watch: Watch) -> None:
        self.watch, program = watch, watch.program
        x, g = program.variable_lower.size, program.row_lower.size
        outputs = {"x": x, "f": 1, "g": g, "lam_x": x, "lam_g": g, "lam_p": program.parameters.size}
        inputs = [ca.Sparsity.dense(outputs[name]) for name in ca.nlpsol_out()]
        super().__init__("iteration", inputs, ca.Sparsity.dense(1))

    def eval(self, arguments: Any) -> list[float]:
        return [0.0 if self.watch.record(*arguments[:2]) else 1.0]


class _GradientCall(PythonFunction):
    """Gradient of the cost that reports each point of evaluation."""

    def __init__(self, watch: Watch, gradient: ca.Function) -> None:
        self.watch, self.inner = watch, gradient
        inputs = [gradient.sparsity_in(k) for k in range(gradient.n_in())]
        super().__init__("nlp_grad_f", inputs, gradient.sparsity_out(0))

    def eval(self, arguments: Any) -> list[ca.DM]:
        self.watch.record(arguments[0])  # the result is ignored: fatrop cannot be stopped here
        return self.inner.call(arguments)


def _interrupts(problem: BaseException | None) -> bool:
    """Return True for a KeyboardInterrupt, also wrapped by CasADi's conversion to arrays."""
    while problem is not None and not isinstance(problem, KeyboardInterrupt):
        problem = problem.__cause__ or problem.__context__
    return problem is not None
