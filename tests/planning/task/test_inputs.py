"""Bad tasks are refused in one line, before any solver starts."""

from contextlib import contextmanager

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused
from microbot_ocp.planning import straight_path, time_optimal, time_optimal_path
from planning.shared import ARM_VIA, VIA_Q, arm, pendulum, slider

NAN = float("nan")


@contextmanager
def refused_in_one_line(*parts):
    with refused(*parts) as caught:
        yield
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("via_q", "said"),
    [
        (VIA_Q[:, :2], ("via_q", "shape [any, 3]", "[3, 2]")),
        (VIA_Q[0], ("via_q", "shape [any, 3]", "not [3]")),
        (VIA_Q[:1], ("via_q", "2 points", "not 1")),
        (np.zeros((0, 3)), ("via_q", "2 points", "not 0")),
        ([[0, 0, 0], [0, NAN, 0]], ("via_q", "finite", "[1, 1] is nan rad")),
        ([[0, 0, 0], [0, np.inf, 0]], ("via_q", "finite", "[1, 1] is inf rad")),
        ("home", ("via_q", "array of numbers", "'home'")),
        ([[0, 0, 0], [0.1, 0, 0], [0.1, 0, 0]], ("via points 2 and 3", "zero")),
        (
            [[0, 0, 0], [0, 7, 0]],
            ("via point 2", "position limits", "'shoulder'", "401.07 deg", "-360 deg to 360 deg"),
        ),
    ],
)
def test_bad_via_points_are_refused(microbot, via_q, said, no_solver):
    with refused_in_one_line(*said):
        time_optimal(microbot, via_q)


def test_a_pose_that_gravity_makes_impossible_at_rest_is_refused(microbot, no_solver):
    weak = mo.Limits(qd_max=2.0, tau_max=[400.0, 100.0, 200.0])
    said = ("at rest", "'shoulder'", "196 N m", "-100 to 100 N m")
    with refused_in_one_line("via point 1", *said):
        time_optimal(microbot, VIA_Q, weak)
    with refused_in_one_line("path at s = 0", *said):
        time_optimal_path(microbot, straight_path(VIA_Q), weak)


def test_a_pose_passed_in_motion_need_not_be_held(no_solver):
    robot = pendulum(tau_max=6.0, qd_max=10.0)
    said = ("s = 1.5708", "at rest", "'joint 1'", "9.81 N m")
    through = [[0.0], [np.pi / 2], [np.pi]]
    # on a straight line there is no corner, so no stop: this one gets as far as the solver
    with refused("a solver", error=pytest.fail.Exception):
        time_optimal_path(robot, straight_path(through))
    there_and_back = [[0.0], [np.pi / 2], [0.0]]
    with refused_in_one_line(*said):
        time_optimal_path(robot, straight_path(there_and_back))


def test_the_last_pose_is_at_rest_too(no_solver):
    robot = pendulum(tau_max=6.0, qd_max=10.0)
    said = ("via point 2", "at rest", "'joint 1'", "9.81 N m")
    with refused_in_one_line(*said):
        time_optimal(robot, [[0.0], [np.pi / 2]])


def test_a_prismatic_joint_is_spoken_of_in_metres(no_solver):
    robot = slider(tau_max=4.0, q_min=0.0, q_max=1.0)
    said = ("'joint 1'", "1.5 m", "0 m to 1 m")
    with refused_in_one_line(*said):
        time_optimal(robot, [[0.0], [1.5]])


def test_a_robot_without_masses_needs_limits_of_its_motion(no_solver):
    bare = mo.Robot.from_dh([0, 0], [0, 1], [0, 0], limits=mo.Limits(tau_max=1.0))
    for call in (
        lambda: time_optimal(bare, ARM_VIA),
        lambda: time_optimal_path(bare, straight_path(ARM_VIA)),
    ):
        with refused("limits", "'joint 1'", "masses"):
            call()


@pytest.mark.parametrize(
    ("limits", "joint"),
    [
        (mo.Limits(), "'joint 1'"),
        (mo.Limits(q_min=-3.0, q_max=3.0), "'joint 1'"),
        (mo.Limits(tau_max=[50.0, np.inf]), "'joint 2'"),
    ],
)
def test_limits_that_bound_nothing_are_refused(limits, joint, no_solver):
    robot = arm()
    for call in (
        lambda: time_optimal(robot, ARM_VIA, limits),
        lambda: time_optimal_path(robot, straight_path(ARM_VIA), limits),
    ):
        with refused("limits", joint, "velocity, acceleration"):
            call()


def test_limits_of_another_width_are_refused(no_solver):
    limits = mo.Limits(tau_max=1.0).for_joints(3)
    with refused_in_one_line("limits", "3 joints", "robot", "2"):
        time_optimal(arm(), ARM_VIA, limits)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"mesh": NAN}, ("mesh", "finite", "nan intervals")),
        ({"starts": 0}, ("starts", "1, not 0")),
        ({"starts": 2.5}, ("starts", "whole number", "2.5")),
        ({"limit_tolerance": 0.0}, ("limit_tolerance", "0,", "not 0.0")),
        ({"seed": -1}, ("seed", "0, not -1")),
    ],
)
def test_bad_settings_of_the_free_motion_are_refused(changes, said, no_solver):
    with refused_in_one_line(*said):
        time_optimal(arm(), ARM_VIA, **changes)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"grid": 5}, ("grid", "10 points", "not 5")),
        ({"limit_tolerance": -1.0}, ("limit_tolerance", "0,", "not -1.0")),
    ],
)
def test_bad_settings_of_path_timing_are_refused(changes, said, no_solver):
    with refused_in_one_line(*said):
        time_optimal_path(arm(), straight_path(ARM_VIA), **changes)


@pytest.mark.parametrize("function", [time_optimal, time_optimal_path])
def test_an_unknown_setting_is_a_type_error(function, no_solver):
    task = ARM_VIA if function is time_optimal else straight_path(ARM_VIA)
    with refused("'meshes'", "limit_tolerance", error=TypeError):
        function(arm(), task, meshes=40)


@pytest.mark.parametrize(
    ("via_q", "said"),
    [
        ([[0.0, 1.0]], ("via_q", "2 points", "not 1")),
        ([[0.0, 1.0], [0.0, 1.0]], ("via points 1 and 2", "path")),
        ([[0.0], [NAN]], ("via_q", "finite", "[1, 0] is nan rad")),
    ],
)
def test_a_straight_path_needs_different_finite_points(via_q, said):
    with refused_in_one_line(*said):
        straight_path(via_q)


def test_a_path_of_another_width_is_refused(no_solver):
    with refused_in_one_line("path", "2 joints", "not 3"):
        time_optimal_path(arm(), straight_path(VIA_Q))


def test_a_path_that_leaves_the_position_limits_in_between_is_refused(no_solver):
    robot = arm(tau_max=[60.0, 25.0], q_min=-1.0, q_max=1.0)
    path = mo.cubic([[0.0, 0.0], [0.5, 0.0]], [0.0, 1.0], [[8.0, 0.0], [0.0, 0.0]])
    with refused("path at s = 0.", "position limits", "'joint 1'", "57.2958 deg"):
        time_optimal_path(robot, path)
