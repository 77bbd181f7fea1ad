"""The nonlinear program of a timing on places of a path, with explicitly assembled derivatives.

At a given place of a path every limit is a function of s', s'' and s''', whose coefficients are
numbers: the pose, its derivatives, and those of the torque. Every mesh point and every interval is
one call of a small kernel without dynamics, whose values and entries of Jacobian and Hessian go to
known rows and columns. Another path needs no new derivation or compilation. The equations are (5)
to (10) of docs/theory/path_timing.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.codegen import compile_functions
from microbot_ocp.limits import LimitFamily, Member
from microbot_ocp.ocp.transcription import (
    Bounds,
    Kernel,
    KernelCalls,
    Program,
    kernels_of,
    staged,
    with_derivatives,
)

SMOOTHING_WEIGHT = 1e-8  # weight of the squared s''', selects one of many equally fast timings
SPEED_PLACES = (1 / 3, 2 / 3)  # places of an interval at which s' is bounded, shares
TORQUE_PARTS = 6  # coefficients m, c, g of equation (6), and their slopes m', c', g' along s


@dataclass(frozen=True)
class LimitKinds:
    """Kinds of limits that are rows of the program; kernels depend on them alone.

    Attributes
    ----------
    joints : number of joints
    dynamics : True if limits need torques
    of_acceleration : keys of the limits that depend on s'' but not on s'''
    of_rates : keys of the limits that depend on s'''
    family : family with the expressions of further limits, or None
    """

    joints: int
    dynamics: bool
    of_acceleration: tuple[str, ...]
    of_rates: tuple[str, ...]
    family: LimitFamily | None

    @classmethod
    def of(cls, family: LimitFamily) -> LimitKinds:
        """Return the kinds of limits of a family."""
        accelerations, rates = family.of_order(2), family.of_order(3)
        further = any(family[key].limit is not None for key in (*accelerations, *rates))
        return cls(
            joints=family.robot.joint_count,
            dynamics=family.robot.has_dynamics
            and (further or bool({"tau", "taud"} & {*accelerations, *rates})),
            of_acceleration=accelerations,
            of_rates=rates,
            family=family if further else None,
        )

    @property
    def numbers(self) -> int:
        """Number of coefficients at a place."""
        return self.joints * (4 + TORQUE_PARTS * self.dynamics)

    @property
    def further(self) -> tuple[str, ...]:
        """Keys of the limits with expressions of their own."""
        if self.family is None:
            return ()
        keys = (*self.of_acceleration, *self.of_rates)
        return tuple(key for key in keys if self.family[key].limit is not None)


@dataclass(frozen=True, eq=False)
class LimitBounds:
    """Bounds [k] of the rows of a place, divided by their magnitudes."""

    lower: FloatArray
    upper: FloatArray
    size: FloatArray

    @classmethod
    def of(cls, family: LimitFamily, keys: Sequence[str], usual: dict[str, Any]) -> LimitBounds:
        """Return the bounds of the rows of limits; ``usual`` scales those that vary."""
        parts: list[tuple[FloatArray, ...]] = [(np.zeros(0),) * 3]
        for key in keys:
            member = family[key]
            bounds = usual[key] if member.varies else member
            size = _finite_size(np.vstack([bounds.lower, bounds.upper]))
            zero, none = np.zeros_like(size), np.full_like(size, np.inf)
            either = {"lower": (zero, none, size), "upper": (-none, zero, size)}
            sides = [either[side] for side in _sides(member)]
            parts += sides if member.varies else [(member.lower, member.upper, size)]
        lower, upper, size = (np.concatenate(column) for column in zip(*parts, strict=True))
        return cls(lower / size, upper / size, size)


def _sides(member: Member) -> tuple[str, ...]:
    """Return the names of the finite bounds of a varying limit, each of which has its own row."""
    bounds = {"lower": member.lower, "upper": member.upper}
    return tuple(side for side, bound in bounds.items() if not np.isinf(bound).all())


def _finite_size(bounds: FloatArray) -> FloatArray:
    """Return the largest finite magnitude [k] of bounds [m,k]; 1 if there is none."""
    size = np.where(np.isfinite(bounds), np.abs(bounds), 0.0).max(axis=0)
    return np.where(size > 0.0, size, 1.0)


@lru_cache(maxsize=16)
def kernels(kinds: LimitKinds, common: int, fast: bool) -> list[Kernel]:
    """Return the kernels of a mesh point and of an interval, with a number of common coefficients.

    Raises
    ------
    InputError
        The expression of a further limit has no derivatives.
    """
    compiled = compile_functions if fast else list[ca.Function]
    functions = [_point(kinds, common), _interval(kinds, common)]
    try:
        return kernels_of(functions, lambda scalar: compiled(with_derivatives(scalar)))
    except deadline.Over:
        raise
    except Exception as problem:  # a user's expression may raise anything
        if kinds.family is None:
            raise
        names = ", ".join(repr(kinds.family[key].name) for key in kinds.further)
        reason = str(problem).strip().splitlines()[-1:] or [type(problem).__name__]
        raise InputError(
            f"the timing of a path needs derivatives of limit {names}, and its expression has "
            f"none: {reason[0]}"
        ) from problem


def _point(kinds: LimitKinds, common: int) -> ca.Function:
    """Return the limits of s'' at a mesh point, given s' and s''."""
    w, c = ca.MX.sym("w", 2), ca.MX.sym("c", common + kinds.numbers)
    parts = c[common:], c[:common]
    values = _limit_rows(kinds, kinds.of_acceleration, *parts, (w[0], w[1], 0.0))
    return ca.Function("point", [w, c], [values, ca.MX(0)])


