"""Simulation of an arm under given torques, and under a continuous or sampled controller."""

from __future__ import annotations

import time
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.fast_calls import deferred_call
from microbot_ocp._base.relations import reason_of
from microbot_ocp.limits import AT_LIMIT, use_of
from microbot_ocp.motion import SAMPLE_STEP, Motion, PiecewisePolynomial, State
from microbot_ocp.robot import Robot, forward_dynamics, mass_matrix_condition
from microbot_ocp.simulation._controllers import (
    GAINS,
    Controller,
    Reference,
    Saturation,
    SensorNoise,
    gains_of,
    saturate,
    torque_limits,
    with_gains,
)
from microbot_ocp.simulation._integration import (
    COARSEST,
    INTEGRATORS,
    TOLERANCE,
    ForcedEquation,
    IntegrationRun,
    IntegratorSettings,
    integrate,
    plugin,
    with_halved_steps,
    within_deadline,
)
from microbot_ocp.simulation._result import (
    ARMATURE,
    CLOSED_LOOP,
    OPEN_LOOP,
    SINGULAR,
    Simulation,
    Tracking,
    result_fields,
)
from microbot_ocp.simulation._signals import (
    Formula,
    Signal,
    reference_signal,
    torque_formula,
    torque_signal,
)

Integrator = Literal["dop853", "cvodes", "idas", "collocation", "rk"]

MOST_TURNS = 2000  # turns of a joint; about a few seconds of work
MOST_SAMPLES = 400_000  # samples of a controller; about a few seconds of work
FINEST = 100  # fixed steps that a sample may take regardless of max_steps
MOST_DELAY = 1000  # samples of delay; the state holds the torque of each


def simulate(
    robot: Robot,
    tau: Motion | ArrayLike | Formula | None = None,
    q0: ArrayLike | None = None,
    qd0: ArrayLike | None = None,
    t: ArrayLike | None = None,
    *,
    integrator: Integrator = "dop853",
    tolerance: float = TOLERANCE,
    max_steps: int = 20_000,
    time_limit: float = np.inf,
) -> Simulation:
    """Simulate an arm from given torques: ``M(q) qdd = tau - C(q, qd) qd - g(q) - friction``.

    Craig, *Introduction to Robotics*, 3rd ed., section 6.9; the integrators control their error.

    Parameters
    ----------
    robot : Robot
        Robot with masses.
    tau : Motion, callable, array_like [N,n] or [n], optional
        Torques, N m (N): the stored torques of a motion (they may jump at its breaks), a function
        of the CasADi time that returns n expressions, values on the grid ``t`` (linear between), or
        constants; default zero.
    q0 : array_like [n]
        Joint positions at the start, rad (prismatic: m); default those of the motion.
    qd0 : array_like [n], optional
        Velocities at the start, rad/s (m/s); default those of the motion, else zero.
    t : array_like [N]
        Strictly increasing times of the result, s, the first at the start; default those of the
        motion.
    integrator : "dop853", "cvodes", "idas", "collocation" or "rk"
        Method. The first three control the error: Runge-Kutta of order 8 by Dormand and Prince,
        Adams' method, backward differences. The others, Radau collocation of degree 3 and the
        classical Runge-Kutta method, have a fixed step that is halved until two solutions agree
        within the tolerance.
    tolerance : float
        Absolute and relative tolerance.
    max_steps : int
        Largest number of steps: between two times of the grid, or in all for a fixed step.
    time_limit : float
        Wall time, s, after which the integrator is stopped: the status is "time limit", and states
        that it has not reached are NaN. With "cvodes" and "idas" up to a tenth of the states before
        are NaN as well, with a fixed step all of them.

    Returns
    -------
    Simulation
        Result; after a failure its status and advice give the reason.

    Raises
    ------
    InputError
        Shapes are wrong, times do not increase, the start is outside the limits or at a singular
        mass matrix, or so fast that a joint would turn more than 2000 times.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> hold = mo.gravity_torque(robot)([0.0, 0.5, 0.5]).full().ravel()
    >>> still = simulate(robot, hold, q0=[0.0, 0.5, 0.5], t=[0.0, 1.0])
    >>> str(still.status), still.q[-1].round(6).tolist()
    ('solved', [0.0, 0.5, 0.5])
    """
    started = time.perf_counter()
    count = robot.joint_count
    settings = checked_settings(integrator, tolerance, max_steps)
    if isinstance(tau, Motion):
        checks.joints("motion", tau.joint_count, robot)
        q0, qd0 = tau.q[0] if q0 is None else q0, tau.qd[0] if qd0 is None else qd0
        t = tau.t if t is None else t
    if t is None or q0 is None:
        raise InputError("t and q0 must be given unless tau is a Motion")
    grid = checks.times("t", t)
    checks.size("the number of samples", grid.size, checks.MOST_GIVEN)
    start = checked_start(robot, q0, qd0, float(grid[-1] - grid[0]))
    signal = torque_signal(tau, grid, count)

    forced = ForcedEquation(OpenLoop(robot), 2 * count, signal, np.zeros(0))
    with deadline.within(time_limit):
        run = integrate(forced, start, grid, settings)
    return Simulation(
        **result_fields(robot, grid, run, signal.values(grid), None, settings, started, OPEN_LOOP)
    )


