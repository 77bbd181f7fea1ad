"""Part 4a: the torques of the report's exponential motion, with gravity along Z, along Y and off.

All joints move as q(t) = 45 deg (1 + 6 exp(-t/0.3) - 8 exp(-t/0.4)). Gravity acts along the base's
Y axis in the report's code, although the base's Z axis is vertical.

example: python problems/04a_inverse_dynamics.py --out out/04a --robot microbot
"""

from __future__ import annotations

import argparse

import numpy as np

import course_report
import microbot_ocp as mo
import script


def row(values: np.ndarray) -> str:
    return "".join(f"{value:12.4f}" for value in values)


def main(arguments: argparse.Namespace) -> None:
    robot = mo.load_robot(arguments.robot)
    motions = {
        name: mo.simulation.motion_from_formula(
            robot.with_gravity(gravity),
            course_report.motion,
            course_report.DURATION,
            label=f"gravity {name}",
        )
        for name, gravity in course_report.GRAVITY.items()
    }
    form = mo.robot.closed_form(robot)
    first = next(iter(motions.values()))
    curves = [mo.plots.Curve.of(motion) for motion in motions.values()]
    title = "Part 4a: the given motion (report, figures 5 to 7)"
    given = mo.plots.curves(
        robot, [mo.plots.Curve.of(first, "given")], ("q", "qd", "qdd"), title=title
    )
    title = "Part 4a: torques (report, figure 4)"
    torques = mo.plots.curves(robot, curves, ("tau",), base=True, title=title)
    written = mo.plots.save({"motion": given, "torques": torques}, arguments.out)
    written.append(first.to_rerun(robot, arguments.out / "motion.rrd"))

    print(f"M(q) qdd + C(q, qd) qd + G(q) = tau of {robot.name}, kg m^2 and N m:")
    print("\n".join(f"  {line}" for line in form.lines()))
    degrees, start = np.degrees(first.q[0]).round(6), first.qdd[0].round(4)
    print(f"start: q = {degrees} deg, qd = {first.qd[0]} rad/s, qdd = {start} rad/s^2")
    print("torques of joints 1, 2, 3, N m (the report shows curves, no numbers):")
    print(f"  {'t [s]':>10s} " + "".join(f"{'gravity ' + name:^36s}" for name in motions))
    for t in (0.0, 0.1, 0.25, 0.5, 1.0, 2.0):
        at = int(np.abs(first.t - t).argmin())
        print(f"  {t:10.2f} " + "".join(row(motion.tau[at]) for motion in motions.values()))
    peaks = [np.abs(motion.tau).max(axis=0) for motion in motions.values()]
    print("  " + f"{'peak |tau|':>10s} " + "".join(row(peak) for peak in peaks))
    coarse = np.abs(first.tau[::50, 0]).max()
    print(f"  (on the report's grid of 0.05 s the waist's peak is {coarse:.2f} N m)")
    print("""\
why the report differs: vd0 = [0; g; 0] in its code puts gravity along the base's Y axis;
  it takes tdd2 from td3 and N_i from the link before, which changes nothing here (all
  joints move alike, point masses have no inertia)""")
    print(f"{len(written)} files in {arguments.out}")


if __name__ == "__main__":
    script.run(main, script.parser(__doc__, out="out/04a"))
