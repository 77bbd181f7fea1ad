"""Velocity propagation from link to link, checked against the Jacobian, and static torques.

Part 3 of the course report: Craig's example 5.3 in symbols, and the Microbot in numbers beside
the figures that the report prints.

    python problems/03_velocity_propagation.py --theta-deg -18.43,-29.18,-111.38 --rate-deg 35,20,45
"""

from __future__ import annotations

import argparse

import numpy as np

import microbot_ocp as mo
import script
from report_tables import PRINTED_ANGULAR, PRINTED_LINEAR
from symbolic import symbolic_row, symbolic_velocities

THETA, RATE = "-18.43,-29.18,-111.38", "35,20,45"
PRINTED_OMEGA, PRINTED_V = (
    np.array([row.split() for row in text.split("; ")], float)
    for text in (PRINTED_ANGULAR, PRINTED_LINEAR)
)


def row(values: np.ndarray) -> str:
    return "[" + " ".join(f"{round(float(x), 4) + 0.0:8.4f}" for x in values) + " ]"


def show_symbols() -> None:
    print("Part 3.1, Craig's example 5.3: two links, frame 3 at the tip of link 2")
    rows = [symbolic_row(0, 0, 0, joint=1), symbolic_row(0, "L1", 0, joint=2)]
    rows.append(symbolic_row(0, "L2", 0))
    for i, (v, omega) in enumerate(symbolic_velocities(rows, ["qd1", "qd2", None]), 1):
        print(f"  omega{i} = [{', '.join(map(str, omega))}]   v{i} = [{', '.join(map(str, v))}]")
    print("  report: omega3 = qd1 + qd2 + qd3; but frame 3 is fixed to link 2 (Craig): no qd3.\n")


def show_numbers(q: np.ndarray, qd: np.ndarray, force: np.ndarray) -> None:
    robot = mo.load_robot("microbot")
    v, omega = (np.array(x) for x in mo.velocity_propagation(robot)(q, qd))
    printed = np.array_equal([q, qd], np.radians([script.numbers("", x, 3) for x in (THETA, RATE)]))
    print(f"Part 3.2, Microbot at {np.degrees(q).round(4).tolist()} deg, each in its own frame")
    for name, ours, theirs in (("omega", omega, PRINTED_OMEGA), ("v", v, PRINTED_V)):
        for i in range(4):
            beside = f"   report {row(theirs[i])}" if printed else ""
            wrong = printed and np.abs(ours[:, i] - theirs[i]).max() > 2e-3
            beside += "  misprint of the sign: its own v4 needs -1.6" if wrong else ""
            print(f"  {name}{i + 1:<{6 - len(name)}} {row(ours[:, i])}{beside}")
    pose, jacobian = np.array(mo.forward_kinematics(robot)(q)), np.array(mo.jacobian(robot)(q))
    twist = jacobian @ qd
    turned = np.concatenate([pose[:3, :3] @ v[:, 3], pose[:3, :3] @ omega[:, 3]])
    print(f"  tool at    {row(pose[:3, 3])} m")
    if printed:
        print("    report: (3, -1, 4.5), which theta3 = +111.38 reaches, not -111.38")
    print(f"  in base    v = {row(twist[:3])}   omega = {row(twist[3:])} by the Jacobian")
    print(f"  propagation and Jacobian differ by {np.abs(twist - turned).max():.1e}")
    singular = np.linalg.svd(jacobian[:3], compute_uv=False)
    condition = singular[0] / singular[-1] if singular[-1] > 1e-12 * singular[0] else np.inf
    print(f"  manipulability {np.prod(singular):.4f} m^3, condition number {condition:.4f}")
    torque = jacobian[:3].T @ force
    print(f"  force of the tool {row(force)} N in base: torques J'f = {row(torque)} N m")
    print(f"  power by force {force @ twist[:3]:.6f} W, by torque {torque @ qd:.6f} W")


def main(arguments: argparse.Namespace) -> None:
    names = ("theta_deg", "rate_deg", "force")
    theta, rate, force = (script.numbers(n, getattr(arguments, n), 3) for n in names)
    show_symbols()
    show_numbers(np.radians(theta), np.radians(rate), force)


if __name__ == "__main__":
    options = script.parser(__doc__)
    options.add_argument("--theta-deg", default=THETA, help="joint angles, deg")
    options.add_argument("--rate-deg", default=RATE, help="joint speeds, deg/s")
    options.add_argument("--force", default="0,0,10", help="force of the tool on its surroundings")
    script.run(main, options)
