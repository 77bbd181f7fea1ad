"""Rows moved by the least change that brings their curve within position limits and stops."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.certificate import stop_misses
from microbot_ocp.execution._curve import NEAR, played, spline_of
from microbot_ocp.execution._profile import Profile
from microbot_ocp.execution._rows import CommandRows
from microbot_ocp.limits import ROUNDING, LimitFamily, LimitValues, MotionSamples, StateHistory
from microbot_ocp.motion import Motion, State
from microbot_ocp.planning import Stop
from microbot_ocp.robot import Robot

Part = tuple[LimitFamily, StateHistory]
FEWEST_KNOTS = 10  # rows per control point are at most a tenth of all rows
# A place is its times [N], positions [N,n], and the function from positions to position limits.
Place = tuple[FloatArray, FloatArray, Callable[[FloatArray], list[LimitValues]]]


@dataclass(frozen=True, eq=False)
class MoveLeg:
    """Motion from rest to rest, with the limits of its segments and the stops between them."""

    families: Sequence[LimitFamily]
    motion: Motion
    profile: Profile
    stops: Sequence[Stop] = ()

    def parts(self, curve: Motion) -> list[Part]:
        """Return the limits of each segment, with the part of a curve where they hold."""
        history, inner = curve.history(), [mark.time for mark in curve.marks[1:-1]]
        if len(self.families) == 1:
            return [(self.families[0], history)]
        spans = pairwise([0.0, *inner, curve.duration])
        return [(f, history.between(*span)) for f, span in zip(self.families, spans, strict=True)]

    def places(self, curve: Motion, parts: Sequence[Part]) -> Iterator[Place]:
        """Yield the position limits of every part, and the tolerances of the stops on the way."""
        for family, history in parts:
            if family.of_order(0):
                yield history.t, history.samples.q, partial(_of_place, family)
        robot = self.families[0].robot
        for stop, mark in zip(self.stops, curve.marks[1:-1], strict=bool(self.stops)):
            t = np.array([mark.time])
            yield t, curve.sample(t).q, partial(_misses, robot, stop)


def _of_place(family: LimitFamily, q: FloatArray) -> list[LimitValues]:
    return list(family.values(MotionSamples.at_rest(q), family.of_order(0)).values())


def _misses(robot: Robot, stop: Stop, q: FloatArray) -> list[LimitValues]:
    rows = np.array([list(stop_misses(robot, stop, row).values()) for row in q])
    return [LimitValues(rows, np.full_like(rows, -np.inf), np.full_like(rows, -ROUNDING))]


def moved_inside(leg: MoveLeg, given: CommandRows) -> tuple[CommandRows, list[Part]]:
    """Move rows until their curve keeps position limits and stops; return them and its parts.

    The displacement is a cubic B-spline. Fewer control points add less acceleration, so the number
    is doubled only until the curve is inside.
    """
    best, least, spacing = None, np.inf, max(len(given.q) // FEWEST_KNOTS, 1)
    while spacing and least > ROUNDING * NEAR:
        rows, parts, out = _moved_by_spline(leg, given, spacing)
        if out < least:
            best, least = (rows, parts), out
        spacing //= 2
    assert best is not None
    return best


def _moved_by_spline(
    leg: MoveLeg, given: CommandRows, spacing: int
) -> tuple[CommandRows, list[Part], float]:
    """Move rows by a spline with a control point every ``spacing`` rows.

    Sequential least squares: the places where the curve is outside by most beside each control
    point are collected, and the control points get the least change that keeps all of them, to
    first order, until the curve is inside or does not improve. Returns the rows, the parts of their
    curve, and the largest excess.
    """
    robot, step = leg.families[0].robot, spacing * leg.profile.step
    rows, worst = given, np.inf
    moves = np.zeros_like(given.q[: (len(given.q) - 1) // spacing + 1])
    free = np.arange(2, len(moves) - 2)  # zero control points keep both ends at rest
    seen: set[tuple[int, float, int]] = set()  # place, time, and bound that was exceeded
    known, most = -1, np.inf
    while True:
        curve, slopes, beyond = played(robot, rows, leg.profile), [], []
        # The curve of held commands is a step longer at both ends than its rows.
        parts, late = leg.parts(curve), 0.5 * (curve.duration - given.t[-1])
        for place, (t, q, measured) in enumerate(leg.places(curve, parts)):
            knot, excess = (t - late) / step, _excess(measured(q))
            for k in np.unique(np.rint(knot[(excess > 0.0).any(axis=1)])):
                here = np.flatnonzero(np.rint(knot) == k)
                far = enumerate(here[excess[here].argmax(axis=0)])
                seen |= {(place, float(t[i]), j) for j, i in far if excess[i, j] > 0.0}
            for _, at, j in sorted(key for key in seen if key[0] == place):
                i = int(np.abs(t - at).argmin())
                share = _bump(knot[i] - free)[:, None]
                slopes.append((share * _slopes(measured, q[i])[j]).ravel())
                beyond.append(excess[i, j])
        out = float(np.max(beyond, initial=0.0))
        most = min(most, 2.0 * out)
        if better := out < worst:
            best, worst = (rows, parts, out), out
        done = out <= ROUNDING * NEAR or not free.size
        if done or not (better or (len(seen) > known and out <= most)):
            return best
        known = len(seen)
        # Half of the excess on top covers the curve between the collected places.
        asked = np.array(beyond) + 0.5 * out
        moved = _least(np.array(slopes), asked, moves[free].ravel())
        moves[free] = moved.reshape(free.size, -1)
        # The displacement is added to all derivatives, so the rows stay consistent.
        shift = spline_of(moves, step)
        orders = shift, (speed := shift.derivative()), speed.derivative()
        times = np.minimum(given.t + step, shift.breaks[-1])
        added = (order(times) for order in orders)
        rows = replace(given, **State(*map(np.add, state_of(given), added))._asdict())


def _excess(values: list[LimitValues]) -> FloatArray:
    """Return the excess over limits [k] at each place [N,2k], upper bounds first."""
    sides = [v.value - v.upper for v in values], [v.lower - v.value for v in values]
    return np.hstack([*sides[0], *sides[1]])


def _least(slopes: FloatArray, beyond: FloatArray, moved: FloatArray) -> FloatArray:
    """Return the least x with ``beyond + slopes @ (x - moved) <= 0``.

    The dual is non-negative least squares in the multipliers w, with x = -slopes^T w; it is solved
    by the active set method of Lawson and Hanson, *Solving Least Squares Problems*, chapter 23.
    """
    gram, asked = slopes @ slopes.T, beyond - slopes @ moved
    weights, active = np.zeros_like(asked), np.zeros(asked.size, dtype=bool)
    for _ in range(3 * asked.size):
        left = np.where(active, 0.0, asked - gram @ weights)
        if left.max() <= ROUNDING * np.abs(asked).max():
            break
        active[left.argmax()] = True
        while active.any():
            goal = np.zeros_like(weights)
            goal[active] = np.linalg.lstsq(gram[np.ix_(active, active)], asked[active])[0]
            if (goal >= 0.0).all():
                weights = goal
                break
            down = goal < 0.0
            part = (weights[down] / (weights[down] - goal[down])).min()
            weights = np.where(active, weights + part * (goal - weights), 0.0)
            active &= weights > ROUNDING * weights.max()
    return -slopes.T @ weights


def _bump(x: FloatArray) -> FloatArray:
    """Return the value of a uniform cubic B-spline basis function, x knots from its centre."""
    away = np.abs(x)
    near = np.maximum(1.0 - away, 0.0) ** 3
    return (np.maximum(2.0 - away, 0.0) ** 3 - 4.0 * near) / 6.0


def _slopes(measured: Callable[[FloatArray], list[LimitValues]], q: FloatArray) -> FloatArray:
    """Return the derivatives of excesses by the joints [k,n], by central differences."""
    steps = np.cbrt(np.finfo(float).eps) * np.vstack([np.eye(q.size), -np.eye(q.size)])
    sides = _excess(measured(q + steps))
    with np.errstate(invalid="ignore"):  # infinite bounds give NaN
        return (sides[: q.size] - sides[q.size :]).T / (2.0 * steps[0, 0])


def state_of(rows: CommandRows) -> State:
    """Return the positions, velocities and accelerations of rows."""
    return State(rows.q, np.asarray(rows.qd), np.asarray(rows.qdd))
