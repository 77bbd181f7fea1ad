"""A user-defined limit: the speed of the tool is halved inside a zone around a person.

The limit takes ten lines. Free motions, path timing and time scaling keep it, the certificate
checks it, and tables and figures show it.

example: python problems/11_own_limit.py --out out/11
"""

from __future__ import annotations

import argparse

import casadi as ca

import microbot_ocp as mo
import script
from course_report import VIA_Q
from microbot_ocp.robot import MotionState

PERSON = [2.0, -4.0, 4.0]  # position in base, m


def speed(state: MotionState) -> ca.SX:
    return ca.norm_2(state.tool_velocity[:3])


def allowed(state: MotionState) -> ca.SX:
    """Return the allowed tool speed, m/s: 8 far from the person, 4 near the person."""
    distance = ca.norm_2(state.tool[:3, 3] - ca.DM(PERSON))
    return 6.0 + 2.0 * ca.tanh(2.0 * (distance - 2.5))


ZONE = mo.Limit("tool speed near a person", speed, upper=allowed, unit="m/s")


def main(arguments: argparse.Namespace) -> None:
    plain = mo.load_robot(arguments.robot)
    robot = plain.with_limits(also=[ZONE])
    shape = mo.quintic(VIA_Q, [0.0, 1.0, 2.0])
    motions = {
        "free": mo.time_optimal(robot, VIA_Q),
        "path": mo.time_optimal_path(robot, shape),
        "shape": mo.Motion.from_polynomial(
            robot, mo.shortest_duration(robot, shape).polynomial, label="quintic, scaled"
        ),
    }
    careless = mo.time_optimal(plain, VIA_Q)
    print(f"without the zone {careless.duration:.3f} s: {mo.certify(robot, careless).verdict}")
    for name, motion in motions.items():
        certificate = mo.certify(robot, motion)
        print(f"{name:5s} {motion.duration:.3f} s: {certificate.verdict}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    mo.plots.limit_use(robot, motions["free"]).savefig(arguments.out / "limit_use.png")
    motions["free"].to_rerun(robot, arguments.out / "free.rrd")


if __name__ == "__main__":
    script.run(main, script.parser(__doc__, "out/11"))
