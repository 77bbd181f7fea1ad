"""Published tasks among obstacles: ``python -m benchmarks published``.

1. Dissanayake, Goh and Phan-Thien (Robotica 9, 1991): two links of 0.4 m and 0.5 kg, 0.1 kg m^2 and
   10 N m in a level plane, from (0, -2) to (1, -1) rad. Their task has no obstacle; the disc of
   0.06 m at (0.5, 0.15) m is ours, kept clear of capsules of 0.03 m along the links. The answer is
   compared with a transcription that shares no code with the package.
2. Robot Arm Cycle Time Optimization of Frontier-Engineering (arXiv:2604.12290,
   github.com/EinsiaLab/Frontier-Engineering): a KUKA LBR iiwa beside a box, limits of velocity and
   acceleration, no torques. Robot and collision meshes are those of the package ``pybullet``
   (``pip install pybullet``); the motion is judged by the rules of the task: a clamped cubic spline
   through points, 30 samples between two points, contacts by PyBullet.
"""

from __future__ import annotations

import argparse
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

import microbot_ocp as mo
from microbot_ocp import Table

LENGTH, MASS, INERTIA, CENTRE, TORQUE = 0.4, 0.5, 0.1, 0.2, 10.0
ENDS = np.array([[0.0, -2.0], [1.0, -1.0]])
DISC, RADIUS, THICK = np.array([0.5, 0.15]), 0.06, 0.03
POINTS = 33  # points along a link
START = [0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0]
GOAL = [1.2, -0.3, 0.8, -0.8, 0.5, 0.8, 1.0]
VELOCITY, ACCELERATION = np.array([1.48, 1.48, 1.74, 1.74, 2.27, 2.27, 2.27]), 3.0
BOX_CENTER, BOX_SIZE = [0.45, -0.35, 0.65], [0.16, 0.40, 0.16]
THEIRS = 2.4224005  # duration in baseline/result_log.txt of the task, s
EXACT, SAMPLES = 1e-4, 30  # tolerance of the task's limits, and samples between two points
JERK, KNOTS = 300.0, 400  # rad/s^3, and knots of the spline so that it follows the motion
SLOWED = (1.0, 1.001, 1.002, 1.005, 1.01)


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks published", description=__doc__)
    parser.parse_args(arguments)
    _two_links()
    _iiwa()


def two_link_arm() -> mo.Robot:
    """Build Dissanayake's arm with capsules along its links."""
    link = mo.Link(MASS, [CENTRE, 0.0, 0.0], np.diag([0.0, INERTIA, INERTIA]))
    robot = mo.Robot.from_dh(
        alpha=[0.0, 0.0],
        a=[0.0, LENGTH],
        d=[0.0, 0.0],
        links=[link, link],
        limits=mo.Limits(tau_max=TORQUE),
        gravity=(0.0, 0.0, 0.0),
        tool=(0.0, LENGTH, 0.0, 0.0),
        name="two-link arm of Dissanayake",
    )
    capsule = mo.Capsule([0.0, 0.0, 0.0], [LENGTH, 0.0, 0.0], THICK)
    return robot.with_capsules({1: [capsule], 2: [capsule]})


def disc() -> mo.Scene:
    """Build the disc as a ball in the plane of the arm."""
    return mo.Scene([mo.Sphere([*DISC, 0.0], RADIUS, "disc")], self_collision=False)


def shortest_by_opti(distance: float, guess: np.ndarray, points: int = POINTS) -> float:
    """Return the shortest duration by the trapezoidal rule, with links as rows of points, s.

    Parameters
    ----------
    distance : float
        Distance of every point from the disc's centre, m.
    guess : array [N+1,2]
        Initial joint positions at even times, rad.
    points : int
        Number of points along each link.
    """
    opti, intervals = ca.Opti(), len(guess) - 1
    q, w, u = (opti.variable(2, intervals + 1) for _ in range(3))
    duration = opti.variable()
    across = MASS * LENGTH * CENTRE * ca.cos(q[1, :])
    h = MASS * LENGTH * CENTRE * ca.sin(q[1, :])
    h11 = 2 * INERTIA + MASS * CENTRE**2 + MASS * (LENGTH**2 + CENTRE**2) + 2 * across
    h22 = INERTIA + MASS * CENTRE**2
    h12 = h22 + across
    determinant = h11 * h22 - h12**2
    left1 = u[0, :] + h * (2 * w[0, :] * w[1, :] + w[1, :] ** 2)
    left2 = u[1, :] - h * w[0, :] ** 2
    speed = ca.vertcat(
        (h22 * left1 - h12 * left2) / determinant, (h11 * left2 - h12 * left1) / determinant
    )
    step = duration / intervals
    for x, rate in ((q, w), (w, speed)):
        opti.subject_to(x[:, 1:] - x[:, :-1] == step / 2 * (rate[:, 1:] + rate[:, :-1]))
    opti.subject_to(opti.bounded(-TORQUE, u, TORQUE))
    for x, ends in ((q, ENDS), (w, np.zeros((2, 2)))):
        opti.subject_to(x[:, 0] == ends[0])
        opti.subject_to(x[:, -1] == ends[1])
    elbow = LENGTH * ca.vertcat(ca.cos(q[0, :]), ca.sin(q[0, :]))
    turned = q[0, :] + q[1, :]
    along = LENGTH * ca.vertcat(ca.cos(turned), ca.sin(turned))
    for share in np.linspace(0.0, 1.0, points)[1:]:
        for point in (share * elbow, elbow + share * along):
            opti.subject_to(ca.sum1((point - DISC) ** 2) >= distance**2)
    opti.subject_to(opti.bounded(0.1, duration, 5.0))
    opti.minimize(duration)
    opti.set_initial(q, guess.T)
    opti.set_initial(w, np.gradient(guess, 0.5 / intervals, axis=0).T)
    opti.set_initial(duration, 0.5)
    opti.solver("ipopt", {"print_time": False, "expand": True}, {"print_level": 0, "sb": "yes"})
    return float(opti.solve().value(duration))


