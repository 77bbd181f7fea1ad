"""Part 4b: the motion back from its torques, by CasADi's four integrators and the report's Euler.

The torques are those of part 4a with gravity along Z. Every integrator gets them as a function of
the time and solves M(q) qdd = tau - C qd - G at the state it has reached.

    python problems/04b_forward_dynamics.py --out out/04b
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import casadi as ca
import numpy as np

import microbot_ocp as mo
from microbot_ocp.views.joint_plots import Curve, joints_figure, save_figures

DURATION = 2.0
STEP = 0.05  # s, report, part 4b
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)


def report_motion(t: ca.SX) -> list[ca.SX]:
    """Positions of the three joints, rad (report, part 4a)."""
    return [np.pi / 4 * (1 + 6 * ca.exp(-t / 0.3) - 8 * ca.exp(-t / 0.4))] * 3


def euler(robot: mo.Robot, motion: mo.Motion, step: float) -> Curve:
    """Explicit Euler as it should be: accelerations at the state reached, the step as the step."""
    x, tau = ca.SX.sym("x", 6), ca.SX.sym("tau", 3)
    rate = ca.vertcat(x[3:], mo.forward_dynamics(robot)(x[:3], x[3:], tau))
    t = np.arange(round(DURATION / step) + 1) * step
    given = np.column_stack([np.interp(t, motion.t, column) for column in motion.tau.T])
    walk = ca.Function("walk", [x, tau], [x + step * rate]).mapaccum(t.size - 1)
    later = walk(np.concatenate([motion.q[0], motion.qd[0]]), given[:-1].T).full().T
    return Curve(f"Euler, step {step:g} s", t, {"q": np.vstack([motion.q[0], later[:, :3]])})


def reports_euler(motion: mo.Motion) -> Curve:
    """The loop of the report's code: it steps by the elapsed time, with the given acceleration."""
    t = np.arange(round(DURATION / STEP) + 1) * STEP
    qdd, h = motion.sample(t).qdd[:-1], t[:-1, None]
    qd = motion.qd[0] + np.cumsum(np.vstack([0 * qdd[:1], qdd * h]), axis=0)
    change = qd[:-1] * h + 0.5 * qdd * h**2
    q = motion.q[0] + np.cumsum(np.vstack([0 * change[:1], change]), axis=0)
    return Curve("the report's Euler loop", t, {"q": q})


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog="example: python problems/04b_forward_dynamics.py --out out/04b",
    )
    parser.add_argument("--out", type=Path, default=Path("out/04b"), help="folder to write into")
    parser.add_argument("--robot", default="microbot", help="packaged 3-joint robot or .toml file")
    arguments = parser.parse_args()
    try:
        robot = mo.load_robot(arguments.robot)
        motion = mo.motion_from_formula(robot, report_motion, DURATION, label="given")
        grid = np.linspace(0.0, DURATION, 41)
        wanted = motion.sample(grid)

        def torque(t: ca.SX) -> ca.SX:
            q = ca.vertcat(*report_motion(t))
            qd = ca.jacobian(q, t)
            return mo.inverse_dynamics(robot)(q, qd, ca.jacobian(qd, t))

        print("largest error of q at 2 s, deg, by tolerance (wall time, ms):")
        print("  " + " " * 12 + "".join(f"{tolerance:^20.0e}" for tolerance in TOLERANCES))
        best = None
        for name in ("cvodes", "idas", "collocation", "rk"):
            row = ""
            for tolerance in TOLERANCES:
                best = mo.simulate(robot, torque, wanted.q[0], wanted.qd[0], grid,
                                   integrator=name, tolerance=tolerance)  # fmt: skip
                error = np.degrees(np.abs(best.q[-1] - wanted.q[-1]).max())
                row += f"{error:10.1e} ({1e3 * best.wall_time:5.1f}) "
            print(f"  {name:12s}{row}" + ("" if best.ok else f" {best.status}"))
        sampled = mo.simulate(robot, motion.resample(1 / STEP).tau, wanted.q[0], t=grid)
        curves = [
            Curve.of(motion),
            Curve.of(best, "Runge-Kutta, tolerance 1e-12"),
            Curve.of(sampled, "torques each 0.05 s, linear between"),
            euler(robot, motion, STEP),
            reports_euler(motion),
        ]
        title = "Part 4b: forward dynamics (report, figures 8 to 10)"
        figure = joints_figure(
            robot, curves, ("q", "qd", "qdd"), title=title, bounds={"q": 300.0}, base=True
        )
        written = save_figures({"forward": figure}, arguments.out)
    except (mo.InputError, OSError) as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 2
    print("beside them, error of q at 2 s of each joint, deg:")
    for curve in [*curves[2:], euler(robot, motion, 0.005), euler(robot, motion, 0.0005)]:
        error = np.degrees(curve.values["q"][-1] - wanted.q[-1])
        print(f"  {curve.label:38s}" + "".join(f"{value:12.4f}" for value in error))
    print("why the report differs: its loop steps by the elapsed time, not by 0.05 s; its")
    print(
        "  acceleration is M^-1 M qdd, the given one, so its torques are only plotted; g = 0 here"
    )
    print("  but 9.8 in part 4a; its start of 0.8 rad is put in by hand (right: -0.7854 rad)")
    print(f"{len(written)} files in {arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
