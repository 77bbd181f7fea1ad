"""Integration of a differential equation forced by a signal of time, in one integrator call.

Torques and references that are not formulas of time become Chebyshev series on pieces of the time,
so they may jump between two pieces without loss of accuracy.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.child_process import Died, OutOfTime, Send, can_fork, in_child
from microbot_ocp._base.fast_calls import FastCall, deferred_call
from microbot_ocp._base.status import Status
from microbot_ocp.simulation._dormand_prince import (
    NOT_FINITE,
    NOT_FINITE_AT_START,
    OVER,
    SHRUNK,
    TOO_MANY_STEPS,
    integrated,
    step_function,
)
from microbot_ocp.simulation._signals import Signal, series_value

TOLERANCE = 1e-10  # usual relative tolerance of a simulation
COARSEST = 1e-2  # largest tolerance of a simulation
BY_ERROR = ("cvodes", "idas")  # integrators of CasADi that control their error
INTEGRATORS = ("dop853", *BY_ERROR, "collocation", "rk")
LONGEST_STEP = 0.1  # longest step relative to a piece, so that no motion after a rest is skipped
STEPS = 64  # steps in one compiled call; the time limit is checked between calls

# Reasons by a part of the integrators' return codes; the first part that matches counts.
FAILURES = {
    "TOO_MUCH_WORK": TOO_MANY_STEPS,
    "TOO_MUCH_ACC": "the tolerance is below the accuracy of the machine",
    "ERR_FAIL": SHRUNK,
    "CONV_FAIL": SHRUNK,
    "FIRST_R": NOT_FINITE_AT_START,
    "RHSFUNC": NOT_FINITE,
    "RES_": NOT_FINITE,
}

Rate = Callable[[ca.SX, ca.SX, ca.SX, ca.SX], ca.SX]


class ForcedEquation(NamedTuple):
    """Differential equation ``x' = rate(t, x, w(t), parameters)`` forced by a signal w.

    Equal rates share one function, which is built once.

    CVODES is a multistep method and does not restart where its input jumps: a jump costs it
    accuracy or makes it fail. Its independent variable is therefore not t but s, which counts the
    pieces. Within a piece of length h, dt/ds = 30 h y^2 (1 - y)^2 with y = 0 to 1, so the time
    stands still at both edges and the right-hand side is continuous for every signal. The input of
    a piece holds its index, start and length and the coefficients of the signal. A single piece has
    dt/ds = h.
    """

    rate: Rate
    states: int
    signal: Signal
    parameters: FloatArray

    def steps(self) -> FastCall:
        """Return the steps of the Dormand-Prince method, whose inputs are :meth:`inputs`."""
        formula, pieces = self.signal.formula, self.signal.pieces
        kind = formula.serialize() if formula else pieces.coefficients.shape[1:] if pieces else ""
        return _steps(self.rate, self.states, self.parameters.size, kind)

    def inputs(self, start: float, end: float) -> tuple[FloatArray, FloatArray]:
        """Return the edges [K+1] of the pieces and the inputs of a step in each [K,m]."""
        pieces = self.signal.pieces
        edges = np.array([start, end]) if pieces is None else pieces.edges
        series = np.zeros((1, 0)) if pieces is None else pieces.coefficients
        parameters = np.broadcast_to(self.parameters, (edges.size - 1, self.parameters.size))
        each = [edges[:-1], np.diff(edges), parameters, series.reshape(edges.size - 1, -1)]
        return edges, np.column_stack(each)

    def equation(
        self, grid: FloatArray
    ) -> tuple[dict[str, ca.SX], FloatArray, FloatArray, np.ndarray]:
        """Return the equation in s for CasADi's integrators.

        Returns
        -------
        equation : dict
            Dictionary of CasADi.
        stops, inputs : array [K] and [p,K]
            Ends of all pieces and times of the grid after its first, as s, and the inputs there.
        wanted : array [N-1]
            Stop of each time of the grid.
        """
        edges, each = self.inputs(float(grid[0]), float(grid[-1]))
        inputs = np.column_stack([np.arange(float(len(each))), each])
        s, x, u = ca.SX.sym("s"), ca.SX.sym("x", self.states), ca.SX.sym("u", inputs.shape[1])
        y, series = s - u[0], u[3 + self.parameters.size :]
        if len(each) == 1:
            speed, place = u[2], y
        else:
            speed, place = u[2] * 30 * y**2 * (1 - y) ** 2, _place(y)
        t = u[1] + u[2] * place
        if self.signal.pieces is None:
            assert self.signal.formula is not None
            w = self.signal.formula(t)
        else:
            w = series_value(2 * place - 1, series, self.signal.pieces.coefficients.shape[1:])
        ode = speed * self.rate(t, x, w, ca.SX(ca.DM(self.parameters)))
        at = _stretched(grid, edges)[1:]
        stops = np.union1d(at, np.arange(1.0, edges.size))
        stops = stops[np.append(np.diff(stops) > ROUNDING, True)]
        piece = np.maximum(np.ceil(stops - ROUNDING), 1).astype(int) - 1
        wanted = np.searchsorted(stops, at - ROUNDING)
        return {"t": s, "x": x, "u": u, "ode": ode}, stops, inputs[piece].T, wanted


@lru_cache(maxsize=64)
def _steps(rate: Rate, states: int, parameters: int, kind: str | tuple[int, int]) -> FastCall:
    """Return :meth:`ForcedEquation.steps` for a formula or for series of a given shape."""
    size = 0 if isinstance(kind, str) else kind[0] * kind[1]
    t, x, u = ca.SX.sym("t"), ca.SX.sym("x", states), ca.SX.sym("u", 2 + parameters + size)
    if isinstance(kind, str):
        w = ca.Function.deserialize(kind)(t)
    else:
        w = series_value(2 * (t - u[0]) / u[1] - 1, u[2 + parameters :], kind)
    names = ["t", "x", "u"], ["rate"]
    function = ca.Function("rate", [t, x, u], [rate(t, x, w, u[2 : 2 + parameters])], *names)
    return deferred_call(step_function(function), STEPS, kept=True)


class IntegratorSettings(NamedTuple):
    """Integrator of ``INTEGRATORS`` with its tolerance and largest number of steps."""

    integrator: str
    tolerance: float
    max_steps: int


class IntegrationRun(NamedTuple):
    """Result of an integrator.

    ``states`` [N, states] belong to the times of the grid and are NaN after a failure. ``steps`` is
    the number of fixed steps. ``message`` gives the reason of a failure; ``trace`` then holds the
    times and states of a fixed-step run, which continues beyond the failure.
    """

    status: Status
    states: FloatArray
    steps: int = 0
    message: str = ""
    trace: tuple[FloatArray, FloatArray] | None = None


PARTS = 10  # integrator calls under a time limit; finished parts are kept
PROBING_STEPS = 2000  # steps of the fixed-step run that locates a failure


def integrate(
    forced: ForcedEquation, start: FloatArray, grid: FloatArray, settings: IntegratorSettings
) -> IntegrationRun:
    """Integrate the equation; return its states [N, states] at the times of the grid."""
    method = _by_steps if settings.integrator == "dop853" else _by_plugin
    run = method(forced, start, grid, settings)
    if run.status in (Status.SOLVED, Status.TIME_LIMIT) or settings.integrator == "rk":
        return run
    # A fixed-step run continues beyond the failure, so it shows where the states diverge.
    fixed = settings._replace(integrator="rk")
    return run._replace(trace=(grid, _plugin_states(forced, start, grid, fixed, PROBING_STEPS)))


def _by_steps(
    forced: ForcedEquation, start: FloatArray, grid: FloatArray, settings: IntegratorSettings
) -> IntegrationRun:
    """Integrate by the method of Dormand and Prince."""
    pieces = forced.inputs(float(grid[0]), float(grid[-1]))
    # The nodes of one step sample a whole series; a formula may vary faster than any step.
    longest = np.inf if forced.signal.pieces else LONGEST_STEP * (grid[-1] - grid[0])
    limits = settings.tolerance, settings.max_steps, longest
    states, message = integrated(forced.steps(), pieces, start, grid, *limits)
    if not message or message is OVER:
        status = Status.TIME_LIMIT if message else Status.SOLVED
        return IntegrationRun(status, states, message=message)
    return _failed(message, states)


def _by_plugin(
    forced: ForcedEquation, start: FloatArray, grid: FloatArray, settings: IntegratorSettings
) -> IntegrationRun:
    """Integrate with one of CasADi's integrators in one call."""
    arrived = np.full((grid.size, forced.states), np.nan)

    def work(send: Send) -> IntegrationRun:
        stops = forced.equation(grid)[1].size
        states = partial(_plugin_states, forced, start, grid, settings, send=send)
        return with_halved_steps(states, settings, max(stops, 32))

    def receive(states: FloatArray) -> None:
        arrived[: len(states)] = states

    run = within_deadline(work, receive)
    return run if run.states.size else run._replace(states=arrived)


