"""Figures of single motions: what every axes shows, units, nothing outside the page."""

from __future__ import annotations

import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp.views.joint_plots import Curve, joint_figure, joints_figure, save_figures


@pytest.fixture(scope="module")
def robot():
    return mo.load_robot("microbot")


@pytest.fixture(scope="module")
def curves(robot):
    via, t = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]]), [0.0, 2.0, 4.0]
    motion = mo.Motion.from_polynomial(robot, mo.spline(via, t), label="spline", step=0.05)
    run = mo.track(robot, motion, mo.ComputedTorque(100.0), q0=[0.1, 0.0, 0.0], step=0.05)
    return [Curve.of(motion), Curve.of(run)]


def test_one_joint_has_position_velocity_and_acceleration_under_each_other(robot, curves):
    figure = joint_figure(robot, curves, 1, title="a title", marks=[(2.0, np.radians(45))])
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["position [deg]", "velocity [rad/s]", "acceleration [rad/s^2]"]
    assert figure.axes[-1].get_xlabel() == "t [s]"
    drawn = figure.axes[0].get_lines()
    assert [line.get_label() for line in drawn] == ["spline", "computed torque", "via point"]
    np.testing.assert_allclose(drawn[0].get_ydata(), np.degrees(curves[0].values["q"][:, 1]))
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "spline", "computed torque", "via point",
    ]  # fmt: skip


def test_all_joints_have_a_column_each(robot, curves):
    figure = joints_figure(robot, curves, ("q", "error", "tau"), title="a title",
                           limits=robot.limits.bounds("tau"), bounds={"q": 10.0})  # fmt: skip
    assert len(figure.axes) == 9
    assert [axes.get_title() for axes in figure.axes[:3]] == list(robot.joint_names)
    assert len(figure.axes[3].get_lines()) == 1  # a motion has no error
    assert len(figure.axes[6].get_lines()) == 4  # two curves, two limits
    assert figure.axes[0].get_ylim()[0] == -10.0


def test_nothing_is_outside_the_page(robot, curves):
    for figure in (
        joint_figure(robot, curves, 0, title="a title"),
        joints_figure(robot, curves, ("error", "tau"), title="a title"),
    ):
        figure.draw_without_rendering()
        page = figure.bbox
        for item in [*figure.axes, *figure.legends]:
            box = item.get_tightbbox()
            assert box is not None
            assert page.x0 - 1 <= box.x0
            assert box.x1 <= page.x1 + 1
            assert page.y0 - 1 <= box.y0
            assert box.y1 <= page.y1 + 1


def test_figures_are_written(robot, curves, tmp_path):
    written = save_figures({"torque": joints_figure(robot, curves, title="a title")}, tmp_path)
    assert sorted(path.name for path in written) == ["torque.pdf", "torque.png"]
