"""Part 5: textbook trajectories through the report's via points: cubic, LSPB, quintic, splines.

Via points (0, 0, 0), (-8, 45, 30), (-90, 90, 90) deg at 0, 2, 4 s, via velocity (10, 40, 20) deg/s,
blend time 0.5 s, as in the report's code. The splines choose the velocity at the via point.

example: python problems/05_baselines.py --out out/05
"""

from __future__ import annotations

import argparse

import numpy as np

import microbot_ocp as mo
import script
from course_report import BLEND, PEAKS, VIA_Q, VIA_QD, VIA_T

SHAPES = {
    "cubic": mo.cubic(VIA_Q, VIA_T, VIA_QD),
    "LSPB": mo.lspb(VIA_Q, VIA_T, BLEND, VIA_QD),
    "quintic": mo.quintic(VIA_Q, VIA_T, VIA_QD),
    "clamped spline": mo.spline(VIA_Q, VIA_T, "clamped"),
    "natural spline": mo.spline(VIA_Q, VIA_T, "natural"),
}


def triple(values: np.ndarray, form: str = "9.3f") -> str:
    """Format the values of the three joints as columns."""
    return "".join(f"{value:{form}}" for value in values)


def main(arguments: argparse.Namespace) -> None:
    robot = mo.load_robot(arguments.robot)
    motions = {k: mo.Motion.from_polynomial(robot, v, label=k) for k, v in SHAPES.items()}
    curves = [mo.plots.Curve.of(motion) for motion in motions.values()]
    figures = {
        f"joint_{j + 1}": mo.plots.curves(
            robot,
            curves,
            ("q", "qd", "qdd"),
            joints=[j],
            via=(VIA_T, VIA_Q),
            title=f"Part 5, joint {j + 1}",
        )
        for j in range(robot.joint_count)
    }
    figures["torques"] = mo.plots.curves(robot, curves, ("tau",), title="Part 5: torques")
    written = mo.plots.save(figures, arguments.out)
    for name in PEAKS:
        path = arguments.out / f"{name.lower()}.rrd"
        written.append(motions[name].to_rerun(robot, path))

    print("via point at 2 s, and the jump of the acceleration there (deg/s, rad/s^2):")
    for name, shape in SHAPES.items():
        qd, qdd = shape.derivative(), shape.derivative().derivative()
        jump = (qdd(2.0) - qdd(2.0, from_left=True))[0].round(9) + 0.0
        print(f"  {name:16s} qd{triple(np.degrees(qd(2.0)[0]))}   jump{triple(jump)}")
    print("peaks of joints 1, 2, 3, both sides of every jump counted:")
    print(f"  {'':16s}{'|qd| [rad/s]':^27s}{'|qdd| [rad/s^2]':^27s}{'|tau| [N m]':^27s}")
    for name, motion in motions.items():
        row = "".join(triple(np.abs(v).max(axis=0)) for v in (motion.qd, motion.qdd, motion.tau))
        print(f"  {name:16s}{row}")
        if name in PEAKS:
            tau, speed = (triple(np.array(peak)) for peak in PEAKS[name])
            print(f"    {'recomputed':14s}{speed}{'':27s}{tau}")
    print("""\
why the report differs: the signs of (v0 + vf) in its text's a3 and V are wrong, its code
  is right; it says no word of the jumps at 2 s, (-3.05, -0.44, 0.96) rad/s^2 of the cubic
  and (-2.91, -1.16, 0.47) of the LSPB; quintic and splines have none; the natural spline
  starts and ends at full speed, so no arm at rest can follow it""")
    print(f"{len(written)} files in {arguments.out}")


if __name__ == "__main__":
    script.run(main, script.parser(__doc__, out="out/05"))
