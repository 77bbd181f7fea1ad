"""Limits of torques of robots without masses: refused where given, named where brought along."""

import numpy as np
import pytest

import microbot_ocp as mo

BARE = mo.Robot.from_dh([0, 0], [0, 1], [0, 0], tool=(0, 0.8, 0, 0), name="bare")
SHAPE = mo.quintic([[0.0, 0.0], [0.5, 0.8]], [0.0, 2.0])
POSES = [[0.0, 0.0], [0.5, 0.8]]
MOTION = mo.Motion.from_polynomial(BARE, SHAPE, label="quintic")
CALLS = {
    "certify": lambda limits: mo.certify(BARE, MOTION, limits),
    "certify stops": lambda limits: mo.certify(
        BARE, MOTION, limits, via_q=[mo.Stop(q) for q in POSES]
    ),
    "limit_history": lambda limits: mo.limits.limit_history(BARE, MOTION, limits),
    "shortest_duration": lambda limits: mo.shortest_duration(BARE, SHAPE, limits),
    "time_optimal": lambda limits: mo.time_optimal(BARE, POSES, limits),
    "time_optimal_path": lambda limits: mo.time_optimal_path(BARE, mo.straight_path(POSES), limits),
    "compare": lambda limits: mo.compare(BARE, POSES, methods=["cubic"], limits=limits),
}


@pytest.mark.parametrize("key", ["tau_max", "taud_max"])
@pytest.mark.parametrize("name", CALLS)
def test_limits_of_torques_that_are_given_are_refused(name, key):
    with pytest.raises(mo.InputError, match=f"{key} limits the .*'bare' has no masses.*leave out"):
        CALLS[name](mo.Limits(qd_max=1.0, **{key: 5.0}))


def test_those_of_a_file_are_named_as_not_judged():
    robot = BARE.with_limits(qd_max=1.0, tau_max=5.0)
    for more in ({}, {"limits": robot.limits}, {"via_q": POSES}):
        certificate = mo.certify(robot, MOTION, **more)
        assert certificate.ok
        assert certificate.unjudged == ("torque",)
        assert "every limit but that of torque is kept" in certificate.verdict
    assert "its limits of torque are not judged" in mo.time_optimal(robot, POSES, starts=1).note


@pytest.mark.filterwarnings("error")
def test_links_without_any_mass_warn_of_nothing():
    robot = BARE.with_links([mo.Link(0.0, np.zeros(3))] * 2)
    motion = mo.Motion.from_polynomial(robot, SHAPE, label="quintic")
    assert "no torque determines" in mo.certify(robot, motion, mo.Limits(tau_max=5.0)).verdict
