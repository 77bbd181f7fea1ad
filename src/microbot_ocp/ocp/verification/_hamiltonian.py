"""Costates, the Hamiltonian along a phase, and a test of Pontryagin's minimum condition.

Costates: a row of the dynamics is ``z_k+1 - next(z_k, w_k) = 0``, so the costate at mesh point
k + 1 is ``-lam / scale``: the derivative of the optimal cost with respect to the state there, in
cost per unit of the state. At a collocation point it is ``-mu_j / (scale w_j)`` with the multiplier
mu_j of the defect and the quadrature weight w_j (Garg et al., *Automatica* 46, 2010, "A unified
framework for the numerical solution of optimal control problems using pseudospectral methods";
Betts, *Practical Methods for Optimal Control*, 2nd ed., section 4.11).

Hamiltonian: ``H = L + costate' f``, which the optimal control minimises (Bryson and Ho, *Applied
Optimal Control*, sections 2.3 and 3.2). It is constant along a phase whose expressions do not
depend on time, and -1 if the cost is the duration and the duration is free.

Minimum condition: a program solver searches the neighbourhood of its iterate only. If the
Hamiltonian has two local minima in a control, a solution may use the higher one on some intervals
and still satisfy all first-order conditions. To first order, another control on a short interval
changes the cost by the difference of the Hamiltonians times its length (Bryson and Ho, section
2.3).

Theory: docs/theory/certificates.md, equation (5) and "Hamiltonian".
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.solution import PhaseSolution, Solution
from microbot_ocp.ocp.transcription import PhaseLayout
from microbot_ocp.ocp.transcription.schemes import Collocation
from microbot_ocp.ocp.verification._certificate import Costates, Hamiltonian, Thresholds
from microbot_ocp.ocp.verification._conditions import Derivatives
from microbot_ocp.ocp.verification._recomputation import Recomputation, parts_of


def costates_of(phase: PhaseSolution, part: Derivatives, lam_g: FloatArray) -> Costates:
    """Return costates of a phase in cost per unit of the state."""
    layout = part.layout
    states = layout.phase.states
    size = sum(s.size for s in states)
    scale = layout.node_scale[:size]
    after = part.by_stage[layout.nodes[:-1, :size] - layout.stages.start] / scale
    values = np.vstack([after[:1], -part.step[:, :size] / scale])
    point_t, point_values, scheme = np.zeros(0), np.zeros((0, size)), layout.kind.scheme
    if isinstance(scheme, Collocation):
        point_t = (phase.t[:-1, None] + np.outer(np.diff(phase.t), scheme.points)).ravel()
        point_values = _at_points(layout, scheme, lam_g).reshape(-1, size)
    return Costates(
        phase=phase.name,
        t=phase.t,
        values=parts_of(states, values),
        after=parts_of(states, after),
        point_t=point_t,
        point_values=parts_of(states, point_values),
    )


def _at_points(layout: PhaseLayout, scheme: Collocation, lam_g: FloatArray) -> FloatArray:
    """Return costates [N, degree, n] at the collocation points."""
    size = sum(s.size for s in layout.phase.states)
    defects = layout.stage_rows[:, layout.node_size :][:, : scheme.degree * size]
    mu = lam_g[defects].reshape(-1, scheme.degree, size)
    return -mu / (layout.node_scale[:size] * scheme.weights[:, None])


def hamiltonian_of(phase: PhaseSolution, part: Derivatives, lam_x: FloatArray) -> Hamiltonian:
    """Return the Hamiltonian of a phase and the mean that transversality requires."""
    layout = part.layout
    steps = np.diff(layout.mesh)
    # The derivative with respect to the length of an interval at a fixed start also moves its
    # points in time, on average by half as much as a later start does: dL/dh = H + h/2 dL/dt.
    values = (part.by_length - part.by_start * steps / 2) / phase.duration
    mean = float(values @ steps)
    declared = layout.phase
    along = [*declared.derivatives.values(), *declared.running_costs, *declared.algebraic_equations]
    along += [c.expression for c in declared.constraints]
    used = ca.vertcat(*along)
    price = -float(lam_x[layout.nodes[:, -1]].sum()) / layout.node_scale[-1]
    low, high = declared.duration_bounds
    # A bound may be missed by this much: a duration that is nearer is at it.
    near = Thresholds.feasibility * phase.duration
    free = low < high and min(phase.duration - low, high - phase.duration) > near
    points = (*declared.end_constraints, *declared.point_constraints, *declared.point_costs)
    constraints = [c.expression for c in points]
    apart = not ca.depends_on(ca.vertcat(used, *constraints), declared.duration)
    return Hamiltonian(
        phase=phase.name,
        t=(phase.t[:-1] + phase.t[1:]) / 2,
        values=values,
        mean=mean,
        drift=float(np.abs(values - mean).max()),
        autonomous=not ca.depends_on(used, declared.time),
        expected=-float(part.end_cost[-1]) / layout.node_scale[-1] if free and apart else None,
        duration_price=price,
    )


VALUES_TRIED = 9  # values of a control between its bounds, and quantiles of its own values


def better_controls(solution: Solution) -> tuple[float, dict[str, dict[str, FloatArray]]]:
    """Return the first-order decrease of the cost by other controls, and their values by phase.

    Controls are arrays [N, points, size]. Bounded polynomial controls are tested one at a time at
    the collocation points of phases without algebraic variables.
    """
    gain, controls = 0.0, {}
    for phase in solution.phases:
        gained, values = _of_phase(phase, solution.row_multipliers)
        if gained > 0:
            gain, controls[phase.name] = gain + gained, values
    return gain, controls


def _of_phase(phase: PhaseSolution, multipliers: FloatArray) -> tuple[float, dict[str, FloatArray]]:
    layout = phase.laid_out
    declared, scheme = layout.phase, layout.kind.scheme
    looked_at = [
        control
        for control in declared.controls
        if control.shape == "polynomial" and np.isfinite([control.lower, control.upper]).any()
    ]
    if declared.algebraics or not looked_at or not isinstance(scheme, Collocation):
        return 0.0, {}
    intervals, share, t = phase.points(np.array(scheme.points))
    at = Recomputation(phase)
    sampled = at.interpolated(intervals, share)
    for control in looked_at:  # the values of the program, not limited between the points
        sampled[control.name] = phase.values[control.name].reshape(-1, control.size)
    steps = np.diff(phase.mesh)[intervals]
    costates = _at_points(layout, scheme, multipliers).reshape(t.size, -1)
    weights = steps * phase.duration * np.tile(scheme.weights, layout.intervals)

    def hamiltonian(values: dict[str, FloatArray]) -> FloatArray:
        columns = {k: v.T for k, v in values.items()}
        table = at.expressions.table(columns, t, phase.duration)
        slopes = at.expressions.dynamics(table).full()
        sums = slopes[-1] + np.einsum("ki,ik->k", costates, slopes[:-1])
        for limit in declared.constraints:
            values_there = at.expressions.function([limit.expression])(table).full()
            room = Thresholds.feasibility * limit.scale[:, None]
            below, above = limit.lower[:, None] - room, limit.upper[:, None] + room
            broken = (values_there < below) | (values_there > above)
            sums = np.where(broken.any(axis=0), np.inf, sums)
        return np.where(np.isfinite(sums), sums, np.inf)

    before = hamiltonian(sampled)
    best, values = before.copy(), {c.name: sampled[c.name].copy() for c in looked_at}
    for control in looked_at:
        for component in np.flatnonzero(np.isfinite(control.upper - control.lower)).tolist():
            even = np.linspace(control.lower[component], control.upper[component], VALUES_TRIED)
            shares = np.linspace(0.0, 1.0, VALUES_TRIED)
            quantiles = np.quantile(sampled[control.name][:, component], shares)
            for value in np.union1d(even, quantiles):
                tried = values[control.name].copy()
                tried[:, component] = value
                trial = hamiltonian({**sampled, **values, control.name: tried})
                lower = trial < best
                best = np.where(lower, trial, best)
                values[control.name][lower, component] = value
    with np.errstate(invalid="ignore"):
        gain = np.nan_to_num((before - best) * weights, posinf=0.0)
    shape = layout.intervals, scheme.degree, -1
    tables = {name: table.reshape(shape) for name, table in values.items()}
    return float(gain.sum()), tables
