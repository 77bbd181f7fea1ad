"""Part 6: computed-torque control of the report's exponential motion, ideal and disturbed.

The arm starts at rest at q = 0, the motion at -45 deg (at_i = 0, atd_i = 0 in the report's code).
The report's gain is kp = 0.1; here kp = 100 and a sweep of gains. The disturbances of the second
table are not from the report; those runs start on the motion.

example: python problems/06_computed_torque.py --out out/06 --kp 100
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

import numpy as np

import course_report
import microbot_ocp as mo
import script

SWEEP = (0.1, 1.0, 10.0, 25.0, 100.0, 400.0)  # kp, 1/s^2; the report uses the first
NOISE = mo.simulation.SensorNoise(q=np.radians(0.05), qd=np.radians(1.0), seed=1)
SHARE = 0.8  # torque limit as a fraction of the peak torque of the motion
GIVEN: dict[str, Any] = {"duration": course_report.DURATION, "saturation": False}


def changed(robot: mo.Robot, mass: float = 1.0, **friction: float) -> mo.Robot:
    """Return the arm with scaled masses or other friction."""
    return robot.with_links([replace(k, mass=mass * k.mass, **friction) for k in robot.links])


def troubles(robot: mo.Robot, peak: np.ndarray) -> dict[str, dict[str, Any]]:
    """Return the disturbances that the report leaves out, as arguments of ``track``."""
    sampled, noisy = {"sample_rate": 100.0}, {"noise": NOISE}
    return {
        "ideal": {},
        f"torque limits at {100 * SHARE:.0f} % of the peak": {"saturation": SHARE * peak},
        "masses 20 % larger": {"plant": changed(robot, 1.2)},
        "viscous friction 10 N m s/rad": {"plant": changed(robot, viscous_friction=10.0)},
        "Coulomb friction 10 N m": {"plant": changed(robot, coulomb_friction=10.0)},
        "sampled at 1 kHz": {"sample_rate": 1000.0},
        "sampled at 100 Hz": sampled,
        "1 kHz, noise 0.05 deg, 1 deg/s": {"sample_rate": 1000.0, **noisy},
        "100 Hz, noise 0.05 deg, 1 deg/s": {**sampled, **noisy, "tolerance": 1e-6},
    }


def sweep_gains(robot: mo.Robot) -> dict[float, mo.simulation.Tracking]:
    """Return one run per gain from a start 45 deg off, and print the closed form of the error."""
    print(
        "start error -45 deg, exact model, no limits; kv = 2 sqrt(kp); any joint (all are alike):"
    )
    print("  kp [1/s^2]   error at 2 s [deg]   closed form [deg]   largest difference [rad]")
    runs = {}
    for kp in SWEEP:
        run = runs[kp] = mo.track(
            robot,
            course_report.motion,
            mo.ComputedTorque(kp),
            q0=np.zeros(robot.joint_count),
            **GIVEN,
        )
        decay = np.sqrt(kp) * run.t[:, None]
        exact = run.error[0] * (1 + decay) * np.exp(-decay)
        ends, worst = np.degrees([run.error[-1, 0], exact[-1, 0]]), np.abs(run.error - exact).max()
        print(f"  {kp:10g} {ends[0]:20.6g} {ends[1]:19.6g} {worst:26.1e}")
    return runs


def compare_integrators(robot: mo.Robot, kp: float) -> None:
    """Print the error of CasADi's integrators of the closed loop against the closed form."""
    start = np.zeros(robot.joint_count)
    print(f"the closed loop with kp = {kp:g} by each integrator of CasADi, tolerance 1e-8:")
    print("  integrator    largest difference from the closed form [rad]   wall time [ms]")
    for name in ("cvodes", "idas", "collocation", "rk"):
        run = mo.track(
            robot, course_report.motion, mo.ComputedTorque(kp), q0=start, integrator=name,
            tolerance=1e-8, **GIVEN,
        )  # fmt: skip
        decay = np.sqrt(kp) * run.t[:, None]
        off = np.abs(run.error - run.error[0] * (1 + decay) * np.exp(-decay)).max()
        print(f"  {name:12s} {off:20.1e} {1e3 * run.wall_time:42.1f}   {run.status}")


