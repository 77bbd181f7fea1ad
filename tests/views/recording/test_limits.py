"""Spells at limits, their lanes, switches and lines of text."""

import numpy as np
import pytest
from reading import read, scalars, static

from helpers import tells
from microbot_ocp.limits import Limit, limit_history, tool_speed
from microbot_ocp.motion import Mark, Motion
from microbot_ocp.robot import Limits
from microbot_ocp.trajectories import cubic, quintic
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.recording import of_motion
from microbot_ocp.views.recording._limits import limit_notes
from microbot_ocp.views.recording._loads import tool_velocity


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
        (s.joint, s.text, round(clock[s.first], 2), round(clock[s.last], 2))
        for s in recording.spells["motion"]
    ]
    assert told == [
        (0, "torque at its upper limit", 0.0, 0.3),
        (2, "velocity at its upper limit", 0.2, 0.4),
        (0, "torque beyond its lower limit", 0.6, 1.0),
    ]


def test_lanes_begin_and_end_with_the_spells(bang):
    _, path = bang
    t, words = read(path, "/saturation/motion/1_waist", "StateChange:state")
    upper, lower = "torque at its upper limit", "torque beyond its lower limit"
    assert [w[0] for w in words] == [upper, "within", lower, "within"]
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
    assert labels[0] == ["velocity of elbow reaches its upper limit"]


def test_lines_of_text(bang):
    _, path = bang
    t, lines = read(path, "/marks/motion", "TextLog:text")
    told = [line[0] for line in lines]
    assert told == [
        "velocity of elbow reaches its upper limit",
        "torque of waist leaves its upper limit",
        "velocity of elbow leaves its upper limit",
        "phase 2",
        "torque of waist exceeds its lower limit",
    ]
    assert t[3] == pytest.approx(0.5)


def test_lanes_have_a_colour_for_every_word(bang):
    _, path = bang
    lane = "/saturation/motion/1_waist"
    values = static(path, lane, "StateConfiguration:values")
    visible = static(path, lane, "StateConfiguration:visible")
    assert dict(zip(values, visible, strict=True)) == {
        "torque at its upper limit": True, "torque beyond its lower limit": True, "within": False,
    }  # fmt: skip


def test_nothing_is_at_no_limit(microbot):
    shape = cubic([[0, 0, 0], [-0.5, 1.0, 0.8]], [0.0, 0.4])
    free = microbot.with_limits(Limits())
    recording = of_motion(free, Motion.from_polynomial(free, shape, label="cubic"))
    assert recording.spells["motion"] == []


def test_spells_are_those_of_the_limit_history(microbot):
    shape = cubic([[0, 0, 0], [-0.5, 1.0, 0.8]], [0.0, 0.6])
    motion = Motion.from_polynomial(microbot, shape, label="cubic")
    recording = of_motion(microbot, motion)
    clock = recording.arms[0].times["sim_time"]
    drawn = {(s.joint, round(clock[s.first], 1), round(clock[s.last], 1))
             for s in recording.spells["motion"]}  # fmt: skip
    history = limit_history(microbot, motion)
    told = {(s.joint, round(s.start, 1), round(s.end, 1)) for s in history.every_spell()}
    assert drawn == told != set()


@pytest.fixture(scope="module")
def limited(microbot, tmp_path_factory):
    """A cubic that breaks one further limit and keeps the rest."""
    shape = cubic([[0, 0, 0], [-0.5, 1.0, 0.8]], [0.0, 2.0])
    motion = Motion.from_polynomial(microbot, shape, label="cubic")
    state = motion.sample(motion.t)
    fastest = np.linalg.norm(tool_velocity(microbot, state), axis=1).max()
    height = Limit("tool height", lambda state: state.tool[2, 3], lower=-100.0, unit="m")
    zone = Limit(
        "zone speed",
        lambda state: state.tool_velocity[2],
        upper=lambda state: 20.0 + state.q[0],
        unit="m/s",
    )
    also = [tool_speed(0.95 * fastest), height, zone]
    robot = microbot.with_limits(qddd_max=[3.0, np.inf, np.inf], also=also)
    recording = of_motion(robot, motion)
    path = recording.save(tmp_path_factory.mktemp("rrd") / "limited.rrd")
    return recording, path, fastest


def test_a_payload_keeps_its_torque_and_rate_under_limits_of_the_rate(microbot):
    heavy = microbot.with_payload(4.0)
    motion = Motion.from_polynomial(heavy, quintic([[0, 0, 0], [-0.5, 1.0, 0.8]], [0, 1]), label="")
    arm = of_motion(microbot.with_limits(taud_max=1e4), motion).arms[0]
    np.testing.assert_array_equal(arm.history.values["tau"], arm.curves["tau"])
    exact = heavy.torques_along(*motion.samples(arm.times["sim_time"]))
    near = 1e-3 * np.abs(exact["taud"]).max()
    np.testing.assert_allclose(arm.history.values["taud"], exact["taud"], rtol=0.0, atol=near)


def test_jumps_are_told_and_not_drawn(microbot):
    motion = Motion.from_polynomial(microbot, cubic([[0, 0, 0], [0, 1.0, 0.8]], [0, 2]), label="")
    recording = of_motion(microbot.with_limits(taud_max=1e4), motion)
    (arm,) = recording.arms
    assert np.abs(arm.history.values["taud"]).max() < 1e4
    assert any("acceleration jumps" in note for note in limit_notes(arm))


def test_further_limits_have_plots_with_their_bounds(limited):
    recording, path, fastest = limited
    arm = recording.arms[0]
    _, speed = scalars(path, "/plots/tool_speed/value/motion")
    expected = np.linalg.norm(tool_velocity(recording.robot, arm.state), axis=1)
    np.testing.assert_allclose(speed, expected, rtol=1e-9, atol=1e-9)
    _, rows = read(path, "/plots/tool_speed/value/limit_upper", "Scalars:scalars")
    np.testing.assert_allclose([row[0] for row in rows if row], 0.95 * fastest)
    titles = [plot.title for plot in recording.limit_plots]
    assert titles == [
        "jerk of waist [rad/s^3]",
        "tool speed [m/s]",
        "tool height [m]",
        "zone speed [m/s]",
    ]
    _, zone = scalars(path, "/plots/zone_speed/value/limit_upper")
    np.testing.assert_allclose(zone, 20.0 + arm.q[:, 0])


def test_spells_at_a_tool_speed_limit_have_a_lane_and_lines_of_text(limited):
    recording, path, fastest = limited
    (spell,) = [s for s in recording.spells["motion"] if s.text.startswith("tool speed")]
    assert (spell.joint, spell.text) == (None, "tool speed beyond its upper limit")
    _, speed = scalars(path, "/plots/tool_speed/value/motion")
    at = np.flatnonzero(speed >= 0.99 * 0.95 * fastest)
    assert (spell.first, spell.last) == (at[0], at[-1])
    _, states = read(path, "/saturation/motion/4_other", "StateChange:state")
    assert [row[0] for row in states] == ["within", "tool speed beyond its upper limit", "within"]
    _, lines = read(path, "/marks/motion", "TextLog:text")
    assert any("tool speed exceeds" in line[0] for line in lines)
    text = static(path, "/summary", "TextDocument:text")[0]
    tells(text, "Tool speed", "105 %")
