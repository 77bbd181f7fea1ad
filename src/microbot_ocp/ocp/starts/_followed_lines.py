"""Guesses whose controls follow the straight lines between the end conditions of states.

A heading has no influence on the position where the guessed speed is zero, so no step of a solver
turns it. Where a control has no influence on states with conditions at both ends, controls and the
other states are therefore found point by point by a Gauss-Newton iteration on the equations and
on the slopes of the lines. Its steps are the shortest in scaled variables.
"""

from __future__ import annotations

from functools import partial

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.problem import Expressions, OptimalControlProblem, Phase, Variable, parts_of
from microbot_ocp.ocp.transcription import Guess, Guesses, interpolate, sampled

POINTS, STEPS = 21, 20
STEP_LENGTHS = 0.5 ** np.arange(6)


def following_lines(problem: OptimalControlProblem, guesses: Guesses) -> dict[str, Guess]:
    """Return guesses whose controls and free states follow the states known at both ends.

    A phase keeps its guess if every control has an influence there.
    """
    return {phase.name: _followed(phase, guesses[phase.name]) for phase in problem.phases}


def _followed(phase: Phase, guess: Guess) -> Guess:
    free: list[Variable] = [*phase.controls, *phase.algebraics]
    free += [s for s in phase.states if s.initial is None or s.final is None]
    duration, shares = float(guess.duration or 1.0), np.linspace(0.0, 1.0, POINTS)
    tables = {v.name: sampled(guess.values.get(v.name), v, shares) for v in phase.variables}
    missed = _line_equations(phase, tables, duration)
    symbols = ca.vertcat(*(v.symbol for v in free), ca.MX(0, 1))
    if not ca.depends_on(missed, symbols):
        return guess
    expressions = Expressions(phase, phase.measurements)
    look = expressions.with_slopes(missed, symbols, POINTS)

    def looked(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        values = {name: table.T for name, table in {**tables, **parts_of(free, x)}.items()}
        return look(expressions.tables(values, duration * shares, duration))

    scale, lower, upper = (
        np.concatenate([getattr(v, side) for v in free]) for side in ("scale", "lower", "upper")
    )
    x = np.clip(np.hstack([tables[v.name] for v in free]), lower, upper)
    left, jacobian = looked(x)
    controls = ca.vertcat(*(control.symbol for control in phase.controls), ca.MX(0, 1))
    present = sorted({*ca.jacobian_sparsity(missed, controls).get_triplet()[1]})
    if jacobian[:, :, present].any(axis=(0, 1)).all():
        return guess
    for _ in range(STEPS):
        if not (np.isfinite(left).all() and np.isfinite(jacobian).all()):
            return guess
        inverse = np.linalg.pinv(jacobian * scale)
        step = -scale * np.einsum("kij,kj->ki", inverse, left)
        for share in STEP_LENGTHS:  # each point takes the longest step that reduces its residual
            tried = np.clip(x + share * step, lower, upper)
            there, jacobian_there = looked(tried)
            nearer = (np.linalg.norm(there, axis=1) < np.linalg.norm(left, axis=1))[:, None]
            x, left = np.where(nearer, tried, x), np.where(nearer, there, left)
            jacobian = np.where(nearer[:, None], jacobian_there, jacobian)
            step = np.where(nearer, 0.0, step)
    return guess.with_values({k: partial(interpolate, t) for k, t in parts_of(free, x).items()})


def _line_equations(phase: Phase, tables: dict[str, FloatArray], duration: float) -> ca.MX:
    """Return the left side of the equations of a point, which is zero on the lines.

    The equations are the slopes of the lines of states with conditions at both ends, equality
    constraints, and algebraic equations.
    """
    equations = [
        (phase.derivatives[s.name] - ca.DM(tables[s.name][-1] - tables[s.name][0]) / duration)
        * duration
        / ca.DM(s.scale)
        for s in phase.states
        if s.initial is not None and s.final is not None
    ]
    equations += [
        (limit.expression - ca.DM(limit.lower)) / ca.DM(limit.scale)
        for limit in phase.constraints
        if (limit.lower == limit.upper).all()
    ]
    return ca.vertcat(*equations, *phase.algebraic_equations, ca.MX(0, 1))
