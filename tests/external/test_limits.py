"""Members of the family of limits against pinocchio and ruckig."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from ruckig import InputParameter, Ruckig, Trajectory

import microbot_ocp as mo
from external.pinocchio_model import pinocchio_model
from microbot_ocp.limits import LimitFamily, MotionSamples
from planning.shared import slider


@pytest.mark.parametrize("name", ["microbot", "puma560", "ur5e", "panda", "stanford"])
def test_the_tools_velocity_and_acceleration_are_those_of_pinocchio(name):
    robot = mo.load_robot(name).with_limits(
        also=[
            mo.Limit("velocity of the tool", lambda s: s.tool_velocity, upper=1.0),
            mo.Limit("acceleration of the tool", lambda s: s.tool_acceleration, upper=1.0),
        ]
    )
    model = pinocchio_model(robot)
    tool = pin.SE3(np.array(robot.tool))
    frame = model.addFrame(pin.Frame("the tool", model.njoints - 1, tool, pin.FrameType.OP_FRAME))
    data = model.createData()
    random = np.random.default_rng(5)
    q, qd, qdd = random.uniform(-2.0, 2.0, (3, 200, robot.joint_count))
    values = LimitFamily.of(robot).values(MotionSamples(q, qd, qdd, np.zeros_like(q)))
    aligned = pin.LOCAL_WORLD_ALIGNED
    for k in range(len(q)):
        pin.forwardKinematics(model, data, q[k], qd[k], qdd[k])
        velocity = pin.getFrameVelocity(model, data, frame, aligned).vector
        acceleration = pin.getFrameClassicalAcceleration(model, data, frame, aligned).vector
        np.testing.assert_allclose(
            values["velocity_of_the_tool"].value[k], velocity, rtol=1e-10, atol=1e-10
        )
        np.testing.assert_allclose(
            values["acceleration_of_the_tool"].value[k], acceleration, rtol=1e-10, atol=1e-9
        )


def ruckig_duration(distance, velocity, acceleration, jerk):
    """Shortest time from rest to rest, all joints ending together."""
    count = len(distance)
    task = InputParameter(count)
    task.current_position, task.target_position = [0.0] * count, list(distance)
    task.max_velocity, task.max_acceleration = list(velocity), list(acceleration)
    task.max_jerk = list(jerk)
    trajectory = Trajectory(count)
    Ruckig(count).calculate(task, trajectory)
    return trajectory.duration


TASKS = [
    ([1.0], [0.8], [2.0], [10.0]),  # all limits met
    ([0.2], [0.8], [2.0], [10.0]),  # neither top speed nor top acceleration
    pytest.param(
        [1.0, 0.4, -0.7],
        [1.0, 0.5, 2.0],
        [2.0, 3.0, 1.5],
        [12.0, 9.0, 20.0],
        marks=pytest.mark.thorough,
    ),
]


@pytest.mark.parametrize(("distance", "velocity", "acceleration", "jerk"), TASKS)
def test_under_velocity_acceleration_and_jerk_the_duration_is_ruckigs(
    distance, velocity, acceleration, jerk
):
    count = len(distance)
    robot = mo.Robot.from_dh(
        alpha=[0.0] * count,
        a=[0.0] * count,
        d=[0.0] * count,
        joint_type="prismatic",
        links=[mo.Link(1.0, [0.0, 0.0, 0.0])] * count,
        gravity=(0.0, 0.0, 0.0),
        limits=mo.Limits(qd_max=velocity, qdd_max=acceleration, qddd_max=jerk),
    )
    motion = mo.time_optimal(robot, [[0.0] * count, distance], starts=1)
    assert motion.solved
    exact = ruckig_duration(distance, velocity, acceleration, jerk)
    assert motion.duration == pytest.approx(exact, rel=1e-4)
    assert np.abs(motion.qdd[[0, -1]]).max() < 1e-6
    assert mo.certify(robot, motion).ok


def test_a_straight_line_under_jerk_is_as_fast_as_ruckigs():
    robot = slider(qd_max=0.8, qdd_max=2.0, qddd_max=10.0)
    motion = mo.time_optimal_path(robot, mo.straight_path([[0.0], [1.0]]))
    exact = ruckig_duration([1.0], [0.8], [2.0], [10.0])
    assert motion.solved
    assert motion.duration == pytest.approx(exact, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["cubic", "quintic"])
def test_jerk_along_a_trajectory_that_starts_from_rest(shape):
    """Along one line every shape takes what the line takes."""
    robot = slider(qd_max=0.8, qdd_max=2.0, qddd_max=10.0)
    path = getattr(mo, shape)([[0.0], [1.0]], [0.0, 2.0])
    motion = mo.time_optimal_path(robot, path)
    exact = ruckig_duration([1.0], [0.8], [2.0], [10.0])
    assert motion.solved
    assert exact * (1 - 1e-4) < motion.duration < exact * (1 + 1e-4)
    assert mo.certify(robot, motion).ok


@pytest.mark.thorough
@pytest.mark.slow
def test_jerk_is_kept_through_smooth_breaks():
    robot = mo.load_robot("planar_2r").with_limits(qddd_max=60.0)
    path = mo.spline([[0.0, 0.3], [0.8, -0.4], [1.2, 0.9]], [0.0, 1.0, 2.0])
    motion = mo.time_optimal_path(robot, path)
    assert motion.solved
    assert motion.provenance["stops"] == []
    assert mo.certify(robot, motion).ok
