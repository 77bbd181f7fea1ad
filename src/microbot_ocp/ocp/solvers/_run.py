"""One run of a solver on a program, judged by its report and by the point that it returns."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from threading import get_ident
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import deadline, interrupts
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.child_process import Died, OutOfTime, Send, can_fork, in_child
from microbot_ocp._base.quiet import quiet
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.solution import Attempt, LastIterate, Progress, StartingPoint, Watch
from microbot_ocp.ocp.solvers._ldl import BAND
from microbot_ocp.ocp.solvers._plugins import SolverSettings, create
from microbot_ocp.ocp.transcription import Program

LARGE_PROGRAM = 2000  # variables above which one factorisation of IPOPT may exceed a time limit
# A solver stops before its process is killed, so that its last point is returned.
EARLIER_SHARE = 0.02  # fraction of the time limit by which it stops earlier
LEAST_EARLIER = 0.1  # s


@dataclass(frozen=True, eq=False)
class SolverOutcome:
    """Result of one run of a solver."""

    attempt: Attempt
    point: StartingPoint


# Keys: name, variant, scale of the cost and thread.
Solvers = dict[tuple[str, bool, float, int], ca.Function]


@dataclass(frozen=True, eq=False)
class _Answer:
    """Result of a solver call as plain values; ``values`` is empty if it failed."""

    values: Mapping[str, FloatArray] = field(default_factory=dict)
    stats: Mapping[str, Any] = field(default_factory=dict)
    broken: str = ""
    out_of_time: bool = False
    interrupted: bool = False  # True after Ctrl-C


@dataclass(frozen=True, eq=False)
class Runner:
    """Solvers of one program.

    Attributes
    ----------
    program : Program
    settings : SolverSettings
    progress : callable, optional
    solvers : cache of solvers of the program, shared with other solves
    """

    program: Program
    settings: SolverSettings
    progress: Progress | None = None
    solvers: Solvers | None = None

    def run(self, name: str, start: StartingPoint, *, variant: bool = False) -> SolverOutcome:
        """Run one solver from a start, and return its checked result."""
        begin = time.perf_counter()
        forks = not self._trusted(name, start.x.size) and can_fork()
        watch = None if self.progress is None else Watch(self.program, name, self.progress)
        left = self.settings.time_limit
        if self.solvers is None:
            left = deadline.left()
            if forks:  # stop before the process is killed, so that the result is returned
                left -= max(EARLIER_SHARE * left, LEAST_EARLIER)
                watch = watch or LastIterate(self.program, name)
        solver = (
            _Answer(interrupted=True)
            if interrupts.pressed()
            else self._solver(name, variant, watch, left)
        )
        created, arguments = time.perf_counter(), arguments_of(self.program, start)
        if isinstance(solver, _Answer):
            answer = solver
        elif forks:
            answer = _answered_by_child(solver, arguments, name, watch)
        else:
            # IPOPT and the SQP method check for an exception at every evaluation and stop. fatrop
            # does not check, so an exception would only discard its result.
            with interrupts.noted(is_raised=name != "fatrop") as interrupted:
                if watch is not None:
                    watch.interrupted = interrupted
                try:
                    with quiet("stderr"):  # functions that fail at a trial point print their inputs
                        result = solver(**arguments)
                    answer = replace(_plain(solver, result), interrupted=interrupted())
                except (KeyboardInterrupt, RuntimeError) as problem:
                    answer = _failed(problem, interrupted(), watch)
        refused = answer.broken and self.settings.options.get(name)
        if refused and "option" in answer.broken.lower():
            raise InputError(f"options of {name} were rejected: {answer.broken}")
        done = time.perf_counter()
        if watch is not None and watch.failure is not None:
            raise watch.failure
        times = {"wall_time": done - created, "create_time": created - begin}
        outcome = self._outcome(name, start, answer, watch, times)
        return self._accepted(outcome) if answer.values else outcome

    def _trusted(self, name: str, size: int) -> bool:
        """Return True if a solver needs no separate process to keep its time limit."""
        # A cached solver was built with the time limit of the settings, not with that of this call.
        reused = self.solvers is not None and self.progress is None
        endless = reused and not np.isfinite(self.settings.time_limit)
        banded = self.settings.options.get("ipopt", {}).get("linear_solver") == BAND
        short = (size <= LARGE_PROGRAM or banded) and not endless
        return name == "ipopt" and (short or not np.isfinite(deadline.left()))

    def _solver(
        self, name: str, variant: bool, watch: Watch | None, seconds: float
    ) -> ca.Function | _Answer:
        """Return a solver, cached if possible; an answer if it could not be built.

        A solver with a watch is not cached.
        """
        key = (name, variant, self.program.cost_scale, get_ident())
        solvers = self.solvers if self.solvers is not None and watch is None else {}
        if key not in solvers:
            given = self.program, name, self.settings
            try:
                solvers[key] = create(*given, variant=variant, watch=watch, seconds=seconds)
            except RuntimeError as problem:
                return _Answer(broken=first_cause(problem))
        return solvers[key]

    def _outcome(
        self, name: str, start: StartingPoint, answer: _Answer, watch: Watch | None, times: Any
    ) -> SolverOutcome:
        """Return the result of a call, with cost and violation evaluated independently."""
        program, stats, result = self.program, answer.stats, answer.values
        stopped = answer.interrupted or (watch is not None and watch.stopped)
        if stopped:
            interrupts.note()
        last = start.x if watch is None or watch.x is None else watch.x
        x = last if not result or (stopped and watch is not None) else result["x"]
        cost, infeasibility = checked(program, x)
        status = status_of(name, stats, self.settings, infeasibility)
        message = answer.broken or str(stats.get("return_status", ""))
        if answer.out_of_time:
            status, message = Status.TIME_LIMIT, "did not return and was ended"
        count = stats.get("iter_count", -1) if not answer.broken else -1
        if count < 0:  # a failed solver reports no iterations
            count = max(0 if watch is None else watch.count, 0)
        attempt = Attempt(
            solver=name,
            status=Status.INTERRUPTED if stopped else status,
            message=message,
            iterations=int(count),
            cost=cost,
            infeasibility=infeasibility,
            **times,
            function_time=sum(v for k, v in stats.items() if k.startswith("t_wall_nlp_")),
            broke_down=bool(answer.broken),
        )
        # Solvers return the multipliers of bounds directly; CasADi's own computation is off.
        rows, variables = (
            result[key] * program.cost_scale if result else np.zeros(size)
            for key, size in (("lam_g", program.row_lower.size), ("lam_x", x.size))
        )
        return SolverOutcome(attempt, StartingPoint(x, rows, variables))

    def _accepted(self, outcome: SolverOutcome) -> SolverOutcome:
        """Return the outcome, with status solved if a stopped solver is at an optimum."""
        attempt, point = outcome.attempt, outcome.point
        stopped = attempt.status in (Status.ITERATION_LIMIT, Status.FAILED)
        if not stopped or attempt.solver == "sqp":
            return outcome
        passed = accepted(self.program, point, self.settings.tolerance)
        if passed is None:
            return outcome
        point, error = passed
        message = f"stopped, but its point is an optimum to {error:.1e}"
        return SolverOutcome(replace(attempt, status=Status.SOLVED, message=message), point)


def arguments_of(program: Program, start: StartingPoint) -> dict[str, Any]:
    """Return the arguments of a solver call."""
    arguments: dict[str, Any] = {
        "x0": start.x,
        "p": program.parameters,
        "lbx": program.variable_lower,
        "ubx": program.variable_upper,
        "lbg": program.row_lower,
        "ubg": program.row_upper,
    }
    if start.warm:
        arguments["lam_x0"] = np.asarray(start.variable_multipliers) / program.cost_scale
        arguments["lam_g0"] = np.asarray(start.row_multipliers) / program.cost_scale
    return arguments


def _failed(problem: BaseException, interrupted: bool, watch: Watch | None) -> _Answer:
    """Return the answer of a solver that raised an exception; raise one that nobody asked for."""
    asked = interrupted or (watch is not None and watch.stopped)
    if isinstance(problem, KeyboardInterrupt) and not asked:
        raise problem
    # An exception discards the result of the SQP method.
    return _Answer(broken="" if asked else first_cause(problem), interrupted=interrupted)


def _plain(solver: ca.Function, result: Mapping[str, ca.DM]) -> _Answer:
    """Return the result of a solver call as plain values, with its statistics."""
    values = {key: np.array(result[key]).ravel() for key in ("x", "lam_g", "lam_x")}
    try:
        stats = solver.stats()
    except RuntimeError:  # raised by the SQP method after a failed quadratic program
        stats = {}
    return _Answer(
        values, {k: v for k, v in stats.items() if isinstance(v, bool | int | float | str)}
    )


LONGEST_RUN = 600.0  # s, for a solver that may not end by itself, if no time limit is set
# fatrop loops forever if no regularisation makes its matrix definite. The counter includes the
# previous work of the process.
LONGEST_SILENCE = 10.0  # processor time without an evaluation after which fatrop is killed, s


def _answered_by_child(
    solver: ca.Function, arguments: Mapping[str, Any], name: str, watch: Watch | None
) -> _Answer:
    """Return the answer of a solver in another process, which ends at the time limit."""
    last_iterate = watch if isinstance(watch, LastIterate) else None

    def work(send: Send) -> _Answer:
        if (
            watch is not None and last_iterate is None
        ):  # send iterates to the parent, which reports them
            watch.report = lambda x, cost=None: send((x, cost)) is None
        try:
            with quiet("stderr"):
                return _plain(solver, solver(**arguments))
        except (KeyboardInterrupt, RuntimeError) as problem:
            return _Answer(broken=first_cause(problem))

    def receive(iterate: tuple[FloatArray, float]) -> bool:
        assert watch is not None
        return watch.report(*iterate)

    until = min(deadline.until(), time.perf_counter() + LONGEST_RUN)
    # fatrop may loop forever between evaluations.
    silence = LONGEST_SILENCE if name == "fatrop" and watch is not None else np.inf
    look = None if last_iterate is None else last_iterate.look
    try:
        most = deadline.work_left()
        return in_child(work, until, receive, silence=silence, steps=look, most=most)
    except OutOfTime:
        return _Answer(out_of_time=True)
    except Died:
        return _Answer(broken="the process of the solver ended")
    except KeyboardInterrupt:
        # Raised by the progress function, by its error handling, or by the keyboard.
        return _Answer(interrupted=watch is None or watch.failure is None)
    finally:
        if last_iterate is not None:
            last_iterate.look()


# status of a run ----------------------------------------------------------------------------------

FEASIBLE = 1e-4  # largest scaled violation at which a reported success is accepted


def status_of(
    name: str, stats: Mapping[str, Any], settings: SolverSettings, infeasibility: float
) -> Status:
    """Return the status from the statistics of a solver and the violation at its point."""
    message = str(stats.get("return_status", ""))
    options = settings.options.get(name, {})
    limit = options.get("max_iter", settings.max_iterations)
    if "Time" in message:  # Maximum_WallTime_Exceeded, Maximum_CpuTime_Exceeded
        return Status.TIME_LIMIT
    if "Acceptable" in message and not (options.get("acceptable_iter") and settings.gap == np.inf):
        return Status.FAILED  # the options do not request this level
    if stats.get("success"):  # fatrop reports success even at points that are not finite
        return Status.SOLVED if infeasibility <= FEASIBLE else Status.FAILED
    if stats.get("unified_return_status") == "SOLVER_RET_LIMITED" or "Maximum" in message:
        return Status.ITERATION_LIMIT
    if name == "fatrop" and stats.get("iter_count", -1) >= limit:  # it gives no reason
        return Status.ITERATION_LIMIT
    if "Infeasible" in message or "Restoration" in message:
        return Status.INFEASIBLE
    if "User" in message:
        return Status.INTERRUPTED
    return Status.FAILED


def first_cause(problem: BaseException) -> str:
    """Return the innermost line of a CasADi error, without source locations."""
    lines = [line.strip() for line in str(problem).splitlines() if line.strip()]
    rest = [line for line in lines if not line.startswith("Error in ")] or lines or [repr(problem)]
    return re.sub(r"^\S+\.\w+:\d+: | (at: /|\[\.\.\./).*$", "", rest[-1])


def checked(program: Program, x: FloatArray) -> tuple[float, float]:
    """Return the cost and the largest violation of a bound or row at x, evaluated independently."""
    try:
        with quiet():
            cost = program.cost(x)
            worst = float(program.violations(x, program.row_values(x)).max())
    except RuntimeError:  # an integrator fails at x
        return np.inf, np.inf
    return cost, worst if np.isfinite(cost) else np.inf


# optimality of a stopped run ----------------------------------------------------------------------

# Once its steps are zero, fatrop no longer updates the multipliers of equations, and continues to
# the iteration limit or fails: for a linear-quadratic problem without inequalities it has the
# solution after one iteration without detecting it. The multipliers of equations are therefore
# computed by least squares before the Karush-Kuhn-Tucker conditions are checked.

REGULAR = 1e-14  # regularisation for linearly dependent equations


def accepted(
    program: Program, point: StartingPoint, tolerance: float
) -> tuple[StartingPoint, float] | None:
    """Return the point with multipliers that prove optimality, and the largest error; or None.

    Multipliers of inequalities are those of the solver, except that values smaller than the
    distance to their limit, left by a barrier, are set to zero; they must have the right sign and
    vanish away from their limits. Errors refer to the scaled program with the cost divided by its
    scale, and are judged as in IPOPT (Waechter and Biegler, 2006, equation 5).
    """
    x, multipliers = point.x, point.multipliers
    g, jacobian = program.functions["jacobian"](x, program.parameters)
    _, slope = program.functions["gradient"](x, program.parameters)
    rows = np.array(g).ravel()
    finite = all(np.isfinite(v).all() for v in (x, rows, *multipliers))
    if not finite or not program.violations(x, rows).max() <= tolerance:
        return None
    low, high, value = program.lower, program.upper, np.concatenate([rows, x])
    lam = np.concatenate(multipliers) / program.cost_scale
    decided = np.flatnonzero(low == high)
    lam[decided] = 0.0
    lam[np.abs(lam) < np.where(lam > 0, high - value, value - low)] = 0.0
    given = np.array(slope).ravel() / program.cost_scale
    given = given + np.array(ca.mtimes(jacobian.T, ca.DM(lam[: rows.size]))).ravel()
    given = given + lam[rows.size :]
    slopes = ca.vertcat(jacobian, ca.DM.eye(x.size))[decided.tolist(), :]
    # Stationarity: lam of the equations minimises |given + slopes' lam|.
    try:
        lam[decided], left = _least_squares(slopes, given)
    except RuntimeError:  # the matrix is singular
        return None
    # Complementarity error: multiplier times distance; an infinite limit needs a zero multiplier.
    distance = np.where(lam > 0, high - value, value - low)
    weight = np.where(np.isfinite(distance), np.maximum(distance, 0.0), 1.0)
    acts = (lam != 0) & (low < high)
    error = max(np.abs(left).max(), np.max(np.abs(lam) * weight, where=acts, initial=0.0))
    error /= max(100.0, np.mean(np.abs(lam))) / 100.0
    if not error <= tolerance:
        return None
    lam *= program.cost_scale
    return StartingPoint(x, lam[: rows.size], lam[rows.size :]), float(error)


def _least_squares(slopes: ca.DM, given: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return multipliers that minimise ``|given + slopes' lam|``, and the residual.

    Solves the augmented system ``[I, A'; A, -eps I]`` with A = slopes.
    """
    count = slopes.shape[0]
    matrix = ca.blockcat([[ca.DM.eye(given.size), slopes.T], [slopes, -REGULAR * ca.DM.eye(count)]])
    right = ca.DM(np.concatenate([-given, np.zeros(count)]))
    lam = np.array(ca.solve(matrix, right, "qr")).ravel()[given.size :]
    return lam, given + np.array(ca.mtimes(slopes.T, ca.DM(lam))).ravel()
