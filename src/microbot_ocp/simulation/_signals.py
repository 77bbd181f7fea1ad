"""Inputs of a simulation as signals of time: torques, references, disturbances, formulas."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.relations import reason_of
from microbot_ocp.motion import (
    SAMPLE_STEP,
    Motion,
    PiecewisePolynomial,
    State,
    jump_gaps,
    mesh_of,
    nearest_samples,
)
from microbot_ocp.robot import Robot

Values = Callable[[FloatArray], FloatArray]  # maps times [N] to values [N,m]
Formula = Callable[[Any], Any]  # maps the CasADi time to n expressions

DEGREE = 10  # degree of the Chebyshev series of an input between breaks
FIT_ERROR = 1e-11  # largest error of the series, relative to the largest value
# The same for position, velocity and acceleration: rounding of samples 1 ms apart allows no less.
SAMPLED_FIT = np.array([FIT_ERROR, 1e-10, 1e-8])
SHORTEST_PIECE = 0.5e-3  # length below which a piece without break is not divided, s

# Chebyshev nodes exclude the ends of a piece, because a signal has two values at a break.
NODES = -np.cos((2 * np.arange(DEGREE + 1) + 1) * np.pi / (2 * DEGREE + 2))
FIT = np.linalg.inv(np.polynomial.chebyshev.chebvander(NODES, DEGREE))


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


def torque_signal(tau: Motion | ArrayLike | Formula | None, grid: FloatArray, count: int) -> Signal:
    if isinstance(tau, Motion):
        slack = ROUNDING * max(1.0, tau.duration)
        if grid[0] < -slack or grid[-1] > tau.duration + slack:
            raise InputError(
                f"t must be within the motion, 0 to {tau.duration:g} s, not "
                f"{grid[0]:g} to {grid[-1]:g} s"
            )
        breaks = mesh_of(tau)
        inner = breaks[(breaks > grid[0]) & (breaks < grid[-1])]
        edges = np.concatenate([grid[:1], inner, grid[-1:]])
        torque = interpolated(tau, tau.tau, breaks)
        return fitted(torque, edges, FIT_ERROR * np.abs(tau.tau).max())
    given = np.zeros(count) if tau is None else tau
    if callable(given) or np.ndim(np.asarray(given, dtype=object)) == 1:
        return formula_signal(*torque_formula("tau", given, count))
    table = checks.array("tau", given, (grid.size, count), "N m")

    def values(times: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(times, grid, column) for column in table.T])

    return fitted(values, grid, FIT_ERROR * np.abs(table).max())


def reference_signal(
    motion: Motion | PiecewisePolynomial | Formula, duration: float | None, robot: Robot
) -> tuple[float, float, Signal]:
    """Return start and end, s, and the signal of position, velocity and acceleration [3n]."""
    count = robot.joint_count
    if isinstance(motion, Motion):
        checks.joints("motion", motion.joint_count, robot)
        begin, longest, breaks = 0.0, motion.duration, mesh_of(motion)
        values, fit = (lambda times: np.hstack(motion.sample(times))), SAMPLED_FIT
    elif isinstance(motion, PiecewisePolynomial):
        checks.joints("motion", motion.coefficients.shape[2], robot)
        begin, longest, breaks = float(motion.breaks[0]), motion.duration, motion.breaks
        parts = (motion, motion.derivative(), motion.derivative().derivative())
        values, fit = (lambda times: np.hstack([part(times) for part in parts])), FIT_ERROR
    else:
        if duration is None:
            raise InputError("duration must be given if the motion is a function of time")
        t, q = symbolic("motion", motion, count)
        qd = ca.jacobian(q, t)
        qdd = ca.jacobian(qd, t)
        end = checks.number("duration", duration, "s", above=0.0, at_most=checks.LONGEST)
        return 0.0, end, formula_signal(t, ca.vertcat(q, qd, qdd))
    if duration is None:
        duration = longest
    duration = checks.number("duration", duration, "s", above=0.0, at_most=longest * (1 + ROUNDING))
    checks.number("duration", duration, "s", at_most=checks.LONGEST)
    end = begin + min(duration, longest)
    if isinstance(motion, PiecewisePolynomial) and end == motion.breaks[-1]:
        pieces = series_of(motion)
        if pieces is not None:
            return begin, end, Signal(values, None, pieces)
    edges = np.append(breaks[breaks < end * (1 - ROUNDING)], end)
    # Tolerances are relative to the size of each quantity, sampled inside the pieces.
    inside = np.linspace(edges[:-1], edges[1:], 8, endpoint=False, axis=1)
    scale = np.abs(values(inside.ravel())).reshape(-1, 3, count).max(axis=(0, 2))
    return begin, end, fitted(values, edges, np.repeat(fit * scale, count))


def series_of(motion: PiecewisePolynomial) -> Pieces | None:
    """Return position, velocity and acceleration [3n] as series; None if the degree is too high."""
    powers = motion.coefficients.shape[1]
    if powers > DEGREE + 1:
        return None
    of_share = FIT @ ((1 + NODES[:, None]) / 2) ** np.arange(powers)  # series of powers
    length = np.diff(motion.breaks)[:, None, None]
    scaled = motion.coefficients * length ** np.arange(powers)[:, None]
    count = np.arange(powers)[:, None]
    series = []
    for order in range(3):
        series.append(of_share @ scaled / length**order)
        scaled = np.concatenate([(scaled * count)[:, 1:], np.zeros_like(scaled[:, :1])], axis=1)
    return Pieces(motion.breaks, np.concatenate(series, axis=2))


def motion_from_formula(
    robot: Robot, formula: Formula, duration: float, *, label: str, step: float = SAMPLE_STEP
) -> Motion:
    """Build a motion from positions as a function of the CasADi time, with exact derivatives.

    Parameters
    ----------
    robot : Robot
        Robot with masses, for the torques.
    formula : callable
        Function from the CasADi time, s, to n expressions, rad (m), smooth inside the duration.
    duration : float
        Duration, s.
    label : str
        Label for figures and certificates.
    step : float
        Longest step between the samples, s.

    Returns
    -------
    Motion
        Positions, exact derivatives and torques, sampled at the step.

    Examples
    --------
    >>> import casadi as ca
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> wave = motion_from_formula(robot, lambda t: [ca.sin(t), 0.2 * t, 0.0], 2.0, label="wave")
    >>> wave.qd[0].tolist()
    [1.0, 0.2, 0.0]
    """
    duration = checks.number("duration", duration, "s", above=0.0)
    step = checks.number("step", step, "s", above=0.0)
    count = robot.joint_count
    _, _, signal = reference_signal(formula, duration, robot)
    t = np.linspace(0.0, duration, checks.step_count(duration, step) + 1)
    state = State(*np.split(signal.values(t), [count, 2 * count], axis=1))
    provenance, breaks = {"method": "formula"}, [0.0, duration]
    return Motion.from_state(robot, t, state, label=label, breaks=breaks, provenance=provenance)


def torque_formula(name: str, given: ArrayLike | Formula, count: int) -> tuple[ca.SX, ca.SX]:
    """Return the time and n torques, constant or as a user's function of time."""
    if callable(given):
        return symbolic(name, given, count)
    return ca.SX.sym("t"), ca.SX(ca.DM(checks.array(name, given, (count,), "N m")))