class OpenLoop(NamedTuple):
    """Arm under torques w: ``x' = rate(t, x, w, parameters)``; the parameters are empty."""

    arm: Robot

    def __call__(self, t: ca.SX, x: ca.SX, w: ca.SX, parameters: ca.SX) -> ca.SX:
        """Return the derivative of the state."""
        q, qd = ca.vertsplit(x, self.arm.joint_count)
        return ca.vertcat(qd, forward_dynamics(self.arm)(q, qd, w))


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
    delay: int = 0,
    noise: SensorNoise | None = None,
    disturbance: ArrayLike | Formula | None = None,
    integrator: Integrator | None = None,
    tolerance: float = TOLERANCE,
    max_steps: int = 20_000,
    time_limit: float = np.inf,
) -> Tracking:
    """Simulate the arm ``plant`` along a motion, under a controller with the model ``robot``.

    Under continuous control the closed loop is one differential equation. Under sampled control
    the torque is computed from the (noisy) measurement at every sample and held until the next
    sample. One sample is a map that integrates the arm; CasADi accumulates it over all samples.

    Parameters
    ----------
    robot : Robot
        Model inside the controller.
    motion : Motion, PiecewisePolynomial or callable
        Reference; a callable takes the CasADi time from 0 and returns n expressions for the
        positions, whose derivatives are exact.
    controller : Controller
        :class:`ComputedTorque`, :class:`PDGravity`, :class:`Feedforward` or one of your own.
    plant : Robot, optional
        Simulated arm, with other masses, friction or payload; default ``robot``.
    q0, qd0 : array_like [n], optional
        Start of the arm, rad (m) and rad/s (m/s); default on the reference.
    duration : float, optional
        Duration, s; default that of the motion. Required for a callable.
    step : float
        Longest step between the samples of the result, s.
    saturation : bool, float, array_like [n], (lower, upper) or Limits
        Torque limits, N m (N): True for those of the plant, False for none.
    sample_rate : float, optional
        Sampling rate of the controller, Hz; default continuous control.
    delay : int
        Samples between a measurement and its torque; sampled control only.
    noise : SensorNoise, optional
        Noise of the measurements; sampled control only.
    disturbance : array_like [n] or callable, optional
        Torques on the joints in addition to those of the drives, N m (N): constants, or a
        function of the CasADi time.
    integrator : "dop853", "cvodes", "idas", "collocation" or "rk"
        Method, see :func:`simulate`; default "dop853", or "rk" under sampled control, for which
        "dop853" is not available.
    tolerance, max_steps
        See :func:`simulate`; under sampled control a fixed step may always take 100 steps per
        sample.
    time_limit
        See :func:`simulate`; at this limit all states of a sampled loop are NaN.

    Returns
    -------
    Tracking
        States, errors and torques over the time, with a status.

    Raises
    ------
    InputError
        Shapes or numbers are wrong, robots do not fit together, or noise or delay is given without
        a sample rate.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> shape = mo.quintic([[0.0, 0.0, 0.0], [0.5, 0.8, 0.4]], [0.0, 3.0])
    >>> run = track(robot, shape, mo.ComputedTorque(kp=100.0), q0=[0.1, 0.0, 0.0])
    >>> str(run.status), bool(run.peak_after(2.0).max() < 1e-6)
    ('solved', True)
    """
    started = time.perf_counter()
    arm = robot if plant is None else plant
    count = robot.joint_count
    checks.joints("plant", arm.joint_count, robot)
    chosen = ("dop853" if sample_rate is None else "rk") if integrator is None else integrator
    settings = checked_settings(chosen, tolerance, max_steps)
    begin, end, signal = reference_signal(motion, duration, robot)
    first = signal.values(np.array([begin]))[0]
    q, qd = first[:count], first[count : 2 * count]
    start = checked_start(arm, q if q0 is None else q0, qd if qd0 is None else qd0)
    step = checks.number("step", step, "s", above=0.0)
    lower, upper = torque_limits(saturation, arm)
    load = None
    if disturbance is not None:
        t, expression = torque_formula("disturbance", disturbance, count)
        load = ca.Function("disturbance", [t], [ca.densify(expression)])
    is_linear = type(controller) in GAINS
    gains = gains_of(controller, count) if is_linear else np.zeros(0)
    law = type(controller) if is_linear else _law_text(controller, robot)
    cuts = tuple(lower.tolist()), tuple(upper.tolist())
    loop = ClosedLoop(arm, robot, law, cuts, load.serialize() if load else "")
    forced = ForcedEquation(loop, 2 * count, signal, gains)
    if sample_rate is None:
        for name, given in (("noise", noise is not None), ("delay", delay)):
            if given:
                raise InputError(f"{name} needs a sample_rate: a continuous loop does not sample")
        grid = np.linspace(begin, end, checks.step_count(end - begin, step) + 1)
        with deadline.within(time_limit):
            run = integrate(forced, start, grid, settings)
        wanted = signal.values(grid)
        q, qd = np.split(run.states, 2, axis=1)
        tau = deferred_call(_law(loop))(wanted, q, qd, gains)
    else:
        checks.one_of("integrator under sampled control", chosen, INTEGRATORS[1:])
        sample_rate = checks.number("sample_rate", sample_rate, "Hz", above=0.0)
        t, within = _sample_times(begin, end, sample_rate, step)
        errors = (SensorNoise() if noise is None else noise).draw(t.size, count)
        if not 0 <= delay <= MOST_DELAY:
            raise InputError(f"delay must be 0 to {MOST_DELAY} samples, not {delay}")
        sampled = SampledLoop(arm, _law(loop), gains, load, signal, t, within, errors, delay)
        with deadline.within(time_limit):
            grid, run, tau = sampled.run(start, end, settings)
        wanted = signal.values(grid)
    fields = result_fields(arm, grid, run, tau, load, settings, started, CLOSED_LOOP)
    cut = np.isfinite(lower) | np.isfinite(upper)
    at_limit: Any = (use_of(tau[:, cut], lower[cut], upper[cut]) >= AT_LIMIT).any(axis=1)
    span = np.diff(grid)
    return Tracking(
        **fields,
        reference=State(*np.split(wanted, 3, axis=1)),
        label=controller.label,
        sample_rate=sample_rate,
        saturated_fraction=float((span * at_limit[:-1]).sum() / span.sum()),
        torque_limits=(lower, upper),
    )


