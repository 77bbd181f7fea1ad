"""Curves against time: what every axes shows, units, many joints, one joint, failures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp.motion import Outcome
from microbot_ocp.views.plots import Curve, curves
from planning.shared import slider

CUT = "curves go on beyond"
VIA_Q, VIA_T = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]]), np.array([0.0, 2.0, 4.0])


@pytest.fixture(scope="module")
def robot():
    return mo.load_robot("microbot")


@pytest.fixture(scope="module")
def motion(robot):
    shape = mo.spline(VIA_Q, VIA_T)
    return mo.Motion.from_polynomial(robot, shape, label="spline", step=0.05)


@pytest.fixture(scope="module")
def drawn(robot, motion):
    run = mo.track(robot, motion, mo.ComputedTorque(100.0), q0=[0.1, 0.0, 0.0], step=0.05)
    return [Curve.of(motion), Curve.of(run)]


def legend_texts(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def assert_all_on_the_page(figure):
    figure.draw_without_rendering()
    page = figure.bbox
    for item in [*figure.axes, *figure.legends]:
        box = item.get_tightbbox()
        assert box is not None
        assert page.x0 - 1 <= box.x0
        assert box.x1 <= page.x1 + 1
        assert page.y0 - 1 <= box.y0
        assert box.y1 <= page.y1 + 1


def test_one_joint_has_its_quantities_under_each_other(robot, drawn):
    grid = curves(robot, drawn, ("q", "qd", "qdd"), joints=[1], via=(VIA_T, VIA_Q))
    labels = [axes.get_ylabel() for axes in grid[:, 0]]
    assert labels == ["position [deg]", "velocity [rad/s]", "acceleration [rad/s^2]"]
    assert grid[-1, 0].get_xlabel() == "t [s]"
    lines = {line.get_label(): line for line in grid[0, 0].get_lines()}
    assert list(lines) == ["spline", "computed torque", "_via point"]
    expected = np.degrees(drawn[0].values["q"][:, 1])
    np.testing.assert_allclose(lines["spline"].get_ydata(), expected)
    np.testing.assert_allclose(lines["_via point"].get_ydata(), [0, 45, 90])
    assert legend_texts(grid.figure) == ["spline", "computed torque", "via point passed"]


def test_all_joints_have_a_column_each(robot, drawn):
    grid = curves(
        robot, drawn, ("q", "error", "tau"), limits=robot.limits, bounds={"q": 10.0}, title="mine"
    )
    assert grid.shape == (3, 3)
    assert [axes.get_title() for axes in grid[0]] == list(robot.joint_names)
    assert len(grid[1, 0].get_lines()) == 1  # a motion has no error
    levels = [line.get_ydata()[0] for line in grid[2, 1].get_lines() if line.get_label()[0] == "_"]
    assert levels == [-500.0, 500.0]
    assert [text.get_text() for text in grid[0, 1].texts] == ["limits ±360 deg", CUT]
    assert grid[0, 0].get_ylim()[0] == -10.0
    assert grid.figure.get_suptitle() == "mine"
    assert len({axes.get_xlim() for axes in grid.flat}) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "quantities", [("q",), pytest.param(("error", "tau"), marks=pytest.mark.thorough)]
)
def test_nothing_is_outside_the_page(robot, drawn, quantities):
    assert_all_on_the_page(curves(robot, drawn, quantities, title="a title").figure)
    assert_all_on_the_page(curves(robot, drawn, quantities, joints=[0]).figure)


@pytest.mark.thorough
@pytest.mark.slow
def test_seven_joints_have_a_row_each_and_the_grid_is_the_same_way_round():
    arm = mo.load_robot("panda")
    middle = 0.5 * (arm.limits.q_min + arm.limits.q_max)
    shape = mo.cubic([middle, middle + 0.3], [0.0, 1.0])
    motion = mo.Motion.from_polynomial(arm, shape, label="cubic", step=0.1)
    grid = motion.plot(arm)
    assert grid.shape == (3, 7)
    assert [axes.get_title(loc="left") for axes in grid[0]] == list(arm.joint_names)
    assert {axes.get_ylabel() for axes in grid[2]} == {"torque [N m]"}
    assert_all_on_the_page(grid.figure)


def test_a_prismatic_joint_in_metres_and_newtons():
    robot = slider(qd_max=1.0, tau_max=4.0)
    motion = mo.time_optimal(robot, [[0.0], [1.0]], mesh=10)
    grid = motion.plot(robot)
    assert grid.shape == (3, 1)
    labels = [axes.get_ylabel() for axes in grid[:, 0]]
    assert labels == ["position [m]", "velocity [m/s]", "torque [N]"]
    assert grid[0, 0].get_lines()[0].get_ydata()[-1] == pytest.approx(1.0)
    assert_all_on_the_page(grid.figure)


def test_a_joint_that_is_not_there_and_other_input(robot, motion):
    with refused("joints", "0 to 2", "3"):
        motion.plot(robot, joints=[3])
    with refused("quantity", "q, qd", "'taud'"):
        motion.plot(robot, quantities=["taud"])
    with refused("motion", "3 joints", "robot", "1"):
        motion.plot(slider())


def test_what_was_not_solved_is_said_in_red(robot, motion):
    failed = replace(motion, outcome=Outcome.of(mo.Status.ITERATION_LIMIT))
    title = failed.plot(robot).figure.legends[0].get_title()
    tells(title.get_text(), "spline", "not solved", "iteration limit")
    assert title.get_color() == "#B00020"
    assert motion.plot(robot).figure.legends[0].get_title().get_text() == ""


def test_a_simulation_that_stopped_is_drawn_as_far_as_it_goes(robot, motion):
    run = mo.simulate(robot, motion)
    half = np.where(run.t[:, None] < 2.0, run.q, np.nan)
    stopped = replace(run, q=half, status=mo.Status.INTEGRATION_FAILED)
    grid = stopped.plot(robot)
    assert np.isfinite(grid[0, 0].get_ylim()).all()
    title = grid.figure.legends[0].get_title().get_text()
    tells(title, "simulation", mo.Status.INTEGRATION_FAILED)


def test_given_axes_are_drawn_on_and_keep_their_page(robot, motion):
    figure = Figure()
    own = figure.subplots(1, 3)
    grid = motion.plot(robot, own, quantities=["tau"])
    assert list(grid.flat) == list(own)
    assert figure.legends == []
    assert figure.get_suptitle() == ""
    assert [t.get_text() for t in own[0].get_legend().get_texts()][:1] == ["spline"]
    with refused("axes", "1 x 3", "not 2"):
        motion.plot(robot, own[:2], quantities=["tau"])
    with refused("axes", "matplotlib", "'here'"):
        motion.plot(robot, "here", quantities=["tau"], joints=[0])