def _two_links() -> None:
    robot, scene, rows = two_link_arm(), disc(), []
    for name, around in (("no obstacle", None), ("disc", scene)):
        begin = time.process_time()
        motion = mo.time_optimal(robot, ENDS, scene=around)
        spent = time.process_time() - begin
        certificate = mo.certify(robot, motion, via_q=ENDS, scene=around)
        said = "ok" if certificate.ok else certificate.verdict
        rows.append([name, f"{motion.duration:.5f}", said, f"{spent:.1f}"])
    guess = motion.sample(np.linspace(0.0, motion.duration, 201)).q
    for name, share in (("Opti, as far as planned", 1.01), ("Opti, at the disc", 1.0)):
        begin = time.process_time()
        found = shortest_by_opti(share * (RADIUS + THICK), guess)
        spent = time.process_time() - begin
        rows.append([name, f"{found:.5f}", "", f"{spent:.1f}"])
    print("Dissanayake's arm; published without an obstacle: 0.39185 s\n")
    heads = ["task", "duration [s]", "certificate", "processor time [s]"]
    print(Table.of_text(heads, rows).markdown())


def _iiwa() -> None:
    try:
        import pybullet_data  # type: ignore[import-not-found]
    except ImportError:
        print("\nThe iiwa needs its robot: pip install pybullet")
        return
    path = Path(pybullet_data.getDataPath()) / "kuka_iiwa" / "model.urdf"
    limits = mo.Limits(qd_max=VELOCITY, qdd_max=ACCELERATION, tau_max=np.inf)
    robot = mo.load_robot(path).with_limits(limits)
    box = mo.Box(BOX_SIZE, BOX_CENTER, "box")
    scene, via_q = mo.Scene([box], self_collision=False), np.array([START, GOAL])
    motion = mo.time_optimal(robot, via_q, scene=scene)
    certificate = mo.certify(robot, motion, via_q=via_q, scene=scene)
    way = np.abs(np.subtract(GOAL, START))
    ramps = way * ACCELERATION < VELOCITY**2
    bound = np.where(
        ramps, 2 * np.sqrt(way / ACCELERATION), way / VELOCITY + VELOCITY / ACCELERATION
    )
    print(f"\nKUKA LBR iiwa beside a box: {motion.duration:.5f} s; {certificate.verdict}")
    print(f"No motion can be faster than {bound.max():.5f} s; their baseline takes {THEIRS:.4f} s.")
    smooth = robot.with_limits(mo.Limits(qddd_max=JERK, **_same(limits)))
    calm = mo.time_optimal(smooth, via_q, scene=scene)
    said = ""
    for factor in SLOWED:
        said = _judged(path, calm, factor)
        if said.startswith("feasible"):
            break
    print(f"By their rules, with a jerk of at most {JERK:g} rad/s^3: {said}")


def _same(limits: mo.Limits) -> dict[str, Any]:
    return {"qd_max": limits.qd_max, "qdd_max": limits.qdd_max, "tau_max": limits.tau_max}


def _judged(path: Path, motion: mo.Motion, factor: float) -> str:
    """Return the verdict of the task's rules on a motion, slowed down by a factor."""
    import pybullet  # type: ignore[import-not-found]
    from scipy.interpolate import CubicSpline

    at = np.linspace(0.0, motion.duration, KNOTS)
    knots = factor * at
    spline = CubicSpline(knots, motion.sample(at).q, bc_type="clamped")
    t = np.concatenate([np.linspace(a, b, SAMPLES, endpoint=False) for a, b in pairwise(knots)])
    q, qd, qdd = spline(t), spline(t, 1), spline(t, 2)
    if (np.abs(qd) > VELOCITY + EXACT).any():
        return f"a velocity is too high: {(np.abs(qd) / VELOCITY).max():.6f} of its limit"
    if (np.abs(qdd) > ACCELERATION + EXACT).any():
        return f"an acceleration is too high: {np.abs(qdd).max():.6f}"
    pybullet.connect(pybullet.DIRECT)
    try:
        arm = pybullet.loadURDF(str(path), useFixedBase=True)
        half = [edge / 2 for edge in BOX_SIZE]
        shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half)
        box = pybullet.createMultiBody(0.0, shape, basePosition=BOX_CENTER)
        for pose in q:
            for joint, value in enumerate(pose):
                pybullet.resetJointState(arm, joint, float(value))
            if pybullet.getClosestPoints(arm, box, distance=0.0):
                return "a collision"
    finally:
        pybullet.disconnect()
    return f"feasible, {knots[-1]:.5f} s"
