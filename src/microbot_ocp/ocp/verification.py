"""Certificate of an optimal-control solution: re-simulation, dense limits, optimality conditions.

Nothing here trusts the solver or the derivatives that it was given. The dynamics are integrated
again, the limits are looked at between the mesh points, and the conditions of Karush, Kuhn and
Tucker are formed anew from the declared problem.

Conventions. The Lagrangian of the scaled program is ``f + lam_g' g + lam_x' x``: multipliers are
positive at upper bounds and negative at lower ones. A row of the dynamics is
``z_k+1 - next(z_k, w_k) = 0``, so the costate at the mesh point k + 1 is ``-lam / scale``: the
derivative of the optimal cost with respect to the state there, in cost per unit of the state. The
Hamiltonian is ``H = L + costate' f``, which the optimal control makes smallest (Bryson and Ho,
*Applied Optimal Control*, sections 2.3 and 3.2). It is constant along a phase whose expressions do
not contain the time, and -1 where the cost is the duration and the duration is free.

At the points of collocation the costate is ``-mu_j / (scale w_j)`` with the multiplier of the
defect mu_j and the quadrature weight w_j (Garg et al., *Automatica* 46, 2010, "A unified framework
for the numerical solution of optimal control problems using pseudospectral methods"; Betts,
*Practical Methods for Optimal Control*, 2nd ed., section 4.11).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp.checks import FloatArray, InputError, plain
from microbot_ocp.ocp.assembly import Program, assemble
from microbot_ocp.ocp.kernels import Kernels, build_kernels, joined
from microbot_ocp.ocp.layout import PhaseLayout
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase, Variable, node_variables
from microbot_ocp.ocp.reintegration import (
    each_interval,
    mesh_states,
    open_loop,
    phase_layout,
    state_weights,
)
from microbot_ocp.ocp.rows import DURATION, row_labels, variable_labels
from microbot_ocp.ocp.schemes import Collocation
from microbot_ocp.ocp.solution import PhaseSolution, Solution, unpack
from microbot_ocp.ocp.transcription import Transcription

POINTS = 20  # dense points to an interval
ACTIVE = 1e-4  # of the size of a limit: nearer it is active
NEARLY_ACTIVE = 1e-2  # nearer it is active if its multiplier says so
WORTHLESS = 1e-4  # of the cost: a limit that is worth less over an arc does not act there
INSIDE = 1e-6  # relative distance of a duration from its bounds that makes it free
STALE = 1e-9  # relative difference between the values and the stages of a solution


@dataclass(frozen=True)
class Thresholds:
    """What still passes.

    Attributes
    ----------
    state_error : of the re-simulation, relative to the state's largest magnitude
    excess : of a limit between mesh points, relative to the limit
    feasibility : violation of a row or bound of the scaled program
    stationarity, complementarity, sign : of the scaled program, divided by
        ``max(100, mean of |multipliers|) / 100`` (Waechter and Biegler, 2006, equation 6)
    """

    state_error: float = 1e-3
    excess: float = 1e-3
    feasibility: float = 1e-6
    stationarity: float = 1e-5
    complementarity: float = 1e-5
    sign: float = 1e-5


@dataclass(frozen=True)
class ResimulationCheck:
    """A phase integrated again from its first state with the solution's own control.

    Attributes
    ----------
    phase : str
    status : "ok", or why the integrator stopped
    error : largest error along the phase, relative to the largest magnitude of the state
    local_error : the same where every interval starts at its own mesh state
    state, component, time, value, wanted, unit : where the largest error is, and both values
    """

    phase: str
    status: str
    error: float
    local_error: float
    state: str
    component: int
    time: float
    value: float
    wanted: float
    unit: str


@dataclass(frozen=True)
class LimitUse:
    """Worst point of one bound or path constraint of a phase, on a dense grid.

    Attributes
    ----------
    phase, name, component : which
    kind : "state", "control", "algebraic", "constraint", "end constraint" or "duration"
    time, value, limit, unit : where it is nearest to (or farthest beyond) its limit
    excess : by how much the limit is exceeded, in the unit; 0 where it is kept
    relative : the excess divided by half the range, or by the limit where there is only one
    """

    phase: str
    name: str
    component: int
    kind: str
    time: float
    value: float
    limit: float
    unit: str
    excess: float
    relative: float


@dataclass(frozen=True)
class Residual:
    """One residual: its size in the scaled program, and in the unit of what it belongs to.

    Attributes
    ----------
    scaled : float
    value : in ``unit``
    unit : str
    where : the variable or row in words
    """

    scaled: float
    value: float
    unit: str
    where: str


@dataclass(frozen=True)
class Optimality:
    """Conditions of Karush, Kuhn and Tucker at the solution.

    Attributes
    ----------
    stationarity : ``grad f + J' lam_g + lam_x``, which is zero at an optimum
    feasibility : violation of a row or bound
    complementarity : multiplier times distance to its bound
    sign : multiplier that pushes towards a bound that is not there
    computed_bounds : whether the multipliers of the bounds are those of the solver (False), or were
        computed from the stationarity (True), which then says nothing of bounded variables
    """

    stationarity: Residual
    feasibility: Residual
    complementarity: Residual
    sign: Residual
    computed_bounds: bool


@dataclass(frozen=True, eq=False)
class Costates:
    """Derivatives of the optimal cost with respect to the states of a phase.

    Attributes
    ----------
    phase : str
    t : times of the mesh points [N+1], s
    values : by the name of the state [N+1, size], just before the mesh point (after it at the
        first): where a bound of the state acts at a mesh point, the costate jumps there
    after : by the name of the state [N, size], just after the mesh points
    point_t, point_values : times [M] and values [M, size] at the collocation points
    """

    phase: str
    t: FloatArray
    values: Mapping[str, FloatArray]
    after: Mapping[str, FloatArray]
    point_t: FloatArray
    point_values: Mapping[str, FloatArray]

    def __getitem__(self, name: str) -> FloatArray:
        return self.values[name]


@dataclass(frozen=True, eq=False)
class Hamiltonian:
    """``H = L + costate' f`` along a phase, averaged over every interval.

    Attributes
    ----------
    phase : str
    t : middles of the intervals [N], s
    values : averages over the intervals [N], as the derivative of the discrete Lagrangian with
        respect to the length of the interval. Where a control switches inside an interval the
        averages differ on its two sides, by a share of its length
    mean : over the phase
    drift : largest difference to the mean
    autonomous : whether the phase's expressions are free of the time, so that H should be constant
    expected : what its mean should be, by the transversality of the duration; None where the
        duration is fixed or at a bound, or appears in other expressions than end costs
    duration_price : derivative of the optimal cost with respect to the duration, 0 where it is free
    """

    phase: str
    t: FloatArray
    values: FloatArray
    mean: float
    drift: float
    autonomous: bool
    expected: float | None
    duration_price: float


@dataclass(frozen=True)
class Arc:
    """A stretch of time during which a limit acts.

    Attributes
    ----------
    phase, kind, name, component : which limit
    side : "lower" or "upper"
    start, end : s since the start of the phase
    price : what it would bring to relax the limit by one unit during the arc (cost per unit)
    unit : str
    """

    phase: str
    kind: str
    name: str
    component: int
    side: str
    start: float
    end: float
    price: float
    unit: str


@dataclass(frozen=True, eq=False)
class OCPCertificate:
    """What was checked of a solution, and the verdict.

    Attributes
    ----------
    problem : name of the problem
    ok : whether every check passed
    verdict : the result in words
    resimulations : one check a phase
    limits : one entry for every component of every bound and path constraint
    optimality : Optimality
    costates, hamiltonians : one entry a phase
    arcs : which limit acts when
    thresholds : what still passes
    wall_time : what the certificate took, s
    """

    problem: str
    ok: bool
    verdict: str
    resimulations: tuple[ResimulationCheck, ...]
    limits: tuple[LimitUse, ...]
    optimality: Optimality
    costates: tuple[Costates, ...]
    hamiltonians: tuple[Hamiltonian, ...]
    arcs: tuple[Arc, ...]
    thresholds: Thresholds
    wall_time: float

    def costate(self, phase: str) -> Costates:
        """Costates of a phase by its name."""
        return next(c for c in self.costates if c.phase == phase)

    def hamiltonian(self, phase: str) -> Hamiltonian:
        """Hamiltonian of a phase by its name."""
        return next(h for h in self.hamiltonians if h.phase == phase)

    @property
    def worst_limit(self) -> LimitUse | None:
        """The limit that is exceeded most, relative; None where all are kept."""
        worst = max(self.limits, key=lambda use: use.relative, default=None)
        return worst if worst is not None and worst.excess > 0 else None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; what is not finite becomes None."""
        return plain(self)


