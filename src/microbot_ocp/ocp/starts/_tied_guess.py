"""Initial guesses of controls that equations determine: the equations hold along the guess.

Without limits on both sides such a control has no size of its own, and a start that violates its
equation may lie where the dynamics are meaningless. A few Newton steps at points along the guess
of the states give it both.
"""

from __future__ import annotations

from functools import partial

import casadi as ca
import numpy as np

from microbot_ocp.ocp.problem import Expressions, Phase, control_equations, parts_of, tied_controls
from microbot_ocp.ocp.transcription import Guess, interpolate, sampled

POINTS = 40  # points along a guess at which the equations are solved
STEPS = 10  # Newton steps; equations that are linear in the control need one


def with_tied_controls(phase: Phase, guess: Guess) -> Guess:
    """Return the guess with values of the controls that equations determine and it lacks.

    It is returned unchanged where the equations have no finite solution.
    """
    names = tied_controls(phase)
    tied = [c for c in phase.controls if c.name in names]
    if not tied or names & guess.values.keys():
        return guess
    unknown = ca.vertcat(*(c.symbol for c in tied))
    equations = control_equations(phase)
    if equations.size1() != unknown.size1():
        return guess
    share, duration = np.linspace(0.0, 1.0, POINTS), float(guess.duration or 1.0)
    inputs = Expressions(phase, phase.measurements)
    step = ca.solve(ca.jacobian(equations, unknown), equations)
    newton = ca.Function("newton", inputs.symbols, [ca.densify(step)]).map(POINTS)
    values = {v.name: sampled(guess.values.get(v.name), v, share).T for v in phase.variables}
    low, high = (np.concatenate([getattr(c, side) for c in tied]) for side in ("lower", "upper"))
    now = np.concatenate([values[c.name] for c in tied])
    for _ in range(STEPS):
        points = inputs.tables(values, duration * share, duration)
        now = np.clip(now - np.array(newton(*points)), low[:, None], high[:, None])
        if not np.isfinite(now).all():
            return guess
        values |= parts_of(tied, now, axis=0)
    return guess.with_values({c.name: partial(interpolate, values[c.name].T) for c in tied})
