"""Explicit Runge-Kutta method of order 8 with error control and dense output, DOP853.

Source: Hairer, Nørsett, Wanner, *Solving Ordinary Differential Equations I*, 2nd ed., sections II.4
to II.6, with the constants of their code. One step is one CasADi function; all data of a run are
inputs, so the function is built and compiled once per loop. A one-step method restarts at a jump of
its input at no cost.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.fast_calls import FastCall

TOO_MANY_STEPS = "it needed more steps than allowed"
SHRUNK = "its step became too small"
NOT_FINITE = "the accelerations are not finite"
NOT_FINITE_AT_START = "the accelerations are not finite at the start"
OVER = "stopped at the time limit"

SMALLEST = np.finfo(float).eps  # smallest step relative to the time
TINY = np.finfo(float).tiny  # keeps divisors above zero
LAST_TERM = (4 / 7) ** 4 * (3 / 7) ** 3  # largest value of s^4 (1 - s)^3, the last dense term
STAGES = 12  # stages of the step; 4 more rates follow for the dense output


@cache
def _constants() -> tuple[FloatArray, ...]:
    """Return the coefficients of the stages, the error estimates and the last dense terms."""
    text = Path(__file__).with_name("dormand_prince.txt").read_text("utf-8")
    tables = (part.partition("\n")[2] for part in text.split("# ")[1:])
    return tuple(np.array(table.split(), dtype=float) for table in tables)


def step_function(rate: ca.Function) -> ca.Function:
    """Return one step of ``rate(t, x, u)`` with the choice of the next step size.

    Returns
    -------
    casadi.Function
        ``([t, width, x], u, [tolerance, end, longest]) -> [t, width, x], going, record``. The first
        output has the time, the size of the next step and the state. ``going`` is 0 at the end of
        the piece, or if the step became too small. ``record`` holds 1 if the step was accepted, its
        start and size, and 8 columns [states] of its dense output.
    """
    states = rate.size1_in("x")
    state, control = ca.MX.sym("state", 2 + states), ca.MX.sym("control", 3)
    u = ca.MX.sym("u", rate.size1_in("u"))
    t, wanted, x = ca.vertsplit(state, [0, 1, 2, 2 + states])
    tolerance, end, longest = ca.vertsplit(control)
    # A remainder up to 1 % longer than the step is taken as one step.
    whole = end - t <= 1.01 * wanted
    width = ca.if_else(whole, end - t, wanted)

    weights = np.zeros((STAGES + 4, STAGES + 4))
    earlier, errors, terms = _constants()
    weights[np.tril_indices(STAGES + 4, -1)] = earlier
    rates, at, after = ca.MX(states, 0), x, x
    for stage, row in enumerate(weights):
        if stage:
            at = x + width * ca.mtimes(rates, ca.DM(row[:stage]))
        if stage == STAGES:
            after = at
        rates = ca.horzcat(rates, rate(t + row.sum() * width, at, u))
    change, first, last = after - x, width * rates[:, 0], width * rates[:, STAGES]
    late = width * ca.mtimes(rates, ca.DM(terms.reshape(4, -1).T))

    # The embedded estimates of orders 5 and 3 combine to err5^2 / sqrt(err5^2 + 0.01 err3^2).
    scale = tolerance * (1 + ca.fmax(ca.fabs(x), ca.fabs(after)))
    order_5, order_3 = errors.reshape(2, STAGES)
    fifth, third = (
        ca.sumsqr(ca.mtimes(rates[:, :STAGES], ca.DM(row)) / scale)
        for row in (order_5, order_3 + weights[STAGES, :STAGES])
    )
    error = width * fifth / ca.sqrt(states * (fifth + 0.01 * third) + TINY)
    # Between its ends a long step may be less accurate; the last dense term measures that error.
    between = LAST_TERM * ca.sqrt(ca.sumsqr(late[:, 3] / scale) / states)
    error = ca.fmax(error, between) + 0 * between  # fmax drops NaN, the product restores it
    good = error <= 1
    factor = ca.fmin(6, ca.fmax(1 / 3, 0.9 * ca.fmax(error, TINY) ** -0.125))
    following = width * ca.if_else(error < np.inf, factor, 1 / 3)  # NaN counts as a rejected step
    # A step shortened to hit the end must not shorten the next one.
    following = ca.if_else(ca.logic_and(good, whole), ca.fmax(wanted, following), following)
    following = ca.fmin(following, longest)
    time = ca.if_else(good, ca.if_else(whole, end, t + width), t)
    going = ca.logic_and(time < end, following >= SMALLEST * ca.fmax(ca.fabs(t), ca.fabs(end)))
    terms = ca.horzcat(x, change, first - change, 2 * change - last - first, late)
    record = ca.vertcat(good, t, width, ca.vec(terms))
    state_after = ca.vertcat(time, following, ca.if_else(good, after, x))
    return ca.Function("dop853", [state, u, control], [state_after, going, record])


def integrated(
    steps: FastCall,
    pieces: tuple[FloatArray, FloatArray],
    start: FloatArray,
    grid: FloatArray,
    tolerance: float,
    max_steps: int,
    longest: float,
) -> tuple[FloatArray, str]:
    """Integrate a piecewise smooth equation piece by piece.

    Parameters
    ----------
    steps : callable
        Function from :func:`step_function`, repeated, that keeps the outputs of each call.
    pieces : (edges [K+1], inputs [K,m])
        Times at which the right-hand side may jump, and the input ``u`` between them.
    max_steps : int
        Largest number of steps between two times of the grid.
    longest : float
        Longest step, s.

    Returns
    -------
    states [N, states], message
        States, NaN after a failure; and the reason of the failure, empty without one.
    """
    state, message = np.concatenate([grid[:1], [longest], start]), ""
    passed, tried = 1, 0  # grid times reached, and steps tried since the last one
    records: list[FloatArray] = []
    for end, u in zip(pieces[0][1:], pieces[1], strict=True):
        control = np.array([tolerance, end, longest])
        while state[0] < end and not message:
            states, going, record = steps(state, u, control)
            state = states[-1]
            done = np.searchsorted(grid, states[:, 0], side="right")
            ahead = np.append(passed, done[:-1])
            since = np.arange(1, done.size + 1) - np.searchsorted(ahead, ahead)
            since[ahead == passed] += tried
            if (since > max_steps).any():
                message = TOO_MANY_STEPS
                record = record[: int((since > max_steps).argmax())]
            elif not going[-1] and state[0] < end:
                unknown = not np.isfinite(record[-1]).all()
                message = (NOT_FINITE if records else NOT_FINITE_AT_START) if unknown else SHRUNK
            elif deadline.over():
                message = OVER
            records.append(record[record[:, 0] > 0])
            tried, passed = int(since[-1]) * (done[-1] == ahead[-1]), done[-1]
    return _at(grid, start, np.concatenate(records)), message


def _at(grid: FloatArray, start: FloatArray, records: FloatArray) -> FloatArray:
    """Return states [N, states] at times [N] by the dense output of steps [K]; NaN beyond them."""
    begin, width = records[:, 1], records[:, 2]
    terms = records[:, 3:].reshape(len(records), 8, start.size)
    edges = np.searchsorted(grid, np.append(begin, (begin + width)[-1:]), side="right")
    states = np.full((grid.size, start.size), np.nan)
    states[0] = start
    count = np.diff(edges)
    share = (grid[1 : 1 + count.sum()] - np.repeat(begin, count)) / np.repeat(width, count)
    # Basis of the dense output in s = share: 1, s, s (1 - s), s^2 (1 - s), s^2 (1 - s)^2, ...
    basis = np.ones((share.size, 8))
    for k in range(7):
        basis[:, k + 1] = basis[:, k] * (1 - share if k % 2 else share)
    for low, up, of_step in zip(edges[:-1].tolist(), edges[1:].tolist(), terms, strict=True):
        np.matmul(basis[low - 1 : up - 1], of_step, out=states[low:up])
    return states
