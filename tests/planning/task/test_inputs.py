"""Bad tasks are refused in one line, before any solver starts."""

import re

import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp.planning import straight_path, time_optimal, time_optimal_path
from planning.shared import ARM_VIA, VIA_Q, arm, pendulum, slider

NAN = float("nan")


def refused(call, said):
    with pytest.raises(mo.InputError, match=re.escape(said)) as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("via_q", "said"),
    [
        (VIA_Q[:, :2], "via_q must have shape [any, 3], not [3, 2]"),
        (VIA_Q[0], "via_q must have shape [any, 3], not [3]"),
        (VIA_Q[:1], "via_q must have at least 2 points, not 1"),
        (np.zeros((0, 3)), "via_q must have at least 2 points, not 0"),
        ([[0, 0, 0], [0, NAN, 0]], "via_q must be finite, but entry [1, 1] is nan rad"),
        ([[0, 0, 0], [0, np.inf, 0]], "via_q must be finite, but entry [1, 1] is inf rad"),
        ("home", "via_q must be an array of numbers, not 'home'"),
        ([[0, 0, 0], [0.1, 0, 0], [0.1, 0, 0]], "via points 2 and 3 are the same"),
        (
            [[0, 0, 0], [0, 7, 0]],
            "via point 2 is outside the position limits: joint 'shoulder' at 401.07 deg, "
            "allowed -360 deg to 360 deg",
        ),
    ],
)
def test_bad_via_points_are_refused(microbot, via_q, said, no_solver):
    refused(lambda: time_optimal(microbot, via_q), said)


def test_a_pose_that_gravity_makes_impossible_at_rest_is_refused(microbot, no_solver):
    weak = mo.Limits(qd_max=2.0, tau_max=[400.0, 100.0, 200.0])
    said = (
        "via point 1 cannot be held at rest: joint 'shoulder' needs 196 N m against gravity, "
        "allowed -100 to 100 N m"
    )
    refused(lambda: time_optimal(microbot, VIA_Q, weak), said)
    said = said.replace("via point 1", "path at s = 0")
    refused(lambda: time_optimal_path(microbot, straight_path(VIA_Q), weak), said)


def test_a_pose_passed_in_motion_need_not_be_held(no_solver):
    robot = pendulum(tau_max=6.0, qd_max=10.0)
    said = "path at s = 1.5708 cannot be held at rest: joint 'joint 1' needs 9.81 N m"
    through = [[0.0], [np.pi / 2], [np.pi]]
    # on a straight line there is no corner, so no stop: this one gets as far as the solver
    with pytest.raises(pytest.fail.Exception, match="a solver was started"):
        time_optimal_path(robot, straight_path(through))
    there_and_back = [[0.0], [np.pi / 2], [0.0]]
    refused(lambda: time_optimal_path(robot, straight_path(there_and_back)), said)


def test_the_last_pose_is_at_rest_too(no_solver):
    robot = pendulum(tau_max=6.0, qd_max=10.0)
    said = "via point 2 cannot be held at rest: joint 'joint 1' needs 9.81 N m against gravity"
    refused(lambda: time_optimal(robot, [[0.0], [np.pi / 2]]), said)


def test_a_prismatic_joint_is_spoken_of_in_metres(no_solver):
    robot = slider(tau_max=4.0, q_min=0.0, q_max=1.0)
    said = "joint 'joint 1' at 1.5 m, allowed 0 m to 1 m"
    refused(lambda: time_optimal(robot, [[0.0], [1.5]]), said)


def test_a_robot_without_masses_needs_limits_of_its_motion(no_solver):
    bare = mo.Robot.from_dh([0, 0], [0, 1], [0, 0], limits=mo.Limits(tau_max=1.0))
    for call in (
        lambda: time_optimal(bare, ARM_VIA),
        lambda: time_optimal_path(bare, straight_path(ARM_VIA)),
    ):
        with pytest.raises(mo.InputError, match="mass"):
            call()


@pytest.mark.parametrize(
    "limits",
    [
        mo.Limits(),
        mo.Limits(q_min=-3.0, q_max=3.0),
        mo.Limits(tau_max=[50.0, np.inf]),
    ],
)
def test_limits_that_bound_nothing_are_refused(limits, no_solver):
    robot = arm()
    for call in (
        lambda: time_optimal(robot, ARM_VIA, limits),
        lambda: time_optimal_path(robot, straight_path(ARM_VIA), limits),
    ):
        with pytest.raises(mo.InputError, match=r"limits leave joint '.*' without any bound"):
            call()


def test_limits_of_another_width_are_refused(no_solver):
    limits = mo.Limits(tau_max=1.0).for_joints(3)
    refused(
        lambda: time_optimal(arm(), ARM_VIA, limits),
        "limits are for 3 joints, but the robot has 2",
    )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"mesh": NAN}, "mesh must be finite"),
        ({"starts": 0}, "starts must be at least 1, not 0"),
        ({"starts": 2.5}, "starts must be a whole number, not 2.5"),
        ({"limit_tolerance": 0.0}, "limit_tolerance must be above 0, not 0.0"),
        ({"seed": -1}, "seed must be at least 0, not -1"),
    ],
)
def test_bad_settings_of_the_free_motion_are_refused(changes, said, no_solver):
    refused(lambda: time_optimal(arm(), ARM_VIA, **changes), said)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"grid": 5}, "grid must be at least 10 points, not 5"),
        ({"limit_tolerance": -1.0}, "limit_tolerance must be above 0, not -1.0"),
    ],
)
def test_bad_settings_of_path_timing_are_refused(changes, said, no_solver):
    refused(lambda: time_optimal_path(arm(), straight_path(ARM_VIA), **changes), said)


@pytest.mark.parametrize("function", [time_optimal, time_optimal_path])
def test_an_unknown_setting_is_a_type_error(function, no_solver):
    task = ARM_VIA if function is time_optimal else straight_path(ARM_VIA)
    with pytest.raises(TypeError, match="meshes"):
        function(arm(), task, meshes=40)


@pytest.mark.parametrize(
    ("via_q", "said"),
    [
        ([[0.0, 1.0]], "via_q must have at least 2 points, not 1"),
        ([[0.0, 1.0], [0.0, 1.0]], "via points 1 and 2 are the same: no path between them"),
        ([[0.0], [NAN]], "via_q must be finite"),
    ],
)
def test_a_straight_path_needs_different_finite_points(via_q, said):
    refused(lambda: straight_path(via_q), said)


def test_a_path_of_another_width_is_refused(no_solver):
    refused(
        lambda: time_optimal_path(arm(), straight_path(VIA_Q)), "path must have 2 joints, not 3"
    )


def test_a_path_that_leaves_the_position_limits_in_between_is_refused(no_solver):
    robot = arm(tau_max=[60.0, 25.0], q_min=-1.0, q_max=1.0)
    path = mo.cubic([[0.0, 0.0], [0.5, 0.0]], [0.0, 1.0], [[8.0, 0.0], [0.0, 0.0]])
    with pytest.raises(mo.InputError, match=r"path at s = 0\.\d+ is outside the position limits"):
        time_optimal_path(robot, path)
