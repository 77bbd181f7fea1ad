"""Kinks at a solution: norms or absolute values of controls that are zero, as where no fuel burns.

A solver does not converge where a slope jumps. Nor can optimality be proved where the gradient of
an active constraint vanishes: its multiplier is unbounded.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.problem import Expressions, operations
from microbot_ocp.ocp.solution import PhaseSolution, Solution

ZERO = 1e-2  # size that counts as zero, relative to the largest one along the phase
LEAST = 0.05  # fraction of a phase at a kink above which it is reported
REMEDY = (
    "make the size a control s >= 0 with the cost of s and sumsqr(u) + e**2 <= (s + e)**2, e a "
    "thousandth of its largest value (the cost is then too small by at most e a second), or for a "
    "scalar control write u = p - m with p, m >= 0 and the cost of p + m"
)


def kinks(solution: Solution) -> str:
    """Return a sentence on a kink that a solution stays at, and a formulation without kink.

    Empty if there is none or the solver converged.
    """
    if solution.attempts[-1].status.solved:
        return ""
    for phase in solution.phases:
        layout = phase.laid_out
        assert phase.stages is not None
        t = (phase.t[:-1] + phase.t[1:]) / 2
        values = layout.interpolated(phase.stages, np.arange(t.size), np.full(t.size, 0.5))
        for label, sizes in _sizes(phase, {name: v.T for name, v in values.items()}, t):
            zero = sizes <= ZERO * sizes.max(initial=0.0)
            if zero.mean() >= LEAST and not zero.all():
                return (
                    f"{label} of phase {phase.name!r} has a kink at the solution, as at "
                    f"{t[zero][0]:.3g} s: {REMEDY}."
                )
    return ""


def unheld(solution: Solution) -> str:
    """Return a sentence on an unbounded control that only a constraint limits, if a gap is left.

    The sentence proposes other formulations. Along singular arcs such controls oscillate between
    collocation points at no cost. Empty if there is no such control.
    """
    if solution.status is not Status.GAP_LEFT:
        return ""
    for phase in solution.phases:
        declared = phase.laid_out.phase
        for control in declared.shaped("polynomial"):
            free = np.isinf(control.lower).all() and np.isinf(control.upper).all()
            for limit in declared.constraints if free else ():
                if ca.depends_on(limit.expression, control.symbol):
                    return (
                        f"Only constraint {limit.name!r} limits control {control.name!r} of phase "
                        f"{phase.name!r}: declare the control with shape='linear', or make the "
                        "limited quantity the control, such as torques in place of accelerations."
                    )
    return ""


def _sizes(
    phase: PhaseSolution, values: dict[str, FloatArray], t: FloatArray
) -> Iterator[tuple[str, FloatArray]]:
    """Yield labels and sizes [M] that vanish at kinks.

    Sizes are roots, absolute values, and norms of the gradients of active constraints.
    """
    declared = phase.laid_out.phase
    expressions = Expressions(declared)
    table = expressions.table(values, t, phase.duration)
    terms = [("A running cost", each) for each in declared.running_costs]
    terms += [(f"Constraint {each.name!r}", each.expression) for each in declared.constraints]
    for label, expression in terms:
        for size in _roots(expressions.function([expression])):
            yield label, np.abs(size(table).full().ravel())
    controls = ca.vertcat(*(v.symbol for v in declared.controls), ca.MX(0, 1))
    for limit in (each for each in declared.constraints if each.expression.is_scalar()):
        if ca.depends_on(limit.expression, controls):
            slopes = ca.vec(ca.jacobian(limit.expression, controls))
            value, *slope = expressions.function([limit.expression, slopes])(table).full()
            left = np.minimum(value - limit.lower, limit.upper - value)
            size = np.linalg.norm(slope, axis=0)
            acts = left <= ZERO * np.abs(value).max(initial=limit.scale[0])
            yield f"Constraint {limit.name!r}", np.where(acts, size, size.max())


def _roots(function: ca.Function) -> Iterator[ca.Function]:
    """Yield functions of the roots and absolute values in a function of one table."""
    if not function.is_a("SXFunction"):
        return
    given = function.sx_in()
    for operation, _, _, value in operations(function, given):
        if operation in (ca.OP_SQRT, ca.OP_FABS):
            yield ca.Function("size", given, [value])
