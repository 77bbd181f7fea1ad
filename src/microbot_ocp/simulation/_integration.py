"""Integration of a differential equation forced by a signal of time, in one integrator call.

Torques and references that are not formulas of time become Chebyshev series on pieces of the time,
so they may jump between two pieces without loss of accuracy.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

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

Values = Callable[[FloatArray], FloatArray]  # maps times [N] to values [N,m]

TOLERANCE = 1e-10  # usual relative tolerance of a simulation
COARSEST = 1e-2  # largest tolerance of a simulation
INTEGRATORS = ("dop853", "cvodes", "idas", "collocation", "rk")

DEGREE = 10  # degree of the Chebyshev series of an input between breaks
FIT_ERROR = 1e-11  # largest error of the series, relative to the largest value
LONGEST_STEP = 0.1  # longest step relative to a piece, so that no motion after a rest is skipped


# Chebyshev nodes exclude the ends of a piece, because a signal has two values at a break.
NODES = -np.cos((2 * np.arange(DEGREE + 1) + 1) * np.pi / (2 * DEGREE + 2))
FIT = np.linalg.inv(np.polynomial.chebyshev.chebvander(NODES, DEGREE))
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


class Pieces(NamedTuple):
    """A signal as Chebyshev series in time: ``edges`` [K+1], coefficients [K, degree+1, m]."""

    edges: FloatArray
    coefficients: FloatArray


class Signal(NamedTuple):
    """Signal of time: a formula, or values with Chebyshev series that fit them between breaks.

    ``formula`` is a CasADi function ``(t) -> w[m]``; a formula has no ``pieces``. ``values``
    returns the signal [N,m] at times [N].
    """

    values: Values
    formula: ca.Function | None = None
    pieces: Pieces | None = None


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

    def equation(self, start: float, end: float) -> tuple[dict[str, ca.SX], FloatArray, FloatArray]:
        """Return CasADi's dictionary of the equation in s, the edges [K+1] and the inputs [p,K]."""
        edges, each = self.inputs(start, end)
        inputs = np.column_stack([np.arange(float(len(each))), each])
        s, x, u = ca.SX.sym("s"), ca.SX.sym("x", self.states), ca.SX.sym("u", inputs.shape[1])
        y, series = s - u[0], u[3 + self.parameters.size :]
        if len(each) == 1:
            speed, place = u[2], y
        else:
            speed, place = u[2] * 30 * y**2 * (1 - y) ** 2, y**3 * (10 - 15 * y + 6 * y**2)
        t = u[1] + u[2] * place
        if self.signal.pieces is None:
            assert self.signal.formula is not None
            w = self.signal.formula(t)
        else:
            w = _series(2 * place - 1, series, self.signal.pieces.coefficients.shape[1:])
        ode = speed * self.rate(t, x, w, ca.SX(ca.DM(self.parameters)))
        return {"t": s, "x": x, "u": u, "ode": ode}, edges, inputs.T


@lru_cache(maxsize=64)
def _steps(rate: Rate, states: int, parameters: int, kind: str | tuple[int, int]) -> FastCall:
    """Return :meth:`ForcedEquation.steps` for a formula or for series of a given shape."""
    size = 0 if isinstance(kind, str) else kind[0] * kind[1]
    t, x, u = ca.SX.sym("t"), ca.SX.sym("x", states), ca.SX.sym("u", 2 + parameters + size)
    if isinstance(kind, str):
        w = ca.Function.deserialize(kind)(t)
    else:
        w = _series(2 * (t - u[0]) / u[1] - 1, u[2 + parameters :], kind)
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


SHORTEST_PIECE = 0.5e-3  # length below which a piece without break is not divided, s


