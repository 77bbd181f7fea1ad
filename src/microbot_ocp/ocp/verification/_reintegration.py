"""Integration of the dynamics of a solution by an adaptive integrator that no scheme uses.

The control is the solution's own function of time: constant, linear, or the polynomial through the
values at the collocation points. CVODES, or IDAS if there are algebraic variables, restarts at
every mesh point, so that a jump of the control there costs no accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.growth import carry, transition_matrices
from microbot_ocp._base.quiet import quiet
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.diagnosis import singular
from microbot_ocp.ocp.problem import Variable, as_scalars
from microbot_ocp.ocp.solution import PhaseSolution
from microbot_ocp.ocp.transcription import StageKind
from microbot_ocp.ocp.transcription.schemes import lagrange, within_bounds
from microbot_ocp.ocp.verification._certificate import ResimulationCheck


def mesh_states(phase: PhaseSolution) -> FloatArray:
    """Return all states [N+1, n] at the mesh points."""
    states = phase.laid_out.phase.states
    return np.hstack([phase.values[state.name] for state in states])


LEAST_SIZE = 1e-2  # least size of a state that errors are relative to, as a fraction of its scale


def state_weights(phase: PhaseSolution) -> FloatArray:
    """Return the magnitudes of the states [n] to which their errors are relative.

    Largest magnitude along the phase, but at least a hundredth of the declared scale: a state that
    stays zero has no relative error.
    """
    scale = np.concatenate([state.scale for state in phase.laid_out.phase.states])
    return np.maximum(np.abs(mesh_states(phase)).max(axis=0), LEAST_SIZE * scale)


@dataclass(frozen=True, eq=False)
class Integrated:
    """Result of the integration of a phase.

    Attributes
    ----------
    states : states at the ends of the intervals [N, n]; NaN if the integrator failed
    costs : integrals of the running cost over the intervals [N]; 0 if not requested
    failure : message of the integrator; empty if it succeeded
    """

    states: FloatArray
    costs: FloatArray
    failure: str = ""


def each_interval(phase: PhaseSolution, *, until: float = 1.0, cost: bool = False) -> Integrated:
    """Integrate every interval from its own mesh state up to the fraction ``until`` of its length.

    One call of a mapped integrator covers all intervals. The running cost is integrated if ``cost``
    is True.
    """
    start, failure = mesh_states(phase)[:-1], ""
    # Adams' method needs no Jacobian and takes longer steps; BDF follows for stiff dynamics.
    for method in ("idas",) if phase.laid_out.phase.algebraics else ("adams", "bdf"):
        try:
            with quiet():  # CasADi prints all inputs of a failed call; its message suffices
                run, data = _integrator(phase, method, until, cost)
                states, summed = run.map(len(start))(start.T, data.T)
        except RuntimeError as problem:
            failure = singular(phase) or _why(problem)
            continue
        costs = summed.full().ravel() if cost else np.zeros(len(start))
        return Integrated(states.full().T, costs)
    return Integrated(np.full_like(start, np.nan), np.full(len(start), np.nan), failure)


def interval_errors(
    phase: PhaseSolution, arrived: Integrated, costs: FloatArray, size: float
) -> FloatArray:
    """Return the relative error of every interval [N]: largest of its states and its cost.

    State errors are relative to :func:`state_weights`, the running cost to ``size``.
    """
    missed = np.abs(arrived.states - mesh_states(phase)[1:]) / state_weights(phase)
    error = np.maximum(missed.max(axis=1), np.abs(arrived.costs - costs[: len(missed)]) / size)
    return np.nan_to_num(error, nan=np.inf)


def transitions(phase: PhaseSolution) -> FloatArray:
    """Return transition matrices [N,n,n] of the intervals, for states divided by their weights.

    The dynamics are linearised at the midpoint of each interval.
    """
    states, weights = mesh_states(phase), state_weights(phase)
    middles = 0.5 * (states[:-1] + states[1:])
    run, data = _linearised(phase)
    linear = run.map(len(middles))(middles.T, data.T)
    slopes = linear.full().T.reshape(len(middles), weights.size, -1).transpose(0, 2, 1)
    slopes = np.nan_to_num(slopes) * (weights[None, None, :] / weights[None, :, None])
    return transition_matrices(slopes, np.ones(len(middles)))


def _why(problem: RuntimeError) -> str:
    lines = [line for line in str(problem).strip().split("\n") if line.strip()]
    return f"the integrator failed: {lines[-1].strip() if lines else 'no reason given'}"


def points_of(kind: StageKind, variable: Variable) -> list[float]:
    """Return the fractions of an interval at which a variable has values."""
    return [k.fraction for k in kind.inner if k.source.name == variable.name]


def point_values(phase: PhaseSolution, variable: Variable) -> FloatArray:
    """Return values [N, points, size] of a polynomial control or algebraic variable."""
    return phase.values[variable.name].reshape(phase.mesh.size - 1, -1, variable.size)


class _Equation(NamedTuple):
    """The dynamics on an interval, as a function of the fraction of it that has passed.

    Attributes
    ----------
    dae : dict
        CasADi's dictionary of a DAE in states divided by their scales, so that one absolute
        tolerance fits all. Its parameters are the data of the interval.
    data : array [N, ...]
        Data of every interval.
    guesses : MX
        Part of the parameters with initial guesses of the algebraic variables.
    scale : DM
    """

    dae: dict[str, Any]
    data: FloatArray
    guesses: ca.MX
    scale: ca.DM


class _Inputs:
    """Data of every interval, and the values of the phase's symbols in terms of them.

    Attributes
    ----------
    tables, symbols : data [N, size] of all intervals, and symbols for those of one
    values : pairs of a symbol of the phase and its value at a fraction ``s`` of the interval
    """

    def __init__(self, phase: PhaseSolution, s: ca.MX) -> None:
        layout = phase.laid_out
        declared, self.count = layout.phase, layout.intervals
        self.tables: list[FloatArray] = []
        self.symbols: list[ca.MX] = []
        start, self.length = self.given(phase.t[:-1, None]), self.given(np.diff(phase.t)[:, None])
        self.values = [(p.symbol, self.given(p.value)) for p in declared.parameters]
        for v in declared.controls:
            table = phase.values[v.name]
            if v.shape == "constant":
                self.values.append((v.symbol, self.given(table)))
            elif v.rate is not None:
                begin, end = self.given(table[:-1]), self.given(table[1:])
                self.values.append((v.symbol, begin + s * (end - begin)))
                self.values.append((v.rate, (end - begin) / self.length))
            else:
                places = points_of(layout.kind, v)
                table = within_bounds(point_values(phase, v), places, v.lower, v.upper)
                flat = self.given(table.reshape(self.count, -1))
                weights = ca.vertcat(*lagrange(places, s))
                self.values.append((v.symbol, ca.reshape(flat, v.size, len(places)) @ weights))
        for v in declared.free_parameters:
            self.values.append((v.symbol, self.given(phase.values[v.name][:-1])))
        self.values.append((declared.time, start + s * self.length))
        self.values.append((declared.duration, self.given(np.array([phase.duration]))))

    def given(self, table: FloatArray) -> ca.MX:
        """Add data [N, size], or [size] for all intervals, and return their symbol."""
        self.tables.append(np.broadcast_to(table, (self.count, table.shape[-1])))
        self.symbols.append(ca.MX.sym("given", table.shape[-1]))
        return self.symbols[-1]


def _equation(solved: PhaseSolution, cost: bool, until: float = 1.0) -> _Equation:
    phase, share = solved.laid_out.phase, ca.MX.sym("s")
    inputs = _Inputs(solved, share * until)
    guesses = [inputs.given(point_values(solved, v)[:, 0]) for v in phase.algebraics]
    # Scaled states y = x / scale over the fraction s: dy/ds = until * length * f(x, z, u) / scale.
    x = ca.vertcat(*(v.symbol for v in phase.states))
    z = ca.vertcat(*(v.symbol for v in phase.algebraics), ca.MX(0, 1))
    slope = ca.vertcat(*(phase.derivatives[v.name] for v in phase.states))
    equations = ca.vertcat(*phase.algebraic_equations, ca.MX(0, 1))
    arguments = [x, z, *(symbol for symbol, _ in inputs.values)]
    running = sum(phase.running_costs, ca.MX(0)) if cost else ca.MX(0, 1)
    physics = as_scalars(ca.Function("physics", arguments, [slope, equations, running]))
    scale = ca.DM(np.concatenate([v.scale for v in phase.states]))
    y, inner = ca.MX.sym("y", x.shape[0]), ca.MX.sym("z", z.shape[0])
    values = [value for _, value in inputs.values]
    rate, residual, slope_of_cost = physics(y * scale, inner, *values)
    reach, data = until * inputs.length, ca.vertcat(*inputs.symbols)
    dae: dict[str, Any] = {"t": share, "x": y, "p": data, "ode": reach * rate / scale}
    if cost:
        dae["quad"] = reach * slope_of_cost
    if phase.algebraics:
        dae["z"], dae["alg"] = inner, residual
    return _Equation(dae, np.hstack(inputs.tables), ca.vertcat(*guesses, ca.MX(0, 1)), scale)


INTEGRATION_TOLERANCE = 1e-11  # absolute tolerance of the scaled states, and relative tolerance
MOST_STEPS = 20_000  # steps of the integrator in an interval


def _integrator(
    phase: PhaseSolution, method: str, until: float, cost: bool
) -> tuple[ca.Function, FloatArray]:
    """Return a function of an interval, and the data of every interval [N, ...].

    The function is ``(x at the start, data) -> (x at the end, running cost integral)``.
    """
    dae, data, guesses, scale = _equation(phase, cost, until)
    options: dict[str, Any] = {
        "abstol": INTEGRATION_TOLERANCE,
        "reltol": INTEGRATION_TOLERANCE,
        "max_num_steps": MOST_STEPS,
        "quad_err_con": True,  # the error of the running cost limits the step too
        "disable_internal_warnings": True,
        "show_eval_warnings": False,
    }
    if method == "adams":
        options["linear_multistep_method"] = "adams"
        options["nonlinear_solver_iteration"] = "functional"
    plugin = "idas" if method == "idas" else "cvodes"
    solver = ca.integrator("interval", plugin, dae, 0.0, 1.0, options)
    first = ca.MX.sym("x0", scale.shape[0])
    result = solver(x0=first / scale, p=dae["p"], z0=guesses)
    outputs = [result["xf"] * scale, result["qf"]]
    return ca.Function("of_interval", [first, dae["p"]], outputs), data


def _linearised(phase: PhaseSolution) -> tuple[ca.Function, FloatArray]:
    """Return the function ``(x at the midpoint, data) -> derivatives [n,n]``, and the data."""
    dae, data, guesses, scale = _equation(phase, cost=False)
    slopes, first = ca.jacobian(dae["ode"], dae["x"]), ca.MX.sym("x0", scale.shape[0])
    replaced, values = [dae["t"], dae["x"]], [ca.MX(0.5), first / scale]
    if "z" in dae:
        # Implicit differentiation: df/dx - df/dz (dg/dz)^-1 dg/dx for algebraic equations g(x, z) =
        # 0.
        inner = ca.solve(ca.jacobian(dae["alg"], dae["z"]), ca.jacobian(dae["alg"], dae["x"]))
        slopes = slopes - ca.jacobian(dae["ode"], dae["z"]) @ inner
        replaced, values = [*replaced, dae["z"]], [*values, guesses]
    (at,) = ca.graph_substitute([ca.densify(slopes)], replaced, values)
    at = ca.diag(scale) @ at @ ca.diag(1 / scale)
    return ca.Function("of_interval", [first, dae["p"]], [ca.vec(ca.densify(at))]), data


def resimulate(phase: PhaseSolution, intervals: Integrated) -> ResimulationCheck:
    """Return the check of a phase from its integrated intervals."""
    states = phase.laid_out.phase.states
    wanted, weights = mesh_states(phase)[1:], state_weights(phase)
    defects = np.nan_to_num((intervals.states - wanted) / weights, nan=np.inf)
    k, column = np.unravel_index(int(np.abs(defects).argmax()), defects.shape)
    owners = [(state, i) for state in states for i in range(state.size)]
    state, component = owners[int(column)]
    # The sum of the defects bounds the open-loop error of a system that does not amplify them.
    added = float(np.abs(defects).sum(axis=0).max())
    open_loop, amplification = np.inf, np.inf
    if np.isfinite(added):
        errors, amplification = carry(defects, transitions(phase))
        open_loop = float(np.abs(errors).max())
    return ResimulationCheck(
        phase=phase.name,
        status=Status.FAILED if intervals.failure else Status.SOLVED,
        failure=intervals.failure,
        error=min(added, open_loop),
        local_error=float(np.abs(defects).max()),
        open_loop_error=open_loop,
        amplification=amplification,
        state=state.name,
        component=component,
        time=float(phase.t[int(k) + 1]),
        value=float(intervals.states[k, column]),
        wanted=float(wanted[k, column]),
        unit=state.unit,
    )
