"""Arm under computed torque, 2 s on 2,001 points: ``track`` against scipy's RK45.

scipy calls the whole right-hand side, reference included, as one compiled function of one state.
Both have the default tolerance of ``track``; their distance from a solution at 1e-13 is printed
first. ``track`` also returns torques, accelerations and the conditioning of the mass matrix.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

import microbot_ocp as mo
from benchmarks.arms import via_points
from benchmarks.measure import Benchmark, timed
from microbot_ocp._base.checks import FloatArray

GOAL = 20.0
ROBOTS = ("microbot", "ur5e", "panda")
TOLERANCE = 1e-10
KP = 100.0
GRID = np.linspace(0.0, 2.0, 2001)


def right_side(robot: mo.Robot, path: mo.motion.PiecewisePolynomial) -> ca.Function:
    """Return the derivative of the state, (t, x) -> x', along one piece of a polynomial."""
    count = robot.joint_count
    t, x = ca.SX.sym("t"), ca.SX.sym("x", 2 * count)
    wanted = sum(ca.DM(row) * t**power for power, row in enumerate(path.coefficients[0]))
    speed = ca.jacobian(wanted, t)
    q, qd = x[:count], x[count:]
    pull = KP * (wanted - q) + 2 * np.sqrt(KP) * (speed - qd)
    tau = mo.inverse_dynamics(robot)(q, qd, ca.jacobian(speed, t) + pull)
    return ca.Function("xd", [t, x], [ca.vertcat(qd, mo.forward_dynamics(robot)(q, qd, tau))])


def run(repetitions: int = 0) -> None:
    """Run arms of three, six and seven joints."""
    for name in ROBOTS:
        robot = mo.load_robot(name)
        via = via_points(robot, 0, 2)
        path = mo.quintic(via, [GRID[0], GRID[-1]])
        call = mo.fast_call(right_side(robot, path))
        start = np.concatenate([via[0] + 0.01, np.zeros(robot.joint_count)])

        def rate(t: float, x: FloatArray, call: Callable[..., FloatArray] = call) -> FloatArray:
            return call(np.array([t]), x)

        def peer(
            method: str = "RK45",
            tolerance: float = TOLERANCE,
            rate: Callable[..., FloatArray] = rate,
            start: FloatArray = start,
        ) -> FloatArray:
            span = (GRID[0], GRID[-1])
            return solve_ivp(rate, span, start, method, GRID, rtol=tolerance, atol=tolerance).y.T

        names = {"robot": robot, "path": path, "law": mo.ComputedTorque(KP), "q0": via[0] + 0.01}
        statement = "track(robot, path, law, q0=q0, saturation=False)"
        found = mo.track(robot, path, names["law"], q0=names["q0"], saturation=False)
        exact = peer("DOP853", 1e-13)
        errors = [
            float(np.abs(states - exact).max())
            for states in (peer(), np.hstack([found.q, found.qd]))
        ]
        Benchmark(
            f"Closed loop, {name}; largest error: RK45 {errors[0]:.1e}, track {errors[1]:.1e}",
            ("scipy, RK45", timed("peer()", peer=peer)),
            {"track": timed(statement, 5, track=mo.track, **names)},
            {"track": GOAL},
        ).run(repetitions or 15)