class ClosedLoop(NamedTuple):
    """Arm under a controller: ``x' = rate(t, x, w, gains)`` along the reference w.

    Equal loops share one function, compiled once: gains are inputs of the function. The law of a
    user-defined controller is stored as a serialised function.
    """

    arm: Robot
    model: Robot
    law: type | str
    cuts: tuple[tuple[float, ...], tuple[float, ...]]
    disturbance: str

    def torque(self, w: ca.SX, q: ca.SX, qd: ca.SX, gains: ca.SX) -> ca.SX:
        """Return the torque [n] within the limits of the drives."""
        if isinstance(self.law, str):
            tau = ca.Function.deserialize(self.law)(w, q, qd)
        else:
            controller = with_gains(self.law, gains, self.arm.joint_count)
            tau = controller.torque(self.model, Reference(*ca.vertsplit(w, q.numel())), q, qd)
        return saturate(tau, *map(np.array, self.cuts))

    def __call__(self, t: ca.SX, x: ca.SX, w: ca.SX, gains: ca.SX) -> ca.SX:
        """Return the derivative of the state."""
        q, qd = ca.vertsplit(x, self.arm.joint_count)
        tau = self.torque(w, q, qd, gains)
        if self.disturbance:
            tau += ca.Function.deserialize(self.disturbance)(t)
        return ca.vertcat(qd, forward_dynamics(self.arm)(q, qd, tau))


