"""Limits whose tables are read outside of their grids: neither solved nor certified."""

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from helpers import sampled, tells

VIA = np.radians([[0.0, 0.0, 0.0], [-8.0, 45.0, 30.0], [-90.0, 90.0, 90.0]])
SPEEDS = ca.interpolant("derating", "linear", [[-0.2, 0.0, 0.2, 0.6]], [3.0, 3.0, 2.5, 2.0])
LIMITS = {
    "of a value": mo.Limit("use", lambda k: k.qd[0] / SPEEDS(k.q[0]), lower=-1.0, upper=1.0),
    "of a bound": mo.Limit("elbow", lambda k: k.qd[2], upper=lambda k: SPEEDS(k.q[0])),
}


@pytest.mark.parametrize("kind", sampled(LIMITS, 2))
def test_a_motion_that_leaves_a_table_is_not_certified(kind):
    robot = mo.load_robot("microbot").with_limits(also=[LIMITS[kind]])
    motion = mo.time_optimal_path(robot, mo.straight_path(VIA))
    assert motion.status is mo.Status.OUTSIDE_TABLE
    tells(motion.advice, "derating", "-1.5708", "-0.2")
    certificate = mo.certify(robot, motion)
    assert not certificate.ok
    tells(certificate.verdict, "derating", "-1.5708", "-0.2")


@pytest.mark.thorough
def test_within_the_table_it_is():
    near = mo.Limit("use", lambda k: k.qd[0] / SPEEDS(k.q[0] / 10.0), lower=-1.0, upper=1.0)
    robot = mo.load_robot("microbot").with_limits(also=[near])
    motion = mo.time_optimal_path(robot, mo.straight_path(VIA))
    assert motion.solved
    assert mo.certify(robot, motion).ok
