"""Motions of every kind, and mutations of them that a certificate must find.

``PYTHONPATH=tests:src python tests/external/motions.py microbot puma560 panda`` prints both tables.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

import microbot_ocp as mo
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import Motion, PiecewisePolynomial, State, torque_along
from microbot_ocp.planning import time_optimal, time_optimal_path
from microbot_ocp.planning.free import within_limits
from microbot_ocp.robot import forward_kinematics
from microbot_ocp.scene import with_arm_capsules
from microbot_ocp.trajectories import cubic, lspb, quintic, shortest_duration, spline

FREE = mo.Limits()
SMALL = 1e-3  # of a mass, a torque, a velocity


def via(robot: mo.Robot, seed: int = 0, points: int = 3) -> np.ndarray:
    """Random via points in the middle of the joints' ranges, at most 2 rad from zero."""
    low, high = np.maximum(robot.limits.q_min, -2.0), np.minimum(robot.limits.q_max, 2.0)
    return low + (high - low) * np.random.default_rng(seed).uniform(0.2, 0.8, (points, low.size))


def tracked(robot: mo.Robot, points: np.ndarray, duration: float) -> Motion:
    """What a controller makes of a quintic on an arm that starts beside it."""
    shape = quintic(points[[0, -1]], [0.0, duration])
    wanted = Motion.from_polynomial(robot, shape, label="wanted")
    run = mo.track(robot.with_limits(FREE), wanted, mo.ComputedTorque(100.0), q0=points[0] + 0.01)
    return run.as_motion("tracked")


def shapes(robot: mo.Robot, duration: float) -> Iterator[tuple[str, Motion]]:
    """The textbook's shapes through three points."""
    points, t = via(robot), [0.0, 0.5 * duration, duration]
    for name, shape in (
        ("cubic", cubic(points, t)),
        ("LSPB", lspb(points, t, 0.1 * duration)),
        ("quintic", quintic(points, t)),
        ("spline", spline(points, t)),
    ):
        yield name, Motion.from_polynomial(robot, shape, label=name)


def planned(robot: mo.Robot) -> Iterator[tuple[str, Motion]]:
    """Scaled to the limits, tracked, free and along a path."""
    points = via(robot)
    scaled = shortest_duration(robot, quintic(points[:2], [0.0, 1.0])).polynomial
    yield "scaled quintic", Motion.from_polynomial(robot, scaled, label="scaled")
    yield "tracked", tracked(robot, points, 0.8)
    yield "path timing", time_optimal_path(robot, spline(points, [0.0, 1.0, 2.0]))
    yield "time-optimal", time_optimal(robot, points[:2])


def others(robot: mo.Robot) -> Iterator[tuple[str, Motion]]:
    """What becomes of a task otherwise: under rates, slowed down, prepared, by stops, in arcs."""
    points = via(robot)
    rated = robot.with_limits(taud_max=20.0 * robot.limits.tau_max)
    yield "path under rates", time_optimal_path(rated, spline(points, [0.0, 1.0, 2.0]))
    shape = shortest_duration(rated, quintic(points[:2], [0.0, 1.0])).polynomial
    faster = PiecewisePolynomial(
        shape.breaks / 1.02, shape.coefficients * 1.02 ** np.arange(6)[:, None]
    )
    for name, own in (("slowed down at limits", robot), ("slowed down evenly", rated)):
        slower = within_limits(LimitFamily.of(own), faster, faster.breaks, 5e-4, True)
        assert slower is not None, name
        yield name, slower
    yield "without a search", time_optimal(robot, points, time_limit=0.01)
    yield "prepared", mo.TimeOptimalSolver(robot, points[:2])()
    stops = [
        mo.Stop(q=list(q), dwell=0.1, name=name) for q, name in zip(points, "abc", strict=True)
    ]
    yield "stops", time_optimal(robot, stops)
    yield "switching times", time_optimal(robot, points[:2], switching_times=True)


def among_obstacles(robot: mo.Robot) -> Iterator[tuple[str, Motion]]:
    """Past a ball that the arm without one would hit; needs coal."""
    points = via(robot)
    free = time_optimal(robot, points[:2])
    middle = forward_kinematics(robot)(free.sample([0.5 * free.duration]).q[0]).full()[:3, 3]
    scene = mo.Scene([mo.Sphere(middle, 0.1, "ball")])
    yield "among obstacles", time_optimal(with_arm_capsules(robot), points[:2], scene=scene)


def mutations(robot: mo.Robot, motion: Motion) -> Iterator[tuple[str, mo.Robot, Motion]]:
    """The motion with something wrong, and the robot that it is certified for."""

    def again(**changes: np.ndarray) -> Motion:
        """With the torques that inverse dynamics asks for."""
        state = State(*(changes.get(key, getattr(motion, key)) for key in ("q", "qd", "qdd")))
        return replace(motion, **changes, tau=torque_along(robot, state))

    for joint, link in enumerate(robot.links):
        heavier = list(robot.links)
        heavier[joint] = replace(link, mass=link.mass * (1 + SMALL))
        other = robot.with_links(heavier)
        state = State(motion.q, motion.qd, motion.qdd)
        felt = np.abs(torque_along(other, state) - motion.tau).max() > 1e-9
        if link.mass and felt:  # a mass on the first axis has no effect
            yield f"mass of link {joint + 1}", other, motion
    sign = np.ones(robot.joint_count)
    sign[int(np.abs(motion.tau).max(axis=0).argmin())] = -1.0
    yield "sign of the smallest torque", robot, replace(motion, tau=sign * motion.tau)
    yield "torque 0.1 %", robot, replace(motion, tau=(1 + SMALL) * motion.tau)
    yield "gravity -0.1 %", robot.with_gravity((1 - SMALL) * robot.gravity), motion
    yield "sign of qdd", robot, again(qdd=-motion.qdd)
    yield "sign of qd", robot, again(qd=-motion.qd)
    yield "qd 1 %", robot, again(qd=1.01 * motion.qd)
    yield "qdd 1 %", robot, again(qdd=1.01 * motion.qdd)
    slower = {"t": motion.t * 1.01, "breaks": motion.breaks * 1.01}
    yield "time 1 %", robot, replace(motion, **slower)
    q = motion.q.copy()
    q[motion.t.size // 2] += 1e-3
    yield "one sample 1 mrad", robot, again(q=q)


def row(name: str, robot: mo.Robot, motion: Motion) -> str:
    found = mo.certify(robot, motion, FREE)
    return (
        f"{name:28s} {motion.duration:7.3f} s {found.segments:5d} {found.defect:9.1e} "
        f"{found.stored_torque_error:9.1e} {found.between_samples_error:9.1e} "
        f"{found.amplification:9.1e} {found.final_position_error:9.1e} "
        f"{'passed' if found.ok else 'FAILED'}"
    )


def main(names: list[str], report: Callable[[str], None] = print) -> None:
    report(f"{'':37s} {'':2s}segments   defect    stored   between   growth  open loop")
    for name in names:
        robot = mo.load_robot(name)
        report(f"\n{name}")
        for duration in (1.0, 8.0, 40.0):
            for kind, motion in shapes(robot, duration):
                report(row(kind, robot, motion))
        for kind, motion in planned(robot):
            report(row(kind, robot, motion))
        for kind, motion in (*shapes(robot, 8.0), *planned(robot)):
            for what, other, wrong in mutations(robot, motion):
                report(row(f"{kind}: {what}", other, wrong))


if __name__ == "__main__":
    main(sys.argv[1:])
