"""What is said of tasks that no motion solves."""

from __future__ import annotations

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import tells


def test_a_torque_that_is_too_small_is_named_with_place_and_amount():
    """A pendulum with too little room to swing holds 9.81 N m where it is level."""
    arm = mo.Robot.from_dh(
        alpha=[np.pi / 2],
        a=[0.0],
        d=[0.0],
        links=[mo.Link(2.0, (0.5, 0.0, 0.0), 0.01 * np.eye(3))],
        limits=mo.Limits(q_min=-1.6, q_max=2.0, qd_max=0.2, tau_max=4.0),
    )
    via_q = [[-np.pi / 2], [np.pi / 2]]
    motion = mo.time_optimal(arm, via_q, starts=1, tries=0, mesh=20, compiled=False)
    assert str(motion.status) == "infeasible"
    tells(motion.advice, "torque of joint 1", "via points 1 and 2")
    (found,) = motion.provenance["least_violation"]
    assert found["value"] == 4.0
    # at 0.2 rad/s swinging saves next to nothing
    assert found["exceeded_by"] == pytest.approx(9.81 - 4.0, rel=0.05)
    assert abs(found["q"][0]) < 0.2