def verify(
    problem: OptimalControlProblem | Transcription,
    solution: Solution,
    *,
    thresholds: Thresholds | None = None,
) -> OCPCertificate:
    """Check a solution independently of what made it.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
        What was solved.
    solution : Solution
    thresholds : Thresholds, optional

    Returns
    -------
    OCPCertificate
        First-order conditions make no difference between a local optimum and the best one.

    Raises
    ------
    InputError
        The solution is of another problem, or was not made by a solve.

    Examples
    --------
    >>> from microbot_ocp.ocp import solve
    >>> problem = OptimalControlProblem("double integrator")
    >>> phase = problem.phase("move", duration=(0.1, 10.0))
    >>> x = phase.state("x", initial=0.0, final=1.0, unit="m")
    >>> v = phase.state("v", initial=0.0, final=0.0, unit="m/s")
    >>> u = phase.control("u", lower=-1.0, upper=1.0, unit="m/s^2")
    >>> phase.derivative(x, v)
    >>> phase.derivative(v, u)
    >>> phase.end_cost(phase.duration)
    >>> certificate = verify(problem, solve(problem, mesh=20))
    >>> certificate.ok, round(certificate.hamiltonian("move").mean, 3)
    (True, -1.0)
    >>> [(arc.name, arc.side, round(arc.end, 3)) for arc in certificate.arcs]
    [('u', 'upper', 1.0), ('u', 'lower', 2.0)]
    """
    started = time.perf_counter()
    limits_of = thresholds or Thresholds()
    transcription = _transcription(problem, solution)
    layouts = tuple(phase_layout(phase) for phase in solution.phases)
    plain = [_plain_kernels(layout) for layout in layouts]
    program = assemble(
        transcription.problem,
        [_limited_alike(layout, own) for layout, own in zip(layouts, plain, strict=True)],
    )
    x = _scaled_variables(program, solution)
    lam_g = np.asarray(solution.row_multipliers, dtype=float)
    if lam_g.size != program.row_lower.size:
        raise InputError(
            f"the solution has {lam_g.size} row multipliers for {program.row_lower.size} rows of "
            f"problem {transcription.problem.name!r}"
        )
    parts = [
        _differentiate(phase, own, lam_g) for phase, own in zip(solution.phases, plain, strict=True)
    ]
    gradient = _gradient(program, parts, lam_g)
    lam_x, computed = _bound_multipliers(program, solution, gradient)
    optimality = _optimality(program, x, gradient, lam_g, lam_x, computed, solution.cost_scale)
    resimulations = tuple(_resimulate(phase) for phase in solution.phases)
    dense = [_dense(phase) for phase in solution.phases]
    uses = tuple(use for d in dense for use in _limit_uses(d))
    costates = tuple(
        _costates(phase, part, lam_g) for phase, part in zip(solution.phases, parts, strict=True)
    )
    hamiltonians = tuple(
        _hamiltonian(phase, part, lam_x) for phase, part in zip(solution.phases, parts, strict=True)
    )
    prices = _Prices(program, lam_g, lam_x)
    worth = WORTHLESS * max(abs(solution.cost), 1e-6)
    arcs = tuple(arc for d in dense for arc in _arcs(d, prices, worth))
    problems = _problems(program, x, solution, resimulations, uses, optimality, limits_of)
    said = problems or _praise(resimulations, uses, optimality, hamiltonians, arcs)
    return OCPCertificate(
        problem=transcription.problem.name,
        ok=not problems,
        verdict=("Failed: " if problems else "Passed: ") + "; ".join(said) + ".",
        resimulations=resimulations,
        limits=uses,
        optimality=optimality,
        costates=costates,
        hamiltonians=hamiltonians,
        arcs=arcs,
        thresholds=limits_of,
        wall_time=time.perf_counter() - started,
    )