@lru_cache(maxsize=64)
def _law(loop: ClosedLoop) -> ca.Function:
    """Return the controller as a function of reference [3n], position, velocity and gains."""
    count = loop.arm.joint_count
    size = 0 if isinstance(loop.law, str) else len(GAINS[loop.law]) * count
    sizes = {"w": 3 * count, "q": count, "qd": count, "gains": size}
    symbols = [ca.SX.sym(name, entries) for name, entries in sizes.items()]
    return ca.Function("law", symbols, [ca.densify(loop.torque(*symbols))])


def _law_text(controller: Controller, model: Robot) -> str:
    """Return a user-defined controller as a serialised function."""
    count = model.joint_count
    w, q, qd = ca.SX.sym("w", 3 * count), ca.SX.sym("q", count), ca.SX.sym("qd", count)
    try:
        tau = controller.torque(model, Reference(*ca.vertsplit(w, count)), q, qd)
    except RuntimeError as problem:  # CasADi raises it for errors in the user's law
        raise InputError(f"controller returns no torques: {reason_of(problem)}") from problem
    if tau.shape != (count, 1):
        raise InputError(f"controller must return {count} torques, not shape {tau.shape}")
    return ca.Function("law", [w, q, qd], [ca.densify(tau)]).serialize()


# sampled control ----------------------------------------------------------------------------------