def compare_rivals(
    robot: mo.Robot, kp: float, motion: mo.Motion
) -> dict[str, mo.simulation.Tracking]:
    """Print every disturbance by every controller; return the runs of computed torque."""
    # Gains times the diagonal of M at the start give PD the stiffness of computed torque there.
    inertia = np.diag(mo.mass_matrix(robot)(motion.q[0]).full())
    proportional = mo.PDGravity(kp * inertia, 2 * kp**0.5 * inertia)
    rivals = (mo.ComputedTorque(kp), proportional, mo.Feedforward())
    print("starting on the motion; RMS and peak error of the worst joint, deg:")
    print(f"  {'':32s}" + "".join(f"{rival.label:^24s}" for rival in rivals))
    shown, notes = {}, []
    for case, change in troubles(robot, np.abs(motion.tau).max(axis=0)).items():
        row = ""
        for rival in rivals:
            run = mo.track(robot, course_report.motion, rival, **{**GIVEN, **change})
            shown.setdefault(case, run)
            rms, peak = np.degrees([run.rms.max(), run.peak.max()])
            row += f"{rms:11.4f}{peak:11.4f}" + ("  " if run.solved else " !")
            if not run.solved or run.advice:
                notes.append(f"  ! {rival.label}, {case}: {run.status}; {run.advice}")
        print(f"  {case:32s}{row}")
    print("\n".join(notes), end="\n" if notes else "")
    return shown


def main(arguments: argparse.Namespace) -> None:
    robot = mo.load_robot(arguments.robot)
    law = mo.ComputedTorque(arguments.kp)
    motion = mo.simulation.motion_from_formula(
        robot, course_report.motion, course_report.DURATION, label="motion"
    )
    sweep = sweep_gains(robot)
    compare_integrators(robot, arguments.kp)
    cases = compare_rivals(robot, arguments.kp, motion)
    start = np.zeros(robot.joint_count)
    own = mo.track(robot, course_report.motion, law, q0=start, **GIVEN)
    runs = [mo.plots.Curve.of(motion, "given"), mo.plots.Curve.of(own, f"kp = {arguments.kp:g}"),
            mo.plots.Curve.of(sweep[0.1], "kp = 0.1, the report's")]  # fmt: skip
    troubled = [mo.plots.Curve.of(run, case) for case, run in cases.items()]
    gains = [mo.plots.Curve.of(run, f"kp = {kp:g}") for kp, run in sweep.items()]
    quantities = ("error", "tau")
    title = "Part 6, computed torque"
    figures = {
        "tracking": mo.plots.curves(robot, runs, ("q", "qd", "qdd", "tau"), base=True,
                                  title=f"{title} from a start 45 deg off"),
        "gains": mo.plots.curves(robot, gains, ("error",), title=f"{title}: error by gain"),
        "model": mo.plots.curves(robot, troubled[:5], quantities, base=True,
                               title=f"{title}: limits and a wrong model"),
        "sampling": mo.plots.curves(robot, troubled[:4:-1], quantities,
                                  title=f"{title}: sampling and noise"),
    }  # fmt: skip
    written = mo.plots.save(figures, arguments.out)
    written.append(own.to_rerun(robot, arguments.out / "tracking.rrd"))
    print("""\
why the report differs: its feedback state is frozen at zero and its velocities and
  positions integrate the reference, so no loop is closed; kp = 0.1 settles in tens of
  seconds on a motion of 2 s; ac3 is acceleration(2)""")
    print(f"{len(written)} files in {arguments.out}")


if __name__ == "__main__":
    options = script.parser(__doc__, out="out/06")
    options.add_argument("--kp", type=float, default=100.0, help="position gain, 1/s^2")
    script.run(main, options)
