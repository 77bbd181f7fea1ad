"""Plain CasADi from the same declaration: Opti, Radau collocation, IPOPT with its defaults.

Only the declaration and the guess come from the package. States are continuous polynomials,
controls and algebraic variables have a value at every collocation point, whatever their declared
shape; bounds and path constraints hold there. Nothing is scaled.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from microbot_ocp.ocp import Guess, OptimalControlProblem, Phase, default_guess
from microbot_ocp.ocp.problem import PointConstraint

Array = np.ndarray


@dataclass(frozen=True)
class PeerResult:
    """Result of IPOPT; ``guesses`` starts a solve on another mesh."""

    cost: float
    solved: bool
    status: str
    iterations: int
    seconds: float
    guesses: Mapping[str, Guess] = field(default_factory=dict)


def solve_by_opti(
    problem: OptimalControlProblem,
    intervals: int = 50,
    guess: Mapping[str, Guess] | None = None,
    *,
    degree: int = 3,
    options: Mapping[str, object] | None = None,
    mesh: Array | None = None,
    scaled: bool = False,
) -> PeerResult:
    """Transcribe on an even mesh, or on fractions ``mesh`` [N+1] of every phase, and solve.

    With ``scaled``, variables and dynamics are divided by the size of the guess.

    Raises
    ------
    NotImplementedError
        The problem has rates of linear controls.
    """
    begin = time.perf_counter()
    guesses = {**default_guess(problem), **(guess or {})}
    opti = ca.Opti()
    mesh = np.linspace(0.0, 1.0, intervals + 1) if mesh is None else mesh
    free: dict[str, ca.MX] = {}
    parts = [
        _Part(opti, phase, np.union1d(mesh, phase.point_fractions), degree, guess, scaled, free)
        for phase in problem.phases
        for guess in [guesses[phase.name]]
    ]
    for link, before, after in zip(problem.links, parts[:-1], parts[1:], strict=True):
        for name in link.names:
            if name in before.rows and name in after.rows:
                opti.subject_to(after.x[after.rows[name], 0] == before.x[before.rows[name], -1])
    opti.minimize(sum(part.cost for part in parts))
    settings = {"print_level": 0, "sb": "yes", **(options or {})}
    opti.solver(
        "ipopt",
        {"print_time": False, "error_on_fail": False, "detect_simple_bounds": True},
        settings,
    )
    status = ""
    try:
        opti.solve()
    except RuntimeError as problem_met:
        status = str(problem_met).splitlines()[-1]
    stats = opti.stats()
    status = str(stats.get("return_status", status))
    return PeerResult(
        cost=float(opti.debug.value(opti.f)),
        solved=status == "Solve_Succeeded",
        status=status,
        iterations=int(stats.get("iter_count", -1)),
        seconds=time.perf_counter() - begin,
        guesses={part.phase.name: part.guess() for part in parts},
    )


class _Part:
    """Variables and constraints of one phase."""

    def __init__(
        self,
        opti: ca.Opti,
        phase: Phase,
        mesh: Array,
        degree: int,
        guess: Guess,
        scaled: bool,
        free: dict[str, ca.MX],
    ) -> None:
        if any(c.rate is not None and _uses(phase, c.rate) for c in phase.controls):
            raise NotImplementedError("rates of linear controls")
        self.opti, self.phase, self.mesh, self.degree = opti, phase, mesh, degree
        points = np.array(ca.collocation_points(degree, "radau"))
        steps = np.diff(mesh)
        self.places = np.append(0.0, (mesh[:-1, None] + steps[:, None] * points).ravel())
        self.rows, size = {}, 0
        for state in phase.states:
            self.rows[state.name] = list(range(size, size + state.size))
            size += state.size
        columns = self.places.size - 1
        self.x = opti.variable(size, columns + 1)
        self.u = self._variables(phase.controls, columns)
        self.z = self._variables(phase.algebraics, columns)
        low, high = phase.duration_bounds
        self.duration: ca.MX | float = low
        if high > low:
            self.duration = opti.variable()
            opti.subject_to(opti.bounded(low, self.duration, high))
            opti.set_initial(self.duration, guess.duration or low)
        for own in phase.free_parameters:  # phases that share a parameter share its variable
            if own.name not in free:
                free[own.name] = opti.variable(own.size)
                self._limit(free[own.name], own.lower, own.upper)
                start = guess.values.get(own.name, 0.0)
                known = np.zeros(own.size) if callable(start) else np.asarray(start, dtype=float)
                opti.set_initial(free[own.name], ca.DM(known))
        self.free = free
        names = [own.name for own in phase.free_parameters]
        self.p = ca.vertcat(*(free[name] for name in names), ca.MX(0, 1))
        self.scale = self._scale(guess) if scaled else np.ones(size)
        self._bound()
        self.cost = self._collocate(points, steps)
        self._start(guess)

    def _scale(self, guess: Guess) -> Array:
        """Set scales to powers of ten near the largest guess; return those of the states."""
        phase, found = self.phase, []
        kinds = ((phase.states, self.x), (phase.controls, self.u), (phase.algebraics, self.z))
        for declared, table in kinds:
            scales = [np.zeros(0)]
            for variable in declared:
                value = guess.values.get(variable.name, 0.0)
                size = np.abs(_sampled(value, variable.size, self.places)).max()
                power = 10.0 ** np.round(np.log10(size)) if size > 0 else 1.0
                scales.append(np.full(variable.size, power))
            scale = np.concatenate(scales)
            found.append(scale)
            if scale.size:
                self.opti.set_linear_scale(table, np.tile(scale[:, None], (1, table.shape[1])))
        return found[0]

    def _variables(self, declared: list, columns: int) -> ca.MX:
        size = sum(v.size for v in declared)
        return self.opti.variable(size, columns) if size else ca.MX(0, columns)

    def _limit(self, expression: ca.MX, low: Array, high: Array) -> None:
        """Add the bounds of the rows of a matrix, if there are any."""
        for row in range(expression.shape[0]):
            one = expression[row, :]
            if low[row] == high[row]:
                self.opti.subject_to(one == low[row])
            elif np.isfinite(low[row]) and np.isfinite(high[row]):
                self.opti.subject_to(self.opti.bounded(low[row], one, high[row]))
            elif np.isfinite(low[row]):
                self.opti.subject_to(one >= low[row])
            elif np.isfinite(high[row]):
                self.opti.subject_to(one <= high[row])

    def _bound(self) -> None:
        phase = self.phase
        for state in phase.states:
            rows = self.rows[state.name]
            first, last = 0, self.x.shape[1]
            if state.initial is not None:
                self._limit(self.x[rows, 0], *_within(state, state.initial))
                first = 1
            if state.final is not None:
                self._limit(self.x[rows, -1], *_within(state, state.final))
                last -= 1
            self._limit(self.x[rows, first:last], state.lower, state.upper)
        for declared, table in ((phase.controls, self.u), (phase.algebraics, self.z)):
            offset = 0
            for variable in declared:
                rows = list(range(offset, offset + variable.size))
                offset += variable.size
                self._limit(table[rows, :], variable.lower, variable.upper)

    def _function(self, name: str, outputs: list[ca.MX], data: Sequence[ca.MX] = ()) -> ca.Function:
        phase = self.phase
        kinds = (phase.states, phase.controls, phase.algebraics, phase.free_parameters)
        sizes = [sum(v.size for v in kind) for kind in kinds]
        t, duration = phase.time, phase.duration
        table = [ca.MX.sym(k, size) for k, size in zip("xuzp", sizes, strict=True)]
        old = [v.symbol for v in phase.variables]
        sizes = [v.shape[0] for v in old]
        new = ca.vertsplit(ca.vertcat(*table), [0, *np.cumsum(sizes).tolist()])
        old += [p.symbol for p in phase.parameters]
        new += [ca.MX(ca.DM(p.value)) for p in phase.parameters]
        made = ca.graph_substitute([ca.densify(out) for out in outputs], old, new)
        function = ca.Function(name, [*table, t, duration, *data], made, {"allow_free": False})
        try:
            return function.expand()
        except RuntimeError:  # lookup tables have no scalar form
            return function

    def _collocate(self, points: Array, steps: Array) -> ca.MX:
        phase, opti, d = self.phase, self.opti, self.degree
        zero = ca.MX(1, 1)
        slopes = ca.vertcat(*(phase.derivatives[s.name] for s in phase.states))
        running = sum(phase.running_costs, zero)
        paths = ca.vertcat(*(c.expression for c in phase.constraints), ca.MX(0, 1))
        equations = ca.vertcat(*phase.algebraic_equations, ca.MX(0, 1))
        along = self._function("along", [slopes, running, paths, equations])
        columns = self.x.shape[1] - 1
        times = self.duration * ca.DM(self.places[1:]).T
        duration = self.duration if isinstance(self.duration, ca.MX) else ca.MX(self.duration)
        f, q, path, equation = along.map(columns)(
            self.x[:, 1:],
            self.u,
            self.z,
            ca.repmat(self.p, 1, columns),
            times,
            ca.repmat(duration, 1, columns),
        )
        slope_of, _, weights = ca.collocation_coeff(points.tolist())
        heights = np.repeat(steps, d)
        owns = [k * d + j for k in range(steps.size) for j in range(d + 1)]
        pieces = ca.reshape(self.x[:, owns], -1, steps.size)
        block = ca.kron(ca.DM(slope_of).T, ca.DM.eye(self.x.shape[0]))
        left = ca.reshape(block @ pieces, self.x.shape[0], columns)
        right = f * duration * ca.repmat(ca.DM(heights).T, self.x.shape[0], 1)
        sizes = ca.repmat(ca.DM(self.scale), 1, columns)
        opti.subject_to(left / sizes == right / sizes)
        if equation.shape[0]:
            opti.subject_to(ca.vec(equation) == 0)
        offset = 0
        for limit in phase.constraints:
            size = limit.expression.shape[0]
            self._limit(path[offset : offset + size, :], limit.lower, limit.upper)
            offset += size
        ends = ca.vertcat(*(c.expression for c in phase.end_constraints), ca.MX(0, 1))
        at_end = self._function("end", [sum(phase.end_costs, zero), ends])
        last = self.x[:, -1], self.u[:, -1], self.z[:, -1], self.p, times[-1], duration
        cost, end = at_end(*last)
        offset = 0
        for limit in phase.end_constraints:
            size = limit.expression.shape[0]
            self._limit(end[offset : offset + size], limit.lower, limit.upper)
            offset += size
        cost = cost + self._points(duration)
        each = ca.DM(np.tile(np.array(weights).ravel(), steps.size) * heights)
        return cost + duration * (q @ each)

    def _points(self, duration: ca.MX) -> ca.MX:
        """Add the constraints at given times; return the costs there."""
        phase, total = self.phase, ca.MX(1, 1)
        for item in (*phase.point_constraints, *phase.point_costs):
            data = [m for m in phase.measurements if ca.depends_on(item.expression, m.symbol)]
            function = self._function("point", [item.expression], [m.symbol for m in data])
            for k, fraction in enumerate(item.fractions):
                column = int(np.abs(self.places - fraction).argmin())
                before = max(column - 1, 0)
                table = self.x[:, column], self.u[:, before], self.z[:, before], self.p
                measured = [ca.DM(m.value[k]) for m in data]
                value = function(*table, fraction * duration, duration, *measured)
                if isinstance(item, PointConstraint):
                    self._limit(value, item.lower, item.upper)
                else:
                    total = total + value
        return total

    def _start(self, guess: Guess) -> None:
        phase = self.phase
        for declared, table, places in (
            (phase.states, self.x, self.places),
            (phase.controls, self.u, self.places[1:]),
            (phase.algebraics, self.z, self.places[1:]),
        ):
            rows = [_sampled(guess.values.get(v.name, 0.0), v.size, places) for v in declared]
            if rows:
                self.opti.set_initial(table, np.hstack(rows).T)

    def guess(self) -> Guess:
        """Return the last iterate as a guess for another mesh."""
        value = self.opti.debug.value
        values = {}
        for declared, table, places in (
            (self.phase.states, self.x, self.places),
            (self.phase.controls, self.u, self.places[1:]),
            (self.phase.algebraics, self.z, self.places[1:]),
        ):
            offset = 0
            for variable in declared:
                own = np.array(value(table[offset : offset + variable.size, :]), ndmin=2)
                own = own.reshape(variable.size, places.size)
                offset += variable.size
                values[variable.name] = _interpolated(places, own)
        for own in self.phase.free_parameters:
            values[own.name] = np.ravel(value(self.free[own.name]))
        return Guess(float(value(self.duration)), values)


def _uses(phase: Phase, symbol: ca.MX) -> bool:
    used = [*phase.derivatives.values(), *phase.running_costs]
    used += [c.expression for c in phase.constraints]
    return ca.depends_on(ca.vertcat(*used), symbol)


def _within(variable, condition: tuple[Array, Array]) -> tuple[Array, Array]:
    return np.maximum(variable.lower, condition[0]), np.minimum(variable.upper, condition[1])


def _interpolated(places: Array, table: Array):
    return lambda s: np.column_stack([np.interp(s, places, row) for row in table])


def _sampled(value, size: int, places: Array) -> Array:
    table = np.asarray(value(places) if callable(value) else value, dtype=float)
    if table.ndim <= 1:
        return np.broadcast_to(table.reshape(1, -1), (places.size, size))
    if table.shape[0] == places.size:
        return table
    own = np.linspace(0.0, 1.0, table.shape[0])
    return np.column_stack([np.interp(places, own, column) for column in table.T])