class SampledLoop(NamedTuple):
    """Sampled controller and the arm between its samples."""

    arm: Robot
    law: ca.Function  # maps reference, measured position and velocity, and gains to torque
    gains: FloatArray
    disturbance: ca.Function | None  # maps time to torque
    signal: Signal
    t: FloatArray  # sample times [K]
    within: FloatArray  # result times since the last sample [M], s, up to the period
    errors: FloatArray  # measurement errors [K, 2n]
    delay: int  # samples between a measurement and its torque

    def run(
        self, start: FloatArray, end: float, settings: IntegratorSettings
    ) -> tuple[FloatArray, IntegrationRun, FloatArray]:
        """Simulate the loop; return times [N], states and held torques [N,n].

        One step of the accumulated map measures, computes the torque and integrates the arm until
        the next sample.
        """
        count, inner = self.arm.joint_count, self.within.size
        wanted = self.signal.values(self.t)
        waiting = np.array(self.law(wanted[0], start[:count], start[count:], self.gains)).T
        begin = np.append(start, np.tile(waiting, self.delay))

        def states(steps: int) -> FloatArray:
            period = self._period(*plugin(settings, steps, self.within[-1]))
            given = self.t[None, :], wanted.T, self.errors.T
            _, everything = period.mapaccum(self.t.size)(begin, *given)
            return np.vstack([start, np.array(everything).T.reshape(-1, 2 * count)])

        each = settings._replace(max_steps=max(settings.max_steps // self.t.size, FINEST))
        steps = max(inner, int(np.ceil(self.within[-1] / SAMPLE_STEP)))
        run = within_deadline(lambda _: with_halved_steps(states, each, steps))
        grid = np.append(self.t[0], (self.t[:, None] + self.within).ravel())
        if not run.states.size:  # a failure in one sample leaves the whole map without states
            run = run._replace(states=np.full((grid.size, 2 * count), np.nan))
        seen = np.split(run.states[:-1:inner] + self.errors, 2, axis=1)
        torques = deferred_call(self.law)(wanted, *seen, self.gains)
        held = np.vstack([*[waiting] * self.delay, torques])[: self.t.size]
        tau = np.vstack([np.repeat(held, inner, axis=0), held[-1:]])
        keep = grid <= end + ROUNDING * self.within[-1]
        run = run._replace(states=run.states[keep])
        return np.minimum(grid[keep], end), run, tau[keep]

    def _period(self, name: str, options: dict[str, Any]) -> ca.Function:
        """Return the map of one sample.

        The map takes state, time, reference and measurement error, and returns the next state and
        the states within the sample. The state holds the delayed torques after positions and
        velocities.
        """
        count, inner = self.arm.joint_count, self.within.size
        t, x, u = ca.SX.sym("t"), ca.SX.sym("x", 2 * count), ca.SX.sym("u", count + 1)
        tau = u[:count] + (self.disturbance(u[count] + t) if self.disturbance else 0.0)
        qdd = forward_dynamics(self.arm)(x[:count], x[count:], tau)
        equation = {"t": t, "x": x, "u": u, "ode": ca.vertcat(x[count:], qdd)}
        drift = ca.integrator("drift", name, equation, 0.0, self.within.tolist(), options)
        state, moment = ca.MX.sym("state", (2 + self.delay) * count), ca.MX.sym("moment")
        now = state[: 2 * count]
        wanted, error = ca.MX.sym("wanted", 3 * count), ca.MX.sym("error", 2 * count)
        seen = now + error
        law = self.law(wanted, seen[:count], seen[count:], self.gains)
        torques = ca.vertcat(state[2 * count :, 0], law)
        given = ca.repmat(ca.vertcat(torques[:count], moment), 1, inner)
        after = drift(x0=now, u=given)["xf"]
        outputs = [ca.vertcat(after[:, -1], torques[count:, 0]), ca.vec(after)]
        return ca.Function("period", [state, moment, wanted, error], outputs)


def _sample_times(
    begin: float, end: float, rate: float, step: float
) -> tuple[FloatArray, FloatArray]:
    """Return the times [K] of a controller's samples, and those of the result after each [M]."""
    count = checks.step_count(end - begin, 1.0 / rate)
    inner = checks.step_count(1.0 / rate, step)
    checks.size("the number of samples of the controller", count, MOST_SAMPLES)
    checks.size("the number of samples", count * inner, checks.MOST_GIVEN)
    return begin + np.arange(count) / rate, np.arange(1, inner + 1) / (inner * rate)


# checks of arguments ------------------------------------------------------------------------------


def checked_settings(integrator: str, tolerance: float, max_steps: int) -> IntegratorSettings:
    checks.one_of("integrator", integrator, INTEGRATORS)
    tolerance = checks.number("tolerance", tolerance, above=0.0, at_most=COARSEST)
    max_steps = checks.whole("max_steps", max_steps, at_most=checks.MOST_ITERATIONS)
    return IntegratorSettings(integrator, tolerance, max_steps)


def checked_start(
    robot: Robot, q0: ArrayLike, qd0: ArrayLike | None, duration: float = 0.0
) -> FloatArray:
    count = robot.joint_count
    q = checks.array("q0", q0, (count,), "rad")
    qd = np.zeros(count) if qd0 is None else checks.array("qd0", qd0, (count,), "rad/s")
    low, high = robot.limits.bounds("q")
    outside = np.flatnonzero((q < low - ROUNDING) | (q > high + ROUNDING))
    if outside.size:
        j = int(outside[0])
        raise InputError(
            f"q0 of {robot.joint_names[j]} is {q[j]:g} {robot.unit('q', j)}, outside its limits "
            f"[{low[j]:g}, {high[j]:g}] {robot.unit('q', j)}{checks.degrees_hint(q[j])}"
        )
    turns = np.abs(qd) * duration / (2.0 * np.pi) * (np.array(robot.joint_types) == "revolute")
    if turns.max() > MOST_TURNS:
        j = int(turns.argmax())
        raise InputError(
            f"qd0 of {robot.joint_names[j]} is {qd[j]:g} rad/s, {turns[j]:.3g} turns in "
            f"{duration:g} s: at most {MOST_TURNS} turns are simulated"
        )
    condition = float(deferred_call(mass_matrix_condition(robot))(q)[0])
    if not condition < SINGULAR:
        raise InputError(
            f"mass matrix is singular at q0 = {q.tolist()} (condition number {condition:.2g}): no "
            f"torque determines the acceleration there; {ARMATURE}"
        )
    return np.concatenate([q, qd])
