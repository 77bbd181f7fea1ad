"""The arm in motion: open loop from torques, closed loop under a controller.

Every simulation is one call of one integrator on the whole grid; see :mod:`microbot_ocp.driven`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp import checks
from microbot_ocp.checks import FloatArray, InputError
from microbot_ocp.control import (
    Controller,
    Reference,
    SensorNoise,
    saturate,
    torque_limits,
)
from microbot_ocp.driven import (
    FIT,
    INTEGRATORS,
    Driven,
    Method,
    Run,
    Signal,
    Values,
    fitted,
    formula_signal,
    integrate,
    plugin,
    settled,
)
from microbot_ocp.dynamics import forward_dynamics, mass_matrix_condition
from microbot_ocp.motion import JUMP_GAP, SAMPLE_STEP, Motion, PiecewisePolynomial, State
from microbot_ocp.robot import JointLimits, Limits, Robot

Integrator = Literal["cvodes", "idas", "collocation", "rk"]
Formula = Callable[[Any], Any]  # of the CasADi time, to n expressions
Saturation = bool | ArrayLike | tuple[ArrayLike, ArrayLike] | Limits | JointLimits

# Of a sampled motion's position, velocity, acceleration: rounding of samples 1 ms apart allows no
# more.
SAMPLED_FIT = np.array([1e-11, 1e-10, 1e-8])
NEAR_SINGULAR = 1e6  # condition number of the mass matrix from which on the result says so
OPEN_LOOP = "the torques drive the arm out of all bounds: give others, or simulate a shorter time"
CLOSED_LOOP = "the loop is unstable: raise sample_rate, or lower the gains"
FINEST = 100  # fixed steps that a sample may take in any case
UNBOUNDED = 1e4  # rad and rad/s: no arm goes there
SINGULAR = 1e12  # and from which on torques determine no acceleration
ARMATURE = "give the links armature (rotor inertia), such as mo.Link(..., armature=0.1)"


@dataclass(frozen=True, eq=False)
class Simulation:
    """What an arm did under given torques.

    Attributes
    ----------
    t : array [N]
        Times, s.
    q, qd, qdd, tau : array [N,n]
        Positions, rad (m), velocities, accelerations and the torques that drove them, N m (N).
        NaN where the integrator did not arrive.
    status : str
        "ok", or in words what is wrong.
    integrator : str
    tolerance : float
    steps : int
        Steps taken by a fixed-step integrator, 0 for the others.
    condition_peak, condition_time : float
        Largest condition number of the mass matrix among the samples, and when, s.
    advice : str
        What to do about it, empty where nothing is wrong.
    wall_time : float
        s.
    """

    t: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    tau: FloatArray
    status: str
    integrator: str
    tolerance: float
    steps: int
    condition_peak: float
    condition_time: float
    advice: str
    wall_time: float

    @property
    def ok(self) -> bool:
        """Whether the integrator arrived, within its tolerance."""
        return self.status == "ok"

    def as_motion(self, label: str) -> Motion:
        """The same as a motion from time 0.

        Raises
        ------
        InputError
            The integrator did not arrive.
        """
        return Motion(self.t - self.t[0], self.q, self.qd, self.qdd, self.tau, label)


@dataclass(frozen=True, eq=False)
class Tracking(Simulation):
    """What an arm did under a controller, and how far from its reference.

    Attributes
    ----------
    t, q, qd, qdd, tau, status, ...
        As in :class:`Simulation`; ``tau`` is what the drives gave, within their limits, without
        the disturbance. Under sampled control it is held between the samples.
    reference : State
        Wanted positions, velocities and accelerations [N,n].
    label : str
        Name of the controller.
    sample_rate : float or None
        Hz; None for continuous control.
    saturated_fraction : float
        Share of the time in which at least one torque is at its limit.
    """

    reference: State = field(default_factory=lambda: State(*(np.zeros((0, 0)),) * 3))
    label: str = ""
    sample_rate: float | None = None
    saturated_fraction: float = 0.0

    @property
    def error(self) -> FloatArray:
        """Reference less position [N,n], rad (m)."""
        return self.reference.q - self.q

    @property
    def rms(self) -> FloatArray:
        """Root mean square over the time of the error of every joint [n], rad (m)."""
        return self.rms_after(self.t[0])

    @property
    def peak(self) -> FloatArray:
        """Largest error of every joint [n], rad (m)."""
        return np.abs(self.error).max(axis=0)

    def rms_after(self, start: float) -> FloatArray:
        """Root mean square of the error [n] from the time ``start``, s, to the end."""
        late = self.t >= checks.number("start", start, "s", at_most=float(self.t[-2]))
        t, square = self.t[late], self.error[late] ** 2
        mean = (0.5 * (square[:-1] + square[1:]) * np.diff(t)[:, None]).sum(axis=0)
        return np.sqrt(mean / (t[-1] - t[0]))

    def peak_after(self, start: float) -> FloatArray:
        """Largest error [n] from the time ``start``, s, to the end."""
        late = self.t >= checks.number("start", start, "s", at_most=float(self.t[-2]))
        return np.abs(self.error[late]).max(axis=0)


def simulate(
    robot: Robot,
    tau: Motion | ArrayLike | Formula | None = None,
    q0: ArrayLike | None = None,
    qd0: ArrayLike | None = None,
    t: ArrayLike | None = None,
    *,
    integrator: Integrator = "cvodes",
    tolerance: float = 1e-10,
    max_steps: int = 20_000,
) -> Simulation:
    """Simulate an arm from given torques: ``M(q) qdd = tau - C(q, qd) qd - g(q) - friction``.

    Craig, *Introduction to Robotics*, 3rd ed., section 6.9, with a solver that knows its error.

    Parameters
    ----------
    robot : Robot
        A robot with masses.
    tau : Motion, callable, array_like [N,n] or [n], optional
        Torques, N m (N): the stored ones of a motion (they may jump at its breaks), a function of
        the CasADi time that returns n expressions, values on the grid ``t`` (linear between), or
        constants; default none.
    q0 : array_like [n]
        Start, rad (m); default that of the motion.
    qd0 : array_like [n], optional
        Velocities there, rad/s (m/s); default those of the motion, else zero.
    t : array_like [N]
        Strictly increasing times of the result, s, the first being that of the start; default those
        of the motion.
    integrator : "cvodes", "idas", "collocation" or "rk"
        Adams' method with error control; backward differences with error control; Radau collocation
        of degree 3 or the classical Runge-Kutta method with a fixed step, halved until two
        solutions agree within the tolerance.
    tolerance : float
        Absolute and relative tolerance.
    max_steps : int
        Most steps: from one time of the grid to the next, of a fixed step in all.

    Returns
    -------
    Simulation
        A failure is told in its status and advice.

    Raises
    ------
    InputError
        Wrong shapes, times that do not increase, a start outside the limits or where the mass
        matrix is singular.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> hold = mo.gravity_torque(robot)([0.0, 0.5, 0.5]).full().ravel()
    >>> still = simulate(robot, hold, q0=[0.0, 0.5, 0.5], t=[0.0, 1.0])
    >>> still.status, still.q[-1].round(6).tolist()
    ('ok', [0.0, 0.5, 0.5])
    """
    started = time.perf_counter()
    count = robot.joint_count
    method = _checked_method(integrator, tolerance, max_steps)
    if isinstance(tau, Motion):
        _same_joints("motion", tau.joint_count, robot)
        q0, qd0 = tau.q[0] if q0 is None else q0, tau.qd[0] if qd0 is None else qd0
        t = tau.t if t is None else t
    if t is None or q0 is None:
        raise InputError("t and q0 must be given unless tau is a Motion")
    grid = _checked_times(t)
    start = _checked_start(robot, q0, qd0)
    signal = _torque_signal(tau, grid, count)

    def rate(_: ca.SX, x: ca.SX, w: ca.SX) -> ca.SX:
        return ca.vertcat(x[count:], forward_dynamics(robot)(x[:count], x[count:], w))

    driven = Driven(rate, 2 * count, signal)
    run = integrate(driven, start, grid, method)
    return Simulation(**_told(robot, grid, run, signal.values(grid), None, method, started))


def track(
    robot: Robot,
    motion: Motion | PiecewisePolynomial | Formula,
    controller: Controller,
    *,
    plant: Robot | None = None,
    q0: ArrayLike | None = None,
    qd0: ArrayLike | None = None,
    duration: float | None = None,
    step: float = SAMPLE_STEP,
    saturation: Saturation = True,
    sample_rate: float | None = None,
    noise: SensorNoise | None = None,
    disturbance: ArrayLike | Formula | None = None,
    integrator: Integrator | None = None,
    tolerance: float = 1e-10,
    max_steps: int = 20_000,
) -> Tracking:
    """Let a controller that knows ``robot`` drive the arm ``plant`` along a motion.

    Under continuous control the closed loop is one differential equation. Under sampled control
    the torque is computed from the (noisy) measurement at every sample and held until the next:
    one accumulated map over the samples, each an integration of the arm alone.

    Parameters
    ----------
    robot : Robot
        The model inside the controller.
    motion : Motion, PiecewisePolynomial or callable
        The reference; a callable takes the CasADi time from 0 and returns n expressions for the
        positions, whose derivatives are exact.
    controller : Controller
        :class:`ComputedTorque`, :class:`PDGravity`, :class:`Feedforward` or one of your own.
    plant : Robot, optional
        The arm that is driven: other masses, friction, payload; default ``robot``.
    q0, qd0 : array_like [n], optional
        Start of the arm, rad (m) and rad/s (m/s); default on the reference.
    duration : float, optional
        s; default that of the motion. Needed for a callable.
    step : float
        Longest step between the samples of the result, s.
    saturation : bool, float, array_like [n], (lower, upper) or Limits
        Torque limits, N m (N): True for those of the plant, False for none.
    sample_rate : float, optional
        Samples a second of the controller, Hz; default continuous control.
    noise : SensorNoise, optional
        Of sampled control only.
    disturbance : array_like [n] or callable, optional
        Torques that act on the joints besides those of the drives, N m (N): constants, or a
        function of the CasADi time.
    integrator : "cvodes", "idas", "collocation" or "rk"
        See :func:`simulate`; default "cvodes", under sampled control "rk".
    tolerance, max_steps
        See :func:`simulate`; under sampled control a fixed step may take 100 steps a sample in any
        case.

    Returns
    -------
    Tracking

    Raises
    ------
    InputError
        Bad shapes, numbers or robots that do not fit together, noise without samples.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> shape = mo.quintic([[0.0, 0.0, 0.0], [0.5, 0.8, 0.4]], [0.0, 3.0])
    >>> run = track(robot, shape, mo.ComputedTorque(kp=100.0), q0=[0.1, 0.0, 0.0])
    >>> run.status, bool(run.peak_after(2.0).max() < 1e-6)
    ('ok', True)
    """
    started = time.perf_counter()
    arm = robot if plant is None else plant
    count = robot.joint_count
    _same_joints("plant", arm.joint_count, robot)
    chosen = ("cvodes" if sample_rate is None else "rk") if integrator is None else integrator
    method = _checked_method(chosen, tolerance, max_steps)
    begin, end, signal = _reference_signal(motion, duration, robot)
    first = signal.values(np.array([begin]))[0]
    start = _checked_start(
        arm, first[:count] if q0 is None else q0, first[count : 2 * count] if qd0 is None else qd0
    )
    step = checks.number("step", step, "s", above=0.0)
    lower, upper = torque_limits(saturation, arm)
    push = _disturbance(disturbance, count)
    dynamics = forward_dynamics(arm)

    def torque(w: ca.SX, q: ca.SX, qd: ca.SX) -> ca.SX:
        reference = Reference(w[:count], w[count : 2 * count], w[2 * count :])
        wanted = controller.torque(robot, reference, q, qd)
        if wanted.shape != (count, 1):
            raise InputError(f"controller must return {count} torques, not shape {wanted.shape}")
        return saturate(wanted, lower, upper)

    def rate(t: ca.SX, x: ca.SX, w: ca.SX) -> ca.SX:
        q, qd = x[:count], x[count:]
        return ca.vertcat(qd, dynamics(q, qd, torque(w, q, qd) + push(t)))

    driven = Driven(rate, 2 * count, signal)
    if sample_rate is None:
        if noise is not None:
            raise InputError("noise needs a sample_rate: a continuous loop does not sample")
        grid = np.linspace(begin, end, max(1, int(np.ceil((end - begin) / step - 1e-9))) + 1)
        run = integrate(driven, start, grid, method)
        law = _law(torque, count)
        columns = (signal.values(grid).T, run.states[:, :count].T, run.states[:, count:].T)
        tau = np.array(law.map(grid.size)(*columns)).T
    else:
        sample_rate = checks.number("sample_rate", sample_rate, "Hz", above=0.0)
        samples = _Samples.of(begin, end, sample_rate, step)
        errors = (SensorNoise() if noise is None else noise).draw(samples.t.size, count)
        loop = _SampledLoop(arm, _law(torque, count), push, signal, errors)
        grid, run, tau = loop.run(samples, start, method)
    wanted = signal.values(grid)
    told = _told(arm, grid, run, tau, push, method, started)
    at_limit: Any = np.any((tau <= lower) | (tau >= upper), axis=1)
    span = np.diff(grid)
    return Tracking(
        **told,
        reference=State(*np.split(wanted, 3, axis=1)),
        label=controller.label,
        sample_rate=sample_rate,
        saturated_fraction=float((span * at_limit[:-1]).sum() / span.sum()),
    )


def motion_from_formula(
    robot: Robot, formula: Formula, duration: float, *, label: str, step: float = SAMPLE_STEP
) -> Motion:
    """Motion whose positions are a function of the CasADi time, with exact derivatives.

    Parameters
    ----------
    robot : Robot
        A robot with masses, for the torques.
    formula : callable
        Takes the CasADi time, s, and returns n expressions, rad (m), smooth in between.
    duration : float
        s.
    label : str
    step : float
        Longest step between the samples, s.

    Returns
    -------
    Motion

    Examples
    --------
    >>> import casadi as ca
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> wave = motion_from_formula(robot, lambda t: [ca.sin(t), 0.2 * t, 0.0], 2.0, label="wave")
    >>> wave.qd[0].tolist()
    [1.0, 0.2, 0.0]
    """
    duration = checks.number("duration", duration, "s", above=0.0)
    step = checks.number("step", step, "s", above=0.0)
    count = robot.joint_count
    _, _, signal = _reference_signal(formula, duration, robot)
    t = np.linspace(0.0, duration, max(1, int(np.ceil(duration / step - 1e-9))) + 1)
    q, qd, qdd = np.split(signal.values(t), [count, 2 * count], axis=1)
    return Motion.from_state(
        robot,
        t,
        State(q, qd, qdd),
        label=label,
        breaks=[0.0, duration],
        provenance={"method": "formula"},
    )


def mesh_of(motion: Motion) -> FloatArray:
    """Breaks of a motion with both ends; the gap that stands for a jump is not an interval."""
    breaks = motion.t if motion.breaks is None else motion.breaks
    inner = breaks[(breaks > 0.0) & (breaks < motion.duration)]
    mesh = np.concatenate([[0.0], inner, [motion.duration]])
    return mesh[np.append(np.diff(mesh) > 2 * JUMP_GAP, True)]


def _symbolic(name: str, formula: Formula, count: int) -> tuple[ca.SX, ca.SX]:
    """The time and the n expressions that a user's function makes of it."""
    t = ca.SX.sym("t")
    value = formula(t)
    try:
        if isinstance(value, list | tuple | np.ndarray):
            value = ca.vertcat(*value)
        expression = ca.SX(value)
    except (NotImplementedError, TypeError) as problem:
        raise InputError(f"{name} must return {count} CasADi expressions: {problem}") from None
    if expression.shape != (count, 1):
        raise InputError(f"{name} must return {count} expressions, not shape {expression.shape}")
    return t, expression


