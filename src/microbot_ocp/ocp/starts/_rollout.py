"""Guesses by simulation: the dynamics integrated from the start with constant controls."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.quiet import quiet
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase, Range, Variable, parts_of
from microbot_ocp.ocp.transcription import Guess, Guesses, GuessValue, interpolate, sampled

# Fractions of the ranges of all controls: constant, or in the two halves of every phase.
LEVELS = (0.5, 0.2, 0.1, 0.8, 0.0, 1.0)
STEPS = ((0.2, 1.0), (0.8, 0.0), (0.0, 1.0), (1.0, 0.0))
COMBINED = 4  # components for which all combinations of two values are simulated
EXPLODED = 1e4  # size of a state above which a simulation is rejected, relative to the usual guess
MIDDLE = 50  # grid point at which controls change; both halves have as many steps

FACTORS = np.logspace(-6, 9, 31)  # simulated durations relative to the usual ones
POINTS = 2 * MIDDLE + 1  # grid points of every phase
GRID = np.linspace(0.0, 1.0, POINTS)
Ranges = Mapping[str, Mapping[str, Range]]
Shares = tuple[float, float] | np.ndarray  # fractions in both halves, or mask of extreme components
Scored = tuple[dict[str, Guess], float]  # guesses, and their distance to bounds and conditions


def rollouts(problem: OptimalControlProblem, ordinary: Guesses) -> list[dict[str, Guess]]:
    """Return guesses whose states follow the dynamics under constant controls.

    Controls without bounds are zero; the others are at one fraction of their ranges. In the first
    guess, states violate their bounds and end conditions least. States are clipped to their bounds
    in the guess. Simulations that diverge are omitted; if all do, the result is ``ordinary``.

    Parameters
    ----------
    problem : OptimalControlProblem
    ordinary : mapping from phase name to Guess
        Initial states without a condition, durations, and algebraic variables.
    """
    return Rollouts(problem, ordinary).nearest_first() or [dict(ordinary)]


class Rollouts:
    """Simulations of a problem; the integrators are built once.

    Parameters
    ----------
    problem : OptimalControlProblem
    ordinary : mapping from phase name to Guess
        Initial states without a condition, and algebraic variables.
    ranges : mapping from phase to mapping from name to (lower, upper), each [size], optional
        Ranges of controls with infinite bounds; by default such controls are zero. If no control
        has a range, also ranges of free parameters and free initial states; by default these are
        as in ``ordinary``.
    """

    def __init__(
        self, problem: OptimalControlProblem, ordinary: Guesses, ranges: Ranges | None = None
    ) -> None:
        self.problem, self.ordinary = problem, ordinary
        self.ranges = {
            p.name: {c.name: within(c, (ranges or {}).get(p.name, {})) for c in p.controls}
            for p in problem.phases
        }
        self.integrators = {p.name: _Integrators(p, ordinary[p.name]) for p in problem.phases}
        self.others: dict[str, dict[str, Range]] = {p.name: {} for p in problem.phases}
        if ranges is not None and not _wide(self.ranges):
            for p in problem.phases:
                free = (*p.free_parameters, *p.states)
                known = ranges[p.name]
                self.others[p.name] = {v.name: within(v, known) for v in free if v.name in known}
        self.components = _wide(self.ranges) + _wide(self.others)

    def nearest_first(
        self,
        durations: Mapping[str, float] | None = None,
        *,
        steps: bool = False,
        cost: Callable[[dict[str, Guess]], float] | None = None,
    ) -> list[dict[str, Guess]]:
        """Return guesses as in :func:`rollouts`, nearest first; empty if all simulations diverge.

        With ``steps``, controls that change once, in the middle of every phase, are simulated as
        well. Among equally near guesses, the cheapest by ``cost`` comes first.
        """
        return _ordered(self._nearest(durations or {}, steps=steps), cost)

    def corners(
        self, cost: Callable[[dict[str, Guess]], float] | None = None
    ) -> list[dict[str, Guess]]:
        """Return guesses with some components at an extreme of their ranges, the others centred.

        The extreme is the end on the other side of zero. All combinations of the first few
        components are simulated, with random choices of the others. Empty for one component.
        """
        full, draw = min(self.components, COMBINED), np.random.default_rng(0)
        numbers = range(1, 2**full) if self.components > 1 else ()
        others = draw.integers(0, 2, (2**full, max(self.components - full, 0)))
        all_sides = [np.append(number >> np.arange(full) & 1, others[number]) for number in numbers]
        return _ordered(self._finite({}, all_sides), cost)

    def of_any_duration(self) -> list[dict[str, Guess]]:
        """Return the nearest guess for each of many durations, growing by factors of sqrt(10).

        For fixed durations, return all guesses of :meth:`nearest_first`.
        """
        phases = self.problem.phases
        usual = {p.name: float(self.ordinary[p.name].duration or 1.0) for p in phases}
        tried: list[dict[str, float]] = []
        for factor in FACTORS:
            limited = [(p, np.clip(factor * usual[p.name], *p.duration_bounds)) for p in phases]
            durations = {p.name: float(duration) for p, duration in limited}
            tried += [durations] if durations not in tried else []
        best = 1 if len(tried) > 1 else None
        pairs = [pair for each in tried for pair in self._nearest(each, steps=True)[:best]]
        return [guess for guess, _ in sorted(pairs, key=lambda pair: pair[1])]

    def _nearest(self, durations: Mapping[str, float], *, steps: bool) -> list[Scored]:
        """Return guesses with their distances, nearest first."""
        pairs = [*((share, share) for share in LEVELS), *(STEPS if steps else ())]
        return self._finite(durations, pairs if self.components else pairs[:1])

    def _finite(self, durations: Mapping[str, float], shares: Sequence[Shares]) -> list[Scored]:
        tried = [self._simulated(durations, each) for each in shares]
        return sorted((pair for pair in tried if np.isfinite(pair[1])), key=lambda pair: pair[1])

    def _simulated(self, durations: Mapping[str, float], shares: Shares) -> Scored:
        """Return guesses and their distance to bounds and conditions, relative to state sizes."""
        each = iter(shares)

        def held(low: FloatArray, high: FloatArray) -> Range:
            if isinstance(shares, tuple):
                return _constant(low, high, shares[0]), _constant(low, high, shares[1])
            far = np.array([next(each) if wide else 0 for wide in _is_wide(low, high)])
            other_side = np.where(np.abs(low) <= np.abs(high), 0.0, 1.0)
            value = _constant(low, high, np.where(far, other_side, 0.5))
            return value, value

        guesses, miss = {}, 0.0
        links = {link.after: link.names for link in self.problem.links}
        last: dict[str, FloatArray] = {}
        for phase in self.problem.phases:
            phase_guess = self.ordinary[phase.name]
            duration = float(durations.get(phase.name, phase_guess.duration or 1.0))
            others = {k: held(*bounds)[0] for k, bounds in self.others[phase.name].items()}
            phase_guess = phase_guess.with_values(others)
            start = {s.name: _at_start(phase_guess, s) for s in phase.states}
            free = [_at_start(phase_guess, f) for f in phase.free_parameters]
            start |= {k: last[k] for k in links.get(phase.name, ()) if k in last and k in start}
            controls = {k: held(*bounds) for k, bounds in self.ranges[phase.name].items()}
            table = self.integrators[phase.name].table(start, controls, duration, free)
            values: dict[str, GuessValue] = dict(phase_guess.values)
            for name, (before, after) in controls.items():
                same = np.array_equal(before, after)
                values[name] = before if same else partial(_step, before, after)
            parts = parts_of(phase.states, table)
            for state in phase.states:
                part = parts[state.name]
                clipped = np.clip(part, state.lower, state.upper)
                values[state.name] = partial(interpolate, clipped)
                last[state.name] = clipped[-1]
                size = np.maximum(np.abs(clipped).max(axis=0), ROUNDING)
                ends = sampled(phase_guess.values.get(state.name), state, np.array([0.0, 1.0]))
                usual = np.abs(ends).max(axis=0)
                if np.any(size > EXPLODED * np.maximum(usual, 1.0)):
                    miss = np.inf
                miss += float((np.abs(part - clipped).max(axis=0) / size).sum())
                if state.final is not None:
                    nearest = np.clip(clipped[-1], *state.final)
                    size = np.maximum(size, np.abs(nearest))
                    miss += float((np.abs(clipped[-1] - nearest) / size).sum())
            guesses[phase.name] = Guess(duration, values)
        return guesses, miss if np.isfinite(miss) else np.inf


def _ordered(
    pairs: Sequence[Scored], cost: Callable[[dict[str, Guess]], float] | None
) -> list[dict[str, Guess]]:
    """Return guesses in order, equally near ones sorted by cost if it is given."""
    order = list(range(len(pairs)))
    if cost is not None:
        costs = [cost(guess) for guess, _ in pairs]
        order.sort(key=lambda k: (round(pairs[k][1], 6), costs[k]))
    return [pairs[k][0] for k in order]


def _wide(ranges: Ranges) -> int:
    """Return the number of components with finite, different ends of their ranges."""
    pairs = [pair for of_phase in ranges.values() for pair in of_phase.values()]
    return sum(int(_is_wide(low, high).sum()) for low, high in pairs)


def _is_wide(low: FloatArray, high: FloatArray) -> np.ndarray:
    return np.isfinite(low) & np.isfinite(high) & (low < high)


def within(variable: Variable, ranges: Mapping[str, Range]) -> Range:
    """Return the bounds of a variable, with the ends of its range in place of infinite ones."""
    low, high = ranges.get(variable.name, (variable.lower, variable.upper))
    return (
        np.where(np.isfinite(variable.lower), variable.lower, low),
        np.where(np.isfinite(variable.upper), variable.upper, high),
    )


def _constant(low: FloatArray, high: FloatArray, share: float | FloatArray) -> FloatArray:
    both = np.isfinite(low) & np.isfinite(high)
    with np.errstate(invalid="ignore"):
        return np.where(both, low + share * (high - low), np.clip(0.0, low, high))


def _step(before: FloatArray, after: FloatArray, s: FloatArray) -> FloatArray:
    return np.where(np.asarray(s)[:, None] < 0.5, before, after)


def _at_start(guess: Guess, variable: Variable) -> FloatArray:
    return sampled(guess.values.get(variable.name), variable, np.zeros(1))[0]


class _Integrators:
    """Integrators of the dynamics of a phase over a fraction of its time, at constant controls."""

    def __init__(self, phase: Phase, guess: Guess) -> None:
        self.phase = phase
        states = ca.vertcat(*(s.symbol for s in phase.states))
        algebraic = ca.vertcat(*(a.symbol for a in phase.algebraics), ca.MX(0, 1))
        slopes = ca.vertcat(*(phase.derivatives[s.name] for s in phase.states))
        equations = ca.vertcat(*phase.algebraic_equations, ca.MX(0, 1))
        share, begin, duration = ca.MX.sym("share"), ca.MX.sym("begin"), ca.MX.sym("duration")
        pairs = [(phase.duration, duration), (phase.time, duration * (begin + share))]
        pairs += [(rate, ca.MX.zeros(rate.shape[0])) for rate in phase.rates.values()]
        pairs += [(p.symbol, ca.MX(ca.DM(p.value))) for p in phase.parameters]
        symbols, values = ([pair[k] for pair in pairs] for k in range(2))
        slopes, equations = ca.graph_substitute([slopes, equations], symbols, values)
        held = ca.vertcat(*(c.symbol for c in phase.controls), ca.MX(0, 1))
        given = ca.vertcat(begin, duration, held, *(f.symbol for f in phase.free_parameters))
        dae = {"x": states, "t": share, "p": given, "ode": duration * slopes}
        if phase.algebraics:
            dae |= {"z": algebraic, "alg": equations}
        self.z = np.concatenate([*(_at_start(guess, a) for a in phase.algebraics), np.zeros(0)])
        options = {"max_num_steps": 500, "show_eval_warnings": False}
        options |= {"disable_internal_warnings": True}
        kind, until = "idas" if phase.algebraics else "cvodes", GRID[1 : MIDDLE + 1]
        self.half = ca.integrator("rollout", kind, dae, 0.0, until, options)

    def table(
        self,
        start: Mapping[str, FloatArray],
        controls: Mapping[str, tuple[FloatArray, FloatArray]],
        duration: float,
        free: Sequence[FloatArray],
    ) -> FloatArray:
        """Return states [POINTS, n]; NaN after a failure of the integrator."""
        x, z = np.concatenate([start[s.name] for s in self.phase.states]), self.z
        table = np.full((POINTS, x.size), np.nan)
        table[0] = x
        for half in range(2):
            first, held = half * MIDDLE, [pair[half] for pair in controls.values()]
            given = np.concatenate([[GRID[first], duration], *held, *free])
            if not np.isfinite(table[first]).all():
                break
            try:
                with quiet():  # SUNDIALS prints a line for each failure
                    result = self.half(x0=table[first], z0=z, p=given)
            except RuntimeError:
                break
            table[first + 1 : first + 1 + MIDDLE] = np.array(result["xf"]).T
            z = np.array(result["zf"]).T[-1]
        return table