def _transcription(
    problem: OptimalControlProblem | Transcription, solution: Solution
) -> Transcription:
    layouts = [phase_layout(phase) for phase in solution.phases]
    own = problem.problem if isinstance(problem, Transcription) else problem
    names = [phase.name for phase in own.phases]
    if names != [phase.name for phase in solution.phases]:
        raise InputError(
            f"the solution has phases {[p.name for p in solution.phases]}, but problem "
            f"{own.name!r} has {names}"
        )
    if isinstance(problem, Transcription):
        made = problem
    else:
        made = Transcription(problem, scheme=layouts[0].scheme)
    fresh = made.layouts([layout.chosen for layout in layouts])
    for mine, given in zip(fresh, layouts, strict=True):
        if mine.variable_count != given.variable_count or mine.row_count != given.row_count:
            raise InputError(
                f"phase {mine.phase.name!r} of the solution has other variables or constraints "
                f"than that of problem {own.name!r}"
            )
    return made


def _scaled_variables(program: Program, solution: Solution) -> FloatArray:
    """Variables of the program, from the stages and the last mesh values of every phase."""
    last = program.layouts[-1]
    x = np.zeros(last.variable_offset + last.variable_count)
    for layout, phase in zip(program.layouts, solution.phases, strict=True):
        assert phase.stages is not None
        end = [phase.values[v.name][-1] for v in node_variables(layout.phase)]
        x[layout.variable_offset : layout.last_node] = phase.stages
        node = np.append(np.concatenate(end), phase.duration) / layout.node_scale
        x[layout.last_node : layout.last_node + layout.node_size] = node
    for index, layout in enumerate(program.layouts[:-1]):
        for source, target, factor in _link_places(program, index):
            if source >= layout.last_node + layout.node_size:  # a transition control
                x[source] = x[target] / factor
    return x


