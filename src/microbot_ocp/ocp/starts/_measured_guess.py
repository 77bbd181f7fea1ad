"""Guesses from data: states where the measurements put them, free parameters that suit both.

A step of Newton's method on the cost of every measurement gives the states that it sees; between
the measurements they go straight. Free parameters are those with which the dynamics, integrated
along these states, come nearest to their differences: no trajectory is simulated, so poor
parameters do no harm. Source: Varah, *SIAM J. Sci. Stat. Comput.* 3 (1982), 28-46.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase, Variable
from microbot_ocp.ocp.transcription import Guess, GuessValue, guess_table

NODES = 5  # of the quadrature between two measurements


def with_measurements(
    problem: OptimalControlProblem, guesses: Mapping[str, Guess]
) -> dict[str, Guess]:
    """Guesses of all phases, with states and free parameters from what was measured."""
    found = dict(guesses)
    seen = [_Seen(phase, guesses[phase.name]) for phase in problem.phases if phase.measurements]
    free = {v.name: v for own in seen for v in own.phase.free_parameters}
    for own in seen:
        guess = found[own.phase.name]
        found[own.phase.name] = Guess(guess.duration, {**guess.values, **own.states()})
    unknown = [v for v in free.values() if not any(own.defined(v) for own in seen)]
    values = _fitted(seen, unknown) if unknown else {}
    for name, guess in found.items():
        phase = next(p for p in problem.phases if p.name == name)
        own = {v.name: values[v.name] for v in phase.free_parameters if v.name in values}
        found[name] = Guess(guess.duration, {**guess.values, **own})
    return found


@dataclass(frozen=True, eq=False)
class _Points:
    """Fractions [M] of the phase at which a component of the states is known, and its values."""

    fractions: FloatArray
    values: FloatArray


class _Seen:
    """What the measurements of a phase say of its states."""

    def __init__(self, phase: Phase, guess: Guess) -> None:
        self.phase, self.guess = phase, guess
        self.points = self._find()

    def defined(self, parameter: Variable) -> bool:
        return any(c.defines == parameter.name for c in self.phase.point_constraints)

    def table(self, variable: Variable, fractions: FloatArray) -> FloatArray:
        """The guess of a variable [M, size] without measurements; zeros where there is none."""
        value = self.guess.values.get(variable.name, np.clip(0.0, variable.lower, variable.upper))
        table = guess_table(value, variable.size, fractions)
        return np.broadcast_to(table, (fractions.size, variable.size)).copy()

    def _inputs(self, fractions: FloatArray) -> list[FloatArray]:
        """Values [size, M] of everything that expressions of the phase know, but measurements."""
        phase, size = self.phase, fractions.size
        tables = [self.table(v, fractions).T for v in phase.variables]
        rates = [np.zeros((c.size, size)) for c in phase.controls if c.rate is not None]
        fixed = [np.tile(p.value[:, None], (1, size)) for p in phase.parameters]
        duration = float(self.guess.duration or 1.0)
        return [*tables, *rates, *fixed, duration * fractions[None], np.full((1, size), duration)]

    def _symbols(self) -> list[ca.MX]:
        phase = self.phase
        rates = [c.rate for c in phase.controls if c.rate is not None]
        fixed = [p.symbol for p in phase.parameters]
        return [*(v.symbol for v in phase.variables), *rates, *fixed, phase.time, phase.duration]

    def _find(self) -> dict[int, _Points]:
        phase = self.phase
        x = ca.vertcat(*(s.symbol for s in phase.states))
        places: list[np.ndarray] = [np.zeros((3, 0))]  # component, fraction, value
        offset = 0
        for state in phase.states:
            if state.initial is not None and np.array_equal(*state.initial):
                own = offset + np.arange(state.size)
                places.append(np.vstack([own, 0.0 * own, state.initial[0]]))
            offset += state.size
        for cost in phase.point_costs:
            data = [m for m in phase.measurements if ca.depends_on(cost.expression, m.symbol)]
            if not data:
                continue
            symbols = [*self._symbols(), *(m.symbol for m in data)]
            known = [*self._inputs(cost.fractions), *(m.value.T for m in data)]
            curvature, slope = ca.hessian(cost.expression, x)
            function = ca.Function("cost", symbols, [ca.densify(curvature), ca.densify(slope)])
            states = np.vstack(known[: len(phase.states)])
            for k, fraction in enumerate(cost.fractions.tolist()):
                hessian, gradient = (out.full() for out in function(*(t[:, k] for t in known)))
                if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
                    continue
                sees = np.flatnonzero(np.abs(hessian).sum(axis=1) > 0)
                step = np.linalg.pinv(hessian, hermitian=True) @ gradient[:, 0]
                value = states[:, k] - step
                places.append(np.vstack([sees, np.full(sees.size, fraction), value[sees]]))
        component, fraction, value = np.hstack(places)
        found = {}
        for i in np.unique(component).astype(int).tolist():
            own = component == i
            fractions, first = np.unique(fraction[own], return_index=True)
            found[i] = _Points(fractions, value[own][first])
        return {i: points for i, points in found.items() if points.fractions.size > 1}

    def states(self) -> dict[str, GuessValue]:
        """Guesses of the states that are seen."""
        found: dict[str, GuessValue] = {}
        offset = 0
        for state in self.phase.states:
            if any(offset + i in self.points for i in range(state.size)):
                found[state.name] = lambda s, state=state, offset=offset: self.along(
                    state, offset, s
                )
            offset += state.size
        return found

    def along(self, state: Variable, offset: int, s: FloatArray) -> FloatArray:
        """A state [M, size] at fractions [M], straight between what is known of it."""
        table = self.table(state, s)
        for i in range(state.size):
            points = self.points.get(offset + i)
            if points is not None:
                table[:, i] = np.interp(s, points.fractions, points.values)
        return np.clip(table, state.lower, state.upper)

    def residuals(self, free: ca.MX, unknown: list[Variable]) -> ca.MX:
        """Differences of what is seen, less the integrals of its slopes, relative to its size."""
        phase = self.phase
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        slopes = ca.vertcat(*(phase.derivatives[s.name] for s in phase.states))
        function = ca.Function("slopes", self._symbols(), [slopes])
        found = [ca.MX(0, 1)]
        for i, points in self.points.items():
            steps = np.diff(points.fractions)
            at = (points.fractions[:-1, None] + steps[:, None] * (nodes + 1) / 2).ravel()
            inputs: list[ca.MX | FloatArray] = list(self._inputs(at))
            offset = 0
            for k, state in enumerate(phase.states):
                inputs[k] = self.along(state, offset, at).T
                offset += state.size
            for k, variable in enumerate(phase.variables):
                if variable in unknown:
                    first = sum(v.size for v in unknown[: unknown.index(variable)])
                    own = free[first : first + variable.size]
                    inputs[k] = ca.repmat(own, 1, at.size)
            slope = ca.reshape(function.map(at.size)(*inputs)[i, :], NODES, steps.size)
            integral = (
                ca.DM(weights[None] / 2)
                @ slope
                * ca.DM(steps * float(self.guess.duration or 1.0)).T
            )
            size = max(float(np.abs(points.values).max()), 1e-12)
            found.append((ca.DM(np.diff(points.values)) - integral.T) / size)
        return ca.vertcat(*found)


def _fitted(seen: list[_Seen], unknown: list[Variable]) -> dict[str, FloatArray]:
    """Free parameters with which the dynamics suit the states that are seen."""
    lower, upper = (np.concatenate([getattr(v, k) for v in unknown]) for k in ("lower", "upper"))
    start = np.concatenate([_start(seen, v) for v in unknown])
    edges = np.cumsum([v.size for v in unknown])[:-1]
    if any(own.phase.algebraics for own in seen) or np.any(lower >= upper):
        return {}
    free = ca.MX.sym("free", start.size)
    residuals = ca.vertcat(*(own.residuals(free, unknown) for own in seen))
    if residuals.shape[0] < start.size:
        return {}
    value = ca.Function("residuals", [free], [residuals])
    slope = ca.Function("slopes", [free], [ca.densify(ca.jacobian(residuals, free))])
    try:
        from scipy.optimize import least_squares
    except ImportError:
        raise InputError(
            "guesses of fits to data need scipy: pip install 'microbot_ocp[fit]', or give guess="
        ) from None
    best = None
    for begin in (start, np.where(start == 0, np.clip(1.0, lower, upper), start)):
        try:
            made = least_squares(
                lambda k: value(k).full().ravel(),
                begin,
                jac=lambda k: slope(k).full(),  # type: ignore[arg-type]
                bounds=(lower, upper),
                x_scale="jac",
                max_nfev=50,
            )
        except ValueError:  # not finite at the start
            continue
        if best is None or made.cost < best.cost:
            best = made
    if best is None:
        return {}
    return dict(zip([v.name for v in unknown], np.split(best.x, edges), strict=True))


def _start(seen: list[_Seen], variable: Variable) -> FloatArray:
    """The ordinary guess [size] of a free parameter, inside its bounds."""
    own = next(s for s in seen if variable in s.phase.free_parameters)
    return own.table(variable, np.zeros(1))[0]
