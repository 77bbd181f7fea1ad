"""Inverse kinematics: every branch of the Microbot for a position, by two methods and by formula.

Part 2 of the course report: the four arm postures that reach (3, -1, 4.5), computed by
Gauss-Newton from many starts, by an NLP with IPOPT, and by the report's law of cosines.

    python problems/02_inverse_kinematics.py --position 3,-1,4.5
    python problems/02_inverse_kinematics.py --position=9,0,2 --seed-deg 0,30,-30
"""

from __future__ import annotations

import argparse

import numpy as np

import microbot_ocp as mo
import script
from microbot_ocp.inverse_kinematics import branches_by_nlp, elbow_arm_branches
from symbolic import matrix_text


def unit(robot: mo.Robot) -> np.ndarray:
    """Return the display factor of each joint: 180/pi (deg) if revolute, 1 (m) if prismatic."""
    return np.where(np.array(robot.joint_types) == "revolute", 180 / np.pi, 1.0)


def shown(robot: mo.Robot, q: np.ndarray) -> str:
    return "  ".join(f"{round(x, 4) + 0.0:10.4f}" for x in q * unit(robot))


def apart(q: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the largest joint difference to each row of ``others``, modulo a full turn, rad."""
    return np.abs((q - others + np.pi) % (2 * np.pi) - np.pi).max(axis=1)


def show(robot: mo.Robot, position: np.ndarray) -> None:
    solutions = list(mo.solve_ik_all(robot, position))
    if not solutions[0].solved:
        print(f"{solutions[0].status}: {solutions[0].advice}")
        print(f"  nearest pose [deg] {shown(robot, solutions[0].q)}")
        return
    by_nlp = branches_by_nlp(robot, position)
    continuum = " points of the continuum" if solutions[0].self_motion else ""
    print(f"{len(solutions)} branches by Gauss-Newton, {len(by_nlp)}{continuum} by the NLP\n")
    others = {"to NLP [rad]": by_nlp}
    if robot.name == "microbot":  # the closed form and its order hold for this arm only
        formula = others["to formula [rad]"] = elbow_arm_branches(position)
        solutions.sort(key=lambda solution: int(np.argmin(apart(solution.q, formula))))
    heads = "   ".join(f"{head:>16}" for head in ("position error [m]", *others))
    print("  joint positions [deg]".ljust(12 * robot.joint_count + 2) + heads)
    for solution in solutions:
        sizes = [solution.position_error, *(apart(solution.q, q).min() for q in others.values())]
        print(f"  {shown(robot, solution.q)}   " + "   ".join(f"{size:16.1e}" for size in sizes))
    for k, solution in enumerate(solutions, 1):
        print(f"\nsolution {k}, by forward kinematics: {solution.advice}")
        print(matrix_text(solution.pose))


def main(arguments: argparse.Namespace) -> None:
    robot = mo.load_robot(arguments.robot)
    position = script.numbers("position", arguments.position, 3)
    given = arguments.seed_deg
    seed = script.numbers("seed-deg", given, robot.joint_count) / unit(robot) if given else None
    print(f"{robot.name}: tool to ({', '.join(f'{x:g}' for x in position)}) m")
    show(robot, position)
    if seed is not None:
        nearest = mo.solve_ik(robot, position, seed=seed)
        print(f"\nnearest to the seed [deg] {shown(robot, nearest.q)}   {nearest.status}")


if __name__ == "__main__":
    options = script.parser(__doc__)
    options.add_argument("--position", default="3,-1,4.5", help="tool position x,y,z in base, m")
    options.add_argument("--robot", default="microbot", help="packaged robot or a robot file")
    options.add_argument("--seed-deg", help="show the branch nearest to these (prismatic: m)")
    script.run(main, options)
