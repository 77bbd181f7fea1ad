"""From one compartment of a shelf into the next: UR5e and Panda as their URDF files describe them.

``python -m benchmarks.shelf`` takes links, joints, masses and limits from the files that
``airo-models`` and ``example-robot-data`` ship, fits capsules to their collision geometry, plans,
certifies and prints a row for each. ``--rerun FOLDER`` writes recordings with the shelf.
"""

from __future__ import annotations

import argparse
import time
import warnings
from importlib import metadata
from pathlib import Path

import numpy as np

import microbot_ocp as mo
from microbot_ocp.scene import Surroundings

FILES = (
    ("airo-models", "arms/ur5e/ur5e.urdf", None, 0.62),
    ("example-robot-data", "panda_description/urdf/panda.urdf", "panda_hand", 0.5),
)


def shelf(x: float) -> mo.Scene:
    """Three boards with a back, their front edges at ``x``, and the floor."""
    boards = [
        mo.Box([0.4, 1.0, 0.02], [x + 0.2, 0.0, 0.05 + 0.42 * k], f"board {k + 1}")
        for k in range(3)
    ]
    back = mo.Box([0.02, 1.0, 0.86], [x + 0.41, 0.0, 0.47], "back")
    return mo.Scene([*boards, back, mo.HalfSpace(offset=-0.4, name="floor")], clearance=0.005)


def ends(robot: mo.Robot, scene: mo.Scene, x: float) -> np.ndarray:
    """A pose with the tool in each compartment, the arm clear."""
    around, random = Surroundings(robot, scene), np.random.default_rng(1)
    low = np.maximum(robot.limits.q_min, -np.pi)
    high = np.minimum(robot.limits.q_max, np.pi)
    found = []
    for height in (0.26, 0.68):
        while len(found) < 2:
            q = random.uniform(low, high, (50_000, robot.joint_count))
            tool = np.array(mo.forward_kinematics(robot)(q.T)).T.reshape(-1, 4, 4)[:, 3, :3]
            near = np.abs(tool - [x + 0.08, 0.0, height]) < [0.06, 0.2, 0.05]
            free = next((p for p in q[near.all(axis=1)] if around.is_free(p)), None)
            if free is not None:
                found.append(free)
                break
    return np.array(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rerun", type=Path, help="folder for recordings")
    options = parser.parse_args()
    for package, name, tip, x in FILES:
        path = next(f for f in metadata.files(package) or [] if str(f).endswith(name)).locate()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", mo.RobotFileWarning)
            robot = mo.load_robot(str(path), tip)
        robot = robot.with_capsules(mo.fit_capsules(robot))
        scene = shelf(x)
        via_q = ends(robot, scene, x)
        begin = time.process_time()
        motion = mo.time_optimal(robot, via_q, scene=scene, compiled=False)
        spent = time.process_time() - begin
        certificate = mo.certify(robot, motion, via_q=via_q, scene=scene)
        timed = [path["duration"] for path in motion.provenance.get("paths", ())]
        if not timed:
            print(f"{robot.name}: {motion.status}, {motion.provenance['advice']}")
            continue
        print(
            f"{robot.name}: {motion.status}, {motion.duration:.3f} s; best timing of a path "
            f"{min(timed):.3f} s; {spent:.1f} s of processor time\n{certificate.verdict}",
            flush=True,
        )
        if options.rerun:
            motion.to_rerun(robot, options.rerun / f"{robot.name}_shelf.rrd", scene)


if __name__ == "__main__":
    main()