def _link_places(program: Program, index: int) -> list[tuple[int, int, float]]:
    """Source, target and factor of the rows ``x[target] - factor x[source] = 0`` after a phase."""
    layout, after = program.layouts[index : index + 2]
    kept = next(k.names for k in program.links if k.before == layout.phase.name)
    place: dict[str, tuple[int, Variable]] = {}
    offset = layout.last_node
    for variable in node_variables(layout.phase):
        place[variable.name] = (offset, variable)
        offset += variable.size
    free, target = layout.last_node + layout.node_size, after.variable_offset
    found = []
    for variable in node_variables(after.phase):
        for i in range(variable.size):
            if variable.name in kept:
                start, before = place[variable.name]
                source, factor = start + i, float(before.scale[i] / variable.scale[i])
            else:
                source, factor, free = free, 1.0, free + 1
            found.append((source, target, factor))
            target += 1
    return [*found, (free, target, 1.0)]  # the duration


# optimality conditions ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Derivatives:
    """Derivatives of the discrete Lagrangian of one phase, stage by stage, scaled.

    Attributes
    ----------
    layout : PhaseLayout
    by_stage : of the variables of the stages in turn, without the row that a stage arrives at
    by_start, by_length : with respect to start and length of the interval, as fractions [N]
    by_end : [node size], of end costs and end constraints
    end_cost : of the end costs alone [node size]
    step : multipliers of the steps [N, node size]
    """

    layout: PhaseLayout
    by_stage: FloatArray
    by_start: FloatArray
    by_length: FloatArray
    by_end: FloatArray
    end_cost: FloatArray
    step: FloatArray


def _plain_kernels(layout: PhaseLayout) -> list[Kernels]:
    """Kernels without derivatives and not compiled: what is differentiated here is the original."""

    def derive(stage: ca.Function, end: ca.Function) -> Sequence[ca.Function]:
        return [stage, stage, stage, end, end, end]

    scale = float(layout.node_scale[-1])
    return [build_kernels(layout.phase, scale, kind.scheme, derive) for kind in layout.kinds]


def _limited_alike(layout: PhaseLayout, plain: Sequence[Kernels]) -> PhaseLayout:
    """The layout with the limits of its phase, which may be others than those declared."""
    limits = [
        {name: getattr(own, name) for name in vars(own) if name.endswith(("_lower", "_upper"))}
        for own in plain
    ]
    kinds = tuple(
        replace(kind, kernels=replace(kind.kernels, **own))
        for kind, own in zip(layout.kinds, limits, strict=True)
    )
    return replace(layout, kinds=kinds)


def _differentiate(
    phase: PhaseSolution, kernels: Sequence[Kernels], lam_g: FloatArray
) -> _Derivatives:
    layout = phase_layout(phase)
    assert phase.stages is not None
    n, nz = layout.intervals, layout.node_size
    by_stage = np.zeros_like(phase.stages)
    by_grid = np.zeros((2, n))
    for group, kernel in zip(layout.groups, kernels, strict=True):
        table = layout.table(phase.stages, group)
        run = _stage_gradient(kernel.stage).map(group.intervals.size)
        slope, slope_of_grid = run(table.T, layout.constants(group.intervals), lam_g[group.rows].T)
        by_stage[group.variables - layout.variable_offset] = slope.full().T
        by_grid[:, group.intervals] = slope_of_grid.full()
    constants = joined([p.value for p in layout.phase.parameters])
    node = [phase.values[v.name][-1] for v in node_variables(layout.phase)]
    z = np.append(np.concatenate(node), phase.duration) / layout.node_scale
    end_row = layout.last_row + layout.next_nodes
    lam_end = lam_g[end_row : end_row + layout.end_rows]
    run = _end_gradient(kernels[0].end)
    return _Derivatives(
        layout=layout,
        by_stage=by_stage,
        by_start=by_grid[0],
        by_length=by_grid[1],
        by_end=run(z, constants, lam_end).full().ravel(),
        end_cost=run(z, constants, np.zeros(layout.end_rows)).full().ravel(),
        step=lam_g[layout.stage_row[:, None] + np.arange(nz)],
    )


def _symbols(function: ca.Function) -> list[Any]:
    kind = ca.SX if function.is_a("SXFunction") else ca.MX
    return [kind.sym(f"i{k}", function.size1_in(k)) for k in range(function.n_in())]


def _stage_gradient(stage: ca.Function) -> ca.Function:
    v, c = _symbols(stage)
    following, rows, cost = stage(v, c)
    both = ca.vertcat(-following, rows)
    lam = type(v).sym("lam", both.shape[0])
    lagrangian = cost + ca.dot(lam, both)
    slopes = [ca.densify(ca.gradient(lagrangian, w)) for w in (v, c)]
    return ca.Function("stage_gradient", [v, c, lam], [slopes[0], slopes[1][:2]])


def _end_gradient(end: ca.Function) -> ca.Function:
    z, c = _symbols(end)
    rows, cost = end(z, c)
    lam = type(z).sym("lam", rows.shape[0])
    slope = ca.densify(ca.gradient(cost + ca.dot(lam, rows), z))
    return ca.Function("end_gradient", [z, c, lam], [slope])


