"""Part 6: the partitioned control law on the report's exponential motion, and what may spoil it.

The arm starts at rest at q = 0, the motion at -45 deg (at_i = 0, atd_i = 0 in the report's code).
The report's gain is kp = 0.1; here kp = 100 (chosen here) and a sweep. All disturbances of the
second table are chosen here; there the arm starts on the motion.

    python problems/06_computed_torque.py --out out/06
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

import microbot_ocp as mo
from microbot_ocp.views.joint_plots import Curve, joints_figure, save_figures

DURATION = 2.0
KP = 100.0  # 1/s^2
SWEEP = (0.1, 1.0, 10.0, 25.0, 100.0, 400.0)  # the report's gain first
NOISE = mo.SensorNoise(q=np.radians(0.05), qd=np.radians(1.0), seed=1)
SHARE = 0.8  # of the torque that the motion needs at most


def report_motion(t: ca.SX) -> list[ca.SX]:
    """Positions of the three joints, rad (report, part 6)."""
    return [np.pi / 4 * (1 + 6 * ca.exp(-t / 0.3) - 8 * ca.exp(-t / 0.4))] * 3


def changed(robot: mo.Robot, mass: float = 1.0, **friction: float) -> mo.Robot:
    """The same arm with other masses or friction."""
    return robot.with_links([replace(k, mass=mass * k.mass, **friction) for k in robot.links])


def troubles(robot: mo.Robot, peak: np.ndarray) -> dict[str, dict[str, Any]]:
    """What the report leaves out, as arguments of ``track``."""
    return {
        "ideal": {},
        f"torque limits at {100 * SHARE:.0f} % of the peak": {"saturation": SHARE * peak},
        "masses 20 % larger": {"plant": changed(robot, 1.2)},
        "viscous friction 10 N m s/rad": {"plant": changed(robot, viscous_friction=10.0)},
        "Coulomb friction 10 N m": {"plant": changed(robot, coulomb_friction=10.0)},
        "sampled at 1 kHz": {"sample_rate": 1000.0},
        "sampled at 100 Hz": {"sample_rate": 100.0},
        "1 kHz, noise 0.05 deg, 1 deg/s": {"sample_rate": 1000.0, "noise": NOISE},
        "100 Hz, noise 0.05 deg, 1 deg/s": {
            "sample_rate": 100.0,
            "noise": NOISE,
            "tolerance": 1e-6,
        },
    }


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog="example: python problems/06_computed_torque.py --out out/06 --kp 100",
    )
    parser.add_argument("--out", type=Path, default=Path("out/06"), help="folder to write into")
    parser.add_argument("--robot", default="microbot", help="packaged 3-joint robot or .toml file")
    parser.add_argument("--kp", type=float, default=KP, help="position gain, 1/s^2")
    arguments = parser.parse_args()
    try:
        law = mo.ComputedTorque(arguments.kp)
        robot = mo.load_robot(arguments.robot)
        count = robot.joint_count
        motion = mo.motion_from_formula(robot, report_motion, DURATION, label="motion")
        given: dict[str, Any] = {"duration": DURATION, "saturation": False}
        start = {**given, "q0": np.zeros(count)}
        sweep = {kp: mo.track(robot, report_motion, mo.ComputedTorque(kp), **start) for kp in SWEEP}
        main_run = mo.track(robot, report_motion, law, **start)
        # As stiff as computed torque with the arm's inertia at the start, each joint by itself.
        inertia = np.diag(mo.mass_matrix(robot)(motion.q[0]).full())
        rivals = (law, mo.PDGravity(arguments.kp * inertia, 2 * arguments.kp**0.5 * inertia),
                  mo.Feedforward())  # fmt: skip
        cases = troubles(robot, np.abs(motion.tau).max(axis=0))
        runs = {
            (case, rival.label): mo.track(robot, report_motion, rival, **{**given, **change})
            for case, change in cases.items()
            for rival in rivals
        }
        curves = [Curve.of(motion, "given"), Curve.of(main_run, f"kp = {arguments.kp:g}"),
                  Curve.of(sweep[0.1], "kp = 0.1, the report's")]  # fmt: skip
        shown = [Curve.of(runs[case, law.label], case) for case in cases]
        gains = [Curve.of(run, f"kp = {kp:g}") for kp, run in sweep.items()]
        title = "Part 6, computed torque"
        figures = {
            "tracking": joints_figure(robot, curves, ("q", "qd", "qdd", "tau"), base=True,
                                      title=f"{title} from a start 45 deg off"),
            "gains": joints_figure(robot, gains, ("error",), title=f"{title}: error by gain"),
            "model": joints_figure(robot, shown[:5], ("error", "tau"), base=True,
                                   title=f"{title}: limits and a wrong model"),
            "sampling": joints_figure(robot, shown[:4:-1], ("error", "tau"),
                                      title=f"{title}: sampling and noise"),
        }  # fmt: skip
        written = save_figures(figures, arguments.out)
    except (mo.InputError, OSError) as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 2
    print(
        "start error -45 deg, exact model, no limits; kv = 2 sqrt(kp); any joint (all are alike):"
    )
    print("  kp [1/s^2]   error at 2 s [deg]   closed form [deg]   largest difference [rad]")
    for kp, run in sweep.items():
        w = np.sqrt(kp)
        exact = run.error[0] * (1 + w * run.t[:, None]) * np.exp(-w * run.t[:, None])
        ends, worst = np.degrees([run.error[-1, 0], exact[-1, 0]]), np.abs(run.error - exact).max()
        print(f"  {kp:10g} {ends[0]:20.6g} {ends[1]:19.6g} {worst:26.1e}")
    print("starting on the motion; RMS and peak error of the worst joint, deg:")
    print(f"  {'':32s}" + "".join(f"{rival.label:^24s}" for rival in rivals))
    for case in cases:
        row = ""
        for rival in rivals:
            run = runs[case, rival.label]
            rms, peak = np.degrees([run.rms.max(), run.peak.max()])
            row += f"{rms:11.4f}{peak:11.4f}" + ("  " if run.ok else " !")
        print(f"  {case:32s}{row}")
    for (case, label), run in runs.items():
        if not run.ok or run.advice:
            print(f"  ! {label}, {case}: {run.status}; {run.advice}")
    print("why the report differs: its feedback state is frozen at zero and its velocities and")
    print("  positions integrate the reference, so no loop is closed; kp = 0.1 settles in tens of")
    print("  seconds on a motion of 2 s; ac3 is acceleration(2)")
    print(f"{len(written)} files in {arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
