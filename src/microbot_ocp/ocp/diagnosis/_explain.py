"""Why a problem has no solution: which limits contradict each other, and by how much.

The dynamics are kept; every limit (bound, path constraint, end condition, duration) may give, by
one amount over the whole phase, and the sum of these amounts, scaled, is made as small as possible.
That names one way out. Each limit that conflicts with it, by its multipliers, is then asked what it
would have to give if it gave alone.

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
from microbot_ocp.ocp.diagnosis._finiteness import finite_start
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.solution import Solution, unpack
from microbot_ocp.ocp.starts import default_guess, rollouts, scaled, starting_point
from microbot_ocp.ocp.transcription import EQUATIONS, Guess, Label, Meshes, Program, Transcription

GIVES = 1e-4  # scaled amount below which a limit holds
CONFLICTS = 1e-3  # multiplier, of a sum of scaled amounts, above which a limit conflicts
LONGER = 10.0  # times a duration of the guess: the most where only limits give
ALONE = 12  # how many limits are tried alone
OTHERS = 3  # simulations from which the way out is looked for, too
# Where one way out is as cheap as another: rather an end than a start.
_WEIGHTS = {"final": 0.01, "duration": 0.02, "initial": 0.03}
_PLACES = {"initial": "start of ", "final": "end of "}


@dataclass(frozen=True)
class Relaxation:
    """A limit and what it would have to give.

    Attributes
    ----------
    phase, name : str
    kind : str
        "limit", "initial", "final" or "duration".
    side : str
        "lower" or "upper"; "" for a value that is demanded.
    limit : float
        As declared.
    amount : float
        By how much it would have to give, in ``unit``; None where nothing that it could give alone
        would help.
    unit : str
    time : float
        Since the start of the phase, s, where it is exceeded most (or presses most).
    component : int
        Of what has several.
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
        """The limit and its place."""
        what = {"lower": "lower limit", "upper": "upper limit"}.get(self.side, "value")
        unit = f" {self.unit}" if self.unit else ""
        at = _PLACES.get(self.kind, "")
        return f"{at}{self.name} in phase {self.phase!r} ({what} {self.limit:.6g}{unit})"

    def __str__(self) -> str:
        if self.amount is None:
            return self.subject
        unit = f" {self.unit}" if self.unit else ""
        where = f" at t = {self.time:.4g} s" if self.kind == "limit" else ""
        return f"{self.subject} would have to give {self.amount:.4g}{unit}{where}"


