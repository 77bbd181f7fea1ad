"""The Manutec r3: its published optimal motions, and the fastest by its arcs."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from benchmarks.suite.mechanisms import (
    MANUTEC_VOLT,
    manutec_effort,
    manutec_time,
)
from benchmarks.suite.table import BY_NAME

import microbot_ocp as mo
from microbot_ocp import ocp

HELD = 0  # at the limit of its speed; else the sign of the voltage
ARCS = np.array(
    [
        [-1, -1, 1],
        [-1, HELD, 1],
        [-1, HELD, HELD],
        [HELD, HELD, HELD],
        [HELD, HELD, -1],
        [HELD, 1, -1],
        [1, 1, -1],
        [1, 1, 1],
        [1, -1, 1],
    ]
)
LENGTHS = [0.042, 0.064, 0.064, 0.083, 0.077, 0.026, 0.036, 0.072, 0.032]  # s, to begin with


def arc(robot: mo.Robot, signs: np.ndarray) -> ca.Function:
    """An arc integrated: a joint that is held has no acceleration, the others their voltage."""
    x, length = ca.SX.sym("x", 6), ca.SX.sym("T")
    mass, bias = mo.mass_matrix(robot)(x[:3]), mo.bias_torque(robot)(x[:3], x[3:])
    free, qdd = np.flatnonzero(signs).tolist(), ca.SX(3, 1)
    if free:
        tau = ca.DM(7.5 * signs[free] * MANUTEC_VOLT[free])
        found = ca.solve(mass[free, free], tau - bias[free])
        for i, joint in enumerate(free):
            qdd[joint] = found[i]
    equation = {"x": x, "p": length, "ode": length * ca.vertcat(x[3:], qdd)}
    return ca.integrator("arc", "cvodes", equation, 0, 1, {"abstol": 1e-13, "reltol": 1e-13})


@pytest.mark.thorough
def test_the_fastest_motion_by_its_arcs() -> None:
    """Nine lengths from nine conditions: the end, and each speed where it first is at its limit."""
    robot = mo.load_robot("manutec_r3")
    arcs = [arc(robot, signs) for signs in ARCS]
    lengths = ca.MX.sym("T", len(arcs))
    state, states, wanted = ca.DM([0.0, -1.5, 0.0, 0.0, 0.0, 0.0]), [], []
    for k, run in enumerate(arcs):
        state = run(x0=state, p=lengths[k])["xf"]
        states.append(state)
    for k, joint, speed in ((0, 1, -1.5), (1, 2, 5.2), (2, 0, 3.0)):
        wanted.append(states[k][3 + joint] - speed)
    rows = ca.vertcat(*wanted, state - ca.DM([1.0, -1.95, 1.0, 0.0, 0.0, 0.0]))
    both = ca.Function("both", [lengths], [rows, ca.jacobian(rows, lengths), ca.horzcat(*states)])
    found = np.array(LENGTHS)
    for _ in range(6):
        value, slope, reached = (np.array(part) for part in both(found))
        found = found - np.linalg.solve(slope, value.ravel())
    assert np.abs(both(found)[0]).max() < 1e-11
    assert found.sum() == pytest.approx(BY_NAME["manutec_time"].optimum, rel=1e-11)
    assert np.all(found > 0)
    low, high = robot.limits.bounds("q")
    assert np.all((low <= reached[:3].T) & (high >= reached[:3].T))
    # 1.5e-5 less than the figure published
    assert found.sum() == pytest.approx(BY_NAME["manutec_time"].published, rel=2e-5)


@pytest.mark.thorough
def test_both_are_met() -> None:
    # 50 intervals leave the fastest motion 0.6 % beyond a velocity between mesh points, and say so
    endings = {manutec_effort: ocp.Status.SOLVED, manutec_time: ocp.Status.TOO_COARSE}
    for build, error in ((manutec_effort, 1e-6), (manutec_time, 2e-5)):
        solution = ocp.solve(build(), 50, scheme="radau")
        assert solution.status is endings[build]
        assert BY_NAME[build.__name__].error(solution.cost) < error