def symbolic(name: str, formula: Formula, count: int) -> tuple[ca.SX, ca.SX]:
    """Return the time and the n expressions of a user's function."""
    if not callable(formula):
        raise TypeError(f"{name} is no function")  # the caller's annotation names the other types
    t = ca.SX.sym("t")
    try:
        value = formula(t)
        if isinstance(value, list | tuple | np.ndarray):
            value = ca.vertcat(*value)
        expression = ca.SX(value)
    except (NotImplementedError, RuntimeError, TypeError) as problem:
        reason = reason_of(problem)
        raise InputError(f"{name} must return {count} CasADi expressions: {reason}") from problem
    if expression.shape != (count, 1):
        raise InputError(f"{name} must return {count} expressions, not shape {expression.shape}")
    return t, expression


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
    tolerance = np.maximum(tolerance, np.finfo(float).eps)
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


def series_value(place: ca.SX, flat: ca.SX, shape: tuple[int, ...]) -> ca.SX:
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


def interpolated(motion: Motion, samples: FloatArray, breaks: FloatArray, most: int = 6) -> Values:
    """Return the interpolation of a motion's samples [N,n], by polynomials within each piece.

    A polynomial passes through at most ``most`` nearest samples of its piece: six for quintics.
    """
    first = nearest_samples(motion.t, breaks)  # at a jump the second sample, which is at the break
    gap = np.append(jump_gaps(motion.t), False)

    def values(times: FloatArray) -> FloatArray:
        i = np.clip(np.searchsorted(motion.t, times, side="right") - 1, 0, motion.t.size - 2)
        piece = np.clip(np.searchsorted(first, i, side="right") - 1, 0, first.size - 2)
        low, high = first[piece], first[piece + 1]
        high = high - gap[high - 1]  # the second sample of a jump belongs to the next piece
        widths = np.minimum(most, high - low + 1)
        answer = np.zeros((times.size, motion.joint_count))
        for width in np.unique(widths):
            rows = np.flatnonzero(widths == width)
            leftmost = np.clip(i[rows] - width // 2 + 1, low[rows], high[rows] - width + 1)
            stencil = leftmost[:, None] + np.arange(width)
            weights = lagrange_weights(times[rows], motion.t[stencil])
            answer[rows] = (weights[:, :, None] * samples[stencil]).sum(axis=1)
        return answer

    return values


def lagrange_weights(t: FloatArray, nodes: FloatArray) -> FloatArray:
    """Return the weights [N,k] of values at nodes [N,k] in their polynomial at times t [N]."""
    weights = np.ones_like(nodes)
    for k in range(nodes.shape[1]):
        for other in range(nodes.shape[1]):
            if other != k:
                weights[:, k] *= (t - nodes[:, other]) / (nodes[:, k] - nodes[:, other])
    return weights
