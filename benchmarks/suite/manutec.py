"""Manutec r3 in least time: check of our figure, and the probable origin of the published one.

    python -m benchmarks.suite.manutec

The equations of motion are derived here from the published figures (Otter and Tuerk, *The DFVLR
Models 1 and 2 of the Manutec r3 Robot*, 1988), as a Lagrangian in the published frames, not by the
package's recursion in its own frames. The fastest motion has nine arcs, on which every joint has
its full voltage or its speed limit; they are integrated by SciPy's DOP853 at 1e-12. Their lengths
are solved such that the arm ends at rest at the goal and reaches a speed limit where it holds that
limit. The output is the minimum time, the use of the limits, and the minimum times of coarse
meshes.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import root

from benchmarks.suite.mechanisms import MANUTEC_VOLT, manutec_time
from microbot_ocp import ocp

PUBLISHED = 0.4951963
GOAL = np.array([1.0, -1.95, 1.0, 0.0, 0.0, 0.0])
LIMITS = {"q": (2.97, 2.01, 2.86), "qd": (3.0, 1.5, 5.2), "u": (7.5, 7.5, 7.5)}
ROTOR, GEARS = 1.3e-3, (-105.0, 210.0, 60.0)  # kg m^2 and ratios


def _about_z(angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))


def _about_x(angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(1, 0, 0), ca.horzcat(0, c, -s), ca.horzcat(0, s, c))


def accelerations() -> ca.Function:
    """Return ``(q, qd, u) -> qdd`` by Lagrange's equations; Z up, joints about Z, X and X."""
    q, qd, u = ca.SX.sym("q", 3), ca.SX.sym("qd", 3), ca.SX.sym("u", 3)
    one = _about_z(q[0])
    two = one @ _about_x(q[1])
    three = two @ _about_x(q[2])
    elbow = two @ ca.DM([0.0, 0.0, 0.5])
    bodies = (
        (two, two @ ca.DM([0.172, 0.0, 0.205]), 56.5, (2.58, 2.73, 0.64, -0.46)),
        (three, elbow + three @ ca.DM([0.028, 0.0, 0.202]), 60.3, (5.41, 5.60, 0.39, 0.33)),
    )
    kinetic, potential = 1.16 * qd[0] ** 2 / 2, ca.SX(0)
    for rotation, centre, mass, (xx, yy, zz, xz) in bodies:
        velocity = ca.jacobian(centre, q) @ qd
        turning = rotation.T @ ca.reshape(ca.jacobian(ca.vec(rotation), q) @ qd, 3, 3)
        omega = ca.vertcat(turning[2, 1], turning[0, 2], turning[1, 0])
        inertia = ca.DM([[xx, 0.0, xz], [0.0, yy, 0.0], [xz, 0.0, zz]])
        kinetic += mass * ca.sumsqr(velocity) / 2 + omega.T @ inertia @ omega / 2
        potential += 9.81 * mass * centre[2]
    kinetic += ROTOR / 2 * sum((gear * qd[i]) ** 2 for i, gear in enumerate(GEARS))
    kinetic += ROTOR * GEARS[2] * qd[2] * qd[1]  # link 2 carries rotor 3
    momentum = ca.gradient(kinetic, qd)
    torque = ca.DM(MANUTEC_VOLT) * u
    right = torque - ca.jacobian(momentum, q) @ qd + ca.gradient(kinetic - potential, q)
    return ca.Function("qdd", [q, qd, u], [ca.solve(ca.jacobian(momentum, qd), right)])


# Signs of the voltages on every arc; 0 while the speed is held at its limit.
ARCS = (
    (-1, -1, 1), (-1, 0, 1), (-1, 0, 0), (0, 0, 0), (0, 0, -1), (0, 1, -1), (1, 1, -1), (1, 1, 1),
    (1, -1, 1),
)  # fmt: skip
LENGTHS = (0.042, 0.064, 0.064, 0.083, 0.077, 0.026, 0.036, 0.072, 0.032)  # initial guess, s
HELD = ((0, 1, -1.5), (1, 2, 5.2), (2, 0, 3.0))  # last arc before, joint, and speed held


def moved(lengths: np.ndarray, qdd: ca.Function, free: ca.Function) -> list[np.ndarray]:
    """Integrate all arcs; return states and voltages [M, 9] along each."""
    state, found = np.array([0.0, -1.5, 0.0, 0.0, 0.0, 0.0]), []
    for signs, length in zip(ARCS, lengths, strict=True):
        own = np.array(signs)

        def voltages(x: np.ndarray, own: np.ndarray = own) -> np.ndarray:
            held = free(x[:3], x[3:], 7.5 * own, own == 0).full().ravel()
            return np.where(own == 0, held, 7.5 * own)

        made = solve_ivp(
            lambda _, x: np.append(x[3:], qdd(x[:3], x[3:], voltages(x)).full().ravel()),
            (0.0, length),
            state,
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            dense_output=True,
        )
        state = made.y[:, -1]
        along = made.sol(np.linspace(0.0, length, 50)).T
        found.append(np.hstack([along, [voltages(x) for x in along]]))
    return found


def holding(qdd: ca.Function) -> ca.Function:
    """Return ``(q, qd, u, held) -> u``, the voltages at which held joints do not accelerate."""
    q, qd, u, held = (ca.SX.sym(name, 3) for name in ("q", "qd", "u", "held"))
    change = ca.jacobian(qdd(q, qd, u), u)
    # A held joint has zero acceleration, any other one its given voltage.
    rows = ca.diag(held) @ change + ca.diag(1 - held)
    missing = held * qdd(q, qd, (1 - held) * u)
    return ca.Function("u", [q, qd, u, held], [(1 - held) * u - ca.solve(rows, missing) * held])


def main() -> None:
    qdd = accelerations()
    free = holding(qdd)

    def missed(lengths: np.ndarray) -> np.ndarray:
        arcs = moved(lengths, qdd, free)
        speeds = [arcs[arc][-1, 3 + joint] - speed for arc, joint, speed in HELD]
        return np.append(arcs[-1][-1, :6] - GOAL, speeds)

    made = root(missed, LENGTHS, tol=1e-13)
    arcs = np.vstack(moved(made.x, qdd, free))
    off = np.abs(made.fun).max()
    print(f"nine arcs: {made.x.sum():.9f} s, published {PUBLISHED} s; misses {off:.0e}")
    for name, own in (("q", slice(0, 3)), ("qd", slice(3, 6)), ("u", slice(6, 9))):
        print(f"{name}: uses {np.abs(arcs[:, own]).max(axis=0).round(6)} of {LIMITS[name]}")
    for scheme in ("trapezoidal", "hermite_simpson", "radau"):
        for mesh in (25, 50, 100):
            found = ocp.solve(manutec_time(), mesh, scheme=scheme)
            print(f"{scheme} {mesh}: {found.cost:.7f} s {found.status}", flush=True)


if __name__ == "__main__":
    main()
