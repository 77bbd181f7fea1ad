"""Spells at limits, their lanes, switches and lines of text."""

import numpy as np
import pytest
from reading import read, static

from microbot_ocp.motion import Mark, Motion
from microbot_ocp.robot import Limits
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.recording import of_motion
from microbot_ocp.views.recording._limits import find_spells


@pytest.fixture(scope="module")
def bang(microbot, tmp_path_factory):
    """Torque of the waist: full, none, full the other way, and beyond; of the others none."""
    t = np.linspace(0.0, 1.0, 1001)
    tau = np.zeros((1001, 3))
    tau[t < 0.3, 0] = 400.0
    tau[t > 0.6, 0] = -397.0
    tau[t > 0.9, 0] = -420.0
    qd = np.zeros((1001, 3))
    qd[(t > 0.2) & (t < 0.4), 2] = 2.0
    q = 0.5 * t[:, None] * np.ones(3)
    motion = Motion(t, q, qd, 0 * tau, tau, marks=(Mark(0.5, "phase 2"),))
    limits = Limits(qd_max=2.0, tau_max=[400.0, 500.0, 200.0])
    recording = of_motion(microbot.with_limits(limits), motion)
    return recording, recording.save(tmp_path_factory.mktemp("rrd") / "bang.rrd")


def test_spells(bang):
    recording, _ = bang
    clock = recording.arms[0].times["sim_time"]
    told = [
        (s.joint, s.text, round(clock[s.first], 2), round(clock[s.last], 2), s.beyond)
        for s in recording.spells["motion"]
    ]
    assert told == [
        (0, "torque max", 0.0, 0.3, False),
        (2, "velocity max", 0.2, 0.4, False),
        (0, "torque min exceeded", 0.6, 1.0, True),
    ]


def test_lanes_begin_and_end_with_the_spells(bang):
    _, path = bang
    t, words = read(path, "/saturation/motion/1_waist", "StateChange:state")
    assert [w[0] for w in words] == ["torque max", "within", "torque min exceeded", "within"]
    np.testing.assert_allclose(t, [0.0, 0.3, 0.605, 1.0], atol=6e-3)
    _, shoulder = read(path, "/saturation/motion/2_shoulder", "StateChange:state")
    assert shoulder == [["within"]]


def test_switches_lie_on_the_trail(bang):
    recording, path = bang
    t, places = read(path, "/world/motion/switches", "Points3D:positions")
    np.testing.assert_allclose(t, [0.205, 0.295, 0.395, 0.605], atol=6e-3)
    q = recording.arms[0].q
    at = np.searchsorted(recording.arms[0].times["sim_time"], t - 1e-9)
    expected = scene.link_origins(recording.robot, q[at])[:, -1]
    np.testing.assert_allclose(np.array(places)[:, 0], expected, atol=1e-5)
    _, labels = read(path, "/world/motion/switches/latest", "Points3D:labels")
    assert labels[0] == ["elbow velocity max begins"]


def test_lines_of_text(bang):
    _, path = bang
    t, lines = read(path, "/marks/motion", "TextLog:text")
    told = [line[0] for line in lines]
    assert told == [
        "elbow velocity max begins",
        "waist torque max ends",
        "elbow velocity max ends",
        "phase 2",
        "waist torque min exceeded begins",
    ]
    assert t[3] == pytest.approx(0.5)


def test_lanes_have_a_colour_for_every_word(bang):
    _, path = bang
    lane = "/saturation/motion/1_waist"
    values = static(path, lane, "StateConfiguration:values")
    visible = static(path, lane, "StateConfiguration:visible")
    assert dict(zip(values, visible, strict=True)) == {
        "torque max": True, "torque min exceeded": True, "within": False,
    }  # fmt: skip


def test_nothing_is_at_no_limit(bang):
    recording, _ = bang
    assert find_spells(Limits().for_joints(3), recording.arms[0]) == []