def _plugin_states(
    forced: ForcedEquation,
    start: FloatArray,
    grid: FloatArray,
    settings: IntegratorSettings,
    steps: int,
    send: Send = lambda _: None,
) -> FloatArray:
    """Return the states [N, states] of an integrator of CasADi.

    Under a time limit those that control the error work in parts, and ``send`` gets the states
    after each.
    """
    equation, stops, inputs, wanted = forced.equation(grid)
    in_parts = settings.integrator in BY_ERROR and np.isfinite(deadline.until())
    name, options = plugin(settings, steps)
    states, low = start[None], 0.0
    for part in np.array_split(np.arange(stops.size), min(PARTS, stops.size) if in_parts else 1):
        run = ca.integrator("run", name, equation, low, stops[part].tolist(), options)
        states = np.vstack([states, run(x0=states[-1], u=inputs[:, part])["xf"].full().T])
        low = float(stops[part[-1]])
        if in_parts:
            send(states[np.append(0, wanted[wanted <= part[-1]] + 1)])
    return states[np.append(0, wanted + 1)]


def within_deadline(
    work: Callable[[Send], IntegrationRun], receive: Send = lambda _: None
) -> IntegrationRun:
    """Run ``work`` and return its result; under a time limit it runs in another process.

    ``receive`` gets what ``work`` sends. If the work does not finish, the result has no states.
    """
    if not (np.isfinite(deadline.until()) and can_fork()):
        return work(lambda _: None)

    def taken(part: FloatArray) -> bool:
        receive(part)
        return True

    try:
        return in_child(work, deadline.until(), taken)
    except OutOfTime:
        status, message = Status.TIME_LIMIT, OVER
    except Died:
        status, message = Status.INTEGRATION_FAILED, "the process of the integrator ended"
    return IntegrationRun(status, np.zeros((0, 0)), message=message)


