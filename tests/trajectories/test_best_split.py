"""The best split of the time between segments: closed forms, a grid of splits, changes of it."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import microbot_ocp as mo
from helpers import refused

VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
SPEED, PUSH = 0.8, 2.5  # m/s, m/s^2


def times(durations):
    return np.cumsum([0.0, *durations])


def cubic(via_q):
    return lambda durations: mo.cubic(via_q, times(durations))


def lspb(via_q, share):
    return lambda durations: mo.lspb(via_q, times(durations), share * np.asarray(durations))


def slider(**limits):
    """One mass on a rail, without gravity."""
    return mo.Robot.from_dh(
        alpha=[0.0], a=[0.0], d=[0.0], joint_type="prismatic", links=[mo.Link(3.0, [0, 0, 0])],
        gravity=(0.0, 0.0, 0.0), limits=mo.Limits(**limits),
    )  # fmt: skip


def duration(robot, make, durations):
    try:
        return mo.shortest_duration(robot, make(durations)).duration
    except mo.InputError:  # this split leaves the position limits
        return np.inf


def best(robot, make, via_q):
    return mo.best_split(robot, make, mo.trajectories.first_splits(via_q))


def arm(name):
    """A packaged arm without the limits of rates that a cubic cannot keep."""
    return mo.load_robot(name).with_limits(taud_max=np.inf, qddd_max=np.inf)


def random_via(robot, count, seed):
    low, high = np.maximum(robot.limits.q_min, -2.0), np.minimum(robot.limits.q_max, 2.0)
    share = np.random.default_rng(seed).uniform(0.15, 0.85, (count, robot.joint_count))
    return low + (high - low) * share


@pytest.mark.parametrize("count", [2, 3, 5, pytest.param(40, marks=pytest.mark.thorough)])
def test_to_and_fro_takes_the_sum_of_its_ways(count):
    """Craig's heuristic stops where a joint turns back: each way takes its own shortest time."""
    ways = np.linspace(0.3, 1.7, count - 1)
    via_q = times(ways * (-1.0) ** np.arange(count - 1))[:, None]
    fast = best(slider(qd_max=SPEED), cubic(via_q), via_q)
    strong = best(slider(qdd_max=PUSH), cubic(via_q), via_q)
    assert fast.duration == pytest.approx(1.5 * ways.sum() / SPEED, rel=1e-4)
    assert strong.duration == pytest.approx(np.sqrt(6 * ways / PUSH).sum(), rel=1e-4)
    np.testing.assert_allclose(strong.split, np.sqrt(6 * ways / PUSH), rtol=1e-3)
    assert strong.duration == strong.polynomial.duration == pytest.approx(strong.split.sum())


