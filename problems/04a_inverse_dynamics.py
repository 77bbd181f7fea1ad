"""Part 4a: the torques of the report's exponential motion, with gravity along Z, along Y and off.

All joints move as q(t) = 45 deg (1 + 6 exp(-t/0.3) - 8 exp(-t/0.4)). The report's code lets gravity
act along the base's Y axis; the base's Z axis is the vertical one.

    python problems/04a_inverse_dynamics.py --out out/04a
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import casadi as ca
import numpy as np

import microbot_ocp as mo
from microbot_ocp.closed_form import closed_form
from microbot_ocp.views.joint_plots import Curve, joints_figure, save_figures

DURATION = 2.0
GRAVITY = {  # acceleration of free fall, base frame
    "along Z (right)": (0.0, 0.0, -9.8),
    "along Y (report's code)": (0.0, -9.8, 0.0),
    "off": (0.0, 0.0, 0.0),
}


def report_motion(t: ca.SX) -> list[ca.SX]:
    """Positions of the three joints, rad (report, part 4a)."""
    return [np.pi / 4 * (1 + 6 * ca.exp(-t / 0.3) - 8 * ca.exp(-t / 0.4))] * 3


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog="example: python problems/04a_inverse_dynamics.py --out out/04a --robot microbot",
    )
    parser.add_argument("--out", type=Path, default=Path("out/04a"), help="folder to write into")
    parser.add_argument("--robot", default="microbot", help="packaged 3-joint robot or .toml file")
    arguments = parser.parse_args()
    try:
        robot = mo.load_robot(arguments.robot)
        motions = {
            name: mo.motion_from_formula(
                robot.with_gravity(gravity), report_motion, DURATION, label=f"gravity {name}"
            )
            for name, gravity in GRAVITY.items()
        }
        form = closed_form(robot)
        first = next(iter(motions.values()))
        curves = [Curve.of(motion) for motion in motions.values()]
        figures = {
            "motion": joints_figure(
                robot, [Curve.of(first, "given")], ("q", "qd", "qdd"),
                title="Part 4a: the given motion (report, figures 5 to 7)",
            ),
            "torques": joints_figure(
                robot, curves, base=True, title="Part 4a: torques (report, figure 4)"
            ),
        }  # fmt: skip
        written = save_figures(figures, arguments.out)
    except (mo.InputError, OSError) as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 2
    print(f"M(q) qdd + C(q, qd) qd + G(q) = tau of {robot.name}, kg m^2 and N m:")
    print("\n".join(f"  {line}" for line in form.lines()))
    print(f"start: q = {np.degrees(first.q[0]).round(6)} deg, qd = {first.qd[0]} rad/s, "
          f"qdd = {first.qdd[0].round(4)} rad/s^2")  # fmt: skip
    print("torques of joints 1, 2, 3, N m (the report shows curves, no numbers):")
    print(f"  {'t [s]':>10s} " + "".join(f"{'gravity ' + name:^36s}" for name in motions))
    for t in (0.0, 0.1, 0.25, 0.5, 1.0, 2.0):
        at = int(np.abs(first.t - t).argmin())
        row = "".join("".join(f"{v:12.4f}" for v in motion.tau[at]) for motion in motions.values())
        print(f"  {t:10.2f} {row}")
    peaks = [np.abs(motion.tau).max(axis=0) for motion in motions.values()]
    print("  " + f"{'peak |tau|':>10s} " + "".join("".join(f"{v:12.4f}" for v in p) for p in peaks))
    coarse = np.abs(first.tau[::50, 0]).max()
    print(f"  (on the report's grid of 0.05 s the waist's peak is {coarse:.2f} N m)")
    print(
        "why the report differs: vd0 = [0; g; 0] in its code puts gravity along the base's Y axis;"
    )
    print("  it takes tdd2 from td3 and N_i from the link before, which changes nothing here (all")
    print("  joints move alike, point masses have no inertia)")
    print(f"{len(written)} files in {arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
