"""A published arm with an obstacle, against a transcription that of other code."""

import numpy as np
import pytest
from benchmarks.published import ENDS, RADIUS, THICK, disc, shortest_by_opti, two_link_arm

import microbot_ocp as mo

pytest.importorskip("ompl")


@pytest.mark.thorough
def test_the_two_link_arm_goes_around_a_disc_as_fast_as_opti_says() -> None:
    robot, scene = two_link_arm(), disc()
    motion = mo.time_optimal(robot, ENDS, scene=scene, mesh=20, starts=1, compiled=False)
    certificate = mo.certify(robot, motion, via_q=ENDS, scene=scene)
    assert certificate.ok
    assert certificate.clearance is not None
    assert certificate.clearance.minimum > 0.0
    guess = motion.sample(np.linspace(0.0, motion.duration, 41)).q
    exact = shortest_by_opti(RADIUS + THICK, guess)
    assert exact < motion.duration < 1.015 * exact
    assert motion.duration > 1.15 * 0.39185  # without the disc
