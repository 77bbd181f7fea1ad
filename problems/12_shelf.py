"""Motion between two compartments of a shelf: UR5e and Panda as their URDF files describe them.

Links, joints, masses and limits come from the files that `airo-models` and `example-robot-data`
ship; capsules are fitted to their collision geometry. The script draws random poses with the tool
in each compartment and takes the pair with the smallest joint distance as start and goal, which
keeps the posture of the arm. Needs the extras `arms`, `cell` and `urdf`.

example: python problems/12_shelf.py --out out/12
"""

from __future__ import annotations

import argparse
import time
import warnings
from importlib import metadata

import numpy as np

import microbot_ocp as mo
import script
from microbot_ocp.scene import Surroundings

# package, URDF file in it, tip link, and distance of the shelf from the base, m
ARMS = {
    "ur5e": ("airo-models", "arms/ur5e/ur5e.urdf", None, 0.62),
    "panda": ("example-robot-data", "panda_description/urdf/panda.urdf", "panda_hand", 0.5),
}
HEIGHTS = (0.26, 0.68)  # height of the middle of each compartment, m
POSES = 50_000  # random poses drawn at a time
ENOUGH = 40  # free poses to collect in each compartment


def shelf(x: float) -> mo.Scene:
    """Return three boards with a back, their front edges at ``x`` (m), and the floor."""
    boards = [
        mo.Box([0.4, 1.0, 0.02], [x + 0.2, 0.0, 0.05 + 0.42 * k], f"board {k + 1}")
        for k in range(3)
    ]
    back = mo.Box([0.02, 1.0, 0.86], [x + 0.41, 0.0, 0.47], "back")
    return mo.Scene([*boards, back, mo.HalfSpace(offset=-0.4, name="floor")], clearance=0.005)


def ends(robot: mo.Robot, scene: mo.Scene, x: float) -> np.ndarray:
    """Return two poses [2,n], one in each compartment, that are near in joint space."""
    around, random = Surroundings(robot, scene), np.random.default_rng(1)
    low = np.maximum(robot.limits.q_min, -np.pi)
    high = np.minimum(robot.limits.q_max, np.pi)
    inside = []
    for height in HEIGHTS:
        free: list[np.ndarray] = []
        while len(free) < ENOUGH:
            q = random.uniform(low, high, (POSES, robot.joint_count))
            tool = np.array(mo.forward_kinematics(robot)(q.T)).T.reshape(-1, 4, 4)[:, 3, :3]
            near = np.abs(tool - [x + 0.16, 0.0, height]) < [0.05, 0.2, 0.08]
            free += [pose for pose in q[near.all(axis=1)] if around.is_free(pose)]
        inside.append(np.array(free))
    first, second = inside
    apart = np.abs(first[:, None] - second).max(axis=2)
    start, goal = np.unravel_index(apart.argmin(), apart.shape)
    return np.array([first[start], second[goal]])


def load(arm: str) -> mo.Robot:
    """Load the arm from its URDF file and fit capsules to its collision geometry."""
    package, name, tip, _ = ARMS[arm]
    try:
        files = metadata.files(package) or []
    except metadata.PackageNotFoundError:
        raise mo.InputError(
            f"the file of {arm} needs the package {package}: pip install -e '.[arms]'"
        ) from None
    path = next(file for file in files if str(file).endswith(name)).locate()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mo.robot.RobotFileWarning)
        robot = mo.load_robot(str(path), tip)
    return robot.with_capsules(mo.fit_capsules(robot))


def main(arguments: argparse.Namespace) -> None:
    arguments.out.mkdir(parents=True, exist_ok=True)
    for arm in ARMS if arguments.arm == "both" else [arguments.arm]:
        robot, scene = load(arm), shelf(ARMS[arm][-1])
        via_q = ends(robot, scene, ARMS[arm][-1])
        begin = time.process_time()
        motion = mo.time_optimal(robot, via_q, scene=scene)
        spent = time.process_time() - begin
        told = motion.provenance
        if "paths" not in told:
            print(f"{arm}: {motion.advice}")
            continue
        certificate = mo.certify(robot, motion, via_q=via_q, scene=scene)
        paths = ", ".join(f"{path['duration']:.3f} s" for path in told["paths"])
        print(
            f"{arm}: {motion.status}, {motion.duration:.3f} s; paths around with their best "
            f"timing {paths}; {spent:.1f} s of processor time\n{certificate.verdict}",
            flush=True,
        )
        motion.to_rerun(robot, arguments.out / f"{arm}.rrd", scene)


if __name__ == "__main__":
    parser = script.parser(__doc__)
    parser.add_argument("--out", type=script.Path, default=script.Path("out/12"), help="folder")
    parser.add_argument("--arm", choices=[*ARMS, "both"], default="both")
    script.run(main, parser)