def _gradient(program: Program, parts: Sequence[_Derivatives], lam_g: FloatArray) -> FloatArray:
    """``grad f + J' lam_g`` of the scaled program."""
    gradient = np.zeros(program.variable_lower.size)
    for index, part in enumerate(parts):
        layout = part.layout
        nz, first, last = layout.node_size, layout.variable_offset, layout.last_node
        gradient[first:last] += part.by_stage
        gradient[layout.nodes[1:]] += part.step
        begin = layout.start_row
        for i, place in enumerate(layout.initial_rows):
            gradient[first + place] += lam_g[begin + i]
        gradient[last : last + nz] += part.by_end
        begin = layout.last_row + layout.next_nodes + layout.end_rows
        for i, place in enumerate(layout.final_rows):
            gradient[last + place] += lam_g[begin + i]
        if layout.next_nodes:
            for i, (source, target, factor) in enumerate(_link_places(program, index)):
                gradient[target] += lam_g[layout.last_row + i]
                gradient[source] -= factor * lam_g[layout.last_row + i]
    return gradient


def _bound_multipliers(
    program: Program, solution: Solution, gradient: FloatArray
) -> tuple[FloatArray, bool]:
    given = solution.variable_multipliers
    if given is not None and np.size(given) == gradient.size:
        return np.asarray(given, dtype=float), False
    bounded = np.isfinite(program.variable_lower) | np.isfinite(program.variable_upper)
    return np.where(bounded, -gradient, 0.0), True


def _optimality(
    program: Program,
    x: FloatArray,
    gradient: FloatArray,
    lam_g: FloatArray,
    lam_x: FloatArray,
    computed: bool,
    cost_scale: float,
) -> Optimality:
    g = np.array(program.functions["jacobian"](x, program.parameters)[0]).ravel()
    labels = [*variable_labels(program), *row_labels(program)]
    scale = np.array([label.scale for label in labels])
    value, lam = np.concatenate([x, g]), np.concatenate([lam_x, lam_g])
    low = np.concatenate([program.variable_lower, program.row_lower])
    high = np.concatenate([program.variable_upper, program.row_upper])
    size = max(100.0 * cost_scale, float(np.mean(np.abs(lam)))) / 100.0
    excess = np.maximum(np.maximum(low - value, value - high), 0.0)
    with np.errstate(invalid="ignore"):
        distance = np.where(lam > 0, high - value, value - low)
        acts = np.isfinite(distance) & (low < high)
        slack = np.where(acts, np.abs(lam) * np.maximum(distance, 0.0), 0.0)
    # a multiplier may push towards a bound that exists only
    wrong = np.where(np.where(lam > 0, np.isinf(high), np.isinf(low)), np.abs(lam), 0.0)

    def worst(sizes: FloatArray, factor: FloatArray, unit: str, divisor: float) -> Residual:
        sizes = np.nan_to_num(sizes, nan=np.inf)
        i = int(np.argmax(sizes))
        own = labels[i].unit or "1"
        return Residual(
            float(sizes[i] / divisor), float(sizes[i] * factor[i]), unit.format(own), str(labels[i])
        )

    residual = np.abs(gradient + lam_x)
    return Optimality(
        stationarity=worst(residual, 1 / scale[: x.size], "cost per {}", size),
        feasibility=worst(excess, scale, "{}", 1.0),
        complementarity=worst(slack, np.ones(scale.size), "cost", size),
        sign=worst(wrong, 1 / scale, "cost per {}", size),
        computed_bounds=computed,
    )


# costates and Hamiltonian -------------------------------------------------------------------------


def _split(states: Sequence[Variable], table: FloatArray) -> dict[str, FloatArray]:
    edges = np.cumsum([0, *(s.size for s in states)])
    return {s.name: table[:, a : a + s.size] for s, a in zip(states, edges[:-1], strict=True)}


def _costates(phase: PhaseSolution, part: _Derivatives, lam_g: FloatArray) -> Costates:
    layout = part.layout
    states = layout.phase.states
    size = sum(s.size for s in states)
    scale = layout.node_scale[:size]
    after = part.by_stage[layout.nodes[:-1, :size] - layout.variable_offset] / scale
    values = np.vstack([after[:1], -part.step[:, :size] / scale])
    point_t, point_values = np.zeros(0), np.zeros((0, size))
    for group in layout.groups:
        scheme = group.kind.scheme
        if isinstance(scheme, Collocation):
            defects = group.rows[:, layout.node_size :][:, : scheme.degree * size]
            mu = lam_g[defects].reshape(-1, scheme.degree, size)
            own = -mu / (scale * scheme.weights[:, None])
            t = phase.t[group.intervals, None] + np.outer(
                np.diff(phase.t)[group.intervals], scheme.points
            )
            point_t = np.concatenate([point_t, t.ravel()])
            point_values = np.vstack([point_values, own.reshape(-1, size)])
    in_turn = np.argsort(point_t, kind="stable")
    point_t, point_values = point_t[in_turn], point_values[in_turn]
    return Costates(
        phase=phase.name,
        t=phase.t,
        values=_split(states, values),
        after=_split(states, after),
        point_t=point_t,
        point_values=_split(states, point_values),
    )


