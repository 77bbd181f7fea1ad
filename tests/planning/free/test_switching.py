"""Switching times of free motions as unknowns."""

import numpy as np
import pytest
from benchmarks.switching_times import task

import microbot_ocp as mo
from helpers import refused
from planning.shared import slider

LENGTH, MASS, INERTIA, CENTRE = 0.4, 0.5, 0.1, 0.2
VIA = np.array([[0.0, -2.0], [1.0, -1.0]])


def two_links():
    """The arm of Dissanayake, Goh and Phan-Thien (1991): 10 N m, no gravity."""
    link = mo.Link(
        mass=MASS,
        center_of_mass=[CENTRE, 0.0, 0.0],
        inertia=np.diag([INERTIA / 2, INERTIA / 2, INERTIA]),
    )
    return mo.Robot.from_dh(
        alpha=[0.0, 0.0],
        a=[0.0, LENGTH],
        d=[0.0, 0.0],
        links=[link, link],
        gravity=(0.0, 0.0, 0.0),
        limits=mo.Limits(tau_max=10.0),
        name="two links",
    )


@pytest.mark.thorough
def test_the_fastest_motion_of_a_two_link_arm_to_ten_digits():
    """0.391854539515663 s is PROPT's figure."""
    motion = mo.time_optimal(two_links(), VIA, starts=1, mesh=60, switching_times=True)
    assert motion.solved
    assert motion.duration == pytest.approx(0.391854539515663, abs=1e-10)
    said = motion.provenance["switching_times"]
    assert said["status"] == "solved"
    times = {(j["name"], j["component"]): [] for j in said["junctions"]}
    for junction in said["junctions"]:
        times[junction["name"], junction["component"]].append(junction["time"])
    np.testing.assert_allclose(times["torque", 0], [0.19592726975783], atol=1e-8)
    np.testing.assert_allclose(times["torque", 1], [0.04570932123295, 0.23530043137035], atol=1e-8)
    assert motion.provenance["on_a_mesh"] > motion.duration
    assert motion.provenance["gap"] < 1e-8
    certificate = mo.certify(two_links(), motion)
    assert certificate.ok
    away = np.abs(np.abs(motion.tau) - 10.0).max(axis=1)
    assert np.median(away) < 1e-3  # both torques at a limit all along, but at the switches


def test_one_joint_that_reaches_its_speed_limit():
    """Inertia 2 kg m^2, 4 N m, 1 rad/s: 0.5 s, 1.5 s and 0.5 s for 2 rad."""
    link = mo.Link(mass=1.0, center_of_mass=[0.0, 0.0, 0.0], inertia=np.diag([1.0, 1.0, 2.0]))
    robot = mo.Robot.from_dh(
        alpha=[0.0], a=[0.0], d=[0.0], links=[link], limits=mo.Limits(tau_max=4.0, qd_max=1.0)
    )
    motion = mo.time_optimal(robot, [[0.0], [2.0]], starts=1, mesh=30, switching_times=True)
    assert motion.provenance["switching_times"]["status"] == "solved"
    assert motion.duration == pytest.approx(2.5, abs=1e-9)
    times = sorted({round(j["time"], 8) for j in motion.provenance["switching_times"]["junctions"]})
    assert times == [0.5, 2.0]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "family", "via", "most"),
    [
        # two switches within an interval of the mesh
        pytest.param("planar_2r", "torque", 1, 0.7051308, marks=pytest.mark.thorough),
        ("planar_2r", "torque, speed", 0, 0.5873758),  # both joints at their speed limits in turn
        pytest.param("planar_3r", "torque", 0, 0.3650857, marks=pytest.mark.thorough),
        pytest.param("microbot", "torque", 0, 0.7729275, marks=pytest.mark.thorough),
    ],
)
def test_random_tasks_have_exact_switching_times(name, family, via, most):
    robot, poses = task(name, family, via, 0)
    motion = mo.time_optimal(robot, poses, starts=1, switching_times=True)
    assert motion.provenance["switching_times"]["status"] == "solved"
    assert motion.duration < most < motion.provenance["on_a_mesh"]
    assert mo.certify(robot, motion).ok


def test_a_slack_has_no_switching_times():
    with refused("switching_times", "slack", "0"):
        mo.time_optimal(two_links(), VIA, slack=0.1, switching_times=True)


def test_one_joint_with_only_a_jerk_limit():
    """A constraint may have the name of a control: 2 rad within 10 rad/s^3 take 32 * 2 / 10."""
    robot = mo.Robot.from_dh(alpha=[0.0], a=[0.0], d=[0.0], limits=mo.Limits(qddd_max=10.0))
    motion = mo.time_optimal(robot, [[0.0], [2.0]], starts=1, switching_times=True)
    assert motion.provenance["switching_times"]["status"] == "solved"
    assert motion.duration == pytest.approx((32 * 2 / 10) ** (1 / 3), abs=1e-9)


def test_one_joint_with_only_a_limit_of_the_torque_rate():
    """Torque and its rate are outputs of one function: 2 kg within 10 N/s are a jerk of 5 m/s^3."""
    robot = slider(mass=2.0, tau_max=100.0, taud_max=10.0)
    motion = mo.time_optimal(robot, [[0.0], [1.5]], starts=1, switching_times=True)
    assert motion.provenance["switching_times"]["status"] == "solved"
    assert motion.duration == pytest.approx((32 * 1.5 / 5) ** (1 / 3), abs=1e-9)
    assert mo.certify(robot, motion).ok
