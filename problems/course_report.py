"""Numbers and integration loops of the course report, for the scripts to compare with."""

from __future__ import annotations

import casadi as ca
import numpy as np

import microbot_ocp as mo

DURATION = 2.0  # duration of the motion of parts 4 and 6, s
STEP = 0.05  # grid step of the report, s
GRAVITY = {  # acceleration of free fall, base frame
    "along Z (right)": (0.0, 0.0, -9.8),
    "along Y (report's code)": (0.0, -9.8, 0.0),
    "off": (0.0, 0.0, 0.0),
}
VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])  # part 5
VIA_QD = np.radians([[0, 0, 0], [10, 40, 20], [0, 0, 0]])
VIA_T = np.array([0.0, 2.0, 4.0])
BLEND = 0.5  # s
# Peak |torque| with gravity along Z and peak speed of part 5, recomputed from the formulas in the
# report's code; the report itself shows curves only (figures 12 to 17).
PEAKS = {
    "cubic": ([86.57, 276.11, 132.85], [1.119, 0.698, 0.713]),
    "LSPB": ([81.36, 323.06, 149.06], [0.983, 0.698, 0.640]),
}


def motion(t: ca.SX) -> list[ca.SX]:
    """Return the positions of the three joints, rad (parts 4 and 6)."""
    return [np.pi / 4 * (1 + 6 * ca.exp(-t / 0.3) - 8 * ca.exp(-t / 0.4))] * 3


def grid(step: float = STEP) -> np.ndarray:
    """Return the times of the motion, s."""
    return np.arange(round(DURATION / step) + 1) * step


def euler(robot: mo.Robot, given: mo.Motion, step: float) -> np.ndarray:
    """Integrate by explicit Euler: acceleration at the integrated state, constant time step."""
    x, tau = ca.SX.sym("x", 6), ca.SX.sym("tau", 3)
    rate = ca.vertcat(x[3:], mo.forward_dynamics(robot)(x[:3], x[3:], tau))
    held = np.column_stack([np.interp(grid(step), given.t, column) for column in given.tau.T])
    walk = ca.Function("walk", [x, tau], [x + step * rate]).mapaccum(len(held) - 1)
    later = walk(np.concatenate([given.q[0], given.qd[0]]), held[:-1].T).full().T
    return np.vstack([given.q[0], later[:, :3]])


def code_euler(given: mo.Motion) -> np.ndarray:
    """Integrate as part 4b's code does: its step is the elapsed time, its qdd the given one."""
    t = grid()
    qdd, h = given.sample(t).qdd[:-1], t[:-1, None]
    qd = given.qd[0] + np.cumsum(np.vstack([0 * qdd[:1], qdd * h]), axis=0)
    change = qd[:-1] * h + 0.5 * qdd * h**2
    return given.q[0] + np.cumsum(np.vstack([0 * change[:1], change]), axis=0)