def _hamiltonian(phase: PhaseSolution, part: _Derivatives, lam_x: FloatArray) -> Hamiltonian:
    layout = part.layout
    steps = np.diff(layout.mesh)
    # With a longer interval the later points of it come later as well: half of the effect that a
    # later start has is not the Hamiltonian's.
    values = (part.by_length - part.by_start * steps / 2) / phase.duration
    mean = float(values @ steps)
    own = layout.phase
    along = [*own.derivatives.values(), *own.running_costs, *own.algebraic_equations]
    along += [c.expression for c in own.constraints]
    used = ca.vertcat(*along)
    price = -float(lam_x[layout.nodes[:, -1]].sum()) / layout.node_scale[-1]
    low, high = own.duration_bounds
    free = low < high and min(phase.duration - low, high - phase.duration) > INSIDE * phase.duration
    constraints = [c.expression for c in own.end_constraints]
    apart = not ca.depends_on(ca.vertcat(used, *constraints), own.duration)
    return Hamiltonian(
        phase=phase.name,
        t=(phase.t[:-1] + phase.t[1:]) / 2,
        values=values,
        mean=mean,
        drift=float(np.abs(values - mean).max()),
        autonomous=not ca.depends_on(used, own.time),
        expected=-float(part.end_cost[-1]) / layout.node_scale[-1] if free and apart else None,
        duration_price=price,
    )


# re-simulation ------------------------------------------------------------------------------------


def _resimulate(phase: PhaseSolution) -> ResimulationCheck:
    states = phase_layout(phase).phase.states
    wanted, weights = mesh_states(phase)[1:], state_weights(phase)
    ends, status = open_loop(phase)
    error = np.nan_to_num(np.abs(ends - wanted) / weights, nan=np.inf)
    local = np.nan_to_num(np.abs(each_interval(phase)[0] - wanted) / weights, nan=np.inf)
    k, column = np.unravel_index(int(error.argmax()), error.shape)
    owners = [(state, i) for state in states for i in range(state.size)]
    state, component = owners[int(column)]
    return ResimulationCheck(
        phase=phase.name,
        status=status,
        error=float(error.max()),
        local_error=float(local.max()),
        state=state.name,
        component=component,
        time=float(phase.t[int(k) + 1]),
        value=float(ends[k, column]),
        wanted=float(wanted[k, column]),
        unit=state.unit,
    )


# limits on a dense grid ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Limited:
    """One quantity with limits [size], along a dense grid [M, size]."""

    kind: str
    name: str
    unit: str
    lower: FloatArray
    upper: FloatArray
    scale: FloatArray
    values: FloatArray
    end: bool = False  # whether it has a value at the end of the phase only

    def size(self, i: int) -> float:
        """What an excess is relative to: half the range, the limit, or the scale."""
        low, high = float(self.lower[i]), float(self.upper[i])
        if np.isfinite(low) and np.isfinite(high) and high > low:
            return (high - low) / 2
        limit = max((abs(k) for k in (low, high) if np.isfinite(k)), default=0.0)
        return limit if limit > 0 else float(self.scale[i])


@dataclass(frozen=True, eq=False)
class _Dense:
    """A phase on its dense grid: both ends of every interval and the points between them."""

    phase: PhaseSolution
    t: FloatArray
    interval: np.ndarray
    limited: list[_Limited] = field(default_factory=list)


