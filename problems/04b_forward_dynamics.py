"""Part 4b: the motion recovered from its torques by four CasADi integrators and the report's Euler.

The torques are those of part 4a with gravity along Z. Every integrator evaluates them as a function
of time and solves M(q) qdd = tau - C qd - G at the integrated state.

example: python problems/04b_forward_dynamics.py --out out/04b
"""

from __future__ import annotations

import argparse

import casadi as ca
import numpy as np

import course_report
import microbot_ocp as mo
import script

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)


def main(arguments: argparse.Namespace) -> None:
    robot = mo.load_robot(arguments.robot)
    motion = mo.simulation.motion_from_formula(
        robot, course_report.motion, course_report.DURATION, label="given"
    )
    grid = course_report.grid()
    wanted = motion.sample(grid)

    def torque(t: ca.SX) -> ca.SX:
        q = ca.vertcat(*course_report.motion(t))
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
        print(f"  {name:12s}{row}" + ("" if best.solved else f" {best.status}"))

    def euler(step: float) -> mo.plots.Curve:
        values = {"q": course_report.euler(robot, motion, step)}
        return mo.plots.Curve(f"Euler, step {step:g} s", course_report.grid(step), values)

    sampled = mo.simulate(robot, motion.resample(1 / course_report.STEP).tau, wanted.q[0], t=grid)
    curves = [
        mo.plots.Curve.of(motion),
        mo.plots.Curve.of(best, "Runge-Kutta, tolerance 1e-12"),
        mo.plots.Curve.of(sampled, "torques each 0.05 s, linear between"),
        euler(course_report.STEP),
        mo.plots.Curve("the report's Euler loop", grid, {"q": course_report.code_euler(motion)}),
    ]
    title = "Part 4b: forward dynamics (report, figures 8 to 10)"
    shown = ("q", "qd", "qdd")
    figure = mo.plots.curves(robot, curves, shown, title=title, bounds={"q": 300.0}, base=True)
    written = mo.plots.save({"forward": figure}, arguments.out)
    recorded = best.as_motion("integrated from torques")
    written.append(recorded.to_rerun(robot, arguments.out / "forward.rrd"))
    print("beside them, error of q at 2 s of each joint, deg:")
    for curve in [*curves[2:], euler(0.005), euler(0.0005)]:
        error = np.degrees(curve.values["q"][-1] - wanted.q[-1])
        print(f"  {curve.label:38s}" + "".join(f"{value:12.4f}" for value in error))
    print("""\
why the report differs: its loop steps by the elapsed time, not by 0.05 s; its
  acceleration is M^-1 M qdd, the given one, so its torques are only plotted; g = 0 here
  but 9.8 in part 4a; its start of 0.8 rad is put in by hand (right: -0.7854 rad)""")
    print(f"{len(written)} files in {arguments.out}")


if __name__ == "__main__":
    script.run(main, script.parser(__doc__, out="out/04b"))
