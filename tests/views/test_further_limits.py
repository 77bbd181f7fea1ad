"""A limit beside those of the joints in every figure and table: here the tool's speed."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from matplotlib.figure import Figure

import microbot_ocp as mo
from helpers import refused, tells
from views.test_curves import assert_all_on_the_page, legend_texts

VIA_Q = np.radians([[0.0, 0.0, 0.0], [-8.0, 45.0, 30.0], [-90.0, 90.0, 90.0]])
TOP_SPEED = 6.0  # m/s


@pytest.fixture(scope="module")
def robot():
    return mo.load_robot("microbot").with_limits(also=[mo.limits.tool_speed(upper=TOP_SPEED)])


@pytest.fixture(scope="module")
def motion(robot):
    return mo.Motion.from_polynomial(robot, mo.quintic(VIA_Q, [0.0, 1.2, 2.6]), label="quintic")


@pytest.fixture(scope="module")
def speed(robot, motion):
    """Speed of the tool from the Jacobian at every sample, m/s."""
    jacobian = np.array(mo.jacobian(robot).map(motion.t.size)(motion.q.T))
    rows = jacobian[:3].reshape(3, motion.t.size, 3)
    return np.linalg.norm(np.einsum("iNj,Nj->Ni", rows, motion.qd), axis=1)


@pytest.fixture(scope="module")
def comparison(robot):
    return mo.compare(robot, VIA_Q, ["cubic_scaled", "lspb_scaled"], via_t=[0.0, 1.2, 2.6])


def test_its_value_is_drawn_with_its_bound_across_the_page(robot, motion, speed):
    grid = motion.plot(robot, quantities=["qd", "tool_speed", "tau"])
    assert grid.shape == (3, 3)
    assert grid[1, 0] is grid[1, 1] is grid[1, 2]
    panel = grid[1, 0]
    assert panel.get_ylabel() == "tool speed [m/s]"
    curve = panel.get_lines()[0]
    np.testing.assert_allclose(curve.get_xdata(), motion.t)
    np.testing.assert_allclose(curve.get_ydata(), speed, atol=1e-9)
    bounds = [line.get_ydata()[0] for line in panel.get_lines() if line.get_label() == "_limit"]
    assert bounds == [TOP_SPEED]
    assert [axes.get_title() for axes in grid[0]] == list(robot.joint_names)
    assert_all_on_the_page(grid.figure)


def test_a_bound_that_varies_is_a_curve_beside_the_value(robot, motion):
    zone = mo.Limit(
        "zone speed",
        lambda state: state.tool_velocity[0],
        lower=-30.0,
        upper=lambda state: 10.0 + state.q[0],
        unit="m/s",
    )
    grid = motion.plot(robot.with_limits(also=[zone]), quantities=["zone_speed"])
    (bound,) = [line for line in grid[0, 0].get_lines() if line.get_label() == "_own limit"]
    np.testing.assert_allclose(bound.get_ydata(), 10.0 + motion.q[:, 0])
    assert any("limit" in text and "colour" in text for text in legend_texts(grid.figure))


def test_a_torque_rate_has_a_panel_for_each_joint_where_it_is_limited(robot, motion):
    limited = robot.with_limits(taud_max=5000.0)
    grid = motion.plot(limited, quantities=["taud"])
    assert grid[0, 0].get_ylabel() == "torque rate [N m/s]"
    y = grid[0, 2].get_lines()[0].get_ydata()
    inside = slice(5, 400)  # before the jump of the jerk at the via point
    slope = np.gradient(motion.tau[:, 2], motion.t)
    np.testing.assert_allclose(y[inside], slope[inside], rtol=1e-3, atol=1.0)


@pytest.mark.thorough
@pytest.mark.slow
def test_other_layouts_and_axes_of_the_caller(robot, motion):
    alone = motion.plot(robot, quantities=["tool_speed"])
    assert alone[0, 0].get_title() == ""
    own = Figure().subplots(2, 3)
    grid = motion.plot(robot, own, quantities=["tool_speed", "q"])
    assert list(grid.flat) == list(own.flat)
    assert [axes.get_visible() for axes in own[0]] == [True, False, False]
    panda = mo.load_robot("panda").with_limits(also=[mo.limits.tool_speed(upper=1.0)])
    middle = 0.5 * (panda.limits.q_min + panda.limits.q_max)
    shape = mo.cubic([middle, middle + 0.3], [0.0, 1.0])
    slow = mo.Motion.from_polynomial(panda, shape, label="cubic", step=0.1)
    grid = slow.plot(panda, quantities=["q", "tool_speed"])
    assert grid[1, 0] is grid[1, 6]
    assert grid[0, 0] is not grid[0, 6]
    assert_all_on_the_page(grid.figure)


@pytest.mark.thorough
def test_a_tracking_and_a_comparison_draw_it_too(robot, motion, comparison):
    run = mo.track(robot, motion, mo.ComputedTorque(100.0))
    panel = run.plot(robot, quantities=["tool_speed"])[0, 0]
    assert panel.get_lines()[0].get_ydata().max() > TOP_SPEED
    panel = comparison.plot(quantities=["tool_speed"])[0, 0]
    peaks = [line.get_ydata().max() for line in panel.lines if line.get_label()[0] != "_"]
    assert max(peaks) == pytest.approx(TOP_SPEED, rel=1e-4)


def test_a_quantity_without_a_limit_is_refused(robot, motion):
    with refused("quantity", "tool_speed", "'x'"):
        motion.plot(robot, quantities=["x"])
    vector = mo.Limit("tool velocity", lambda state: state.tool_velocity[:2], -1.0, 1.0, "m/s")
    with refused("'tool_velocity'", "2 components"):
        motion.plot(robot.with_limits(also=[vector]), quantities=["tool_velocity"])


def test_its_use_has_a_panel_of_its_own(robot, motion, speed):
    grid = mo.plots.limit_use(robot, motion)
    assert [axes.get_ylabel() for axes in grid[:, 0]] == [
        "velocity [%]", "torque [%]", "tool speed [%]",
    ]  # fmt: skip
    curve = grid[2, 0].get_lines()[0]
    at_samples = np.interp(motion.t, curve.get_xdata(), curve.get_ydata())
    np.testing.assert_allclose(at_samples, 100.0 * speed / TOP_SPEED, atol=1e-6)
    only = mo.plots.limit_use(robot, motion, quantities=["tool_speed"])
    assert legend_texts(only.figure)[0] == "limit"  # no joints to tell apart
    assert_all_on_the_page(grid.figure)


def test_components_that_are_not_joints_are_named_in_their_panel(robot, motion):
    vector = mo.Limit(
        "tool velocity", lambda state: state.tool_velocity[:2], -9.0, 9.0, "m/s", ("x", "y")
    )
    grid = mo.plots.limit_use(robot.with_limits(also=[vector]), motion)
    texts = [text.get_text() for text in grid[-1, 0].get_legend().get_texts()]
    assert texts == ["x", "y"]


def test_it_has_a_lane_where_it_is_used_up(robot, motion, speed):
    axes = mo.plots.saturation({"mine": motion}, robot=robot)
    lanes = [text.get_text() for text in axes.get_yticklabels()]
    assert lanes == [*robot.joint_names, "tool speed"]
    bars = [bar for box in axes.containers if box.get_label() == "_spell" for bar in box]
    (lane,) = [bar for bar in bars if round(bar.get_y() + bar.get_height() / 2) == 3]
    beyond = motion.t[speed >= 0.99 * TOP_SPEED]
    span = lane.get_x(), lane.get_x() + lane.get_width()
    np.testing.assert_allclose(span, (beyond[0], beyond[-1]), atol=2e-3)
    assert any("tool speed at" in text for text in legend_texts(axes.figure))
    assert_all_on_the_page(axes.figure)


@pytest.mark.thorough
def test_a_comparison_has_a_column_for_it(comparison, tmp_path):
    table = comparison.table()
    assert "peak tool speed [%]" in table.heads
    column = [row[table.heads.index("peak tool speed [%]")] for row in table.cells]
    certified = [
        next(c for c in certificate.limit_checks if c.quantity == "tool_speed")
        for certificate in comparison.certificates.values()
    ]
    assert column == [f"{100 * check.utilisation[0]:.0f}" for check in certified]
    comparison.save(tmp_path, ["csv", "json"])
    with (tmp_path / "comparison.csv").open(encoding="utf-8", newline="") as stream:
        (head, *_) = csv.reader(stream)
    assert any(name.startswith("utilisation_tool_speed") for name in head)


@pytest.mark.thorough
def test_a_broken_one_is_named_in_the_verdict(robot, motion):
    entry = mo.compare(robot, VIA_Q, ["cubic"]).entries[0]
    certificate = mo.certify(robot, motion)
    assert not certificate.ok
    assert "tool speed" in certificate._repr_html_()
    comparison = mo.Comparison(
        robot,
        VIA_Q,
        robot.limits,
        (mo.tasks.Entry(**{**vars(entry), "certificate": certificate}),),
        "cubic",
    )
    tells(str(comparison.table()), "FAILED", "tool speed +")


@pytest.mark.slow
def test_notebooks_and_the_report_name_it(robot, comparison):
    tells(robot._repr_html_(), "tool speed", "6 m/s")
    figure = mo.plots.report_figure(comparison, footer="")
    texts = [text.get_text() for text in figure.findobj(lambda a: hasattr(a, "get_text"))]
    tells("\n".join(t for t in texts if isinstance(t, str)), "tool speed", "6 m/s")
    figure.draw_without_rendering()


@pytest.mark.slow
def test_the_phase_plane_names_it(robot):
    slow = robot.with_limits(also=[mo.limits.tool_speed(upper=1.0)])
    axes = mo.plots.phase_plane(slow, mo.straight_path(VIA_Q))
    texts = legend_texts(axes.figure)
    assert any("tool speed at" in text for text in texts)
    assert "velocity limits" in texts  # not of the joints alone
    assert not {text.get_text() for text in axes.texts} & set(robot.joint_names)
