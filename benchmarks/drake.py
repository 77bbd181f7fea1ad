"""Free time-optimal motions of arms with 3 to 7 joints: ours, and Drake's B-splines with SNOPT.

Every row is one task, the report's three poses or three random ones, with rest at both ends:
duration, wall time, and the largest excess over a limit at 2000 places along the motion.
``time_optimal`` runs with its defaults, once with an empty cache of compiled functions and once
with a full one. Drake's KinematicTrajectoryOptimization has the torque limits at evenly spaced
places, two per control point, and limits of speeds and positions at the control points. It is given
the fraction of the duration at which our motion passes the via point, because it has no unknown for
it.
"""

from __future__ import annotations

import importlib
import os
import tempfile
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

import microbot_ocp as mo
from benchmarks.free_time_optimal import VIA_Q
from microbot_ocp.limits import LimitFamily, MotionSamples

ROBOTS = ("microbot", "puma560", "ur5e", "panda")
CONTROL_POINTS = (24, 48)
PLACES = 2000


@dataclass(frozen=True)
class Row:
    """Row of one motion: duration and wall time, s, and the largest relative excess of a limit."""

    way: str
    duration: float
    wall: float
    excess: float
    status: str

    def __str__(self) -> str:
        return (
            f"  {self.way:28} {self.duration:9.4f} s {self.wall:8.2f} s "
            f"{100 * self.excess:8.3g} %   {self.status}"
        )


def random_points(robot: mo.Robot, seed: int, count: int = 3) -> np.ndarray:
    """Draw poses within the limits at which the arm can rest."""
    random, limits = np.random.default_rng(seed), robot.limits
    low, high = np.maximum(limits.q_min, -np.pi), np.minimum(limits.q_max, np.pi)
    gravity, points = mo.gravity_torque(robot), []
    while len(points) < count:
        q = low + (high - low) * random.uniform(0.05, 0.95, low.size)
        if np.all(np.abs(np.array(gravity(q)).ravel()) < 0.9 * limits.tau_max):
            points.append(q)
    return np.array(points)


def ours(robot: mo.Robot, via: np.ndarray, way: str) -> tuple[Row, float]:
    """Return our row by defaults, and the fraction of its duration at the via point."""
    begin = time.perf_counter()
    motion = mo.time_optimal(robot, via)
    wall = time.perf_counter() - begin
    share = motion.marks[1].time / motion.duration
    excess = motion.provenance["excess"]
    return Row(way, motion.duration, wall, excess, str(motion.status)), share


def plant_of(robot: mo.Robot) -> Any:
    """Return the arm as Drake's plant."""
    drake: Any = importlib.import_module("pydrake.all")
    plant = drake.MultibodyPlant(0.0)
    plant.mutable_gravity_field().set_gravity_vector(robot.gravity)
    body, zero = plant.world_body(), np.zeros(robot.joint_count)
    before = np.eye(4)
    for k, link in enumerate(robot.links):
        pose = np.array(mo.forward_kinematics(robot, k + 1)(zero))
        offset = drake.RigidTransform(np.linalg.inv(before) @ pose)
        frame = plant.AddFrame(drake.FixedOffsetFrame(f"joint {k}", body.body_frame(), offset))
        i = link.inertia
        central = drake.RotationalInertia(i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
        inertia = drake.SpatialInertia.MakeFromCentralInertia(
            link.mass, link.center_of_mass, central
        )
        body = plant.AddRigidBody(f"link {k}", inertia)
        kind = drake.RevoluteJoint if robot.joint_types[k] == "revolute" else drake.PrismaticJoint
        joint = plant.AddJoint(kind(f"q{k}", frame, body.body_frame(), [0, 0, 1]))
        plant.AddJointActuator(f"motor {k}", joint)
        before = pose
    plant.Finalize()
    return plant


def by_drake(robot: mo.Robot, via: np.ndarray, count: int, share: float) -> Row:
    """Return the row of KinematicTrajectoryOptimization with SNOPT."""
    drake: Any = importlib.import_module("pydrake.all")
    begin = time.perf_counter()
    n, limits = robot.joint_count, robot.limits
    task = drake.KinematicTrajectoryOptimization(n, count, spline_order=5)
    zero = np.zeros((n, 1))
    task.AddDurationCost(1.0)
    task.AddDurationConstraint(0.05, 60.0)
    task.AddPositionBounds(limits.q_min, limits.q_max)
    task.AddVelocityBounds(limits.qd_min, limits.qd_max)
    if np.isfinite(limits.qdd_max).any():
        task.AddAccelerationBounds(limits.qdd_min, limits.qdd_max)
    for place, q in zip((0.0, share, 1.0), via, strict=True):
        task.AddPathPositionConstraint(q, q, place)
    for place in (0.0, 1.0):
        task.AddPathVelocityConstraint(zero, zero, place)
    plant = plant_of(robot)
    places = np.linspace(0, 1, 2 * count)
    task.AddEffortBoundsAtNormalizedTimes(plant, places, limits.tau_min, limits.tau_max)
    shares = np.linspace(0, 1, count)
    guess = np.array([np.interp(shares, [0, share, 1], q) for q in via.T])
    basis = drake.BsplineBasis(5, count, initial_parameter_value=0, final_parameter_value=3.0)
    task.SetInitialGuess(drake.BsplineTrajectory(basis, guess))
    result = drake.SnoptSolver().Solve(task.prog())
    path = task.ReconstructTrajectory(result)
    wall = time.perf_counter() - begin
    t = np.linspace(path.start_time(), path.end_time(), PLACES)
    orders = [path.MakeDerivative(k) if k else path for k in range(4)]
    samples = MotionSamples(*(curve.vector_values(t).T for curve in orders))
    excess = float(LimitFamily.of(robot).excess(samples).max())
    duration = path.end_time() - path.start_time()
    status = str(result.get_solution_result()).rpartition(".")[-1]
    return Row(f"Drake, {count} control points", duration, wall, excess, status)


def run(repetitions: int = 0) -> None:
    """Run the report's task, and ``repetitions`` random tasks of every arm, by default one."""
    for name in ROBOTS:
        robot = mo.load_robot(name)
        robot = robot.with_limits(taud_max=np.inf)  # Drake has no limits of torque rates
        tasks = {"the report's three poses": VIA_Q} if name == "microbot" else {}
        for seed in range(1, 1 + (repetitions or 1)):
            tasks[f"three random points (seed {seed})"] = random_points(robot, seed)
        for title, via in tasks.items():
            print(f"\n{name}, {title}: duration, wall time, excess", flush=True)
            with tempfile.TemporaryDirectory() as empty:
                kept = os.environ.get("MICROBOT_OCP_CACHE")
                os.environ["MICROBOT_OCP_CACHE"] = empty
                try:
                    rows = [ours(robot, via, "time_optimal, empty cache")[0]]
                    # A slightly different task shares only the cache on the disk.
                    row, share = ours(robot, via + 1e-9, "time_optimal, full cache")
                finally:
                    del os.environ["MICROBOT_OCP_CACHE"]
                    if kept is not None:
                        os.environ["MICROBOT_OCP_CACHE"] = kept
            rows += [row, *(by_drake(robot, via, count, share) for count in CONTROL_POINTS)]
            print("\n".join(map(str, rows)))
