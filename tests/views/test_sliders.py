"""Sliders moved by hand, without a browser."""

import sys
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp.motion import Outcome

VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])


@pytest.fixture(scope="module")
def robot():
    return mo.load_robot("microbot")


@pytest.fixture(scope="module")
def sliders(robot):
    return mo.views.notebook.TimeOptimalSliders(robot, VIA_Q, mesh=15)


@pytest.fixture
def at_rest(sliders):
    """Sliders at their first position."""
    sliders.torque.value, sliders.speed.value, sliders.payload.value = 100, 100, 0.0
    assert sliders.wait()
    return sliders


def picture(sliders):
    image = Image.open(BytesIO(sliders._repr_mimebundle_()["image/png"]))
    return np.asarray(image.convert("RGB")).astype(int)


def coloured(pixels):
    """Number of pixels of the curve's colour, #D55E00, beside those of the legend."""
    near = np.abs(pixels[:-45] - [0xD5, 0x5E, 0x00]).max(axis=-1) < 30
    return int(near.sum())


@pytest.mark.slow
def test_a_moved_slider_solves_the_task_under_its_limits(at_rest, robot):
    before, pixels = at_rest.motion, picture(at_rest)
    at_rest.torque.value, at_rest.speed.value = 80, 120
    assert at_rest.wait()
    own = robot.limits
    assert at_rest.robot.limits.tau_max == pytest.approx(0.8 * own.tau_max)
    assert at_rest.robot.limits.qd_max == pytest.approx(1.2 * own.qd_max)
    assert at_rest.motion.duration > 1.05 * before.duration
    assert f"{at_rest.motion.duration:.3f} s" in at_rest.message
    assert mo.certify(at_rest.robot, at_rest.motion, via_q=VIA_Q).ok
    assert coloured(pixels) > 500
    assert (picture(at_rest) != pixels).any()


@pytest.mark.thorough
def test_the_payload_is_part_of_the_robot(at_rest, robot):
    light = at_rest.motion.duration
    at_rest.payload.value = 1.0
    assert at_rest.wait()
    assert at_rest.robot.links[-1].mass == robot.links[-1].mass + 1.0
    assert at_rest.motion.duration > 1.1 * light
    needed = mo.inverse_dynamics(at_rest.robot)(*(v.T for v in at_rest.motion.sample(0.0)))
    assert needed.full().ravel() == pytest.approx(at_rest.motion.tau[0], rel=1e-6)


@pytest.mark.thorough
def test_a_setting_that_cannot_be_is_told_and_shows_no_motion(at_rest):
    at_rest.torque.value, at_rest.payload.value = 60, 2.0
    assert at_rest.wait()
    assert at_rest.motion is None
    tells(at_rest.message, "not solved", "via point 1", "at rest", "N m")
    assert at_rest.message.replace("'", "&#x27;") in at_rest._status.value
    assert coloured(picture(at_rest)) == 0
    at_rest.payload.value = 0.0
    assert at_rest.wait()
    assert at_rest.motion is not None


def test_a_solver_that_fails_is_told(at_rest, monkeypatch):
    outcome = Outcome.of(mo.Status.INFEASIBLE, "it cannot be")
    failed = mo.Motion(*([0.0, 1.0], *np.zeros((4, 2, 3))), outcome=outcome)
    monkeypatch.setattr(at_rest, "_solver", lambda *_, **__: failed)
    at_rest.torque.value = 90
    assert at_rest.wait()
    assert at_rest.motion is None
    tells(at_rest.message, "not solved", "it cannot be")

    def broken(*_, **__):
        raise RuntimeError("no memory")

    monkeypatch.setattr(at_rest, "_solver", broken)
    at_rest.torque.value = 91
    assert at_rest.wait()
    tells(at_rest.message, "not solved", "RuntimeError: no memory")


@pytest.mark.thorough
def test_a_burst_of_moves_does_not_queue_up(at_rest):
    before = at_rest.solves
    for share in range(99, 69, -1):
        at_rest.torque.value = share
    assert at_rest.wait()
    assert at_rest.solves - before < 10
    assert at_rest.robot.limits.tau_max[0] == pytest.approx(0.7 * 400.0)


def test_a_notebook_gets_a_widget_and_a_picture_for_where_none_can_live(at_rest):
    bundle = at_rest._repr_mimebundle_()
    assert "application/vnd.jupyter.widget-view+json" in bundle
    assert bundle["image/png"].startswith(b"\x89PNG")
    assert bundle["text/plain"] == at_rest.message


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"torque": 1.5}, ("torque", "pair", "1.5")),
        ({"speed": (1.2, 1.5)}, ("lowest speed", "1, not 1.2")),
        ({"torque": (0.5, 0.9)}, ("highest torque", "1, not 0.9")),
        ({"payload": -1.0}, ("payload", "0 kg", "-1.0")),
        ({"mesh": 1}, ("mesh", "4 intervals", "not 1")),
    ],
)
def test_bad_arguments_are_refused(robot, arguments, message):
    with refused(*message):
        mo.views.notebook.TimeOptimalSliders(robot, VIA_Q, **arguments)


def test_without_ipywidgets_it_says_what_to_install(robot, monkeypatch):
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    with refused("ipywidgets", "pip install 'microbot_ocp[notebook]'"):
        mo.views.notebook.TimeOptimalSliders(robot, VIA_Q)
