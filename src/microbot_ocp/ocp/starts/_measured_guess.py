"""Initial guesses from data: states at the measurements, and free parameters fitted to them.

A Newton step on the cost of every measurement yields the states that it depends on; between
measurements they are interpolated linearly. One Gauss-Newton step then fits the free parameters:
the dynamics, integrated along these states, should match their differences. Most dynamics are
linear in the parameters, and no trajectory is simulated, so poor initial parameters do no harm.
Source: Varah, *SIAM J. Sci. Stat. Comput.* 3 (1982), 28-46.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.problem import Expressions, OptimalControlProblem, Phase, Variable, parts_of
from microbot_ocp.ocp.transcription import Guess, Guesses, GuessValue, sampled

Points = Mapping[int, tuple[FloatArray, FloatArray]]  # fractions [M] and values [M] by component

NODES = 5  # quadrature points between two measurements


def with_measurements(problem: OptimalControlProblem, guesses: Guesses) -> dict[str, Guess]:
    """Return guesses with states and free parameters from the measurements."""
    completed = dict(guesses)
    measured = {p.name: _points(p, guesses[p.name]) for p in problem.phases if p.measurements}
    phases = [phase for phase in problem.phases if phase.name in measured]
    for phase in phases:
        states = _states(phase, completed[phase.name], measured[phase.name])
        completed[phase.name] = completed[phase.name].with_values(states)
    defined = {c.defines for phase in phases for c in phase.point_constraints}
    unknown = {v.name: v for p in phases for v in p.free_parameters if v.name not in defined}
    fitted = _fitted(phases, completed, measured, list(unknown.values())) if unknown else {}
    for phase in problem.phases:
        values = {v.name: fitted[v.name] for v in phase.free_parameters if v.name in fitted}
        completed[phase.name] = completed[phase.name].with_values(values)
    return completed


def _states(phase: Phase, guess: Guess, points: Points) -> dict[str, GuessValue]:
    """Return guesses of the measured states."""
    states, offset = {}, 0
    for state in phase.states:
        measured = {i: points[offset + i] for i in range(state.size) if offset + i in points}
        if measured:
            states[state.name] = partial(_along, guess, state, measured)
        offset += state.size
    return states


def _along(guess: Guess, state: Variable, points: Points, s: FloatArray) -> FloatArray:
    """Interpolate a state [M, size] at fractions [M], linearly between its known values."""
    table = sampled(guess.values.get(state.name), state, s)
    for i, (fractions, values) in points.items():
        table[:, i] = np.interp(s, fractions, values)
    return np.clip(table, state.lower, state.upper)


def _points(phase: Phase, guess: Guess) -> Points:
    """Return the known values of state components: at a fixed start and at measurements."""
    x = ca.vertcat(*(s.symbol for s in phase.states))
    duration, offset = float(guess.duration or 1.0), 0
    places: list[np.ndarray] = [np.zeros((3, 0))]  # component, fraction, value
    for state in phase.states:
        if state.initial is not None and np.array_equal(*state.initial):
            components = offset + np.arange(state.size)
            places.append(np.vstack([components, 0.0 * components, state.initial[0]]))
        offset += state.size
    for cost in phase.point_costs:
        data = [m for m in phase.measurements if ca.depends_on(cost.expression, m.symbol)]
        if not data:
            continue
        expressions, s = Expressions(phase, data), cost.fractions
        values = {v.name: sampled(guess.values.get(v.name), v, s).T for v in phase.variables}
        measured = [m.value.T for m in data]
        inputs = expressions.tables(values, duration * s, duration, data=measured)
        curvature, slope = ca.hessian(cost.expression, x)
        outputs = [ca.densify(curvature), ca.densify(slope)]
        function = ca.Function("cost", expressions.symbols, outputs)
        states = np.vstack(inputs[: len(phase.states)])
        for k, fraction in enumerate(s.tolist()):
            hessian, gradient = (out.full() for out in function(*(t[:, k] for t in inputs)))
            if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
                continue
            seen = np.flatnonzero(np.abs(hessian).sum(axis=1) > 0)
            # Newton step x - H^+ grad; components with a zero row of H were not measured.
            value = states[:, k] - np.linalg.pinv(hessian, hermitian=True) @ gradient[:, 0]
            places.append(np.vstack([seen, np.full(seen.size, fraction), value[seen]]))
    component, fraction, value = np.hstack(places)
    points = {}
    for i in np.unique(component).astype(int).tolist():
        fractions, first = np.unique(fraction[component == i], return_index=True)
        if fractions.size > 1:
            points[i] = fractions, value[component == i][first]
    return points


def _fitted(
    phases: list[Phase], guesses: Guesses, measured: Mapping[str, Points], unknown: list[Variable]
) -> dict[str, FloatArray]:
    """Return free parameters for which the dynamics match the measured states best."""
    lower, upper = (np.concatenate([getattr(v, k) for v in unknown]) for k in ("lower", "upper"))
    holders = [next(p for p in phases if v in p.free_parameters) for v in unknown]
    pairs = zip(holders, unknown, strict=True)
    values = [(guesses[p.name].values.get(v.name), v) for p, v in pairs]
    start = np.concatenate([sampled(value, v, np.zeros(1))[0] for value, v in values])
    start = np.where(start == 0, np.clip(1.0, lower, upper), start)
    x = ca.MX.sym("free", start.size)
    parts = ca.vertsplit(x, np.cumsum([0, *(v.size for v in unknown)]).tolist())
    free = dict(zip([v.name for v in unknown], parts, strict=True))
    rows = [row for p in phases for row in _misfits(p, guesses[p.name], measured[p.name], free)]
    residuals = ca.vertcat(*rows, ca.MX(0, 1))
    if any(p.algebraics for p in phases) or residuals.shape[0] < start.size:
        return {}
    run = ca.Function("misfits", [x], [residuals, ca.densify(ca.jacobian(residuals, x))])
    misfit, slopes = (out.full() for out in run(start))
    if not (np.isfinite(misfit).all() and np.isfinite(slopes).all()):
        return {}
    best = np.clip(start - np.linalg.lstsq(slopes, misfit[:, 0])[0], lower, upper)
    return parts_of(unknown, best)


def _misfits(phase: Phase, guess: Guess, points: Points, free: Mapping[str, ca.MX]) -> list[ca.MX]:
    """Return differences of measured states minus integrals of their derivatives, relative."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    duration = float(guess.duration or 1.0)
    slopes = ca.vertcat(*(phase.derivatives[s.name] for s in phase.states))
    expressions, rows = Expressions(phase), []
    function = ca.Function("slopes", expressions.symbols, [slopes])
    for i, (fractions, seen) in points.items():
        steps = np.diff(fractions)
        at = (fractions[:-1, None] + steps[:, None] * (nodes + 1) / 2).ravel()
        values = {v.name: sampled(guess.values.get(v.name), v, at).T for v in phase.variables}
        inputs: list[ca.MX | FloatArray] = list(expressions.tables(values, duration * at, duration))
        for k, variable in enumerate(phase.variables):
            if variable.name in free:
                inputs[k] = ca.repmat(free[variable.name], 1, at.size)
        slope = ca.reshape(function.map(at.size)(*inputs)[i, :], NODES, steps.size)
        integral = ca.DM(weights[None] / 2) @ slope * ca.DM(steps * duration).T
        size = float(np.abs(seen).max()) or 1.0
        rows.append((ca.DM(np.diff(seen)) - integral.T) / size)
    return rows