def _torque_signal(
    tau: Motion | ArrayLike | Formula | None, grid: FloatArray, count: int
) -> Signal:
    if isinstance(tau, Motion):
        slack = 1e-9 * max(1.0, tau.duration)
        if grid[0] < -slack or grid[-1] > tau.duration + slack:
            raise InputError(
                f"t must be within the motion, 0 to {tau.duration:g} s, not "
                f"{grid[0]:g} to {grid[-1]:g} s"
            )
        breaks = mesh_of(tau)
        inner = breaks[(breaks > grid[0]) & (breaks < grid[-1])]
        edges = np.concatenate([grid[:1], inner, grid[-1:]])
        return fitted(_stored_torque(tau), edges, FIT * np.abs(tau.tau).max())
    if callable(tau):
        t, expression = _symbolic("tau", tau, count)
        return formula_signal(expression, t)
    given = np.zeros(count) if tau is None else tau
    if np.ndim(np.asarray(given, dtype=object)) == 1:
        constant = checks.array("tau", given, (count,), "N m")
        t = ca.SX.sym("t")
        return formula_signal(ca.SX(ca.DM(constant)), t)
    table = checks.array("tau", given, (grid.size, count), "N m")

    def values(times: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(times, grid, column) for column in table.T])

    return fitted(values, grid, FIT * np.abs(table).max())