def with_halved_steps(
    states: Callable[[int], FloatArray], settings: IntegratorSettings, steps: int
) -> IntegrationRun:
    """Return the result of an integrator; a fixed step is halved until two results agree."""
    most = max(settings.max_steps, 4 * steps)
    try:
        x = states(steps)
        if settings.integrator in BY_ERROR:
            finite = np.isfinite(x).all()
            return IntegrationRun(Status.SOLVED, x) if finite else _failed(NOT_FINITE, x)
        change, reason = np.inf, ""
        while not reason:
            steps *= 2
            finer = states(steps)
            with np.errstate(invalid="ignore"):
                before, change = change, float(np.abs(finer - x).max())
                size = 1.0 + float(np.abs(finer).max())
            x = finer
            if change <= settings.tolerance * size:
                return IntegrationRun(Status.SOLVED, x, steps)
            if change < ROUNDING * size and change > 0.5 * before:
                reason = "rounding errors are larger"
            elif 2 * steps > most:  # results that are not finite go on: a finer step may be
                reason = f"more than {most} steps needed"
    except RuntimeError as problem:
        return _failed(str(problem), np.zeros((0, 0)))
    if not np.isfinite(x).all():
        return _failed(NOT_FINITE, x)
    message = (
        f"tolerance of {settings.tolerance:.0e} not met: {reason} (the last two results differ by "
        f"{change:.1e})"
    )
    return IntegrationRun(Status.TOLERANCE_NOT_MET, x, steps, message)


def plugin(
    settings: IntegratorSettings, steps: int, span: float = 1.0
) -> tuple[str, dict[str, Any]]:
    """Return CasADi's name of an integrator and its options.

    ``steps`` is the number of fixed steps, ``span`` the length of a piece in the independent
    variable.
    """
    if settings.integrator == "rk":
        return "rk", {"number_of_finite_elements": steps, "show_eval_warnings": False}
    if settings.integrator == "collocation":
        rootfinder = {"error_on_fail": True, "show_eval_warnings": False}
        return "collocation", {
            "number_of_finite_elements": steps,
            "rootfinder_options": rootfinder,
        }
    options: dict[str, Any] = {
        "abstol": settings.tolerance,
        "reltol": settings.tolerance,
        "max_num_steps": settings.max_steps,
        "max_step_size": LONGEST_STEP * span,
        "disable_internal_warnings": True,
        "print_stats": False,
    }
    if settings.integrator == "cvodes":
        # Equations of arms are not stiff: Adams' method needs neither Jacobian nor linear solver.
        options["linear_multistep_method"] = "adams"
        options["nonlinear_solver_iteration"] = "functional"
    return settings.integrator, options


def _stretched(t: FloatArray, edges: FloatArray) -> FloatArray:
    """Return the independent variable s of :class:`ForcedEquation` at times t [N]."""
    count = edges.size - 1
    piece = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, count - 1)
    place = np.clip((t - edges[piece]) / np.diff(edges)[piece], 0.0, 1.0)
    if count == 1:
        return place
    low, high = np.zeros_like(place), np.ones_like(place)
    # Bisection inverts the time within a piece.
    for _ in range(60):
        y = 0.5 * (low + high)
        above = _place(y) > place
        low, high = np.where(above, low, y), np.where(above, y, high)
    inside = np.where((place > 0) & (place < 1), 0.5 * (low + high), place)
    return piece.astype(float) + inside


def _place(y: Any) -> Any:
    """Return the time within a piece as a share of its length."""
    return y**3 * (10 - 15 * y + 6 * y**2)


def _failed(message: str, states: FloatArray) -> IntegrationRun:
    """Return the failed run of an integrator, with the reason from its error message."""
    code = re.search(r"(?:CV|IDA)_([A-Z_]+)", message)
    reason = message.strip().split("\n")[-1]
    if code:
        meanings = (meaning for part, meaning in FAILURES.items() if part in code.group(1))
        reason = next(meanings, code.group())
    message = f"the integrator failed: {reason}"
    return IntegrationRun(Status.INTEGRATION_FAILED, states, message=message)