@dataclass(frozen=True, eq=False)
class Explanation:
    """What an elastic solve found.

    Attributes
    ----------
    feasible : whether all limits can be kept together
    conclusive : whether the elastic solve converged
    gives : the cheapest way out: what would have to give, together
    alternatives : other ways out, each by one limit alone (both its sides, all its components)
    conflicts : limits that conflict with it and would not help alone
    phases : values by phase of the trajectory on the cheapest way out
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
            "No trajectory was found that keeps these limits together. The least that would help:"
        ]
        lines += [f"  {item}" for item in self.gives]
        if self.alternatives:
            lines.append("Or, instead, one of these alone:")
            lines += ["  " + ", and ".join(map(str, items)) for items in self.alternatives]
        if self.conflicts:
            lines.append("Also in the way, but no help alone:")
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
    """Find out which limits of a problem contradict each other.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
    mesh : int or array of fractions [N+1], or one a phase
        A coarse one does.
    guess : guesses or Solution, optional
        Where the search starts: the solution of the solve that failed, for example. By default
        the usual guess, and simulations with constant controls.
    limits_only : bool
        Whether conditions at ends and bounds of durations hold, which are at most ten times those
        of the guess, and only the cheapest way out is looked for.
    max_iterations : int
        Of each elastic solve.
    """
    if not isinstance(problem, Transcription):
        problem = Transcription(scaled(problem, guess))
    program = problem.program(mesh)
    x = finite_start(program, starting_point(program, problem.problem, guess).x)
    checks.number("max_iterations", max_iterations, at_least=0, at_most=checks.MOST_ITERATIONS)
    elastic = _Elastic(program, max_iterations)
    if limits_only:  # that cost nothing, and they would run away
        durations = np.concatenate([layout.nodes[:, -1] for layout in program.layouts])
        elastic.highest[durations] = LONGER * x[durations]
    others = _simulated(program, problem.problem) if guess is None else ()
    return elastic.explain(chain([x], others), limits_only)


def _simulated(program: Program, problem: OptimalControlProblem) -> Iterator[FloatArray]:
    for guess in rollouts(problem, default_guess(problem))[:OTHERS]:
        x = starting_point(program, problem, guess).x
        if np.isfinite(program.row_values(x)).all():
            yield x


@dataclass(frozen=True, eq=False)
class _Item:
    """One side of one component of one limit: where it acts."""

    label: Label
    kind: str
    side: int  # -1 lower, 1 upper
    equal: bool
    value: float  # scaled
    rows: np.ndarray  # of the elastic program
    most: float  # that it may give, scaled


class _Elastic:
    """The program with one slack for every limit, at the end of its variables.

    Every side of a limit has rows of its own: were the two in one row, their slacks would cancel
    over the phase. A demanded value that stands in one row only keeps it, and gives either way.
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
            # a control that ends as the next node is bounded there: the same limit twice
            key = (label.phase, kind, label.kind == "end", label.name, label.component)
            groups.setdefault(key, []).append(row)
        for (_, kind, *_), members in groups.items():
            rows = np.array(members)
            for side, limits in ((-1, self.lower), (1, self.upper)):
                acting = rows[np.isfinite(limits[rows])]
                if not acting.size:
                    continue
                value = float(limits[acting[0]])
                most = 0.99 * value if kind == "duration" and side < 0 else np.inf
                equal = bool(np.all(self.lower[acting] == self.upper[acting]))
                yield _Item(self.labels[acting[0]], kind, side, equal, value, acting, most)

    def _arrange(self) -> None:
        """Note rows of the elastic program: which they are in the program, and their limits."""
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
        weights = [1.0 + _WEIGHTS.get(item.kind, 0.0) for item in self.items]
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
        hessian = ca.diagcat(inner, ca.DM(slacks, slacks))
        cost = ca.dot(ca.DM(weights), s)
        cache = {
            "nlp_jac_g": ca.Function("nlp_jac_g", [v, p], [limits, whole]),
            "nlp_grad_f": ca.Function("nlp_grad_f", [v, p], [cost, ca.MX(slope)]),
            "nlp_hess_l": ca.Function("nlp_hess_l", [v, p, lam_f, lam_g], [hessian]),
        }
        options = {
            "print_time": False,
            "calc_lam_p": False,
            "calc_lam_x": False,
            "no_nlp_grad": True,
            "error_on_fail": False,
            "cache": cache,
            "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-7, "max_iter": max_iterations},
        }
        return ca.nlpsol("elastic", "ipopt", {"x": v, "p": p, "f": cost, "g": limits}, options)

    def solve(self, x: FloatArray, allowed: np.ndarray) -> tuple[bool, FloatArray, FloatArray]:
        """Return whether it converged, variables with slacks, multipliers of the rows."""
        slacks = len(self.items)
        most = np.where(allowed, [item.most for item in self.items], 0.0)
        result = self.solver(
            x0=np.concatenate([x, np.where(allowed, 0.1, 0.0)]),
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
        """Do as :meth:`solve`, from the start that leads to the cheapest way out."""
        ends = []
        for x in starts:
            ends.append(self.solve(x, allowed))
            good, values, _ = ends[-1]
            if good and not np.any(values[self.count :] > GIVES):
                break
        return min(ends, key=lambda one: (not one[0], one[1][self.count :].sum()))

    def explain(self, starts: Iterable[FloatArray], limits_only: bool) -> Explanation:
        slacks = len(self.items)
        may = np.array([item.kind == "limit" or not limits_only for item in self.items])
        good, values, multipliers = self.cheapest(starts, may)
        best, amounts = values[: self.count], values[self.count :]
        phases = unpack(self.program.layouts, best) if np.isfinite(best).all() else ()
        giving = np.flatnonzero(amounts > GIVES)
        if not good or not giving.size:
            return Explanation(good and not giving.size, good, (), (), (), phases)
        gives = tuple(self._relaxation(i, amounts[i], best, multipliers) for i in giving.tolist())
        pressing = [
            float(np.maximum(item.side * multipliers[place], 0.0).sum())  # positive at upper limits
            for item, place in zip(self.items, self.places, strict=True)
        ]
        order = [int(i) for i in np.argsort(pressing)[::-1] if pressing[i] > CONFLICTS]
        giving_groups = self._groups(giving.tolist())
        alternatives, conflicts = [], []
        for group in self._groups(order)[: 0 if limits_only else ALONE]:
            if [group] == giving_groups:
                continue  # the way out that is known
            helps, trial, _ = self.solve(best, np.isin(np.arange(slacks), group))
            x, relaxations = trial[: self.count], trial[self.count :]
            those = [i for i in group if relaxations[i] > GIVES]
            alone = [self._relaxation(i, relaxations[i], x, multipliers) for i in those]
            if helps and alone:
                alternatives.append(tuple(alone))
            else:
                most = max(group, key=lambda i: pressing[i])
                conflicts.append(self._relaxation(most, None, best, multipliers))
        return Explanation(False, True, gives, tuple(alternatives), tuple(conflicts), phases)

    def _groups(self, order: Sequence[int]) -> list[list[int]]:
        """Return both sides and all components of a limit together, in the given order."""
        names = [(item.label.phase, item.kind, item.label.name) for item in self.items]
        asked = dict.fromkeys(names[i] for i in order)
        return [[i for i, name in enumerate(names) if name == one] for one in asked]

    def _relaxation(
        self, index: int, amount: float | None, x: FloatArray, multipliers: FloatArray
    ) -> Relaxation:
        item = self.items[index]
        label = item.label
        values = np.concatenate([self.program.row_values(x), x[self.bounded]])[item.rows]
        worst = int(np.argmax(item.side * values))
        if amount is None:
            worst = int(np.argmax(item.side * multipliers[self.places[index]]))
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