def fitted(values: Values, breaks: FloatArray, tolerance: ArrayLike) -> Signal:
    """Fit values by a Chebyshev series on every piece of the time.

    Pieces start as the whole time and are divided at the break nearest to their middle, so that
    smooth intervals keep long pieces and a jump ends up between two pieces.

    Parameters
    ----------
    values : callable
        Function from times [N] to values [N,m]; it is never evaluated at a break.
    breaks : array [K+1]
        Times at which the values or their derivatives may jump, both ends included, s.
    tolerance : array_like [m]
        Largest error of each column.
    """
    tolerance = np.maximum(tolerance, 1e-17)
    probes = -np.cos((np.arange(DEGREE) + 1) * np.pi / (DEGREE + 1))
    probe = np.polynomial.chebyshev.chebvander(probes, DEGREE)
    both = np.concatenate([NODES, probes])
    todo = [(float(breaks[0]), float(breaks[-1]))]
    edges: list[float] = []
    coefficients: list[FloatArray] = []
    while todo:
        spans = np.array(todo)
        middle, half = spans.mean(axis=1), 0.5 * np.diff(spans, axis=1)[:, 0]
        t = middle[:, None] + half[:, None] * both
        samples = values(t.ravel()).reshape(*t.shape, -1)
        series = FIT @ samples[:, : DEGREE + 1]
        error = np.abs(probe @ series - samples[:, DEGREE + 1 :]).max(axis=1)
        fits = (error <= tolerance).all(axis=1)
        todo = []
        for (start, end), good, polynomial in zip(spans, fits, series, strict=True):
            low = np.searchsorted(breaks, start, side="right")
            inner = breaks[low : np.searchsorted(breaks, end, side="left")]
            if good or not (inner.size or end - start > SHORTEST_PIECE):
                edges.append(start)
                coefficients.append(polynomial)
                continue
            cut = 0.5 * (start + end)
            if inner.size:
                cut = float(inner[np.abs(inner - cut).argmin()])
            todo += [(start, cut), (cut, end)]
    order = np.argsort(edges)
    pieces = Pieces(np.append(np.array(edges)[order], breaks[-1]), np.array(coefficients)[order])
    return Signal(values, None, pieces)


def _series(place: ca.SX, flat: ca.SX, shape: tuple[int, ...]) -> ca.SX:
    """Return the value [m] of Chebyshev series at ``place`` in [-1, 1] by Clenshaw's recurrence."""
    terms, width = shape
    series = ca.reshape(flat, width, terms)
    later, latest = ca.SX.zeros(width), ca.SX.zeros(width)
    for k in range(terms - 1, 0, -1):
        later, latest = series[:, k] + 2 * place * later - latest, later
    return series[:, 0] + place * later - latest


def formula_signal(t: ca.SX, expression: ca.SX) -> Signal:
    """Return the signal of an expression [m] of the time ``t``."""
    function = ca.Function("signal", [t], [ca.densify(expression)], ["t"], ["w"])

    def values(times: FloatArray) -> FloatArray:
        return np.array(function.map(times.size)(times[None, :])).T

    return Signal(values, function)


def integrate(
    forced: ForcedEquation, start: FloatArray, grid: FloatArray, settings: IntegratorSettings
) -> IntegrationRun:
    """Integrate the equation; return its states [N, states] at the times of the grid."""
    if settings.integrator != "dop853":
        return _by_plugin(forced, start, grid, settings)
    pieces = forced.inputs(float(grid[0]), float(grid[-1]))
    # The nodes of one step sample a whole series; a formula may vary faster than any step.
    longest = np.inf if forced.signal.pieces else LONGEST_STEP * (grid[-1] - grid[0])
    limits = settings.tolerance, settings.max_steps, longest
    states, message = integrated(forced.steps(), pieces, start, grid, *limits)
    if not message:
        return IntegrationRun(Status.SOLVED, states)
    if message is OVER:
        return run_without_states(Status.TIME_LIMIT, OVER)._replace(states=states)
    # A fixed-step run continues beyond the failure, so it shows where the failure is.
    settings = settings._replace(integrator="rk")
    return _by_plugin(forced, start, grid, settings, _failed(message, states))


PARTS = 10  # integrator calls under a time limit; finished parts are kept
PROBING_STEPS = 2000  # steps of the fixed-step run that locates a failure


