"""Sizes are bounded before they hurt, and messages are short whatever is given."""

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused
from microbot_ocp._base import checks
from microbot_ocp.scene import load_scene


@pytest.fixture(scope="module")
def robot():
    return mo.load_robot("microbot")


VIA = [[0.0, 0.0, 0.0], [-1.0, 1.0, 1.0]]


@pytest.mark.parametrize("setting", ["mesh", "starts", "tries"])
def test_settings_beyond_all_computers_are_refused(robot, setting):
    with refused(setting, "20000", "1000000000000"):
        mo.time_optimal(robot, VIA, **{setting: 10**12})


def test_grids_of_gigabytes_are_refused(robot):
    path = mo.straight_path(VIA)
    for call in (mo.planning.time_path, mo.planning.phase_plane, mo.time_optimal_path):
        with refused("grid", "20000", "100000"):
            call(robot, path, grid=100_000)


@pytest.mark.parametrize(
    ("limit", "said"),
    [
        ({"qd_max": 1e-7}, ("qd_max of joint 'waist'", "1e-07 rad/s,", "10000 s")),
        ({"qdd_max": 1e-11}, ("qdd_max of joint 'waist'", "1e-11 rad/s^2", "10000 s")),
        ({"qddd_max": 1e-19}, ("qddd_max of joint 'waist'", "1e-19 rad/s^3", "10000 s")),
        ({"taud_max": 1e-9}, ("taud_max of joint 'shoulder'", "1e-09 N m/s", "10000 s")),
    ],
)
def test_motions_of_days_are_refused(robot, limit, said):
    slow, ends = robot.with_limits(**limit), [mo.Stop(q=q) for q in VIA]
    for call in (
        lambda: mo.time_optimal(slow, VIA),
        lambda: mo.compare(slow, VIA),
        lambda: mo.time_optimal_path(slow, mo.straight_path(VIA)),
        lambda: mo.time_optimal(slow, VIA if "taud_max" in limit else ends),
    ):
        with refused(*said):
            call()


@pytest.mark.parametrize(
    "limit",
    [mo.limits.tool_speed(1e-5), mo.limits.tool_acceleration(1e-9), mo.limits.power(1e-9)],
    ids=lambda limit: limit.name,
)
def test_further_limits_that_make_a_motion_last_for_days_are_refused(robot, limit):
    with refused(f"({limit.name})", "straight motion"):
        mo.time_optimal(robot.with_limits(also=[limit]), VIA)


@pytest.mark.parametrize("pairs", [5, True, "ab", [1], [["a"]]])
def test_what_is_no_pair_to_ignore_is_refused(pairs):
    with refused("ignore must"):
        load_scene({"ignore": pairs})


def test_a_long_motion_has_fewer_samples_a_second(robot):
    motion = mo.Motion.from_polynomial(robot, mo.quintic(VIA, [0, 1e6]), label="slow")
    assert motion.t.size <= checks.MOST_SAMPLES / 100 + 2
    assert motion.duration == 1e6
    with refused("number of samples", "1e+09", "2,000,000"):
        motion.resample(1000.0)


@pytest.mark.parametrize(
    "given", [{"step": 1e-12}, {"sample_rate": 1e12}, {"sample_rate": 1.0, "step": 1e-12}]
)
def test_simulations_of_terabytes_are_refused(robot, given):
    shape = mo.quintic(VIA, [0.0, 2.0])
    with refused("number of samples", "2,000,000"):
        mo.track(robot, shape, mo.ComputedTorque(kp=100.0), **given)


def test_simulations_of_years_are_refused(robot):
    with refused("duration", "10000 s", "1000000000.0"):
        mo.track(robot, mo.quintic(VIA, [0.0, 1e9]), mo.ComputedTorque(kp=100.0))
    with refused("number of samples", "1e+12"):
        mo.simulation.motion_from_formula(robot, lambda t: [t, t, t], 1.0, label="a", step=1e-12)


def test_what_is_too_fast_or_too_near_is_refused(robot):
    with refused("qd0 of waist", "10000 rad/s", "1.59e+04 turns", "10 s"):
        mo.simulate(robot, q0=[0, 0.5, 0.3], qd0=[1e4, 0, 0], t=[0, 10.0])
    with refused("via points 1 and 2", "1.7e-11 rad"):
        mo.time_optimal(robot, np.radians([[0, 0, 0], [1e-9, 0, 0]]))


def test_what_is_far_away_is_refused(robot):
    for position in ([1e155, 0, 0], [1e7, 0, 0]):
        with refused("position", "1e+06 m", f"{position[0]:.4g} m"):
            mo.solve_ik(robot, position)
    with refused("via_t", "10000 s"):
        mo.compare(robot, VIA, ["cubic_report"], via_t=[0, 1e6])


def nested(depth):
    value = []
    for _ in range(depth):
        value = [value]
    return value


@pytest.mark.parametrize(
    "value",
    [
        1 + 2j,
        [np.complex128(1j)] * 3,
        np.array([1j, 0, 0]),
        np.array([1j, 0, 0], dtype=object),
        nested(5000),
        10**400,
        10**5000,
        "1" * 5000,
        {"a": 1},
        object(),
        None,
        [[1], [2, 3]],
        True,
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_is_no_number_is_refused_in_a_short_sentence(robot, value):
    for call in (
        lambda: checks.number("speed", value),
        lambda: checks.array("speed", value, (3,)),
        lambda: robot.with_limits(qd_max=[1.0, value, 1.0]),
    ):
        with pytest.raises(mo.InputError, match=r"speed|qd_max") as caught:
            call()
        assert len(str(caught.value)) < 300


def test_a_long_message_keeps_its_ends():
    message = str(mo.InputError("begin " + "x" * 5000 + " end"))
    assert len(message) < 300
    assert (message[:5], message[-3:]) == ("begin", "end")


@pytest.mark.parametrize("words", [40, 80, 200])
def test_a_long_sentence_is_whole(words):
    """Certificates and advice in messages were cut in their middle at 290 characters."""
    sentence = " ".join(f"part{k}" for k in range(words))
    assert str(mo.InputError(sentence)) == sentence
    path = "/".join(["folder"] * 19)  # 132 characters
    assert str(mo.InputError(f"{path} {sentence}")) == f"{path} {sentence}"
