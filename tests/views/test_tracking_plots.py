"""Errors and torques of controllers as drawn."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import microbot_ocp as mo
from helpers import refused
from planning.shared import slider
from views.test_curves import assert_all_on_the_page, legend_texts


@pytest.fixture(scope="module")
def robot():
    return mo.load_robot("microbot")


@pytest.fixture(scope="module")
def motion(robot):
    shape = mo.quintic([[0.0, 0.0, 0.0], [0.5, 0.8, 0.4]], [0.0, 1.0])
    return mo.Motion.from_polynomial(robot, shape, label="quintic")


@pytest.fixture(scope="module")
def runs(robot, motion):
    peak = 0.8 * np.abs(motion.tau).max(axis=0)
    laws = (mo.ComputedTorque(100.0), mo.Feedforward())
    return [mo.track(robot, motion, law, saturation=peak) for law in laws]


def shades(axes):
    """Spans of time and of height of what is shaded as saturated, by colour."""
    found = {}
    for patch in axes.patches:
        if patch.get_label() == "_saturated":
            box = patch.get_extents().transformed(axes.transData.inverted())
            found.setdefault(to_rgb(patch.get_facecolor()), []).append((box.x0, box.x1))
    return found


@pytest.mark.slow
def test_errors_in_degrees_and_limits_of_the_drives(robot, runs):
    run = runs[0]
    grid = run.plot(robot)
    assert grid.shape == (2, 3)
    assert [axes.get_ylabel() for axes in grid[:, 0]] == ["error [deg]", "torque [N m]"]
    for joint in range(3):
        line = grid[0, joint].get_lines()[0]
        expected = np.degrees(run.reference.q - run.q)[:, joint]
        np.testing.assert_allclose(line.get_ydata(), expected, atol=1e-12)
        levels = {
            line.get_ydata()[0] for line in grid[1, joint].lines if line.get_label() == "_limit"
        }
        tau = run.tau[:, joint]
        assert levels <= {tau.min(), tau.max()} | {-tau.max(), -tau.min()}
        assert levels
    assert legend_texts(grid.figure)[0] == "computed torque"
    assert_all_on_the_page(grid.figure)


def test_shaded_where_the_torque_is_at_its_limit(robot, runs, motion):
    run = runs[0]
    bound = 0.8 * np.abs(motion.tau).max(axis=0)
    grid = run.plot(robot)
    assert np.any(np.abs(run.tau) >= bound)
    for joint in range(3):
        spans = [span for each in shades(grid[1, joint]).values() for span in each]
        middle = 0.5 * (run.t[:-1] + run.t[1:])
        shaded = np.any([(a < middle) & (middle < b) for a, b in spans] or [middle < 0], axis=0)
        np.testing.assert_array_equal(shaded, np.abs(run.tau[:-1, joint]) >= 0.99 * bound[joint])
        assert shades(grid[0, joint]) == {}
    assert any("torque" in text and "limit" in text for text in legend_texts(grid.figure))


@pytest.mark.thorough
def test_several_controllers_have_a_colour_a_style_and_shades_of_their_own(robot, runs):
    grid = mo.plots.tracking(robot, runs)
    lines = grid[0, 0].get_lines()
    assert [line.get_label() for line in lines] == ["computed torque", runs[1].label]
    assert len({line.get_color() for line in lines}) == 2
    assert len({line.get_linestyle() for line in lines}) == 2
    colors = {color for axes in grid[1] for color in shades(axes)}
    assert colors == {to_rgb(line.get_color()) for line in lines}
    assert len({axes.get_xlim() for axes in grid.flat}) == 1
    assert_all_on_the_page(grid.figure)


def test_limits_that_differ_are_those_of_the_curve_of_their_colour(robot, motion, runs):
    free = mo.track(robot, motion, mo.ComputedTorque(100.0), saturation=False)
    own = Figure().subplots(2, 3)
    grid = mo.plots.tracking(robot, {"free": free, "limited": runs[0]}, own)
    assert list(grid.flat) == list(own.flat)
    limited = grid[1, 0].get_lines()[1]
    bounds = [line for line in grid[1, 0].get_lines() if line.get_label() == "_own limit"]
    assert {line.get_color() for line in bounds} == {limited.get_color()}
    assert {line.get_ydata()[0] for line in bounds} == {
        -np.abs(limited.get_ydata()).max(), np.abs(limited.get_ydata()).max()
    }  # fmt: skip
    assert not [line for line in grid[1, 0].get_lines() if line.get_label() == "_limit"]


def test_an_error_of_a_prismatic_joint_in_millimetres():
    robot = slider(tau_max=4.0)
    shape = mo.quintic([[0.0], [1.0]], [0.0, 2.0])
    run = mo.track(robot, shape, mo.ComputedTorque(25.0), q0=[0.01])
    grid = run.plot(robot)
    assert [axes.get_ylabel() for axes in grid[:, 0]] == ["error [mm]", "torque [N]"]
    assert grid[0, 0].get_lines()[0].get_ydata()[0] == pytest.approx(-10.0)


def test_bad_input(robot, runs):
    with refused("trackings", "one"):
        mo.plots.tracking(robot, [])
    with refused("tracking", "3 joints", "robot", "1"):
        mo.plots.tracking(slider(), runs)
