"""How far arms reach, and the angles of an orientation."""

import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp.robot import fixed_angles, largest_reach, rotation_of


def test_the_reach_of_an_arm_that_stretches_out():
    found, bound = largest_reach(mo.load_robot("microbot"))
    assert bound == pytest.approx(9.0)
    assert found == pytest.approx(9.0, abs=1e-3)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_fixed_angles_where_roll_and_yaw_are_one(pitch):
    rotation = rotation_of([0.3, pitch, 0.4])
    np.testing.assert_allclose(rotation_of(fixed_angles(rotation)), rotation, atol=1e-9)
