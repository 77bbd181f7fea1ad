"""Whether another control at the same state has a smaller Hamiltonian: Pontryagin's condition.

A solver of programs looks at the neighbourhood of its point only. Where the Hamiltonian has two
valleys in a control, a solution may stand in the higher one on some intervals, with all conditions
of the first order met, and better ones are found by none of its steps. To first order, another
control on a short interval changes the cost by the difference of the Hamiltonians (Bryson and Ho,
*Applied Optimal Control*, section 2.3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.problem import Variable
from microbot_ocp.ocp.solution import PhaseSolution, Solution
from microbot_ocp.ocp.transcription.schemes import Collocation
from microbot_ocp.ocp.verification._recomputation import Recomputation
from microbot_ocp.ocp.verification._reintegration import phase_layout


@dataclass(frozen=True)
class MinimumSettings:
    """Which controls a Hamiltonian is compared at.

    Attributes
    ----------
    tried : values of a control from bound to bound, and as many that it takes elsewhere
    keeps : relative excess of a constraint above which a control is none to compare with
    """

    tried: int = 9
    keeps: float = 1e-6


SETTINGS = MinimumSettings()


def better_controls(solution: Solution) -> tuple[float, dict[str, dict[str, FloatArray]]]:
    """What the cost would fall by, to first order, and the controls [N, points, size] by phase.

    Bounded polynomial controls are looked at one by one, at the points of collocation of phases
    whose intervals are of one degree and which have no algebraic variables.
    """
    gain, controls = 0.0, {}
    for phase in solution.phases:
        own, values = _of_phase(phase, solution.row_multipliers)
        if own > 0:
            gain, controls[phase.name] = gain + own, values
    return gain, controls


def _of_phase(phase: PhaseSolution, multipliers: FloatArray) -> tuple[float, dict[str, FloatArray]]:
    layout = phase_layout(phase)
    declared, group = layout.phase, layout.groups[0]
    scheme = group.kind.scheme
    looked_at = [
        control
        for control in declared.controls
        if control.shape == "polynomial" and np.isfinite([control.lower, control.upper]).any()
    ]
    if len(layout.groups) > 1 or not isinstance(scheme, Collocation):
        return 0.0, {}
    if declared.algebraics or not looked_at:
        return 0.0, {}
    count, size = scheme.degree, sum(s.size for s in declared.states)
    intervals = np.repeat(group.intervals, count)
    share = np.tile(scheme.points, group.intervals.size)
    at = Recomputation(phase)
    sampled = at.interpolated(intervals, share)
    for control in looked_at:  # as they stand, not as they are limited in between
        sampled[control.name] = phase.values[control.name].reshape(-1, control.size)
    steps = np.diff(phase.mesh)[intervals]
    t = (phase.mesh[intervals] + share * steps) * phase.duration
    defects = group.rows[:, layout.node_size :][:, : count * size]
    scale = layout.node_scale[:size] * np.asarray(scheme.weights)[:, None]
    costates = (-multipliers[defects].reshape(-1, count, size) / scale).reshape(-1, size)
    weights = steps * phase.duration * np.tile(scheme.weights, group.intervals.size)

    def hamiltonian(values: dict[str, FloatArray]) -> FloatArray:
        columns = {k: v.T for k, v in values.items()}
        table = at.expressions.table(columns, t, phase.duration)
        slopes = at.expressions.dynamics(table).full()
        sums = slopes[-1] + np.einsum("ki,ik->k", costates, slopes[:-1])
        for limit in declared.constraints:
            own = at.expressions.function([limit.expression])(table).full()
            room = SETTINGS.keeps * limit.scale[:, None]
            broken = (own < limit.lower[:, None] - room) | (own > limit.upper[:, None] + room)
            sums = np.where(broken.any(axis=0), np.inf, sums)
        return np.where(np.isfinite(sums), sums, np.inf)

    before = hamiltonian(sampled)
    best, values = before.copy(), {c.name: sampled[c.name].copy() for c in looked_at}
    for control in looked_at:
        for component in np.flatnonzero(_bounded(control)).tolist():
            even = np.linspace(control.lower[component], control.upper[component], SETTINGS.tried)
            own = np.quantile(
                sampled[control.name][:, component], np.linspace(0.0, 1.0, SETTINGS.tried)
            )
            for value in np.union1d(even, own):
                tried = values[control.name].copy()
                tried[:, component] = value
                found = hamiltonian({**sampled, **values, control.name: tried})
                lower = found < best
                best = np.where(lower, found, best)
                values[control.name][lower, component] = value
    with np.errstate(invalid="ignore"):
        gain = np.nan_to_num((before - best) * weights, posinf=0.0)
    shape = (layout.intervals, count)
    found = {name: table.reshape(*shape, -1) for name, table in values.items()}
    return float(gain.sum()), found


def _bounded(control: Variable) -> np.ndarray:
    return np.isfinite(control.lower) & np.isfinite(control.upper)
