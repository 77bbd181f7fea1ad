"""Dry friction of free motions: both torques of a reversal are within the limits."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp.ocp import OptimalControlProblem
from microbot_ocp.planning.task import WINDOW, WINDOW_REACH, reversals, windowed_torques
from microbot_ocp.robot import COULOMB_SMOOTHING

INERTIA, FRICTION, TORQUE = 2.0, 6.0, 20.0


@pytest.fixture(scope="module")
def turning():
    """A wheel with dry friction; gravity does not move it."""
    link = mo.Link(0.0, np.zeros(3), np.diag([0, 0, INERTIA]), coulomb_friction=FRICTION,
                   allow_unphysical=True)  # fmt: skip
    return mo.Robot.from_dh([0.0], [0.0], [0.0], links=[link], limits=mo.Limits(tau_max=TORQUE))


def kept_in(robot, window):
    """Function of the velocity, acceleration and torque without friction: what is limited."""
    problem = OptimalControlProblem("one point")
    phase = problem.phase("phase", duration=1.0)
    q, qd, qdd, tau = (ca.MX.sym(name) for name in ("q", "qd", "qdd", "tau"))
    kept, _ = windowed_torques(phase, robot, (q, qd, qdd, qdd), lambda *_: (tau, None))
    symbols = [p.symbol for p in phase.parameters]
    values = [window if p.name == WINDOW else p.value for p in phase.parameters]
    expression = ca.substitute([kept["tau"]], [*symbols, phase.duration], [*values, 1.0])
    return ca.Function("kept", [qd, qdd, tau], expression)


def friction(velocity):
    return FRICTION * np.tanh(velocity / COULOMB_SMOOTHING)


def test_what_is_kept_is_kept_anywhere_within_the_window(turning):
    window, random = 0.02, np.random.default_rng(0)
    kept = kept_in(turning, window)
    allowed = 0
    for _ in range(2000):
        qd, qdd = random.normal(0.0, 0.1), random.normal(0.0, 10.0)
        tau = random.uniform(-TORQUE - FRICTION, TORQUE + FRICTION)
        if abs(float(kept(qd, qdd, tau))) > TORQUE:
            continue
        allowed += 1
        # half of the way to the next point is 0.25 / WINDOW_REACH of the window; at its very ends
        # the smoothing lets a part of the friction pass
        inside = qd + qdd * np.linspace(-window, window, 41) * 0.25 / WINDOW_REACH
        assert np.abs(tau + friction(inside)).max() <= TORQUE + 0.25 * FRICTION
    assert allowed > 500


def test_far_from_a_reversal_and_without_a_window_it_is_the_torque(turning):
    assert float(kept_in(turning, 0.02)(1.0, 10.0, 3.0)) == pytest.approx(3.0 + FRICTION, rel=1e-6)
    near = float(kept_in(turning, 0.0)(0.02, 10.0, 3.0))
    assert near == pytest.approx(3.0 + friction(0.02), abs=0.03 * FRICTION)


def test_reversals_are_those_of_joints_with_friction():
    velocity = np.array([[0.0, 1.0], [1.0, 0.5], [0.5, -0.5], [-0.5, -1.0], [-1e-3, -1.0]])
    both = reversals(velocity, np.array([True, True])).tolist()
    assert both == [True, True, True, False]  # at rest it vanishes, too
    first = reversals(velocity[:, :1], np.array([True])).tolist()
    assert first == [True, False, True, False]


def test_the_fastest_motion_to_and_fro(turning):
    """Against the closed form: both ways from rest to rest, braking helped by the friction."""
    rise, brake = (TORQUE - FRICTION) / INERTIA, (TORQUE + FRICTION) / INERTIA
    best = sum(np.sqrt(2.0 * way * (1.0 / rise + 1.0 / brake)) for way in (1.0, 0.6))
    motion = mo.time_optimal(turning, [[0.0], [1.0], [0.4]], mesh=30, starts=1)
    assert motion.solved
    assert best <= motion.duration <= best * 1.003
    assert mo.certify(turning, motion).ok


def test_a_finer_mesh_is_faster(turning):
    coarse, fine = (
        mo.time_optimal(turning, [[0.0], [1.0]], mesh=mesh, starts=1).duration for mesh in (10, 40)
    )
    assert fine <= coarse + 1e-6
