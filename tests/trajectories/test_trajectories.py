"""Textbook trajectories: against the course report's tables, and their own properties."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import microbot_ocp as mo
from helpers import refused
from microbot_ocp.motion import Motion
from microbot_ocp.trajectories import (
    cubic,
    lspb,
    quintic,
    via_points,
    via_velocities,
)

VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
VIA_T = [0.0, 2.0, 4.0]
VIA_QD = np.radians([[0, 0, 0], [10, 40, 20], [0, 0, 0]])
BLEND = 0.5

# Course report, part 5, recomputed: t (s), then q (deg), qd (deg/s), qdd (deg/s^2) of each joint;
# at a break the later piece.
CUBIC_ROWS = [
    (0.3, [-0.8685, 1.20375, 1.0575], [-5.385, 7.9125, 6.825], [-13.9, 25.25, 20.5]),
    (1.0, [-6.5, 12.5, 10.0], [-8.5, 23.75, 17.5], [5.0, 20.0, 10.0]),
    (1.7, [-9.6815, 33.59625, 23.8425], [1.615, 35.9125, 20.825], [23.9, 14.75, -0.5]),
    (2.0, [-8.0, 45.0, 30.0], [10.0, 40.0, 20.0], [-143.0, -12.5, 50.0]),
    (3.3, [-65.304, 83.69125, 76.28], [-59.29, 17.4125, 34.3], [36.4, -22.25, -28.0]),
    (3.8, [-87.524, 89.46, 88.68], [-23.84, 5.35, 12.8], [105.4, -26.0, -58.0]),
]
LSPB_ROWS = [
    (0.3, [-0.63, 2.1, 1.5], [-4.2, 14.0, 10.0], [-14.0, 140 / 3, 100 / 3]),
    (0.5, [-1.75, 35 / 6, 25 / 6], [-7.0, 70 / 3, 50 / 3], [0.0, 0.0, 0.0]),
    (1.7, [-9.47, 34.5, 24.3], [-0.2, 30.0, 18.0], [34.0, 100 / 3, 20 / 3]),
    (2.0, [-8.0, 45.0, 30.0], [10.0, 40.0, 20.0], [-398 / 3, -100 / 3, 100 / 3]),
    (3.3, [-64.65, 79.5, 73.5], [-169 / 3, 70 / 3, 110 / 3], [0.0, 0.0, 0.0]),
    (
        3.8,
        [-87.74666667, 89.06666667, 88.53333333],
        [-22.53333333, 9.33333333, 14.66666667],
        [338 / 3, -140 / 3, -220 / 3],
    ),
]


def report(name):
    if name == "cubic":
        return cubic(VIA_Q, VIA_T, VIA_QD)
    return lspb(VIA_Q, VIA_T, BLEND, VIA_QD)


@pytest.mark.parametrize(("name", "rows"), [("cubic", CUBIC_ROWS), ("lspb", LSPB_ROWS)])
def test_the_reports_tables(name, rows):
    motion = report(name)
    velocity = motion.derivative()
    acceleration = velocity.derivative()
    for t, *wanted in rows:
        for function, row in zip((motion, velocity, acceleration), wanted, strict=True):
            np.testing.assert_allclose(np.degrees(function(t)[0]), row, atol=1e-8)


@pytest.mark.parametrize(
    ("name", "torque", "speed"),
    [
        ("cubic", [86.57286626, 276.11061267, 132.85427267], [1.11859157, 0.6981317, 0.7126761]),
        ("lspb", [81.35564483, 323.05996955, 149.05700806], [0.98320215, 0.6981317, 0.63995406]),
    ],
)
def test_the_reports_peaks(name, torque, speed):
    """Peaks over closed segments: both one-sided limits at the jumps of the acceleration."""
    motion = Motion.from_polynomial(mo.load_robot("microbot"), report(name), label=name)
    # The peaks were recomputed on a grid (relative error below 1e-6).
    np.testing.assert_allclose(np.abs(motion.tau).max(axis=0), torque, rtol=2e-6)
    np.testing.assert_allclose(np.abs(motion.qd).max(axis=0), speed, rtol=2e-6)


finite = st.floats(-10.0, 10.0)


@st.composite
def via_tables(draw):
    m, n = draw(st.integers(2, 5)), draw(st.integers(1, 4))
    table = [
        np.array(draw(st.lists(finite, min_size=m * n, max_size=m * n))).reshape(m, n)
        for _ in range(3)
    ]
    steps = draw(st.lists(st.floats(0.1, 5.0), min_size=m - 1, max_size=m - 1))
    start = draw(finite)
    return (*table, start + np.concatenate([[0.0], np.cumsum(steps)]))


def jump(function):
    """Largest jump at the inner breaks."""
    inner = function.breaks[1:-1]
    if not inner.size:
        return 0.0
    return float(np.abs(function(inner) - function(inner, from_left=True)).max())


def at_vias(function, t):
    """Values just before and just after each via point."""
    return function(t), function(t, from_left=True)


@settings(max_examples=50, deadline=None)
@given(via_tables(), st.floats(0.01, 0.5))
def test_positions_and_velocities_are_met_and_continuous(table, share):
    q, qd, qdd, t = table
    for motion in (cubic(q, t, qd), lspb(q, t, share * np.diff(t), qd), quintic(q, t, qd, qdd)):
        velocity = motion.derivative()
        size = 1.0 + np.abs(velocity.coefficients[:, 0]).max()
        for values in at_vias(motion, t):
            np.testing.assert_allclose(values, q, atol=1e-9 * size)
        for values in at_vias(velocity, t):
            np.testing.assert_allclose(values, qd, atol=1e-8 * size)
        assert jump(motion) < 1e-9 * size
        assert jump(velocity) < 1e-8 * size
    acceleration = quintic(q, t, qd, qdd).derivative().derivative()
    size = 1.0 + np.abs(acceleration.coefficients).max()
    for values in at_vias(acceleration, t):
        np.testing.assert_allclose(values, qdd, atol=1e-9 * size)


@settings(max_examples=25, deadline=None)
@given(via_tables(), st.floats(0.2, 5.0))
def test_stretching_the_shape_is_the_same_as_stretching_its_data(table, factor):
    q, qd, _, t = table
    stretched = cubic(q, t, qd).stretched(factor)
    again = cubic(q, t[0] + (t - t[0]) * factor, qd / factor)
    times = np.linspace(again.breaks[0], again.breaks[-1], 40)
    np.testing.assert_allclose(stretched(times), again(times), atol=1e-8)


def test_heuristic_velocities():
    """Craig, section 7.3: zero where the slope changes sign, else the mean of the slopes."""
    via = via_points([[0, 0, 0, 0], [1, 1, -2, 0], [4, 0, -3, 5]], [0, 1, 2])
    wanted = [[0, 0, 0, 0], [2, 0, -1.5, 0], [0, 0, 0, 0]]
    np.testing.assert_allclose(via_velocities(via), wanted)
    np.testing.assert_allclose(
        cubic(via.q, via.t).coefficients, cubic(via.q, via.t, wanted).coefficients
    )
    np.testing.assert_allclose(
        quintic(via.q, via.t).coefficients, quintic(via.q, via.t, wanted).coefficients
    )


def test_lspb_with_blends_that_fill_the_segment():
    motion = lspb([[0.0], [1.0]], [0.0, 2.0], 1.0)
    assert motion.breaks.tolist() == [0.0, 1.0, 2.0]
    np.testing.assert_allclose(motion.derivative()([0.5, 1.0, 1.5]).ravel(), [0.5, 1.0, 0.5])
    # Half of a segment that binary fractions cannot hold is still allowed.
    assert lspb([[0.0], [1.0]], [0.0, 0.3], 0.15).breaks.size == 3


def test_lspb_takes_one_blend_time_a_segment():
    motion = lspb([[0.0], [1.0], [3.0]], [0.0, 1.0, 3.0], [0.25, 0.5])
    assert motion.breaks.tolist() == [0.0, 0.25, 0.75, 1.0, 1.5, 2.5, 3.0]
    np.testing.assert_allclose(motion.derivative()([0.0, 1.0, 3.0]), 0.0, atol=1e-12)


BAD_INPUTS = [
    (lambda: cubic([[0.0]], [0.0]), ("via_q", "two", "joint", "[1, 1]")),
    (lambda: cubic([0.0, 1.0], [0.0, 1.0]), ("via_q", "shape [any, any]", "[2]")),
    (lambda: cubic([[0.0], [1.0]], [0.0, 1.0, 2.0]), ("via_t", "shape [2]", "[3]")),
    (lambda: cubic([[0.0], [1.0]], [1.0, 1.0]), ("via_t[1] is 1 s", "via_t[0] of 1 s")),
    (lambda: lspb([[0.0], [1.0]], [1.0, 0.5], 0.1), ("via_t[1] is 0.5 s", "via_t[0] of 1 s")),
    (lambda: quintic([[0.0], [np.nan]], [0.0, 1.0]), ("via_q", "finite", "[1, 0] is nan rad")),
    (
        lambda: cubic([[0.0], [1.0]], [0.0, 1.0], [[0.0, 0.0], [0.0, 0.0]]),
        ("via_qd", "shape [2, 1]", "[2, 2]"),
    ),
    (
        lambda: quintic([[0.0], [1.0]], [0.0, 1.0], via_qdd=[[0.0]]),
        ("via_qdd", "shape [2, 1]", "[1, 1]"),
    ),
    (
        lambda: lspb([[0.0], [1.0]], [0.0, 1.0], 0.6),
        ("blend_time", "segment 1", "0.5 s", "0.6 s"),
    ),
    (lambda: lspb([[0.0], [1.0]], [0.0, 1.0], 0.0), ("blend_time", "0 s", "0.0")),
    (
        lambda: lspb([[0.0], [1.0], [2.0]], [0, 1, 2], [0.1, -0.1]),
        ("blend_time", "segment 2", "0 s", "-0.1 s"),
    ),
    (lambda: lspb([[0.0], [1.0]], [0, 1], [0.1, 0.1]), ("blend_time", "shape [1]", "[2]")),
]


@pytest.mark.parametrize(("call", "message"), BAD_INPUTS)
def test_bad_inputs(call, message):
    with refused(*message):
        call()
