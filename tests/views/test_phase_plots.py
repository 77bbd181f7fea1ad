"""The figure of the phase plane: what is drawn is what was computed."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp.motion import PiecewisePolynomial
from planning.shared import pendulum, slider
from views.test_curves import assert_all_on_the_page, legend_texts

VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])


def test_profile_curve_and_switches():
    robot = mo.load_robot("microbot")
    plane = mo.planning.phase_plane(robot, mo.straight_path(VIA_Q))
    axes = mo.plots.phase_plane(robot, plane, unit="rad")
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("path parameter s [rad]", "ds/dt [rad/s]")
    lines = {str(line.get_label()): line for line in axes.get_lines()}
    np.testing.assert_allclose(lines["switch"].get_xdata(), plane.switches)
    np.testing.assert_allclose(lines["joint velocity limits"].get_ydata(), plane.velocity_bound)
    drawn = np.concatenate([np.asarray(line.get_ydata()) for line in axes.get_lines()])
    assert plane.speed.max() in drawn
    assert legend_texts(axes.figure) == [
        "inadmissible",
        "maximum-velocity curve (torque)",
        "joint velocity limits",
        "torque of elbow at its upper limit",
        "torque of elbow at its lower limit",
        "velocity of waist at its lower limit",
        "switch",
    ]
    assert {"waist", "shoulder"} <= {text.get_text() for text in axes.texts}
    assert_all_on_the_page(axes.figure)


def test_a_slider_has_force_limits_and_no_curve():
    robot = slider(tau_max=4.0, qd_max=1.0)
    own = Figure().subplots()
    axes = mo.plots.phase_plane(robot, mo.straight_path([[0.0], [1.0]]), own)
    assert axes is own
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    assert any("force" in text and "upper limit" in text for text in texts)
    assert not any("maximum-velocity" in text for text in texts)


def test_a_path_that_cannot_be_travelled_says_so():
    path = PiecewisePolynomial([0.0, np.pi], [[[0.0], [1.0]]])
    axes = mo.plots.phase_plane(pendulum(tau_max=5.0), path)
    (text,) = axes.texts
    tells(text.get_text(), "not solved", "end", "s = ")
    assert text.get_color() == "#B00020"


def test_one_axes_only():
    with refused("axes", "matplotlib", "not 2"):
        mo.plots.phase_plane(
            slider(tau_max=4.0), mo.straight_path([[0.0], [1.0]]), Figure().subplots(1, 2)
        )
