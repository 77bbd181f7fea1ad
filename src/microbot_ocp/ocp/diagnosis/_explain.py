"""Contradictory limits of a problem without solution, and the amounts by which they conflict.

An elastic program keeps the dynamics and relaxes every limit (bound, path constraint, end
condition, duration) by one slack over the whole phase; the sum of the scaled slacks is minimised.
Its optimum is the cheapest relaxation. Each limit that conflicts with it, according to the
multipliers, is then relaxed alone.

Theory: docs/theory/certificates.md, equation (6).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.ipopt import ipopt
from microbot_ocp.ocp.diagnosis._finiteness import finite_start
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.solution import Solution, unpack
from microbot_ocp.ocp.starts import default_guess, rollouts, scaled, starting_point
from microbot_ocp.ocp.transcription import EQUATIONS, Guess, Label, Meshes, Program, Transcription

RELAXED = 1e-4  # scaled slack, or sum of multipliers, above which a limit is relaxed or in conflict
LONGEST_RATIO = 10.0  # largest duration relative to the guess if only limits are relaxed
MOST_ALONE = 12  # number of limits that are relaxed alone
SIMULATED_STARTS = 3  # simulations that serve as further starts of the elastic solve
# Kinds in the order in which equally cheap ones are relaxed, and the extra weight of each next one.
_PREFERRED, EXTRA_WEIGHT = ("limit", "final", "duration", "initial"), 0.01
_PLACES = {"initial": "start of ", "final": "end of "}


@dataclass(frozen=True)
class Relaxation:
    """A limit and the amount by which it would have to be relaxed.

    Attributes
    ----------
    phase, name : str
    kind : str
        "limit", "initial", "final" or "duration".
    side : str
        "lower" or "upper"; "" for a fixed value.
    limit : float
        Declared limit.
    amount : float
        Amount of the relaxation, in ``unit``; None if relaxing this limit alone does not help.
    unit : str
    time : float
        Time since the start of the phase, s, of the largest excess (or the largest multiplier).
    component : int
        Index into a limit with several components.
    """

    phase: str
    name: str
    kind: str
    side: str
    limit: float
    amount: float | None
    unit: str
    time: float
    component: int = 0

    @property
    def subject(self) -> str:
        """Name, place and value of the limit."""
        kind, at = f"{self.side} limit" if self.side else "value", _PLACES.get(self.kind, "")
        limit = f"{self.limit:.6g} {self.unit}".rstrip()
        return f"{at}{self.name} in phase {self.phase!r} ({kind} {limit})"

    def __str__(self) -> str:
        if self.amount is None:
            return self.subject
        amount = f"{self.amount:.4g} {self.unit}".rstrip()
        where = f" at t = {self.time:.4g} s" if self.kind == "limit" else ""
        return f"{self.subject} would have to be relaxed by {amount}{where}"


@dataclass(frozen=True, eq=False)
class Explanation:
    """Result of the elastic solves.

    Attributes
    ----------
    feasible : True if all limits can be kept together
    conclusive : True if the elastic solve converged
    gives : the cheapest relaxation: limits that are relaxed together
    alternatives : other relaxations, each of one limit alone with all its sides and components
    conflicts : limits in conflict that do not help if relaxed alone
    phases : values by phase of the trajectory of the cheapest relaxation
    """

    feasible: bool
    conclusive: bool
    gives: tuple[Relaxation, ...]
    alternatives: tuple[tuple[Relaxation, ...], ...]
    conflicts: tuple[Relaxation, ...]
    phases: Sequence[Any] = field(repr=False, default=())

    def __str__(self) -> str:
        if not self.conclusive:
            return (
                "The elastic problem did not converge: check scales and the guess, or try a "
                "coarser mesh."
            )
        if self.feasible:
            return (
                "All limits can be kept together: the problem has trajectories. Start from a "
                "better guess (the one found here, for example) or give the solver more iterations."
            )
        lines = [
            "No trajectory within all limits was found. The cheapest relaxation that allows one:"
        ]
        lines += [f"  {item}" for item in self.gives]
        if self.alternatives:
            lines.append("Alternatively, one of these alone:")
            lines += ["  " + ", and ".join(map(str, items)) for items in self.alternatives]
        if self.conflicts:
            lines.append("Also in conflict, but relaxing one of these alone does not help:")
            lines += [f"  {item.subject}" for item in self.conflicts]
        return "\n".join(lines)


def explain(
    problem: OptimalControlProblem | Transcription,
    mesh: Meshes = 50,
    guess: Mapping[str, Guess] | Solution | None = None,
    *,
    limits_only: bool = False,
    max_iterations: int = 500,
) -> Explanation:
    """Find the limits of a problem that contradict each other.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
    mesh : int or array of fractions [N+1], or one a phase
        A coarse mesh suffices.
    guess : guesses or Solution, optional
        Starting point of the search, for example the solution of the failed solve. By default the
        default guess, followed by simulations with constant controls.
    limits_only : bool
        True keeps end conditions and duration bounds; durations are at most ten times those of
        the guess, and only the cheapest relaxation is computed.
    max_iterations : int
        Iteration limit of each elastic solve.
    """
    if not isinstance(problem, Transcription):
        problem = Transcription(scaled(problem, guess))
    program = problem.program(mesh)
    x = finite_start(program, starting_point(program, problem.problem, guess).x)
    checks.number("max_iterations", max_iterations, at_least=0, at_most=checks.MOST_ITERATIONS)
    elastic = _ElasticProgram(program, max_iterations)
    if limits_only:  # long durations cost nothing here and would grow without limit
        durations = np.concatenate([layout.nodes[:, -1] for layout in program.layouts])
        elastic.highest[durations] = LONGEST_RATIO * x[durations]
    others = _simulated(program, problem.problem) if guess is None else ()
    return elastic.explain(chain([x], others), limits_only)


def _simulated(program: Program, problem: OptimalControlProblem) -> Iterator[FloatArray]:
    for guess in rollouts(problem, default_guess(problem))[:SIMULATED_STARTS]:
        x = starting_point(program, problem, guess).x
        if np.isfinite(program.row_values(x)).all():
            yield x


@dataclass(frozen=True, eq=False)
class _LimitSide:
    """One side of one component of a limit, with all its rows."""

    label: Label
    kind: str
    side: int  # -1 lower, 1 upper
    equal: bool
    value: float  # scaled
    rows: np.ndarray  # rows of the elastic program
    most: float  # largest scaled slack


class _ElasticProgram:
    """The program with one slack per side of a limit, appended to its variables.

    Both sides of a limit have their own rows: in a common row the two slacks would cancel over the
    phase. A fixed value in a single row keeps that row, with one slack per direction.
    """

    def __init__(self, program: Program, max_iterations: int) -> None:
        self.program = program
        low, high = program.variable_lower, program.variable_upper
        self.bounded = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
        self.count = low.size
        self.lower = np.concatenate([program.row_lower, low[self.bounded]])
        self.upper = np.concatenate([program.row_upper, high[self.bounded]])
        bounded = (program.variable_labels[i] for i in self.bounded)
        self.labels = [*program.row_labels, *bounded]
        self.items = list(self._items())
        self.highest = np.full(self.count, np.inf)
        self._arrange()
        self.solver = self._solver(max_iterations)

    def _items(self) -> Any:
        groups: dict[tuple[Any, ...], list[int]] = {}
        for row, label in enumerate(self.labels):
            if label.kind in EQUATIONS:
                continue
            kind = label.kind if label.kind in ("initial", "final", "duration") else "limit"
            # The end of a control and the node there may bound one quantity twice: group them.
            key = (label.phase, kind, label.kind == "end", label.name, label.component)
            groups.setdefault(key, []).append(row)
        for (_, kind, *_), members in groups.items():
            rows = np.array(members)
            for side, limits in ((-1, self.lower), (1, self.upper)):
                acting = rows[np.isfinite(limits[rows])]
                if not acting.size:
                    continue
                value = float(limits[acting[0]])
                most = (1 - RELAXED) * value if kind == "duration" and side < 0 else np.inf
                equal = bool(np.all(self.lower[acting] == self.upper[acting]))
                yield _LimitSide(self.labels[acting[0]], kind, side, equal, value, acting, most)

    def _arrange(self) -> None:
        """Set up the rows of the elastic program: their source rows, limits and slack places."""
        strict = [i for i, label in enumerate(self.labels) if label.kind in EQUATIONS]
        source = list(strict)
        lower, upper = (list(limits[strict]) for limits in (self.lower, self.upper))
        shared: dict[int, int] = {}
        self.places: list[np.ndarray] = []
        for item in self.items:
            first, count = int(item.rows[0]), item.rows.size
            alone = item.equal and count == 1
            if alone and first in shared:
                self.places.append(np.array([shared[first]]))
                continue
            shared[first] = len(source)
            self.places.append(len(source) + np.arange(count))
            source += item.rows.tolist()
            acts = [alone or item.side == side for side in (-1, 1)]
            lower += list(self.lower[item.rows]) if acts[0] else [-np.inf] * count
            upper += list(self.upper[item.rows]) if acts[1] else [np.inf] * count
        self.source = np.array(source)
        self.row_limits = np.array(lower), np.array(upper)

    def _solver(self, max_iterations: int) -> ca.Function:
        # Rows: limits <= g(x) - side * s <= limits, with slacks s >= 0 appended to x, equation (6).
        program, slacks = self.program, len(self.items)
        functions, height = program.functions, self.source.size
        rows = np.concatenate(self.places)
        sizes = [place.size for place in self.places]
        columns = np.repeat(np.arange(slacks), sizes)
        signs = np.repeat([-float(item.side) for item in self.items], sizes)
        give = ca.DM.triplet(rows.tolist(), columns.tolist(), ca.DM(signs), height, slacks)
        bounded, order = self.bounded.tolist(), self.source.tolist()
        pick = ca.DM.eye(self.count)[bounded, :]
        copies = ca.DM.eye(len(self.labels))[:, order]
        weights = [1.0 + EXTRA_WEIGHT * _PREFERRED.index(item.kind) for item in self.items]
        v = ca.MX.sym("v", self.count + slacks)
        p = ca.MX.sym("p", program.parameters.size)
        x, s = v[: self.count], v[self.count :]
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", height)
        g, jacobian = functions["jacobian"](x, p)
        limits = ca.vertcat(g, x[bounded])[order] + ca.mtimes(give, s)
        slope = ca.DM([0.0] * self.count + weights)
        whole = ca.horzcat(ca.vertcat(jacobian, pick)[order, :], give)
        lam = ca.mtimes(copies, lam_g)[: g.shape[0]]
        inner = functions["hessian_upper"].call([x, p, 0.0, lam])[0]
        # The slacks are linear in rows and cost: their part of the Hessian is zero.
        hessian = ca.diagcat(inner, ca.DM(slacks, slacks))
        cost = ca.dot(ca.DM(weights), s)
        cache = {
            "nlp_jac_g": ca.Function("nlp_jac_g", [v, p], [limits, whole]),
            "nlp_grad_f": ca.Function("nlp_grad_f", [v, p], [cost, ca.MX(slope)]),
            "nlp_hess_l": ca.Function("nlp_hess_l", [v, p, lam_f, lam_g], [hessian]),
        }
        elastic = {"x": v, "p": p, "f": cost, "g": limits}
        # An acceptable point suffices, as by default in IPOPT.
        options = {"max_iter": max_iterations, "acceptable_iter": 15}
        return ipopt("elastic", elastic, options, no_nlp_grad=True, cache=cache)

    def solve(self, x: FloatArray, allowed: np.ndarray) -> tuple[bool, FloatArray, FloatArray]:
        """Return convergence, variables with slacks, and multipliers of the rows."""
        slacks = len(self.items)
        most = np.where(allowed, [item.most for item in self.items], 0.0)
        result = self.solver(
            x0=np.concatenate([x, np.zeros(slacks)]),
            p=self.program.parameters,
            lbx=np.concatenate([np.full(self.count, -np.inf), np.zeros(slacks)]),
            ubx=np.concatenate([self.highest, most]),
            lbg=self.row_limits[0],
            ubg=self.row_limits[1],
        )
        values = np.array(result["x"]).ravel()
        good = bool(self.solver.stats().get("success") and np.isfinite(values).all())
        return good, values, np.array(result["lam_g"]).ravel()

    def cheapest(
        self, starts: Iterable[FloatArray], allowed: np.ndarray
    ) -> tuple[bool, FloatArray, FloatArray]:
        """Return the cheapest result of :meth:`solve` over the starts; a feasible one ends it."""
        ends = []
        for x in starts:
            ends.append(self.solve(x, allowed))
            good, values, _ = ends[-1]
            if good and not np.any(values[self.count :] > RELAXED):
                break
        return min(ends, key=lambda one: (not one[0], one[1][self.count :].sum()))

    def explain(self, starts: Iterable[FloatArray], limits_only: bool) -> Explanation:
        slacks = len(self.items)
        may = np.array([item.kind == "limit" or not limits_only for item in self.items])
        good, values, multipliers = self.cheapest(starts, may)
        best, amounts = values[: self.count], values[self.count :]
        phases = unpack(self.program.layouts, best) if np.isfinite(best).all() else ()
        giving = np.flatnonzero(amounts > RELAXED)
        if not good or not giving.size:
            return Explanation(good and not giving.size, good, (), (), (), phases)
        gives = tuple(self._relaxation(i, amounts[i], best, multipliers) for i in giving.tolist())
        pressing = [
            float(np.maximum(item.side * multipliers[place], 0.0).sum())  # upper: positive
            for item, place in zip(self.items, self.places, strict=True)
        ]
        order = [int(i) for i in np.argsort(pressing)[::-1] if pressing[i] > RELAXED]
        giving_groups = self._groups(giving.tolist())
        alternatives, conflicts = [], []
        for group in self._groups(order)[: 0 if limits_only else MOST_ALONE]:
            if [group] == giving_groups:
                continue  # this is the cheapest relaxation itself
            helps, trial, _ = self.solve(best, np.isin(np.arange(slacks), group))
            x, relaxations = trial[: self.count], trial[self.count :]
            those = [i for i in group if relaxations[i] > RELAXED]
            alone = [self._relaxation(i, relaxations[i], x, multipliers) for i in those]
            if helps and alone:
                alternatives.append(tuple(alone))
            else:
                most = max(group, key=lambda i: pressing[i])
                conflicts.append(self._relaxation(most, None, best, multipliers))
        return Explanation(False, True, gives, tuple(alternatives), tuple(conflicts), phases)

    def _groups(self, order: Sequence[int]) -> list[list[int]]:
        """Return index groups: both sides and all components of each limit, in the given order."""
        names = [(item.label.phase, item.kind, item.label.name) for item in self.items]
        ordered = dict.fromkeys(names[i] for i in order)
        return [[i for i, name in enumerate(names) if name == one] for one in ordered]

    def _relaxation(
        self, index: int, amount: float | None, x: FloatArray, multipliers: FloatArray
    ) -> Relaxation:
        item = self.items[index]
        label = item.label
        sizes = np.concatenate([self.program.row_values(x), x[self.bounded]])[item.rows]
        if amount is None:
            sizes = multipliers[self.places[index]]
        worst = int(np.argmax(item.side * sizes))
        return Relaxation(
            phase=label.phase,
            name=label.component_name,
            kind=item.kind,
            side="" if item.equal else ("lower" if item.side < 0 else "upper"),
            limit=item.value * label.scale,
            amount=None if amount is None else amount * label.scale,
            unit=label.unit,
            time=self.program.time_of(self.labels[item.rows[worst]], x),
            component=label.component,
        )
