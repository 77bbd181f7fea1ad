"""Costates at the mesh points and at the points of collocation, from the multipliers.

A row of the dynamics is ``z_k+1 - next(z_k, w_k) = 0``, so the costate at the mesh point k + 1 is
``-lam / scale``: the derivative of the optimal cost with respect to the state there, in cost per
unit of the state.

At the points of collocation the costate is ``-mu_j / (scale w_j)`` with the multiplier of the
defect mu_j and the quadrature weight w_j (Garg et al., *Automatica* 46, 2010, "A unified framework
for the numerical solution of optimal control problems using pseudospectral methods"; Betts,
*Practical Methods for Optimal Control*, 2nd ed., section 4.11).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.problem import Variable
from microbot_ocp.ocp.solution import PhaseSolution
from microbot_ocp.ocp.transcription.schemes import Collocation
from microbot_ocp.ocp.verification._certificate import Costates
from microbot_ocp.ocp.verification._stationarity import Derivatives


def _split(states: Sequence[Variable], table: FloatArray) -> dict[str, FloatArray]:
    edges = np.cumsum([0, *(s.size for s in states)])
    return {s.name: table[:, a : a + s.size] for s, a in zip(states, edges[:-1], strict=True)}


def costates_of(phase: PhaseSolution, part: Derivatives, lam_g: FloatArray) -> Costates:
    """Costates of a phase in cost per unit of the state."""
    layout = part.layout
    states = layout.phase.states
    size = sum(s.size for s in states)
    scale = layout.node_scale[:size]
    after = part.by_stage[layout.nodes[:-1, :size] - layout.stages.start] / scale
    values = np.vstack([after[:1], -part.step[:, :size] / scale])
    point_t, point_values = np.zeros(0), np.zeros((0, size))
    for group in layout.groups:
        scheme = group.kind.scheme
        if isinstance(scheme, Collocation):
            defects = group.rows[:, layout.node_size :][:, : scheme.degree * size]
            mu = lam_g[defects].reshape(-1, scheme.degree, size)
            own = -mu / (scale * scheme.weights[:, None])
            t = phase.t[group.intervals, None] + np.outer(
                np.diff(phase.t)[group.intervals], scheme.points
            )
            point_t = np.concatenate([point_t, t.ravel()])
            point_values = np.vstack([point_values, own.reshape(-1, size)])
    in_turn = np.argsort(point_t, kind="stable")
    point_t, point_values = point_t[in_turn], point_values[in_turn]
    return Costates(
        phase=phase.name,
        t=phase.t,
        values=_split(states, values),
        after=_split(states, after),
        point_t=point_t,
        point_values=_split(states, point_values),
    )
