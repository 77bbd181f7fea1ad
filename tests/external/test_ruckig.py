"""Shortest durations against Ruckig's time-optimal rest-to-rest motions of single joints."""

import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp.trajectories import (
    cubic,
    lspb,
    quintic,
    shortest_duration,
)

ruckig = pytest.importorskip("ruckig")


def ruckig_duration(distance, velocity, acceleration):
    """Time-optimal duration under limits of velocity and acceleration, s."""
    problem = ruckig.InputParameter(1)
    problem.current_position, problem.target_position = [0.0], [distance]
    problem.max_velocity, problem.max_acceleration = [velocity], [acceleration]
    trajectory = ruckig.Trajectory(1)
    assert ruckig.Ruckig(1).calculate(problem, trajectory) == ruckig.Result.Working
    return trajectory.duration


@pytest.mark.parametrize("seed", range(12))
def test_the_trapezoid_is_time_optimal_and_smooth_shapes_are_slower(seed):
    random = np.random.default_rng(seed)
    distance, velocity, acceleration = random.uniform([0.1, 0.2, 0.5], [3.0, 2.0, 8.0])
    robot = mo.Robot.from_dh(alpha=[0.0], a=[0.0], d=[0.0])
    limits = mo.Limits(qd_max=velocity, qdd_max=acceleration)
    best = ruckig_duration(distance, velocity, acceleration)
    # The best trapezoid: blends as long as the top speed takes, or a triangle.
    blend = min(velocity / acceleration, np.sqrt(distance / acceleration))
    whole = distance / (blend * acceleration) + blend
    vias = [[0.0], [distance]]
    share = min(blend / whole, 0.5)
    shape = lspb(vias, [0.0, 1.0], share)
    assert shortest_duration(robot, shape, limits).duration == pytest.approx(best, rel=1e-6)
    for slower in (cubic(vias, [0.0, 1.0]), quintic(vias, [0.0, 1.0])):
        assert shortest_duration(robot, slower, limits).duration > best
