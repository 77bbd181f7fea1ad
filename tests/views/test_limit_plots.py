"""Use of limits and saturation as drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

import microbot_ocp as mo
from helpers import refused, tells
from limits.test_limit_history import bang_cruise_bang
from microbot_ocp.motion import Outcome
from planning.shared import slider
from views.test_curves import assert_all_on_the_page, legend_texts


@pytest.fixture(scope="module")
def robot():
    return slider(tau_max=4.0, qd_max=1.0)


@pytest.fixture(scope="module")
def motion(robot):
    return mo.Motion.from_polynomial(robot, bang_cruise_bang(), label="mine")


def test_use_of_each_kind_of_limit(robot, motion):
    grid = mo.plots.limit_use(robot, motion)
    assert [axes.get_ylabel() for axes in grid[:, 0]] == ["velocity [%]", "torque [%]"]
    assert grid[-1, 0].get_xlabel() == "t [s]"
    curve, *others = grid[1, 0].get_lines()
    y = np.asarray(curve.get_ydata())
    t = np.asarray(curve.get_xdata())
    np.testing.assert_allclose(y[(t < 0.49) | (t > 1.01)], 100.0)
    np.testing.assert_allclose(y[(t > 0.51) & (t < 0.99)], 0.0, atol=1e-9)
    switches = sorted({line.get_xdata()[0] for line in others if line.get_label() == "_switch"})
    np.testing.assert_allclose(switches, [0.0, 0.5, 1.0, 1.5], atol=2e-3)
    assert [line.get_ydata()[0] for line in others if line.get_label() == "_limit"] == [100.0]
    assert_all_on_the_page(grid.figure)


def test_jumps_that_no_rate_allows_are_marked_and_not_drawn(robot, motion):
    grid = mo.plots.limit_use(robot, motion, limits=mo.Limits(taud_max=10.0))
    lines = grid[0, 0].get_lines()
    jumps = sorted(line.get_xdata()[0] for line in lines if line.get_label() == "_jump")
    np.testing.assert_allclose(jumps, [0.0, 0.5, 1.0, 1.5])
    assert grid[0, 0].get_ylim()[1] == 125.0
    assert any("acceleration jumps" in text for text in legend_texts(grid.figure))


def test_a_broken_limit_stays_in_sight(robot, motion):
    grid = mo.plots.limit_use(robot, motion, limits=mo.Limits(tau_max=2.0))
    assert grid.shape == (1, 1)
    assert grid[0, 0].get_ylim()[1] > 200.0


def test_bad_input(robot, motion):
    with refused("quantity", "qd, tau", "'taud'", "'tau'"):
        mo.plots.limit_use(robot, motion, quantities=["taud"])
    with refused("limits", "bound", "none"):
        mo.plots.limit_use(robot, motion, limits=mo.Limits())
    with refused("robot", "mapping"):
        mo.plots.saturation({"mine": motion})
    with refused("motions", "one"):
        mo.plots.saturation({}, robot=robot)


def test_bars_stand_where_the_limits_are_used_up(robot, motion):
    axes = mo.plots.saturation({"mine": motion}, robot=robot)
    bars = [bar for box in axes.containers if box.get_label() == "_spell" for bar in box]
    spans = sorted((bar.get_x(), bar.get_x() + bar.get_width()) for bar in bars)
    np.testing.assert_allclose(spans, [[0, 0.5], [0.495, 1.005], [1.0, 1.5]], atol=2e-3)
    assert [text.get_text() for text in axes.get_yticklabels()] == ["joint 1"]
    assert [text.get_text() for text in axes.texts] == ["mine, 1.500 s"]
    upper, lower, velocity = legend_texts(axes.figure)
    tells(upper, "torque", "upper limit")
    tells(lower, "torque", "lower limit")
    tells(velocity, "velocity", "limit")
    assert_all_on_the_page(axes.figure)


def test_saturation_of_a_comparison_tells_what_failed(comparison):
    axes = mo.plots.saturation(comparison)
    assert len(axes.get_yticklabels()) == 9  # three joints of three motions
    tells(axes.figure.legends[0].get_title().get_text(), "lspb", "not solved")
    own = Figure().subplots()
    assert mo.plots.saturation(comparison, own, methods=["cubic"]) is own
    assert len(own.get_yticklabels()) == 3


def test_a_motion_that_was_not_solved_says_so(robot, motion):
    failed = replace(motion, outcome=Outcome.of(mo.Status.ITERATION_LIMIT))
    title = mo.plots.limit_use(robot, failed).figure.legends[0].get_title().get_text()
    tells(title, "not solved", mo.Status.ITERATION_LIMIT)
