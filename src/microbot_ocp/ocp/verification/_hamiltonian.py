"""The Hamiltonian along a phase.

It is ``H = L + costate' f``, which the optimal control makes smallest (Bryson and Ho, *Applied
Optimal Control*, sections 2.3 and 3.2). It is constant along a phase whose expressions do not
contain the time, and -1 where the cost is the duration and the duration is free.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.solution import PhaseSolution
from microbot_ocp.ocp.verification._certificate import Hamiltonian
from microbot_ocp.ocp.verification._stationarity import Derivatives

INSIDE = 1e-6  # relative distance of a duration from its bounds that makes it free


def hamiltonian_of(phase: PhaseSolution, part: Derivatives, lam_x: FloatArray) -> Hamiltonian:
    """Hamiltonian of a phase, and what it should be."""
    layout = part.layout
    steps = np.diff(layout.mesh)
    # With a longer interval the later points of it come later as well: half of the effect that a
    # later start has is not the Hamiltonian's.
    values = (part.by_length - part.by_start * steps / 2) / phase.duration
    mean = float(values @ steps)
    own = layout.phase
    along = [*own.derivatives.values(), *own.running_costs, *own.algebraic_equations]
    along += [c.expression for c in own.constraints]
    used = ca.vertcat(*along)
    price = -float(lam_x[layout.nodes[:, -1]].sum()) / layout.node_scale[-1]
    low, high = own.duration_bounds
    free = low < high and min(phase.duration - low, high - phase.duration) > INSIDE * phase.duration
    points = (*own.end_constraints, *own.point_constraints, *own.point_costs)
    constraints = [c.expression for c in points]
    apart = not ca.depends_on(ca.vertcat(used, *constraints), own.duration)
    return Hamiltonian(
        phase=phase.name,
        t=(phase.t[:-1] + phase.t[1:]) / 2,
        values=values,
        mean=mean,
        drift=float(np.abs(values - mean).max()),
        autonomous=not ca.depends_on(used, own.time),
        expected=-float(part.end_cost[-1]) / layout.node_scale[-1] if free and apart else None,
        duration_price=price,
    )
