"""Direct transcription by multiple shooting, kept in stages for structured solvers.

Each interval is one explicit Runge-Kutta step of order four, exact for chains of integrators. Every
mesh point carries z = (states, linear controls, duration); an interval adds the control w. Controls
"constant" hold over the interval, "linear" run between the values at its ends, so for a double
integrator with linear acceleration the discrete motion is the exact one.

The nonlinear program has, stage by stage, the variables (z_k, w_k) and the rows
``z_{k+1} - next(z_k, w_k) = 0`` followed by the stage's constraints; the solver sees everything
divided by its scale. Its derivatives are those of one stage kernel mapped over the stages.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence, Sized
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp import checks
from microbot_ocp.checks import FloatArray, InputError
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase, Variable, node_variables

GuessValue = ArrayLike | Callable[[FloatArray], ArrayLike]


@dataclass(frozen=True, eq=False)
class Guess:
    """Starting point of one phase: its duration and values by name.

    Values are constants [size], arrays [N+1, size] over the mesh points, or functions of the
    fractions [N+1] of the phase returning such arrays.
    """

    duration: float
    values: Mapping[str, GuessValue]


@dataclass(frozen=True, eq=False)
class PhaseLayout:
    """Where one phase stands in the program, and its kernels."""

    phase: Phase
    mesh: FloatArray  # fractions [N+1] from 0 to 1
    node_scale: FloatArray
    control_scale: FloatArray
    variable_offset: int
    row_offset: int
    transition: int  # extra controls at the last mesh point, for the link to the next phase
    stage_rows: int
    initial_rows: tuple[int, ...]  # node components with a condition at the start
    final_rows: tuple[int, ...]
    end_rows: int
    next_nodes: int  # components of the first z of the next phase, 0 at the last phase

    @property
    def intervals(self) -> int:
        """Number of intervals N."""
        return self.mesh.size - 1

    @property
    def node_size(self) -> int:
        """Components of z."""
        return self.node_scale.size

    @property
    def control_size(self) -> int:
        """Components of w."""
        return self.control_scale.size

    @property
    def stage_size(self) -> int:
        """Components of (z, w)."""
        return self.node_size + self.control_size

    @property
    def variable_count(self) -> int:
        """All variables of the phase."""
        return self.intervals * self.stage_size + self.node_size + self.transition

    @property
    def last_node(self) -> int:
        """Index of the first component of the last z."""
        return self.variable_offset + self.intervals * self.stage_size

    @property
    def rows_per_stage(self) -> int:
        """Rows of a stage: the step to the next z and the constraints."""
        return self.node_size + self.stage_rows

    @property
    def stage_row(self) -> np.ndarray:
        """Index [N] of the first row of every stage."""
        k = np.arange(self.intervals)
        return self.row_offset + self.rows_per_stage * k + len(self.initial_rows) * (k > 0)

    @property
    def last_row(self) -> int:
        """Index of the first row at the last mesh point."""
        return self.row_offset + self.intervals * self.rows_per_stage + len(self.initial_rows)

    @property
    def row_count(self) -> int:
        """All rows of the phase."""
        at_end = self.next_nodes + self.end_rows + len(self.final_rows)
        return self.last_row - self.row_offset + at_end


@dataclass(frozen=True, eq=False)
class Kernels:
    """Stage and end functions of a phase with their derivatives, in scaled variables.

    ``stage(v, c) -> next, constraints, cost`` with v = (z, w) and c = (fraction at the start,
    length of the interval as a fraction, parameters); ``end(z, parameters) -> constraints, cost``.
    """

    stage: ca.Function
    stage_jacobian: ca.Function
    stage_hessian: ca.Function
    end: ca.Function
    end_jacobian: ca.Function
    end_hessian: ca.Function
    stage_lower: FloatArray
    stage_upper: FloatArray
    end_lower: FloatArray
    end_upper: FloatArray


def _linear(phase: Phase) -> list[Variable]:
    return [c for c in phase.controls if c.shape == "linear"]


def _constant(phase: Phase) -> list[Variable]:
    return [c for c in phase.controls if c.shape == "constant"]


def _stack(variables: Sequence[Variable], attribute: str) -> FloatArray:
    parts = [getattr(v, attribute) for v in variables]
    return np.concatenate(parts) if parts else np.zeros(0)


Derive = Callable[[ca.Function, ca.Function], Sequence[ca.Function]]


def with_derivatives(stage: ca.Function, end: ca.Function) -> Sequence[ca.Function]:
    """Stage and end functions, each with its Jacobian and Hessian."""
    return [*_stage_derivatives(stage), *_end_derivatives(end)]


def build_kernels(
    phase: Phase, duration_scale: float, derive: Derive = with_derivatives
) -> Kernels:
    """Kernels of a phase, expanded to scalar graphs where its expressions allow it."""
    f, g, cost = _physics(phase)
    count = {
        "x": sum(v.size for v in phase.states),
        "l": sum(v.size for v in _linear(phase)),
        "c": sum(v.size for v in _constant(phase)),
    }
    nodes, controls = node_variables(phase), [*_constant(phase), *_linear(phase)]
    node_scale = np.append(_stack(nodes, "scale"), duration_scale)
    v = ca.MX.sym("v", node_scale.size + count["c"] + count["l"])
    c = ca.MX.sym("c", 2 + sum(p.value.size for p in phase.parameters))
    constants = c[2:]
    scale = np.concatenate([node_scale, _stack(controls, "scale")])
    x, begin, duration, constant, end = _split(v * scale, count)
    length = c[1] * duration
    rate = (end - begin) / length if count["l"] else ca.MX(0, 1)

    def control(fraction: float) -> ca.MX:
        return ca.vertcat(constant, begin + fraction * (end - begin))

    def at(fraction: float) -> tuple[ca.MX, ca.MX]:
        """State and accumulated cost after a Runge-Kutta step over a fraction of the interval."""
        step, start = fraction * length, c[0] * duration
        middle = start + step / 2
        u0, um, u1 = control(0.0), control(fraction / 2), control(fraction)
        k1, l1 = f(x, u0, rate, start, duration, constants)
        k2, l2 = f(x + step / 2 * k1, um, rate, middle, duration, constants)
        k3, l3 = f(x + step / 2 * k2, um, rate, middle, duration, constants)
        k4, l4 = f(x + step * k3, u1, rate, start + step, duration, constants)
        return x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4), step / 6 * (l1 + 2 * l2 + 2 * l3 + l4)

    arrived, running = at(1.0)
    following = ca.vertcat(arrived, end, duration) / node_scale
    rows, lower, upper = [], [], []
    fractions = (0.0, *phase.between)
    for fraction in (*fractions, 1.0):
        here = {0.0: x, 1.0: arrived}.get(fraction)
        if here is None:
            here = at(fraction)[0]
            low, high, values = _between_bounds(phase, here)
            rows += values
            lower += low
            upper += high
        now = (c[0] + fraction * c[1]) * duration
        values = g(here, control(fraction), rate, now, duration, constants)
        for constraint, value in zip(phase.constraints, _as_list(values), strict=True):
            # at the end of the interval a continuous expression is the next stage's business
            if fraction == 1.0 and not _jumps(phase, constraint.expression):
                continue
            rows.append(value / constraint.scale)
            lower.append(constraint.lower / constraint.scale)
            upper.append(constraint.upper / constraint.scale)
    stage = ca.Function("stage", [v, c], [following, ca.vertcat(*rows), running])

    z = ca.MX.sym("z", node_scale.size)
    constants = ca.MX.sym("c", sum(p.value.size for p in phase.parameters))
    last = z * node_scale
    x_end, u_end = last[: count["x"]], last[count["x"] : count["x"] + count["l"]]
    t_end = last[-1]
    no_control = ca.vertcat(ca.MX.zeros(count["c"]), u_end)
    values = _as_list(g(x_end, no_control, ca.MX.zeros(count["l"]), t_end, t_end, constants))
    kept = [
        (value / k.scale, k.lower / k.scale, k.upper / k.scale)
        for k, value in zip(phase.constraints, values, strict=True)
        if not _jumps(phase, k.expression)
    ]
    end_rows = ca.vertcat(*(row for row, _, _ in kept)) if kept else ca.MX(0, 1)
    end_function = ca.Function(
        "end", [z, constants], [end_rows, cost(x_end, no_control, t_end, constants)]
    )
    return Kernels(
        *derive(_expanded(stage), _expanded(end_function)),
        stage_lower=joined(lower),
        stage_upper=joined(upper),
        end_lower=joined([low for _, low, _ in kept]),
        end_upper=joined([high for _, _, high in kept]),
    )


def joined(parts: Sequence[FloatArray]) -> FloatArray:
    return np.concatenate(parts) if parts else np.zeros(0)


def _as_list(values: Any) -> list[ca.MX]:
    if isinstance(values, ca.MX):
        return [values]
    return list(values) if isinstance(values, (list, tuple)) else []


def _split(unscaled: ca.MX, count: Mapping[str, int]) -> tuple[ca.MX, ...]:
    sizes = [count["x"], count["l"], 1, count["c"], count["l"]]
    edges = np.cumsum([0, *sizes]).tolist()
    return tuple(unscaled[a:b] for a, b in itertools.pairwise(edges))


def _physics(phase: Phase) -> tuple[ca.Function, ca.Function, ca.Function]:
    """Dynamics with running cost, path constraints and end cost as functions."""
    x = ca.vertcat(*(s.symbol for s in phase.states))
    u = ca.vertcat(*(k.symbol for k in (*_constant(phase), *_linear(phase))))
    rates = [k.rate for k in _linear(phase) if k.rate is not None]
    rate = ca.vertcat(*rates) if rates else ca.MX(0, 1)
    slope = ca.vertcat(*(phase.derivatives[s.name] for s in phase.states))
    running = sum(phase.running_costs, ca.MX(0))
    constants = ca.vertcat(*(p.symbol for p in phase.parameters), ca.MX(0, 1))
    arguments = [x, u, rate, phase.time, phase.duration, constants]
    f = ca.Function("dynamics", arguments, [slope, running])
    g = ca.Function("constraints", arguments, [k.expression for k in phase.constraints])
    total = sum(phase.end_costs, ca.MX(0))
    return f, g, ca.Function("end_cost", [x, u, phase.duration, constants], [total])


def _jumps(phase: Phase, expression: ca.MX) -> bool:
    """Whether an expression may differ on the two sides of a mesh point."""
    symbols = [k.symbol for k in _constant(phase)]
    symbols += [k.rate for k in _linear(phase) if k.rate is not None]
    return any(ca.depends_on(expression, symbol) for symbol in symbols)


def _between_bounds(
    phase: Phase, x: ca.MX
) -> tuple[list[FloatArray], list[FloatArray], list[ca.MX]]:
    lower, upper, rows, offset = [], [], [], 0
    for state in phase.states:
        if state.between:
            rows.append(x[offset : offset + state.size] / state.scale)
            lower.append(state.lower / state.scale)
            upper.append(state.upper / state.scale)
        offset += state.size
    return lower, upper, rows


def _expanded(function: ca.Function) -> ca.Function:
    """The function as one scalar graph without repeated work, where its calls have such a graph."""
    try:
        scalar = function.expand()
    except RuntimeError:  # interpolants and compiled functions have none: stay with MX
        return function
    return _without_repeats(scalar)


def _without_repeats(function: ca.Function) -> ca.Function:
    if not function.is_a("SXFunction"):
        return function
    inputs = _symbols(function)
    return ca.Function(function.name(), inputs, ca.cse(function.call(inputs)))


def _stage_derivatives(stage: ca.Function) -> tuple[ca.Function, ca.Function, ca.Function]:
    v, c = _symbols(stage)
    following, rows, cost = stage(v, c)
    both = ca.vertcat(following, rows)
    jacobian = ca.Function(
        "stage_jacobian", [v, c], [both, ca.jacobian(both, v), cost, _row(ca.gradient(cost, v))]
    )
    lam = type(v).sym("lam", both.shape[0])
    sigma = type(v).sym("sigma")
    lagrangian = sigma * cost + ca.dot(lam, ca.vertcat(-following, rows))
    return (
        stage,
        _without_repeats(jacobian),
        _hessian("stage_hessian", lagrangian, v, [v, c, lam, sigma]),
    )


def _end_derivatives(end: ca.Function) -> tuple[ca.Function, ca.Function, ca.Function]:
    z, c = _symbols(end)
    rows, cost = end(z, c)
    jacobian = ca.Function(
        "end_jacobian", [z, c], [rows, ca.jacobian(rows, z), cost, _row(ca.gradient(cost, z))]
    )
    lam = type(z).sym("lam", rows.shape[0])
    sigma = type(z).sym("sigma")
    lagrangian = sigma * cost + ca.dot(lam, rows)
    return (
        end,
        _without_repeats(jacobian),
        _hessian("end_hessian", lagrangian, z, [z, c, lam, sigma]),
    )


def _hessian(name: str, lagrangian: Any, v: Any, inputs: list[Any]) -> ca.Function:
    return _without_repeats(ca.Function(name, inputs, [ca.hessian(lagrangian, v)[0]]))


def _row(gradient: Any) -> Any:
    return ca.densify(gradient)


def _symbols(function: ca.Function) -> list[Any]:
    kind = ca.SX if function.is_a("SXFunction") else ca.MX
    return [kind.sym(f"i{k}", function.sparsity_in(k)) for k in range(function.n_in())]


def fractions(mesh: int | ArrayLike) -> FloatArray:
    """Mesh fractions [N+1] from a number of intervals or from the fractions themselves."""
    if isinstance(mesh, (int, np.integer)):
        if mesh < 2:
            raise InputError(f"mesh must have at least 2 intervals, not {mesh}")
        return np.linspace(0.0, 1.0, int(mesh) + 1)
    if isinstance(mesh, float):
        raise InputError(f"mesh must be a whole number of intervals or fractions, not {mesh}")
    given = checks.array("mesh", mesh, (None,))
    if given.size < 3 or given[0] != 0.0 or given[-1] != 1.0 or np.any(np.diff(given) <= 0):
        raise InputError("mesh must be increasing fractions from 0 to 1, or a number of intervals")
    return given


class Transcription:
    """A problem with its kernels built once, to be laid out on any number of meshes.

    Parameters
    ----------
    problem : OptimalControlProblem
    duration_scale : float
        Typical duration of a phase, s.
    prepare : callable, optional
        Turns each kernel function into a faster equal one (compiled code).
    """

    def __init__(
        self,
        problem: OptimalControlProblem,
        *,
        duration_scale: float = 1.0,
        prepare: Callable[[Sequence[ca.Function]], Sequence[ca.Function]] | None = None,
    ) -> None:
        problem.check()
        self.problem = problem
        self.duration_scale = duration_scale
        known: dict[str, Sequence[ca.Function]] = {}

        def derive(stage: ca.Function, end: ca.Function) -> Sequence[ca.Function]:
            # phases with the same physics share everything that is expensive
            key = stage.serialize() + end.serialize()
            if key not in known:
                made = with_derivatives(stage, end)
                known[key] = made if prepare is None else prepare(made)
            return known[key]

        self.kernels = [build_kernels(phase, duration_scale, derive) for phase in problem.phases]

    def layouts(self, meshes: Sequence[int | ArrayLike] | int) -> tuple[PhaseLayout, ...]:
        """Lay the problem out on a mesh for each phase."""
        phases = self.problem.phases
        chosen = list(meshes) if isinstance(meshes, Sized) else [meshes] * len(phases)
        if len(chosen) != len(phases):
            raise InputError(f"mesh has {len(chosen)} entries for {len(phases)} phases")
        grids = [fractions(mesh) for mesh in chosen]
        layouts, variable_offset, row_offset = [], 0, 0
        links = {link.before: link for link in self.problem.links}
        for index, phase in enumerate(self.problem.phases):
            nodes = node_variables(phase)
            controls = [*_constant(phase), *_linear(phase)]
            kernels = self.kernels[index]
            transition, next_nodes = 0, 0
            if index + 1 < len(self.problem.phases):
                after = node_variables(self.problem.phases[index + 1])
                named = links[phase.name].names
                transition = 1 + sum(v.size for v in after if v.name not in named)
                next_nodes = 1 + sum(v.size for v in after)
            layout = PhaseLayout(
                phase=phase,
                mesh=grids[index],
                node_scale=np.append(_stack(nodes, "scale"), self.duration_scale),
                control_scale=_stack(controls, "scale"),
                variable_offset=variable_offset,
                row_offset=row_offset,
                transition=transition,
                stage_rows=kernels.stage_lower.size,
                initial_rows=_conditioned(nodes, "initial"),
                final_rows=_conditioned(nodes, "final"),
                end_rows=kernels.end_lower.size,
                next_nodes=next_nodes,
            )
            layouts.append(layout)
            variable_offset += layout.variable_count
            row_offset += layout.row_count
        return tuple(layouts)


def _conditioned(nodes: Sequence[Variable], which: str) -> tuple[int, ...]:
    rows, offset = [], 0
    for variable in nodes:
        condition = getattr(variable, which)
        if condition is not None:
            finite = np.isfinite(condition[0]) | np.isfinite(condition[1])
            rows += [offset + int(i) for i in np.flatnonzero(finite)]
        offset += variable.size
    return tuple(rows)


def condition_bounds(
    layout: PhaseLayout, which: str, rows: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    low, high = [], []
    for variable in node_variables(layout.phase):
        condition = getattr(variable, which)
        empty = (np.full(variable.size, -np.inf), np.full(variable.size, np.inf))
        a, b = condition if condition is not None else empty
        low.append(a / variable.scale)
        high.append(b / variable.scale)
    keep = list(rows)
    return joined(low)[keep], joined(high)[keep]