def advanced(v: Any, a: Any, j: Any, change: Any, time: Any) -> tuple[Any, Any, Any, Any]:
    """Return the way travelled in a time, and s', s'' and s''' after it, of numbers or expressions.

    It begins with v = s', a = s'' and j = s''', which is linear in time and changes by ``change``:
    equations (8) to (10) of docs/theory/path_timing.md.
    """
    return (
        time * (v + time / 2.0 * (a + time / 3.0 * (j + change / 4.0))),
        v + time * (a + time / 2.0 * (j + change / 3.0)),
        a + time * (j + change / 2.0),
        j + change,
    )


def _interval(kinds: LimitKinds, common: int) -> ca.Function:
    """Return the rows of docs/theory/path_timing.md, "One program on places", and the cost.

    An interval has v = s' and a = s'' at both ends, its time h, and d, the linear change of s''' in
    it. A constant s''' would meet a limited rate at one end of the interval only, an error of first
    order in its length.
    """
    one, three = kinds.of_acceleration, kinds.of_rates
    sizes = common, *[kinds.numbers] * 3, 1
    w, c = ca.MX.sym("w", 6), ca.MX.sym("c", sum(sizes))
    v, a, h, v_end, a_end, d = ca.vertsplit(w)
    shared, start, end, middle, step = ca.vertsplit(c, np.cumsum([0, *sizes]).tolist())
    first = (a_end - a) / h - 0.5 * d
    last = first + d

    def reached(share: float) -> tuple[Any, ...]:
        return advanced(v, a, first, share * d, share * h)

    travelled, v_reached, *_ = reached(1.0)
    _, v_middle, a_middle, mean = reached(0.5)
    values = ca.vertcat(
        v_end - v_reached,
        step - travelled,
        _limit_rows(kinds, three, start, shared, (v, a, first)),
        _limit_rows(kinds, three, end, shared, (v_end, a_end, last)),
        _limit_rows(kinds, three, middle, shared, (v_middle, a_middle, mean)),
        _limit_rows(kinds, one, middle, shared, (v_middle, a_middle, 0.0)),
        # The speed at the thirds: at the middle alone, s'' would keep a constant error on an arc at
        # the velocity limit.
        *(reached(share)[1] for share in SPEED_PLACES),
    )
    # Integral of the squared s''', which is linear, over the interval.
    rough = h * (first**2 + first * last + last**2) / 3.0
    return ca.Function("interval", [w, c], [values, h + SMOOTHING_WEIGHT * rough])