def _stored_torque(motion: Motion) -> Values:
    """The stored torques between samples: quintics through the nearest six that no break parts."""
    first = np.searchsorted(motion.t, mesh_of(motion) - 1e-9)  # sample of every break
    gap = np.append(np.diff(motion.t) <= 2 * JUMP_GAP, False)

    def values(times: FloatArray) -> FloatArray:
        i = np.clip(np.searchsorted(motion.t, times, side="right") - 1, 0, motion.t.size - 2)
        piece = np.clip(np.searchsorted(first, i, side="right") - 1, 0, first.size - 2)
        low, high = first[piece], first[piece + 1]
        high = high - gap[high - 1]  # the later side of a jump belongs to the piece that follows
        widths = np.minimum(6, high - low + 1)
        answer = np.zeros((times.size, motion.joint_count))
        for width in np.unique(widths):
            own = np.flatnonzero(widths == width)
            leftmost = np.clip(i[own] - width // 2 + 1, low[own], high[own] - width + 1)
            stencil = leftmost[:, None] + np.arange(width)
            weights = _lagrange(times[own], motion.t[stencil])
            answer[own] = (weights[:, :, None] * motion.tau[stencil]).sum(axis=1)
        return answer

    return values


def _lagrange(t: FloatArray, nodes: FloatArray) -> FloatArray:
    """Weights [N,k] of values at nodes [N,k] in the polynomial through them, at times t [N]."""
    weights = np.ones_like(nodes)
    for k in range(nodes.shape[1]):
        for other in range(nodes.shape[1]):
            if other != k:
                weights[:, k] *= (t - nodes[:, other]) / (nodes[:, k] - nodes[:, other])
    return weights


def _reference_signal(
    motion: Motion | PiecewisePolynomial | Formula, duration: float | None, robot: Robot
) -> tuple[float, float, Signal]:
    """Start and end, s, and the signal of position, velocity and acceleration [3n]."""
    count = robot.joint_count
    if isinstance(motion, Motion):
        _same_joints("motion", motion.joint_count, robot)
        begin, longest, breaks = 0.0, motion.duration, mesh_of(motion)
        values, fit = (lambda times: np.hstack(motion.sample(times))), SAMPLED_FIT
    elif isinstance(motion, PiecewisePolynomial):
        _same_joints("motion", motion.coefficients.shape[2], robot)
        begin, longest, breaks = float(motion.breaks[0]), motion.duration, motion.breaks
        parts = (motion, motion.derivative(), motion.derivative().derivative())
        values, fit = (lambda times: np.hstack([part(times) for part in parts])), np.full(3, FIT)
    elif callable(motion):
        if duration is None:
            raise InputError("duration must be given where the motion is a function of the time")
        t, q = _symbolic("motion", motion, count)
        qd = ca.jacobian(q, t)
        qdd = ca.jacobian(qd, t)
        end = checks.number("duration", duration, "s", above=0.0)
        return 0.0, end, formula_signal(ca.vertcat(q, qd, qdd), t)
    else:
        raise InputError(
            f"motion must be a Motion, a PiecewisePolynomial or a function of the time, not "
            f"{motion!r}"
        )
    if duration is None:
        duration = longest
    duration = checks.number("duration", duration, "s", above=0.0, at_most=longest * (1 + 1e-9))
    end = begin + min(duration, longest)
    edges = np.append(breaks[breaks < end * (1 - 1e-12)], end)
    inside = edges[:-1, None] + np.diff(edges)[:, None] * np.arange(8) / 8.0
    scale = np.abs(values(inside.ravel())).reshape(-1, 3, count).max(axis=(0, 2))
    return begin, end, fitted(values, edges, np.repeat(fit * scale, count))


def _disturbance(given: ArrayLike | Formula | None, count: int) -> ca.Function:
    """CasADi function ``(t) -> [n]`` of what else acts on the joints."""
    if callable(given):
        t, expression = _symbolic("disturbance", given, count)
    else:
        constant = np.zeros(count) if given is None else given
        expression = ca.SX(ca.DM(checks.array("disturbance", constant, (count,), "N m")))
        t = ca.SX.sym("t")
    return ca.Function("disturbance", [t], [ca.densify(expression)])


def _law(torque: Callable[[ca.SX, ca.SX, ca.SX], ca.SX], count: int) -> ca.Function:
    """The controller as a function of reference [3n], position [n] and velocity [n]."""
    w, q, qd = ca.SX.sym("w", 3 * count), ca.SX.sym("q", count), ca.SX.sym("qd", count)
    return ca.Function("law", [w, q, qd], [ca.densify(torque(w, q, qd))])


class _Samples(NamedTuple):
    """When a sampled controller acts, and the places in between that the result shows."""

    t: FloatArray  # [K]
    within: FloatArray  # [M], s after a sample, the last one being the period
    end: float

    @classmethod
    def of(cls, begin: float, end: float, rate: float, step: float) -> _Samples:
        count = max(1, int(np.ceil((end - begin) * rate - 1e-9)))
        inner = max(1, int(np.ceil(1.0 / (rate * step) - 1e-9)))
        within = np.arange(1, inner + 1) / (inner * rate)
        return cls(begin + np.arange(count) / rate, within, end)


class _SampledLoop(NamedTuple):
    """A controller that measures now and then, and the arm it drives in between."""

    arm: Robot
    law: ca.Function  # reference, measured position and velocity to torque
    push: ca.Function  # time to disturbance
    signal: Signal
    errors: FloatArray  # of the measurements [K, 2n]

    def run(
        self, samples: _Samples, start: FloatArray, method: Method
    ) -> tuple[FloatArray, Run, FloatArray]:
        """Times [N], states and held torques [N,n].

        One step of the accumulated map measures, computes the torque and integrates the arm with
        it until the next sample.
        """
        count, inner = self.arm.joint_count, samples.within.size
        given = (samples.t[None, :], self.signal.values(samples.t).T, self.errors.T)
        held: list[FloatArray] = []

        def states(steps: int) -> FloatArray:
            function = self._period(samples, plugin(method, steps, samples.within[-1])).mapaccum(
                samples.t.size
            )
            _, everything, torques = function(start, *given)
            held[:] = [np.array(torques).T]
            return np.vstack([start, np.array(everything).T.reshape(-1, 2 * count)])

        each = method._replace(max_steps=max(method.max_steps // samples.t.size, FINEST))
        run = settled(states, each, max(inner, int(np.ceil(samples.within[-1] / SAMPLE_STEP))))
        grid = np.append(samples.t[0], (samples.t[:, None] + samples.within).ravel())
        tau = np.full((grid.size, count), np.nan)
        if held:
            tau = np.vstack([np.repeat(held[0], inner, axis=0), held[0][-1:]])
        if not run.states.size:  # the integrator of one sample stopped all; nothing shows where
            run = run._replace(states=np.full((grid.size, 2 * count), np.nan))
        keep = grid <= samples.end + 1e-9 * samples.within[-1]
        run = run._replace(states=run.states[keep])
        return np.minimum(grid[keep], samples.end), run, tau[keep]

    def _period(self, samples: _Samples, chosen: tuple[str, dict[str, Any]]) -> ca.Function:
        """State, moment, reference and error to: next state, all states on the way, torque."""
        count, inner = self.arm.joint_count, samples.within.size
        t, x, u = ca.SX.sym("t"), ca.SX.sym("x", 2 * count), ca.SX.sym("u", count + 1)
        tau = u[:count] + self.push(u[count] + t)
        qdd = forward_dynamics(self.arm)(x[:count], x[count:], tau)
        equation = {"t": t, "x": x, "u": u, "ode": ca.vertcat(x[count:], qdd)}
        name, options = chosen
        drift = ca.integrator("drift", name, equation, 0.0, samples.within.tolist(), options)
        now, moment = ca.MX.sym("now", 2 * count), ca.MX.sym("moment")
        wanted, error = ca.MX.sym("wanted", 3 * count), ca.MX.sym("error", 2 * count)
        seen = now + error
        held = self.law(wanted, seen[:count], seen[count:])
        after = drift(x0=now, u=ca.repmat(ca.vertcat(held, moment), 1, inner))["xf"]
        outputs = [after[:, -1], ca.vec(after), held]
        return ca.Function("period", [now, moment, wanted, error], outputs)


def _told(
    robot: Robot,
    grid: FloatArray,
    run: Run,
    tau: FloatArray,
    push: ca.Function | None,
    method: Method,
    started: float,
) -> dict[str, Any]:
    """What a result says of a run, with its accelerations and the conditioning on the way."""
    count = robot.joint_count
    states = run.states
    times, trace = (grid, states) if run.trace is None else run.trace
    if not np.isfinite(states).all():
        states = np.full_like(states, np.nan)
    q, qd = states[:, :count], states[:, count:]
    outer = 0.0 if push is None else np.array(push.map(grid.size)(grid[None, :])).T
    qdd = np.array(forward_dynamics(robot).map(grid.size)(q.T, qd.T, (tau + outer).T)).T
    conditioning = mass_matrix_condition(robot).map(times.size)
    condition = np.array(conditioning(trace[:, :count].T)).ravel()
    condition[~np.isfinite(trace).all(axis=1)] = 0.0
    worst = int(condition.argmax())
    status, moment = run.status, _unbounded(times, trace)
    # Before it left all bounds nothing was singular, so the controller did it.
    unbounded = moment is not None and condition[times < moment].max(initial=0.0) < NEAR_SINGULAR
    if moment is not None and status != "ok":
        status = f"the motion grows without bound from {moment:.3g} s on"
    elif status == "ok" and condition[worst] > SINGULAR:
        status = f"mass matrix singular at {times[worst]:.4g} s: no torque determines the motion"
    return {
        "t": grid,
        "q": q,
        "qd": qd,
        "qdd": qdd,
        "tau": tau,
        "status": status,
        "integrator": method.integrator,
        "tolerance": method.tolerance,
        "steps": run.steps,
        "condition_peak": float(condition[worst]),
        "condition_time": float(times[worst]),
        "advice": _advice(
            status, unbounded, push, float(condition[worst]), times[worst], trace[worst, :count]
        ),
        "wall_time": time.perf_counter() - started,
    }


def _unbounded(times: FloatArray, trace: FloatArray) -> float | None:
    """When the state first leaves all bounds, s; None where it never does or nothing is known."""
    if not np.isfinite(trace[0]).all():
        return None
    with np.errstate(invalid="ignore"):
        gone = ~(np.abs(trace).max(axis=1) < UNBOUNDED)
    return float(times[gone.argmax()]) if gone.any() else None


def _advice(
    status: str,
    unbounded: bool,
    push: ca.Function | None,
    condition: float,
    moment: float,
    q: FloatArray,
) -> str:
    if unbounded:
        return OPEN_LOOP if push is None else CLOSED_LOOP
    if condition > NEAR_SINGULAR:
        return (
            f"mass matrix near singular at {moment:.4g} s (condition number {condition:.2g} at q = "
            f"{np.round(q, 4).tolist()}): {ARMATURE}"
        )
    if status != "ok":
        return "ask for a coarser tolerance, or for more steps by max_steps"
    return ""


def _checked_method(integrator: str, tolerance: float, max_steps: int) -> Method:
    checks.one_of("integrator", integrator, INTEGRATORS)
    tolerance = checks.number("tolerance", tolerance, above=0.0, at_most=1e-2)
    if isinstance(max_steps, bool) or not isinstance(max_steps, int) or max_steps < 1:
        raise InputError(f"max_steps must be a whole number of at least 1, not {max_steps!r}")
    return Method(integrator, tolerance, max_steps)


def _checked_times(t: ArrayLike) -> FloatArray:
    grid = checks.array("t", t, (None,), "s")
    if grid.size < 2:
        raise InputError("t must hold at least two times, s")
    stuck = np.flatnonzero(np.diff(grid) <= 0)
    if stuck.size:
        i = int(stuck[0])
        raise InputError(
            f"t must be strictly increasing, but t[{i + 1}] is {grid[i + 1]:g} s after t[{i}] of "
            f"{grid[i]:g} s"
        )
    return grid


def _checked_start(robot: Robot, q0: ArrayLike, qd0: ArrayLike | None) -> FloatArray:
    count = robot.joint_count
    q = checks.array("q0", q0, (count,), "rad")
    qd = np.zeros(count) if qd0 is None else checks.array("qd0", qd0, (count,), "rad/s")
    low, high = robot.limits.bounds("q")
    outside = np.flatnonzero((q < low - 1e-9) | (q > high + 1e-9))
    if outside.size:
        j = int(outside[0])
        raise InputError(
            f"q0 of {robot.joint_names[j]} is {q[j]:g} {robot.unit('q', j)}, outside its limits "
            f"[{low[j]:g}, {high[j]:g}] {robot.unit('q', j)}"
        )
    condition = float(mass_matrix_condition(robot)(q))
    if not condition < SINGULAR:
        raise InputError(
            f"mass matrix is singular at q0 = {q.tolist()} (condition number {condition:.2g}): no "
            f"torque determines the acceleration there; {ARMATURE}"
        )
    return np.concatenate([q, qd])


def _same_joints(name: str, count: int, robot: Robot) -> None:
    if count != robot.joint_count:
        raise InputError(f"{name} has {count} joints, but the robot has {robot.joint_count}")