@pytest.mark.parametrize(
    "make", [cubic, pytest.param(lambda via_q: lspb(via_q, 0.25), marks=pytest.mark.thorough)]
)
def test_the_report_poses_against_a_grid_of_splits(microbot, make):
    found = best(microbot, make(VIA_Q), VIA_Q)
    grid = [duration(microbot, make(VIA_Q), [x, 1 - x]) for x in np.linspace(0.3, 0.7, 41)]
    assert found.solved
    assert found.utilisation == pytest.approx(1.0, abs=1e-7)
    assert min(grid) * 0.99 < found.duration < min(grid) * (1 + 1e-4)
    assert found.duration < 0.98 * grid[20] or make is not cubic  # that of equal times


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["planar_3r", "ur5e", "stanford", "panda", "puma560"],
)
@pytest.mark.parametrize("shape", ["cubic", "quintic"])
def test_three_points_against_a_grid_of_splits(name, shape):
    robot = mo.load_robot(name) if shape == "quintic" else arm(name)
    via_q = random_via(robot, 3, 4)

    def make(durations):
        return getattr(mo, shape)(via_q, times(durations))

    grid = [duration(robot, make, [x, 1 - x]) for x in np.linspace(0.1, 0.9, 25)]
    assert best(robot, make, via_q).duration < min(grid) * (1 + 1e-4)


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("microbot", 8),
        pytest.param("panda", 6, marks=pytest.mark.thorough),
        pytest.param("microbot", 40, marks=pytest.mark.thorough),
    ],
)
def test_no_change_of_the_split_is_faster(name, count):
    robot = arm(name)
    via_q = random_via(robot, count, 5)
    found = best(robot, cubic(via_q), via_q)
    for part in range(0, count - 1, max(1, count // 8)):
        for change in (0.9, 0.99, 1.01, 1.1):
            split = np.where(np.arange(count - 1) == part, change, 1.0) * found.split
            assert duration(robot, cubic(via_q), split) > found.duration * (1 - 1e-3)


@pytest.mark.thorough
@pytest.mark.slow
@settings(max_examples=4, deadline=None)
@given(st.integers(0, 10_000), st.integers(3, 9), st.sampled_from(["microbot", "puma560", "ur5e"]))
def test_never_slower_than_equal_times_or_times_by_the_largest_step(seed, count, name):
    robot = arm(name)
    via_q = random_via(robot, count, seed)
    splits = mo.trajectories.first_splits(via_q)
    shortest = min(duration(robot, cubic(via_q), split) for split in splits)
    assert best(robot, cubic(via_q), via_q).duration <= shortest * (1 + 1e-4)


def test_a_split_that_leaves_the_position_limits_is_led_back():
    """Equal times overshoot the last point, 90 deg, at the mean speed of both ways."""
    via_q = np.radians([[0.0, 0.0, 0.0], [89.0, 1.0, 0.0], [90.0, 90.0, 0.0]])
    robot = mo.load_robot("microbot").with_limits(q_max=np.radians(90.0))
    assert all(
        duration(robot, cubic(via_q), split) == np.inf
        for split in mo.trajectories.first_splits(via_q)
    )
    assert best(robot, cubic(via_q), via_q).solved


@pytest.mark.slow
@pytest.mark.parametrize(
    "limits",
    [
        pytest.param({"also": (mo.limits.tool_speed(upper=2.0),)}, marks=pytest.mark.thorough),
        pytest.param({"also": (mo.limits.power(upper=300.0),)}, marks=pytest.mark.thorough),
        {"qdd_max": 3.0, "qd_max": np.inf},
        {"tau_max": ([-300, -250, -120], [200, 400, 180])},
    ],
)
def test_any_limit_decides_the_split(microbot, limits):
    robot = microbot.with_limits(**limits)
    grid = [duration(robot, cubic(VIA_Q), [x, 1 - x]) for x in np.linspace(0.3, 0.7, 7)]
    assert best(robot, cubic(VIA_Q), VIA_Q).duration < min(grid) * (1 + 1e-4)


@pytest.mark.thorough
def test_the_same_answer_in_every_thread(microbot):
    with ThreadPoolExecutor(3) as pool:
        found = [pool.submit(best, microbot, cubic(VIA_Q), VIA_Q) for _ in range(6)]
    assert len({each.result().duration for each in found}) == 1


@pytest.mark.parametrize(
    ("make", "first", "said"),
    [
        (mo.cubic(VIA_Q, [0, 1, 2]), [1.0, 1.0], ("make_motion", "PiecewisePolynomial")),
        (3.0, [1.0, 1.0], ("make_motion", "function", "3.0")),
        (cubic(VIA_Q), [1.0, 0.0], ("first_durations", "0 s", "[[1.0, 0.0]]")),
        (cubic(VIA_Q), [1.0, np.nan], ("first_durations", "finite", "nan s")),
        (cubic(VIA_Q), [], ("first_durations", "0 s", "[[]]")),
        (cubic(VIA_Q), [1.0, 1.0, 1.0], ("via_t", "shape [3]", "[4]")),
        (cubic(VIA_Q[:, :2]), [1.0, 1.0], ("make_motion", "2 joints", "robot", "3")),
        (lambda durations: durations, [1.0, 1.0], ("make_motion", "PiecewisePolynomial")),
        (
            lambda durations: mo.lspb(VIA_Q, times(durations), 0.2),
            [1.0, 1.0],
            ("make_motion", "same shape", "twice"),
        ),
    ],
)
def test_bad_input(microbot, make, first, said):
    with refused(*said):
        mo.best_split(microbot, make, first)


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        (
            mo.Limits(taud_max=1e3, tau_max=500.0),
            ("jumps", "torque", "'shoulder'", "1.22522 s", "1000 N m/s"),
        ),
        (mo.Limits(q_max=4.0), ("limits", "finite", "qd_max, qdd_max, tau_max")),
        (
            mo.Limits(tau_max=[400.0, 150.0, 200.0]),
            ("0 s", "196 N m", "'shoulder'", "-150 to 150 N m"),
        ),
    ],
)
def test_what_no_split_can_keep_is_refused_as_by_shortest_duration(microbot, limits, said):
    with refused(*said):
        mo.best_split(microbot, cubic(VIA_Q), [1.0, 1.0], limits)
