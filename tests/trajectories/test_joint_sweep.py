"""The motion that shows what every joint does."""

import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp.trajectories import joint_sweep


@pytest.mark.parametrize("name", mo.packaged_robots())
def test_the_sweep_moves_every_joint_within_the_limits(name):
    robot = mo.load_robot(name)
    motion = joint_sweep(robot)
    for quantity in ("q", "qd", "qdd"):
        lower, upper = robot.limits.bounds(quantity)
        values = getattr(motion, quantity)
        assert np.all((values >= lower - 1e-9) & (values <= upper + 1e-9))
    assert np.all(np.ptp(motion.q, axis=0) > 0.1)
