"""Automatic scales: typical sizes of variables, constraints and costs declared without a scale.

Solvers assume sizes near one. The size of a state or control is taken from its guess and end
conditions or from its bounds. Otherwise it follows from the dynamics: the size of a state from its
derivative, limited by the values in simulations with constant controls; the size of a control from
the value that moves a state by its size during the phase. A constraint or cost is divided by its
change when the variables change by their sizes. Dynamics are scaled with their states.

Scales are powers of ten, and a size within a factor of ten of one is not scaled, so that a problem
in suitable units is solved as written.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp.ocp.problem import (
    LIMITS,
    VARIABLES,
    Expressions,
    OptimalControlProblem,
    PathConstraint,
    Phase,
    PointConstraint,
    Range,
    Variable,
    parts_of,
    tied_controls,
    with_items,
    with_phases,
)
from microbot_ocp.ocp.solution import Given, Solution
from microbot_ocp.ocp.starts._initial_guess import completed, default_guess, guess_from
from microbot_ocp.ocp.starts._rollout import rollouts
from microbot_ocp.ocp.transcription import Guess, Guesses, Program, sampled

POINTS = 40  # points along a guess at which expressions are evaluated
MOST_ROUNDS = 10  # rounds in which sizes follow from other sizes
NEGLIGIBLE = 1e-6  # ratio to the scale, the motion or the rate below which a size counts as zero
PEAK_SHARE = 1e-3  # fraction of the largest rate that counts if most are smaller, as at a pulse


def scaled(problem: OptimalControlProblem, guess: Given = None) -> OptimalControlProblem:
    """Return the problem with a scale for every item that was declared without one.

    Parameters
    ----------
    problem : OptimalControlProblem
    guess : guesses or Solution, optional
        Starting point of the solve: a guess of the right size is the best information.

    Returns
    -------
    OptimalControlProblem
        Problem with its symbols and expressions; declared scales are kept.

    Examples
    --------
    >>> problem = OptimalControlProblem("a satellite")
    >>> phase = problem.phase("climb", duration=(10.0, 1e4))
    >>> height = phase.state("height", initial=3e5, final=8e5, unit="m")
    >>> thrust = phase.control("thrust", lower=0.0, upper=0.02, unit="N")
    >>> phase.derivative(height, 1e4 * thrust)
    >>> phase.end_cost(phase.duration)
    >>> [(v.name, float(v.scale[0])) for p in scaled(problem).phases for v in p.states + p.controls]
    [('height', 1000000.0), ('thrust', 0.01)]
    """
    problem.check()
    given: Guesses = {}
    least_sizes: Mapping[str, Mapping[str, FloatArray]] = {}
    if isinstance(guess, Solution):
        given, least_sizes = guess_from(problem, guess), _least_sizes(guess)
    elif guess is not None:
        given = completed(problem, guess) if isinstance(guess, str) else guess
    ordinary = default_guess(problem)
    estimates = [
        _SizeEstimate(p, given.get(p.name, Guess()), ordinary[p.name], least_sizes.get(p.name, {}))
        for p in problem.phases
    ]
    if any(np.isnan(k.sizes[s.name]).any() for k in estimates for s in k.phase.states):
        for simulated in rollouts(problem, {k: given.get(k, g) for k, g in ordinary.items()}):
            for estimate in estimates:
                estimate.add_simulation(simulated[estimate.phase.name])
    for estimate in estimates:
        estimate.find_sizes()
    together: dict[tuple[str, int, str], FloatArray] = {}
    for estimate in estimates:  # phases with equal physics share kernels only for equal scales
        for v in estimate.unscaled:
            key, size = (v.name, v.size, v.unit), estimate.sizes[v.name]
            together[key] = np.fmax(together.get(key, size), size)
    phases = []
    for estimate in estimates:
        scale_of = {v.name: _rounded(together[v.name, v.size, v.unit]) for v in estimate.unscaled}
        scales = {v.name: scale_of.get(v.name, np.asarray(v.scale)) for v in estimate.variables}
        phases.append(estimate.scaled(scales))
    return with_phases(problem, phases)


def driving_ranges(
    problem: OptimalControlProblem, solution: Solution
) -> dict[str, dict[str, Range]]:
    """Return ranges of controls, free parameters and free initial states by phase.

    The range extends the values of the solution on both sides so far that a state can
    move from its largest value to the opposite value during the phase. Sizes of states are their
    largest values, or the scale of a state that stays zero.
    """
    ranges: dict[str, dict[str, Range]] = {}
    given, ordinary = guess_from(problem, solution), default_guess(problem)
    linked = {(link.after, name) for link in problem.links for name in link.names}
    shared = {v.name for v in problem.free_parameters}
    common: dict[str, Range] = {}
    for phase in problem.phases:
        estimate = _SizeEstimate(phase, given[phase.name], ordinary[phase.name], {})
        for v in phase.variables:
            reached = np.abs(estimate.tables[v.name]).max(axis=0)
            estimate.sizes[v.name] = np.where(reached > NEGLIGIBLE * v.scale, reached, v.scale)
        drives, tables, states = estimate.drives(), estimate.tables, phase.states
        parameters = [v for v in phase.free_parameters if v.name in shared]
        widths = {v.name: 2 * drives[v.name] for v in (*phase.controls, *parameters)}
        for s in states:
            if s.initial is None and (phase.name, s.name) not in linked:
                widths[s.name], tables[s.name] = 2 * estimate.sizes[s.name], tables[s.name][:1]
        found = {
            name: (tables[name].min(axis=0) - width, tables[name].max(axis=0) + width)
            for name, width in widths.items()
        }
        for name in shared & found.keys():  # a parameter has one range in all phases
            low, high = common.get(name, found[name])
            found[name] = common[name] = np.fmin(low, found[name][0]), np.fmax(high, found[name][1])
        ranges[phase.name] = found
    return {
        k: {**found, **{n: common[n] for n in shared & found.keys()}} for k, found in ranges.items()
    }


COST_CHANGE = 10.0  # change of the scaled cost if all scaled variables change by one
COST_BAND = 100.0  # factor around one within which changes of the cost are not scaled
BAND = 10.0  # factor around one within which other sizes are not scaled


def cost_scale(program: Program, x: FloatArray) -> float:
    """Return a divisor of the cost: it then changes by ten if all scaled variables change by one.

    A barrier parameter of the size of the tolerance at every limit is then small compared with the
    cost. The gradient is evaluated at the start and beside it, where a quadratic cost has a slope.
    """
    beside = np.clip(x + 0.5, program.variable_lower, program.variable_upper)
    sizes = []
    for point in (x, beside):
        slope = program.slopes(point)[0]
        sizes.append(float(np.abs(slope).sum()))
    change = max((size for size in sizes if np.isfinite(size)), default=COST_CHANGE)
    return float(_rounded(change / COST_CHANGE, COST_BAND))


def _rounded(size: FloatArray | float, band: float = BAND) -> FloatArray:
    """Return powers of ten; one for a size within ``band`` of one, or an unknown size."""
    positive = np.isfinite(size) & (size > 0)
    size = np.where(positive, size, 1.0)
    near = (size >= 1 / band) & (size <= band)
    return np.where(near, 1.0, 10.0 ** np.round(np.log10(size)))


class _SizeEstimate:
    """Sizes of the variables of one phase as far as they are known; NaN for unknown ones."""

    def __init__(
        self,
        phase: Phase,
        given: Guess,
        ordinary: Guess,
        least_sizes: Mapping[str, FloatArray],
    ) -> None:
        self.phase = phase
        self.variables = phase.variables
        self.unscaled = [v for v in self.variables if not v.scaled]
        # An invalid duration is rejected where the guess is used.
        guessed = float(given.duration or np.nan)
        self.duration = guessed if 0 < guessed < np.inf else float(ordinary.duration or 1.0)
        self.share, values = np.linspace(0.0, 1.0, POINTS), given.values
        self.tables = {
            v.name: sampled(values.get(v.name, ordinary.values.get(v.name, 0.0)), v, self.share)
            for v in self.variables
        }
        # Free parameters always count as guessed, because measurements may have determined them,
        # and so do controls that equations determine.
        guessed_names = {*values, *(v.name for v in phase.free_parameters), *tied_controls(phase)}
        tables = {v.name: self.tables[v.name] for v in self.variables if v.name in guessed_names}
        self.sizes = {
            v.name: v.scale
            if v.scaled
            else _size(v, tables.get(v.name), least_sizes.get(v.name, 0.0))
            for v in self.variables
        }
        self.rates = [c for c in phase.controls if c.name in phase.rates]
        self.reached: dict[str, FloatArray] = {}  # largest values of states in simulations

    def add_simulation(self, simulated: Guess) -> None:
        """Record the largest values of the states in a simulation."""
        for state in self.phase.states:
            table = sampled(simulated.values[state.name], state, self.share)
            old = self.reached.get(state.name, np.zeros(state.size))
            self.reached[state.name] = np.fmax(old, np.abs(table).max(axis=0))

    def find_sizes(self) -> None:
        """Determine unknown sizes from known ones."""
        self._follow_dynamics()
        for limit in self.phase.point_constraints:
            if limit.defines and np.isnan(self.sizes[limit.defines]).any():
                values, slopes = self._evaluated(limit.expression)
                span = np.nan_to_num(self._stacked())
                size = _typical((np.abs(slopes) * span).max(axis=2))
                self.sizes[limit.defines] = np.where(size > 0, size, _typical(np.abs(values)))

    def _follow_dynamics(self) -> None:
        # forward_i = T |f_i| for states; backward_j = size_i / (T |df_i/dx_j|), least over i.
        # Each round fills unknown sizes, forward before backward, until none changes.
        slope = self._slopes()
        reached = [self.reached.get(s.name, np.zeros(s.size)) for s in self.phase.states]
        most = np.concatenate(reached)
        most[most == 0] = np.inf
        for _ in range(MOST_ROUNDS):
            sizes = self._stacked()
            if np.isfinite(sizes).all():
                return
            values, slopes = self._evaluated(slope)
            states = sum(s.size for s in self.phase.states)
            with np.errstate(all="ignore"):
                rates, peaks = _typical(np.abs(values)), _typical(np.abs(values), 100)
                forward = self.duration * np.fmax(rates, PEAK_SHARE * peaks)
                moved = self.duration * _typical(np.abs(slopes)) * np.nan_to_num(sizes)
                moved = np.where(moved.any(axis=1), moved.max(axis=1), 1.0)
                forward = np.fmax(np.fmin(forward, most), NEGLIGIBLE * forward)
                forward[forward < NEGLIGIBLE * moved] = 0.0
            backward = self._backward(sizes, slopes)
            unknown = np.isnan(sizes)
            new = np.full(sizes.size, np.nan)
            new[:states] = np.where(forward > 0, forward, np.nan)
            if not np.isfinite(new[unknown]).any():
                new = np.where(np.isfinite(backward) & (backward > 0), backward, np.nan)
            if not np.isfinite(new[unknown]).any():
                return
            self.sizes = parts_of(self.variables, np.where(unknown, new, sizes))

    def _backward(self, sizes: FloatArray, slopes: FloatArray) -> FloatArray:
        """Return the change of each variable that moves a state by its size during the phase.

        Infinite for a variable that no state depends on.
        """
        with np.errstate(all="ignore"):
            drive = sizes[: slopes.shape[1], None] / (self.duration * _typical(np.abs(slopes)))
        drive[~np.isfinite(drive)] = np.inf
        np.fill_diagonal(drive, np.inf)
        return drive.min(axis=0)

    def drives(self) -> dict[str, FloatArray]:
        """Return :meth:`_backward` of the known sizes by name, with zero in place of infinity."""
        drives = self._backward(self._stacked(), self._evaluated(self._slopes())[1])
        drives[np.isinf(drives)] = 0.0
        return parts_of(self.variables, drives)

    def _slopes(self) -> ca.MX:
        return ca.vertcat(*(self.phase.derivatives[s.name] for s in self.phase.states))

    def scaled(self, scales: Mapping[str, FloatArray]) -> Phase:
        """Return the phase with these scales of its variables, and matching constraint scales."""
        self.sizes = dict(scales)
        changed = with_items(self.phase, lambda v: replace(v, scale=scales[v.name]), VARIABLES)
        changed = with_items(changed, lambda c: replace(c, scale=self._limit_scale(c)), LIMITS)
        if changed.duration_scale is None and (size := float(_rounded(self.duration))) != 1.0:
            changed.duration_scale = size
        return changed

    def _limit_scale(self, limit: PathConstraint) -> FloatArray:
        """Return the change of a constraint when the variables change by their scales."""
        if isinstance(limit, PointConstraint) and limit.defines:
            return self.sizes[limit.defines]
        if limit.scaled:
            return limit.scale
        _, slopes = self._evaluated(limit.expression, rates=True)
        rates = [self.sizes[c.name] / self.duration for c in self.rates]
        span = np.concatenate([self._stacked(), *rates])
        size = _typical((np.abs(slopes) * span).max(axis=2))
        return _rounded(np.where(size > 0, size, _magnitude(limit)))

    def _stacked(self) -> FloatArray:
        return np.concatenate([self.sizes[v.name] for v in self.variables])

    def _evaluated(self, expression: ca.MX, rates: bool = False) -> tuple[FloatArray, FloatArray]:
        """Return an expression [M, rows] and its derivatives [M, rows, columns].

        The M points are the guess and random points within the sizes around it.
        """
        random, phase, count = np.random.default_rng(0), self.phase, POINTS
        values, speeds = {}, {}
        for v in self.variables:
            table, size = self.tables[v.name], np.nan_to_num(self.sizes[v.name])
            around = table + size * random.uniform(-1.0, 1.0, (count, v.size))
            around[: count // 4] = table[: count // 4]
            values[v.name] = np.clip(around, v.lower, v.upper).T
        for control in self.rates:
            size = np.nan_to_num(self.sizes[control.name]) / self.duration
            speeds[control.name] = size[:, None] * random.uniform(-1.0, 1.0, (control.size, count))
        expressions = Expressions(phase, phase.measurements)
        points = expressions.tables(values, self.duration * self.share, self.duration, speeds)
        moving = [v.symbol for v in self.variables]
        moving += phase.rates.values() if rates else ()
        return expressions.with_slopes(expression, ca.vertcat(*moving), count)(points)


def _least_sizes(solution: Solution) -> dict[str, dict[str, FloatArray]]:
    """Return the values by phase and variable below which a solution is numerically zero."""
    return {
        phase.name: {v.name: NEGLIGIBLE * v.scale for v in phase.layout.phase.variables}
        for phase in solution.phases
        if phase.layout is not None
    }


LOOSE_RATIO = 1e3  # ratio of bounds to guess above which bounds do not indicate a size


def _size(
    variable: Variable, guess: FloatArray | None, least_size: FloatArray | float = 0.0
) -> FloatArray:
    """Return the size of a variable from its declaration and its guess; NaN if neither gives one.

    Values of the guess below ``least_size`` count as zero.
    """
    sizes = [np.zeros(variable.size)]
    bounded = np.isfinite(variable.lower) & np.isfinite(variable.upper)
    bounds = np.where(bounded, np.fmax(np.abs(variable.lower), np.abs(variable.upper)), np.nan)
    if guess is not None:
        size = np.abs(guess).max(axis=0)
        # A value within rounding of zero, left by a computation, is no size.
        least = np.fmax(ROUNDING * np.where(bounded, bounds, 1.0), least_size)
        sizes.append(np.where(size > least, size, 0.0))
    for condition in (variable.initial, variable.final):
        if condition is not None:
            sizes += [np.where(np.isfinite(side), np.abs(side), 0.0) for side in condition]
    typical = np.max(sizes, axis=0)
    if variable.shape not in ("state", "parameter"):  # controls often reach their bounds
        near = bounded & ((typical == 0) | (bounds <= LOOSE_RATIO * typical))
        typical = np.where(near, bounds, typical)
    elif variable.shape == "state" and (variable.initial is None or variable.final is None):
        # One end that is small beside the bounds, the other being free: the dynamics tell the size.
        small = (typical > 0) & (bounds > LOOSE_RATIO * typical)
        typical = np.where(small, np.nan, typical)
    typical = np.where(typical == 0, bounds, typical)
    return np.where(typical > 0, np.fmin(typical, np.where(bounded, bounds, np.inf)), np.nan)


def _typical(table: FloatArray, percentage: int = 75) -> FloatArray:
    """Return the upper quartile over the points, infinite values omitted.

    A median would be zero if half of the points are at a bound of 0.
    """
    finite = np.isfinite(table)
    filled = np.where(finite, table, np.where(finite.any(axis=0), np.nan, 0.0))
    return np.nanpercentile(filled, percentage, axis=0)


def _magnitude(limit: PathConstraint) -> FloatArray:
    sides = [np.where(np.isfinite(s), np.abs(s), 0.0) for s in (limit.lower, limit.upper)]
    return np.maximum(*sides)