def _by_plugin(
    forced: ForcedEquation,
    start: FloatArray,
    grid: FloatArray,
    settings: IntegratorSettings,
    failed: IntegrationRun | None = None,
) -> IntegrationRun:
    """Integrate with one of CasADi's integrators in one call, or trace a failed run."""
    equation, edges, inputs = forced.equation(float(grid[0]), float(grid[-1]))
    s = _stretched(grid, edges)
    stops = np.union1d(s[1:], np.arange(1.0, edges.size))
    stops = stops[np.append(np.diff(stops) > 1e-13 * edges.size, True)]
    wanted = np.clip(np.searchsorted(stops, s[1:] - 1e-12 * edges.size), 0, stops.size - 1)
    piece = np.clip(np.ceil(stops - ROUNDING).astype(int) - 1, 0, edges.size - 2)

    by_error = settings.integrator in ("cvodes", "idas")
    limited = np.isfinite(deadline.until())
    parts = np.array_split(np.arange(stops.size), PARTS if limited and by_error else 1)

    def states(steps: int, send: Send = lambda _: None) -> FloatArray:
        name, options = plugin(settings, steps)
        x, low, rows = start, 0.0, []
        for part in filter(np.size, parts):
            run = ca.integrator("run", name, equation, low, stops[part].tolist(), options)
            rows.append(run(x0=x, u=inputs[:, piece[part]])["xf"].full().T)
            x, low = rows[-1][-1], float(stops[part[-1]])
            send(rows[-1])
        return np.vstack([start, np.vstack(rows)[wanted]])

    def work(send: Send) -> IntegrationRun:
        return with_halved_steps(lambda steps: states(steps, send), settings, max(stops.size, 32))

    arrived: list[FloatArray] = []
    run = failed or within_deadline(work, run_without_states, arrived.append)
    if run.status is Status.TIME_LIMIT:
        rows = np.full((stops.size, forced.states), np.nan)
        if by_error and arrived:
            rows[: sum(map(len, arrived))] = np.vstack(arrived)
        return run._replace(states=np.vstack([start, rows[wanted]]))
    if not run.states.size:
        run = run._replace(states=np.full((grid.size, forced.states), np.nan))
    if run.status.solved or (settings.integrator == "rk" and not failed):
        return run
    # A fixed-step run continues beyond the failure and shows where the states diverge.
    settings = settings._replace(integrator="rk")
    return run._replace(trace=(grid, states(PROBING_STEPS)))


T = TypeVar("T")


def within_deadline(
    work: Callable[[Send], T],
    otherwise: Callable[[Status, str], T],
    receive: Callable[[FloatArray], object] = lambda _: None,
) -> T:
    """Run ``work`` and return its result; under a time limit it runs in another process.

    ``receive`` gets the parts that ``work`` sends; ``otherwise`` makes the result from a status and
    a message if the work did not finish.
    """
    if not (np.isfinite(deadline.until()) and can_fork()):
        return work(lambda _: None)

    def taken(part: FloatArray) -> bool:
        receive(part)
        return True

    try:
        return in_child(work, deadline.until(), taken)
    except OutOfTime:
        return otherwise(Status.TIME_LIMIT, OVER)
    except Died:
        return otherwise(Status.INTEGRATION_FAILED, "the process of the integrator ended")


def run_without_states(status: Status, message: str) -> IntegrationRun:
    """Return a run without states."""
    return IntegrationRun(status, np.zeros((0, 0)), message=message)


def with_halved_steps(
    states: Callable[[int], FloatArray], settings: IntegratorSettings, steps: int
) -> IntegrationRun:
    """Return the result of an integrator; a fixed step is halved until two results agree."""
    most = max(settings.max_steps, 4 * steps)
    try:
        x = states(steps)
        if settings.integrator in ("cvodes", "idas"):
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
        return "collocation", {
            "number_of_finite_elements": steps,
            "rootfinder_options": {
                "abstol": 1e-14,
                "abstolStep": 1e-14,
                "max_iter": 50,
                "error_on_fail": True,
                "show_eval_warnings": False,
            },
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
    # Bisection inverts y^3 (10 - 15 y + 6 y^2), the time within a piece.
    for _ in range(60):
        y = 0.5 * (low + high)
        above = y**3 * (10 - 15 * y + 6 * y**2) > place
        low, high = np.where(above, low, y), np.where(above, y, high)
    inside = np.where((place > 0) & (place < 1), 0.5 * (low + high), place)
    return piece.astype(float) + inside


def _failed(message: str, states: FloatArray) -> IntegrationRun:
    """Return the failed run of an integrator, with the reason from its error message."""
    code = re.search(r"(?:CV|IDA)_([A-Z_]+)", message)
    reason = message.strip().split("\n")[-1]
    if code:
        meanings = (meaning for part, meaning in FAILURES.items() if part in code.group(1))
        reason = next(meanings, code.group())
    message = f"the integrator failed: {reason}"
    return IntegrationRun(Status.INTEGRATION_FAILED, states, message=message)