def _limit_rows(
    kinds: LimitKinds, keys: Sequence[str], numbers: Any, common: Any, motion: tuple[Any, Any, Any]
) -> Any:
    """Return the values of limits at a place, divided by the magnitudes of their bounds.

    ``motion`` is s', s'' and s''' in the program's unit of time, the first common coefficient.
    """
    n, unit = kinds.joints, common[0]
    parts = [numbers[k * n : (k + 1) * n] for k in range(numbers.shape[0] // n)]
    v, a, j = (rate / unit**k for k, rate in enumerate(motion, start=1))
    q, tangent, curvature, bend = parts[:4]
    # Equations (5) to (7).
    qd = tangent * v
    qdd = tangent * a + curvature * v**2
    qddd = tangent * j + 3.0 * curvature * v * a + bend * v**3
    values = {"qdd": qdd, "qddd": qddd}
    if kinds.dynamics:
        per_a, per_square, held, per_a_rate, per_square_rate, held_rate = parts[4:]
        smoothing, viscous, dry = common[1], common[2 : 2 + n], common[2 + n : 2 + 2 * n]
        side = ca.tanh(qd / smoothing)
        values["tau"] = per_a * a + per_square * v**2 + held + viscous * qd + dry * side
        values["taud"] = (
            per_a * j
            + (per_a_rate + 2.0 * per_square) * v * a
            + per_square_rate * v**3
            + held_rate * v
            + viscous * qdd
            + dry * (1.0 - side**2) * qdd / smoothing
        )
    columns = {key: [value] for key, value in values.items()}
    if kinds.family is not None:
        state, function = [q, qd, qdd, qddd], None
        if kinds.dynamics:
            state += ca.vertsplit(ca.vertcat(values["tau"], values["taud"]))
            function = _given_torques(n)
        expressions = kinds.family.expressions(kinds.further, state, function)
        for key, (value, lower, upper) in expressions.items():
            member, bounds = kinds.family[key], {"lower": lower, "upper": upper}
            sides = [value - bounds[side] for side in _sides(member)]
            columns[key] = sides if member.varies else [value]
    rows, first = [numbers[:0]], 2 + 2 * n
    for key in (*kinds.of_acceleration, *kinds.of_rates):
        for column in columns[key]:
            size = common[first : first + column.shape[0]]
            first += column.shape[0]
            if key in keys:
                rows.append(column / size)
    return ca.vertcat(*rows)


@lru_cache(maxsize=16)
def _given_torques(n: int) -> ca.Function:
    """Return a function that passes on given torques and rates, one argument per number."""
    state = [ca.SX.sym(name, n) for name in ("q", "qd", "qdd", "qddd")]
    torques = [ca.SX.sym(f"torque_{k}") for k in range(2 * n)]
    return ca.Function(
        "given_torques", [*state, *torques], [ca.vertcat(*torques[:n]), ca.vertcat(*torques[n:])]
    )


def program_of(
    kinds: LimitKinds,
    fast: bool,
    breaks: np.ndarray,
    of_points: FloatArray,
    of_intervals: FloatArray,
    bounds: Bounds,
) -> Program:
    """Assemble the program on n intervals from coefficients of points and intervals [N,K].

    The unknowns are s' at the n + 1 places; s'' there, and once more from the left at places where
    s'' may jump (``breaks``); the times of the intervals; the changes of s''' in them. The rows are
    those of the limits, place by place, followed by those of the intervals. Rows without finite
    bounds are left out.
    """
    n, count = len(of_intervals), len(of_points)  # numbers of intervals and unknowns s''
    after, i = n + 1 + count, np.arange(n)
    right = np.arange(1, n + 1)
    right[breaks - 1] = n + 1 + np.arange(breaks.size)
    at_points = np.stack([np.append(np.arange(n + 1), breaks), n + 1 + np.arange(count)], axis=1)
    at_intervals = np.stack([i, n + 1 + i, after + i, i + 1, n + 1 + right, after + n + i], axis=1)
    x = ca.MX.sym("x", bounds.variable_lower.size)
    kept = np.isfinite(bounds.row_lower) | np.isfinite(bounds.row_upper)
    height = int(kept.sum())
    rows = np.where(kept, np.cumsum(kept) - 1, height)
    point, interval = kernels(kinds, of_points.shape[1] - kinds.numbers, fast)
    first = count * point.value.size1_out(0)
    pieces = [
        KernelCalls.at_points(kernel, x, at, lines.reshape(len(at), -1), ca.MX(ca.DM(table.T)))
        for kernel, at, lines, table in (
            (point, at_points, rows[:first], of_points),
            (interval, at_intervals, rows[first:], of_intervals),
        )
    ]
    nlp, functions = staged(x, ca.MX.sym("p", 0), height, pieces)
    chosen = replace(bounds, row_lower=bounds.row_lower[kept], row_upper=bounds.row_upper[kept])
    parts: Any = {"nlp": nlp, "functions": functions, "parameters": np.zeros(0)}
    return Program(layouts=(), **parts, **vars(chosen))