def _dense(phase: PhaseSolution) -> _Dense:
    layout = phase_layout(phase)
    own = layout.phase
    assert phase.stages is not None
    n = layout.intervals
    share = np.linspace(0.0, 1.0, POINTS + 1)
    interval = np.repeat(np.arange(n), share.size)
    place = np.tile(share, n)
    steps = np.diff(layout.mesh)
    constants = np.tile(joined([p.value for p in own.parameters]), (place.size, 1))
    table = np.vstack(layout.dense(phase.stages, interval, place)).T
    t = (layout.mesh[interval] + place * steps[interval]) * phase.duration
    dense = _Dense(phase, t, interval)
    ordered = [
        *own.states,
        *(c for shape in ("constant", "linear", "polynomial") for c in _shaped(own, shape)),
        *own.algebraics,
    ]
    kinds = {id(v): "state" for v in own.states} | {id(v): "algebraic" for v in own.algebraics}
    offset = 0
    for variable in ordered:
        values = table[:, offset : offset + variable.size]
        offset += variable.size
        kind = kinds.get(id(variable), "control")
        dense.limited.append(_limited(kind, variable, values))
    duration = np.array([[phase.duration]])
    low, high = (np.array([d]) for d in own.duration_bounds)
    dense.limited.append(
        _Limited("duration", DURATION, "s", low, high, np.ones(1), duration, end=True)
    )
    linear = _shaped(own, "linear")
    rates = [
        np.diff(phase.values[c.name], axis=0)[interval] / (steps * phase.duration)[interval, None]
        for c in linear
    ]
    symbols = [v.symbol for v in ordered] + [c.rate for c in linear if c.rate is not None]
    data = np.hstack([table, *rates, t[:, None], np.full((t.size, 1), phase.duration), constants])
    inputs = [*symbols, own.time, own.duration, *(p.symbol for p in own.parameters)]
    for kind, limits, rows in (
        ("constraint", own.constraints, slice(None)),
        ("end constraint", own.end_constraints, slice(-1, None)),
    ):
        for limit in limits:
            value = ca.Function("value", [ca.vertcat(*inputs)], [ca.densify(limit.expression)])
            values = value(data[rows].T).full().T
            dense.limited.append(_limited(kind, limit, values, end=kind != "constraint"))
    return dense


def _shaped(phase: Phase, shape: str) -> list[Variable]:
    return [c for c in phase.controls if c.shape == shape]


def _limited(kind: str, own: Any, values: FloatArray, end: bool = False) -> _Limited:
    return _Limited(kind, own.name, own.unit, own.lower, own.upper, own.scale, values, end)


def _limit_uses(dense: _Dense) -> list[LimitUse]:
    found = []
    for limited in dense.limited:
        for i in range(limited.lower.size):
            low, high = float(limited.lower[i]), float(limited.upper[i])
            if not (np.isfinite(low) or np.isfinite(high)):
                continue
            value = limited.values[:, i]
            beyond = np.nan_to_num(np.maximum(low - value, value - high), nan=np.inf)
            k = int(beyond.argmax())
            excess = max(0.0, float(beyond[k]))
            found.append(
                LimitUse(
                    phase=dense.phase.name,
                    name=limited.name,
                    component=i,
                    kind=limited.kind,
                    time=dense.phase.duration if limited.end else float(dense.t[k]),
                    value=float(value[k]),
                    limit=low if low - value[k] >= value[k] - high else high,
                    unit=limited.unit,
                    excess=excess,
                    relative=excess / limited.size(i),
                )
            )
    return found


# switching structure ------------------------------------------------------------------------------


class _Prices:
    """Multipliers of bounds and path constraints by phase and name, in cost per unit."""

    def __init__(self, program: Program, lam_g: FloatArray, lam_x: FloatArray) -> None:
        self.entries: dict[tuple[str, str, int], list[tuple[float, int, float]]] = {}
        layouts = {layout.phase.name: layout for layout in program.layouts}
        for labels, lam in (
            (variable_labels(program), lam_x),
            (row_labels(program), lam_g),
        ):
            for label, multiplier in zip(labels, lam, strict=True):
                if label.kind in ("state", "control", "algebraic", "bound", "constraint"):
                    own = self.entries.setdefault((label.phase, label.name, label.component), [])
                    place = label.place(layouts[label.phase])
                    own.append((place, label.interval, multiplier / label.scale))

    def of(self, phase: str, name: str, component: int) -> np.ndarray:
        """Place, interval and multiplier [M, 3]."""
        return np.array(self.entries.get((phase, name, component), []), dtype=float).reshape(-1, 3)


def _arcs(dense: _Dense, prices: _Prices, worth: float) -> list[Arc]:
    phase = dense.phase
    found = []
    for limited in dense.limited:
        for i in range(0 if limited.end else limited.lower.size):
            low, high = float(limited.lower[i]), float(limited.upper[i])
            if low == high:
                continue
            size = limited.size(i)
            own = prices.of(phase.name, limited.name, i)
            for side, limit, sign in (("lower", low, -1.0), ("upper", high, 1.0)):
                if not np.isfinite(limit):
                    continue
                slack = sign * (limit - limited.values[:, i]) / size
                push = np.maximum(sign * own[:, 2], 0.0)
                strength = np.zeros(phase.mesh.size)
                np.maximum.at(strength, own[:, 1].astype(int), push * size)
                active = slack <= ACTIVE
                active |= (slack <= NEARLY_ACTIVE) & (strength[dense.interval] > slack)
                for first, last in _joined_runs(dense, active):
                    start, end = float(dense.t[first]), float(dense.t[last])
                    # to the nearest dense point, as the multipliers stand at points of the mesh
                    reach = 1e-9 + float(np.diff(phase.mesh).max()) / POINTS
                    near = own[:, 0] >= start / phase.duration - reach
                    near &= own[:, 0] <= end / phase.duration + reach
                    price = float(push[near].sum())
                    if price * size > worth:
                        found.append(
                            Arc(
                                phase.name,
                                limited.kind,
                                limited.name,
                                i,
                                side,
                                start,
                                end,
                                price,
                                limited.unit,
                            )
                        )
    return sorted(found, key=lambda arc: (arc.name, arc.component, arc.start))


