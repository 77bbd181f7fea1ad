"""The optimal-control problem of a free motion through via points, and its solution as a motion."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from math import factorial
from typing import Any

import casadi as ca
import numpy as np
from numpy.polynomial.polynomial import polyval

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.codegen import compile_recipe, compiles
from microbot_ocp.limits import LimitFamily, Member, MotionSamples
from microbot_ocp.motion import PiecewisePolynomial, State, quintic_between
from microbot_ocp.ocp import OptimalControlProblem, Phase, PhaseSolution, Solution, Transcription
from microbot_ocp.planning.task import (
    CHECKS_PER_INTERVAL,
    JERK_SMOOTHING,
    Bounds,
    Conditions,
    Task,
    TaskScale,
    declare_limits,
    derivatives_for,
    finite_scale,
    has_windows,
    torques_of,
    windowed_torques,
    without_dry_friction,
)
from microbot_ocp.robot import Robot

JERK_WEIGHT = "jerk weight"  # name of a phase parameter
CLOSED = 1e-5  # largest sum of gaps, share of the change of position or velocity
BUDGET = "budget"  # name of a phase parameter
OF_VARIABLES = ("q", "qd", "qdd")  # limits that are bounds of states and of the control


def accelerations_jump(family: LimitFamily) -> bool:
    """Return True if accelerations may jump from one limit to another.

    They cannot under limits that depend on the jerk. With dry friction the torques jump instead.
    """
    return not (has_windows(family) or family.jerk_matters)


def limited_rates(family: LimitFamily) -> set[str]:
    """Return the limited ones of jerks and torque rates: meshes are split at their switches."""
    return {"qddd", "taud"} & set(family.keys)


def phase_names(count: int) -> list[str]:
    """Return the names of the phases in order, one from each stop to the next."""
    return [f"phase {index + 1}" for index in range(count)]


@lru_cache(maxsize=16)
def transcription(
    robot: Robot,
    via_bytes: bytes,
    count: int,
    compiled: bool,
    *,
    payload: bool = False,
    budgeted: bool = False,
    conditions: Conditions | None = None,
) -> Transcription:
    """Return the kernels of a robot, with its own limits, and via points; cached."""
    via = np.frombuffer(via_bytes).reshape(count, -1)
    robots = conditions.robots if conditions else (robot,)
    compiled = compiles(compiled)
    # Among obstacles each stage is used in one scene only: compile the parts that scenes share.
    limits = [limit for limited in robots for limit in limited.limits.also]
    shared = compiled and any(limit.knows_derivatives for limit in limits)
    return Transcription(
        free_problem(robot, via, payload=payload, budgeted=budgeted, conditions=conditions),
        scheme="shooting",
        prepare=partial(compile_recipe, columns=True) if compiled and not shared else None,
        derivatives=derivatives_for(*robots, *map(without_dry_friction, robots), compiled=shared),
    )


def free_problem(
    robot: Robot,
    via: FloatArray,
    *,
    payload: bool = False,
    budgeted: bool = False,
    jumps: bool = False,
    conditions: Conditions | None = None,
) -> OptimalControlProblem:
    """Return the optimal-control problem of a robot, with its limits, through via points [m,n].

    Each segment between two via points is a phase of free duration, with the states q and qd and a
    continuous, piecewise linear acceleration as the control.

    ``payload`` adds the parameter "payload" to every phase: a mass at the tool, kg, initially zero.
    ``budgeted`` minimises the effort instead of the time. Its parameter "budget" of the last phase
    is the time allowed for all, s.
    ``jumps`` lets the acceleration jump, as in the fastest motion, without smoothing; under limits
    of the jerk or the torque rate the jerk jumps instead.
    ``conditions`` hold at the via points and select the robot of each segment; by default the arm
    is at rest at both ends and passes the other points at any velocity.
    """
    family = LimitFamily.of(robot)
    conditions = conditions or Task.through(family, via).conditions
    form = _Form(
        family,
        TaskScale.of(family, via, conditions.velocities),
        conditions,
        payload=payload,
        budgeted=budgeted,
        jumps=jumps,
    )
    problem = OptimalControlProblem(f"time-optimal motion of {robot.name}")
    for index, start in enumerate(via[:-1]):
        _declare_segment(problem, form, index, start)
    _link_segments(problem, form)
    return problem


@dataclass(frozen=True, eq=False)
class _Form:
    """Arguments of :func:`free_problem`, and common values of all segments."""

    family: LimitFamily
    size: TaskScale
    conditions: Conditions
    payload: bool
    budgeted: bool
    jumps: bool

    def place(self, index: int) -> tuple[bool, bool]:
        """Return two flags: the segment is the first one, and the last one."""
        return index == 0, index == len(self.conditions.ends) - 2

    @property
    def rated(self) -> bool:
        """True if the acceleration is a state, because the jerk or a torque rate is limited."""
        return self.family.jerk_matters

    @cached_property
    def scales(self) -> tuple[FloatArray, FloatArray]:
        """Scales [n] of velocities and accelerations."""
        limits: Any = self.family.robot.limits
        velocity = finite_scale(*limits.bounds("qd"), otherwise=self.size.velocity)
        return velocity, finite_scale(*limits.bounds("qdd"), otherwise=self.size.acceleration)

    @property
    def held(self) -> np.ndarray:
        """Mask [n] of joints that keep their initial position."""
        limits = self.family.robot.limits
        return (limits.qdd_min == 0.0) & (limits.qdd_max == 0.0)


def _declare_segment(
    problem: OptimalControlProblem, form: _Form, index: int, start: FloatArray
) -> None:
    """Declare the phase from a via point [n] to the next."""
    size, moving = form.size, form.conditions.robots[index]
    family = LimitFamily.of(moving)
    constraints = [key for key in family.keys if key not in OF_VARIABLES]
    torques_of_form = partial(torques_of, keys=constraints, payload=form.payload)
    torques = torques_of_form(moving)
    phase = problem.phase(
        phase_names(index + 1)[-1],
        duration=(size.shortest[index], size.longest[index]),
        scale=None if size.time == 1.0 else size.time,
    )
    state = _declare_state(phase, form, index)
    q, qd, qdd, jerk = state
    mass = [phase.parameter("payload", 0.0)] if form.payload else []
    torque_values = tau = None
    # If accelerations jump, mesh points are at the reversals, and friction needs no window.
    if has_windows(family) and not form.jumps:
        light = torques_of_form(without_dry_friction(moving))
        torque_values, tau = windowed_torques(phase, moving, state, light, mass)
    declare_limits(phase, family, constraints, state, start, torques, mass, torque_values)
    for member in family.means:
        _declare_mean(phase, form, index, member, state)
    at_start, at_end = form.conditions.ends[index : index + 2]
    for row in at_start.rows:
        phase.point_constraint(row.name, row.expression(q, qd), *row.bounds, at=0.0)
    for row in at_end.rows if form.place(index)[1] else ():
        phase.end_constraint(row.name, row.expression(q, qd), *row.bounds)
    if not form.budgeted:
        phase.end_cost(phase.duration)
    else:
        _declare_clock(phase, form, index)
        if tau is None and form.family.robot.has_dynamics:
            tau = torques(*state, *mass)[0]
        moved = qdd if tau is None else tau
        phase.running_cost(ca.sumsqr(moved / effort_scale(form.family, form.scales[1])))
    if not form.jumps:
        weight = phase.parameter(JERK_WEIGHT, JERK_SMOOTHING)
        phase.running_cost(weight * ca.sumsqr(jerk / size.jerk))


def _declare_state(phase: Phase, form: _Form, index: int) -> tuple[Any, Any, Any, Any]:
    """Declare position, velocity, acceleration and jerk of a phase, with its end conditions."""
    limits, held = form.family.robot.limits, form.held
    count, (first, last) = limits.q_min.size, form.place(index)
    at_start, at_end = form.conditions.ends[index : index + 2]

    def bounds(name: str, scale: float | FloatArray, unit: str) -> dict[str, Any]:
        lower, upper = limits.bounds(name)
        return {"lower": lower, "upper": upper, "scale": scale, "unit": unit}

    def at_ends(name: str) -> dict[str, Any]:
        start, end = getattr(at_start, name), getattr(at_end, name)
        initial = start if first else _unless(held, start)
        return {"initial": initial, "final": _unless(held, end) if last else None}

    # The first phase fixes the position of locked joints: a final condition would repeat it.
    position = bounds("q", form.size.position, "rad") | at_ends("q")
    velocity = bounds("qd", form.scales[0], "rad/s") | at_ends("qd")
    acceleration = bounds("qdd", form.scales[1], "rad/s^2")
    ends: dict[str, Any] = {
        "initial": None if at_start.qdd is None else _unless(held, at_start.qdd),
        "final": None if at_end.qdd is None else _unless(held, at_end.qdd),
    }
    q = phase.state("q", count, **position)
    inside = bool(np.isfinite(limits.qd_max).any())
    qd = phase.state("qd", count, **velocity, interior_points=inside)
    if not form.jumps:
        qdd = phase.control("qdd", count, **acceleration, **ends, shape="linear")
        jerk = phase.rate(qdd)
    elif form.rated:
        qdd = phase.state("qdd", count, **acceleration, **ends)
        jerk = phase.control("jerk", count, unit="rad/s^3", shape="polynomial")
        phase.derivative(qdd, jerk)
    else:
        qdd = phase.control("qdd", count, **acceleration, shape="polynomial")
        jerk = ca.MX.zeros(count)
    phase.derivative(q, qd)
    phase.derivative(qd, qdd)
    return q, qd, qdd, jerk


def _declare_clock(phase: Phase, form: _Form, index: int) -> None:
    """Declare the elapsed time as a state, and its bound at the end of the last phase."""
    size, (first, last) = form.size, form.place(index)
    clock = phase.state("clock", initial=0.0 if first else None, scale=size.time, unit="s")
    phase.derivative(clock, ca.MX(1.0))
    late = clock - phase.parameter(BUDGET, 1.0)  # the same expression in all phases shares kernels
    if last:
        phase.end_constraint("time allowed", late, upper=0.0, scale=size.time, unit="s")


def _declare_mean(
    phase: Phase, form: _Form, index: int, member: Member, state: tuple[Any, Any, Any, Any]
) -> None:
    """Declare the accumulated excess of a root mean square over its bound as a state, s.

    The state is the integral of (value / bound)^2 - 1; the bound holds if it is at most zero at the
    end.
    """
    limited, (first, last) = np.flatnonzero(member.limited).tolist(), form.place(index)

    def beyond(*at: Any) -> Any:
        value = form.family.expressions([member.key], at)[member.key][0]
        return (value[limited] / member.upper[limited]) ** 2 - 1.0

    time = form.size.time
    so_far = phase.state(
        f"{member.name} so far",
        len(limited),
        initial=np.zeros(len(limited)) if first else None,
        scale=time,
        unit="s",
    )
    phase.derivative(so_far, beyond(*state))
    if last:
        assert member.limit is not None
        still = ca.MX.zeros(form.family.robot.joint_count)
        rest = member.limit.dwell * beyond(state[0], still, still, still)
        phase.end_constraint(member.name, so_far + rest, upper=0.0, scale=time, unit="s")


def _link_segments(problem: OptimalControlProblem, form: _Form) -> None:
    """Connect the end of every phase to the start of the next, and close a cycle."""
    for index, (before, after) in enumerate(itertools.pairwise(problem.phases)):
        names = ["q", "qd", *(["clock"] if form.budgeted else [])]
        names += [f"{member.name} so far" for member in form.family.means]
        end = form.conditions.ends[index + 1]
        # An acceleration that is given, or that may jump, is not linked.
        apart = end.qdd is not None or end.acceleration_jumps or (form.jumps and not form.rated)
        problem.link(before, after, names=[*names, *([] if apart else ["qdd"])])
    for name in form.conditions.closed:
        begun, ended = (
            next(v.symbol for v in (*phase.states, *phase.controls) if v.name == name)
            for phase in (problem.phases[0], problem.phases[-1])
        )
        back = ended - problem.phases[0].initial(begun)
        problem.phases[-1].end_constraint(f"{name} of the cycle", back, 0.0, 0.0)


def effort_scale(family: LimitFamily, acceleration: FloatArray) -> FloatArray:
    """Return the scales of torques [n], or of accelerations without masses, in the effort.

    The scales are the torque limits, so that the effort is proportional to the heat losses of
    motors of equal quality; a joint without a limit has the largest one.
    """
    if not family.robot.has_dynamics:
        return acceleration
    size = finite_scale(*family.robot.limits.bounds("tau"), otherwise=np.nan)
    return np.nan_to_num(size, nan=1.0 if np.isnan(size).all() else np.nanmax(size))


def _unless(held: np.ndarray, bounds: Bounds) -> Bounds | None:
    """Return a condition [n] without joints that are held; None if nothing is left."""
    lower, upper = np.where(held, -np.inf, bounds[0]), np.where(held, np.inf, bounds[1])
    return (lower, upper) if np.isfinite([lower, upper]).any() else None


def excess_between(family: LimitFamily, solution: Solution) -> list[FloatArray]:
    """Return the largest relative excess of any limit in every interval, [N,K] for each phase."""
    excess = excess_along(family, polynomial(solution))
    return np.split(excess, np.cumsum([p.mesh.size - 1 for p in solution.phases])[:-1])


def excess_along(family: LimitFamily, shape: PiecewisePolynomial) -> FloatArray:
    """Return the largest relative excess of any limit at K places of every piece, [N,K].

    Both ends of the piece are places, with its own jerk.
    """
    shares = np.linspace(0.0, 1.0, CHECKS_PER_INTERVAL + 1)
    after, samples = (shares * np.diff(shape.breaks)[:, None])[..., None], []
    for _ in MotionSamples._fields:
        table = shape.coefficients.swapaxes(0, 1)[:, :, None]  # [degree+1,N,1,n]
        samples.append(polyval(after, table, tensor=False).reshape(-1, table.shape[-1]))
        shape = shape.derivative()
    return family.excess(MotionSamples(*samples)).reshape(-1, shares.size)


def via_times(solution: Solution) -> FloatArray:
    """Return the times [m] at the via points, s."""
    return np.concatenate([[0.0], np.cumsum([phase.duration for phase in solution.phases])])


def polynomial(solution: Solution) -> PiecewisePolynomial:
    """Return the motion between the mesh points, with all phases one after another."""
    return joined(phase_shapes(solution))


def joined(shapes: Sequence[PiecewisePolynomial]) -> PiecewisePolynomial:
    """Return motions one after another, each of which begins at time 0."""
    breaks, start = [np.zeros(1)], 0.0
    for shape in shapes:
        breaks.append(start + shape.breaks[1:])
        start += shape.duration
    return PiecewisePolynomial(
        np.concatenate(breaks), np.concatenate([shape.coefficients for shape in shapes])
    )


def phase_shapes(solution: Solution) -> list[PiecewisePolynomial]:
    """Return the motion of every phase, from time 0 each, as cubics of the linear acceleration.

    One quintic spreads the solver's gaps between intervals over the whole phase: a gap of 1e-8,
    divided by the third power of a short interval, would be a large jerk. If the gaps are large,
    every interval gets the quintic that matches q, qd and qdd at both ends instead.
    """
    return [PiecewisePolynomial(phase.t, _integrated(phase)) for phase in solution.phases]


def _integrated(phase: PhaseSolution) -> FloatArray:
    """Return coefficients [N,6,n] of the intervals of a phase."""
    q, qd, qdd, t = phase["q"], phase["qd"], phase["qdd"], phase.t
    h = np.diff(t)[:, None]
    jerk = np.diff(qdd, axis=0) / h
    velocity = qd[0] + _summed(h * (qdd[:-1] + 0.5 * h * jerk))
    steps = h * (velocity[:-1] + h * (0.5 * qdd[:-1] + h * jerk / 6.0))
    position = q[0] + _summed(steps)
    apart = [np.abs(integral - at) for integral, at in ((position, q), (velocity, qd))]
    sizes = [np.ptp(at, axis=0).max() for at in (q, qd)]
    if any(gap.max() > CLOSED * size for gap, size in zip(apart, sizes, strict=True)):
        return quintic_between(
            State(q[:-1], qd[:-1], qdd[:-1]), State(q[1:], qd[1:], qdd[1:]), h[:, 0]
        )
    still = np.zeros((1, q.shape[1]))
    # The quintic starts at zero and ends with the gaps that integration leaves.
    left = State((q[-1:] - position[-1:]), qd[-1:] - velocity[-1:], still)
    spread = PiecewisePolynomial(
        t[[0, -1]], quintic_between(State(still, still, still), left, t[-1:])
    )
    pieces = np.zeros((t.size - 1, 6, q.shape[1]))
    pieces[:, :4] = np.stack([position[:-1], velocity[:-1], 0.5 * qdd[:-1], jerk / 6.0], axis=1)
    for order in range(6):  # Taylor expansion of the quintic at the start of each interval
        pieces[:, order] += spread(t[:-1]) / factorial(order)
        spread = spread.derivative()
    return pieces


def _summed(steps: FloatArray) -> FloatArray:
    """Return cumulated sums [N+1,n] of steps [N,n], from zero."""
    return np.vstack([np.zeros_like(steps[:1]), np.cumsum(steps, axis=0)])
