"""Sampled control: the torque is computed at every sample and held until the next."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.child_process import Send
from microbot_ocp.motion import SAMPLE_STEP
from microbot_ocp.robot import Robot, forward_dynamics
from microbot_ocp.simulation._integration import (
    IntegrationRun,
    IntegratorSettings,
    Signal,
    in_time,
    missing,
    plugin,
    settled,
)

MOST_SAMPLES = 400_000  # some seconds of work
FINEST = 100  # fixed steps that a sample may take in any case


class Samples(NamedTuple):
    """Times of the samples, and times in between at which the result is given."""

    t: FloatArray  # [K]
    within: FloatArray  # [M], s after a sample, the last one being the period
    end: float

    @classmethod
    def of(cls, begin: float, end: float, rate: float, step: float) -> Samples:
        count = checks.step_count(end - begin, 1.0 / rate)
        inner = checks.step_count(1.0 / rate, step)
        checks.size("the number of samples of the controller", count, MOST_SAMPLES)
        checks.size("the number of samples", count * inner, checks.MOST_GIVEN)
        within = np.arange(1, inner + 1) / (inner * rate)
        return cls(begin + np.arange(count) / rate, within, end)


class SampledLoop(NamedTuple):
    """A sampled controller and the arm between its samples."""

    arm: Robot
    law: ca.Function  # reference, measured position and velocity, gains to torque
    gains: FloatArray
    disturbance: ca.Function | None  # time to disturbance
    signal: Signal
    errors: FloatArray  # of the measurements [K, 2n]
    delay: int = 0  # samples between a measurement and its torque

    def run(
        self, samples: Samples, start: FloatArray, settings: IntegratorSettings
    ) -> tuple[FloatArray, IntegrationRun, FloatArray]:
        """Times [N], states and held torques [N,n].

        One step of the accumulated map measures, computes the torque and integrates the arm with
        it until the next sample.
        """
        count, inner = self.arm.joint_count, samples.within.size
        first = self.signal.values(samples.t[:1])[0]
        waiting = np.array(self.law(first, start[:count], start[count:], self.gains)).ravel()
        begin = np.concatenate([start, np.tile(waiting, self.delay)])
        given = (samples.t[None, :], self.signal.values(samples.t).T, self.errors.T)
        held: list[FloatArray] = []

        def states(steps: int) -> FloatArray:
            period = self._period(samples, *plugin(settings, steps, samples.within[-1]))
            _, everything, torques = period.mapaccum(samples.t.size)(begin, *given)
            held[:] = [np.array(torques).T]
            return np.vstack([start, np.array(everything).T.reshape(-1, 2 * count)])

        each = settings._replace(max_steps=max(settings.max_steps // samples.t.size, FINEST))
        steps = max(inner, int(np.ceil(samples.within[-1] / SAMPLE_STEP)))

        def work(_: Send) -> tuple[IntegrationRun, list[FloatArray]]:
            return settled(states, each, steps), held

        run, held = in_time(work, lambda status, said: (missing(status, said), []))
        grid = np.append(samples.t[0], (samples.t[:, None] + samples.within).ravel())
        tau = np.full((grid.size, count), np.nan)
        if held:
            tau = np.vstack([np.repeat(held[0], inner, axis=0), held[0][-1:]])
        if not run.states.size:  # one map holds all samples, so a failure in one leaves no states
            run = run._replace(states=np.full((grid.size, 2 * count), np.nan))
        keep = grid <= samples.end + 1e-9 * samples.within[-1]
        run = run._replace(states=run.states[keep])
        return np.minimum(grid[keep], samples.end), run, tau[keep]

    def _period(self, samples: Samples, name: str, options: dict[str, Any]) -> ca.Function:
        """State, moment, reference and error to: next state, all states on the way, torque.

        Behind positions and velocities the state has the torques that are still to come.
        """
        count, inner = self.arm.joint_count, samples.within.size
        t, x, u = ca.SX.sym("t"), ca.SX.sym("x", 2 * count), ca.SX.sym("u", count + 1)
        tau = u[:count] + (self.disturbance(u[count] + t) if self.disturbance else 0.0)
        qdd = forward_dynamics(self.arm)(x[:count], x[count:], tau)
        equation = {"t": t, "x": x, "u": u, "ode": ca.vertcat(x[count:], qdd)}
        drift = ca.integrator("drift", name, equation, 0.0, samples.within.tolist(), options)
        state, moment = ca.MX.sym("state", (2 + self.delay) * count), ca.MX.sym("moment")
        now = state[: 2 * count]
        wanted, error = ca.MX.sym("wanted", 3 * count), ca.MX.sym("error", 2 * count)
        seen = now + error
        law = self.law(wanted, seen[:count], seen[count:], self.gains)
        torques = ca.vertcat(state[2 * count :, 0], law)
        held = torques[:count]
        after = drift(x0=now, u=ca.repmat(ca.vertcat(held, moment), 1, inner))["xf"]
        outputs = [ca.vertcat(after[:, -1], torques[count:, 0]), ca.vec(after), held]
        return ca.Function("period", [state, moment, wanted, error], outputs)