def _joined_runs(dense: _Dense, active: np.ndarray) -> list[tuple[int, int]]:
    """Runs of true values; those that are less than an interval apart are one.

    A limit that is kept at a few points of every interval leaves it a little between them.
    """
    steps = np.diff(dense.phase.t)
    found: list[tuple[int, int]] = []
    for first, last in _runs(active):
        if found:
            begin, end = found[-1]
            if dense.t[first] - dense.t[end] < (1 - 1e-6) * steps[dense.interval[end]]:
                found[-1] = (begin, last)
                continue
        found.append((first, last))
    return found


def _runs(active: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of every run of true values."""
    change = np.diff(np.concatenate([[0], active.astype(int), [0]]))
    ends = np.flatnonzero(change < 0) - 1
    return list(zip(np.flatnonzero(change > 0).tolist(), ends.tolist(), strict=True))


# words --------------------------------------------------------------------------------------------


def _problems(
    program: Program,
    x: FloatArray,
    solution: Solution,
    resimulations: Sequence[ResimulationCheck],
    uses: Sequence[LimitUse],
    optimality: Optimality,
    passes: Thresholds,
) -> list[str]:
    problems = []
    if not solution.status.ok:
        problems.append(f"the solve did not converge: {solution.status.value}")
    for phase, again in zip(solution.phases, unpack(program, x), strict=True):
        for name, values in phase.values.items():
            size = max(1e-9, float(np.abs(again.values[name]).max()))
            if not np.abs(values - again.values[name]).max() <= STALE * size:
                problems.append(
                    f"the values of {name} in phase {phase.name!r} are not those of its stages"
                )
    for check in resimulations:
        where = f"phase {check.phase!r}"
        if check.status != "ok":
            problems.append(f"re-simulation of {where} stopped: {check.status}")
        elif not check.error <= passes.state_error:
            cause = ""
            if check.local_error <= passes.state_error / 10:
                cause = (
                    f" (but every interval by itself is within {check.local_error:.2g}: small "
                    "errors grow along the phase)"
                )
            problems.append(
                f"re-simulation of {where} has {_component(check.state, check.component)} = "
                f"{check.value:.6g} {check.unit} instead of {check.wanted:.6g} at "
                f"{check.time:.4g} s, an error of {check.error:.2g} of its size{cause}"
            )
    problems += [
        f"{use.kind} {_component(use.name, use.component)} of phase {use.phase!r} is "
        f"{use.value:.6g} {use.unit} at {use.time:.4g} s, {use.excess:.3g} beyond its limit of "
        f"{use.limit:.6g}"
        for use in uses
        if not use.relative <= passes.excess
    ]
    for residual, limit, said in (
        (optimality.feasibility, passes.feasibility, "not feasible: {} is violated by {}"),
        (optimality.stationarity, passes.stationarity, "not stationary: {} has a slope of {} left"),
        (
            optimality.complementarity,
            passes.complementarity,
            "not complementary: {} has a multiplier away from its limit, worth {}",
        ),
        (optimality.sign, passes.sign, "multiplier of the wrong sign: {} with {}"),
    ):
        if not residual.scaled <= limit:
            amount = f"{residual.value:.3g} {residual.unit}"
            problems.append(said.format(residual.where, amount))
    return problems


def _component(name: str, component: int) -> str:
    return f"{name}[{component}]" if component else name


def _praise(
    resimulations: Sequence[ResimulationCheck],
    uses: Sequence[LimitUse],
    optimality: Optimality,
    hamiltonians: Sequence[Hamiltonian],
    arcs: Sequence[Arc],
) -> list[str]:
    error = max(check.error for check in resimulations)
    worst = max((use.relative for use in uses), default=0.0)
    kept = "is kept" if worst <= 1e-6 else f"is kept to within {100 * worst:.2g} %"
    said = [
        f"first-order conditions hold to {optimality.stationarity.scaled:.1e} (stationarity) and "
        f"{optimality.complementarity.scaled:.1e} (complementarity)",
        f"re-simulation stays within {error:.2g} of the states' size",
        f"every limit {kept} between mesh points",
    ]
    for own in hamiltonians:
        if own.autonomous:
            due = "" if own.expected is None else f" (expected {own.expected:.4g})"
            said.append(
                f"Hamiltonian of phase {own.phase!r} {own.mean:.4g}{due} with a drift of "
                f"{own.drift:.1e}"
            )
    count = len(arcs)
    said.append(f"{count} arc{'' if count == 1 else 's'} on limits")
    return said
