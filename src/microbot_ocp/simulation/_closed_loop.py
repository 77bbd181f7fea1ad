"""The arm under a controller."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.relations import reason_of
from microbot_ocp.limits import AT_LIMIT, use_of
from microbot_ocp.motion import SAMPLE_STEP, Motion, PiecewisePolynomial, State
from microbot_ocp.robot import Robot, forward_dynamics
from microbot_ocp.simulation._controllers import (
    Controller,
    Reference,
    Saturation,
    SensorNoise,
    saturate,
    torque_limits,
)
from microbot_ocp.simulation._inputs import (
    Integrator,
    checked_settings,
    checked_start,
)
from microbot_ocp.simulation._integration import ForcedEquation, integrate
from microbot_ocp.simulation._outcome import result_fields
from microbot_ocp.simulation._result import Tracking
from microbot_ocp.simulation._sampled import SampledLoop, Samples
from microbot_ocp.simulation._signals import Formula, disturbance_function, reference_signal

MOST_DELAY = 1000  # samples, each of which is a part of the state


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
    tolerance: float = 1e-10,
    max_steps: int = 20_000,
    time_limit: float = np.inf,
) -> Tracking:
    """Simulate the arm ``plant`` along a motion, under a controller with the model ``robot``.

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
        The arm that is simulated: other masses, friction, payload; default ``robot``.
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
    delay : int
        Samples between a measurement and the torque that follows from it; of sampled control only.
    noise : SensorNoise, optional
        Of sampled control only.
    disturbance : array_like [n] or callable, optional
        Torques on the joints in addition to those of the drives, N m (N): constants, or a
        function of the CasADi time.
    integrator : "cvodes", "idas", "collocation" or "rk"
        See :func:`simulate`; default "cvodes", under sampled control "rk".
    tolerance, max_steps
        See :func:`simulate`; under sampled control a fixed step may take 100 steps a sample in any
        case.
    time_limit
        See :func:`simulate`; of sampled control nothing is kept.

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
    >>> str(run.status), bool(run.peak_after(2.0).max() < 1e-6)
    ('solved', True)
    """
    started = time.perf_counter()
    arm = robot if plant is None else plant
    count = robot.joint_count
    checks.joints("plant", arm.joint_count, robot)
    chosen = ("cvodes" if sample_rate is None else "rk") if integrator is None else integrator
    settings = checked_settings(chosen, tolerance, max_steps)
    begin, end, signal = reference_signal(motion, duration, robot)
    first = signal.values(np.array([begin]))[0]
    start = checked_start(
        arm, first[:count] if q0 is None else q0, first[count : 2 * count] if qd0 is None else qd0
    )
    step = checks.number("step", step, "s", above=0.0)
    lower, upper = torque_limits(saturation, arm)
    load = disturbance_function(disturbance, count)
    dynamics = forward_dynamics(arm)

    def torque(w: ca.SX, q: ca.SX, qd: ca.SX) -> ca.SX:
        reference = Reference(w[:count], w[count : 2 * count], w[2 * count :])
        try:
            tau = controller.torque(robot, reference, q, qd)
        except RuntimeError as problem:  # CasADi's, of the user's law
            raise InputError(f"controller has no torques: {reason_of(problem)}") from problem
        if tau.shape != (count, 1):
            raise InputError(f"controller must return {count} torques, not shape {tau.shape}")
        return saturate(tau, lower, upper)

    def rate(t: ca.SX, x: ca.SX, w: ca.SX) -> ca.SX:
        q, qd = x[:count], x[count:]
        return ca.vertcat(qd, dynamics(q, qd, torque(w, q, qd) + load(t)))

    forced = ForcedEquation(rate, 2 * count, signal)
    if sample_rate is None:
        for name, given in (("noise", noise is not None), ("delay", delay)):
            if given:
                raise InputError(f"{name} needs a sample_rate: a continuous loop does not sample")
        grid = np.linspace(begin, end, checks.step_count(end - begin, step) + 1)
        with deadline.within(time_limit):
            run = integrate(forced, start, grid, settings)
        law = _law(torque, count)
        columns = (signal.values(grid).T, run.states[:, :count].T, run.states[:, count:].T)
        tau = np.array(law.map(grid.size)(*columns)).T
    else:
        sample_rate = checks.number("sample_rate", sample_rate, "Hz", above=0.0)
        samples = Samples.of(begin, end, sample_rate, step)
        errors = (SensorNoise() if noise is None else noise).draw(samples.t.size, count)
        if not 0 <= delay <= MOST_DELAY:
            raise InputError(f"delay must be 0 to {MOST_DELAY} samples, not {delay}")
        loop = SampledLoop(arm, _law(torque, count), load, signal, errors, delay)
        with deadline.within(time_limit):
            grid, run, tau = loop.run(samples, start, settings)
    fields = result_fields(arm, grid, run, tau, load, settings, started)
    at_limit: Any = (use_of(tau, lower, upper) >= AT_LIMIT).any(axis=1)
    span = np.diff(grid)
    return Tracking(
        **fields,
        reference=State(*np.split(signal.values(grid), 3, axis=1)),
        label=controller.label,
        sample_rate=sample_rate,
        saturated_fraction=float((span * at_limit[:-1]).sum() / span.sum()),
        torque_limits=(lower, upper),
    )


def _law(torque: Callable[[ca.SX, ca.SX, ca.SX], ca.SX], count: int) -> ca.Function:
    """The controller as a function of reference [3n], position [n] and velocity [n]."""
    w, q, qd = ca.SX.sym("w", 3 * count), ca.SX.sym("q", count), ca.SX.sym("qd", count)
    return ca.Function("law", [w, q, qd], [ca.densify(torque(w, q, qd))])
