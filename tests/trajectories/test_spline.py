"""Cubic splines: continuous acceleration, ends, the least curvature, inputs that are refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import microbot_ocp as mo
from helpers import refused


@st.composite
def via_tables(draw):
    m, n = draw(st.integers(2, 7)), draw(st.integers(1, 3))
    numbers = st.floats(-10.0, 10.0)
    q = np.array(draw(st.lists(numbers, min_size=m * n, max_size=m * n))).reshape(m, n)
    steps = draw(st.lists(st.floats(0.1, 5.0), min_size=m - 1, max_size=m - 1))
    return q, draw(numbers) + np.concatenate([[0.0], np.cumsum(steps)])


@settings(max_examples=60, deadline=None)
@given(via_tables(), st.sampled_from(["clamped", "natural"]))
def test_a_spline_is_smooth_and_meets_its_ends(table, ends):
    q, t = table
    motion = mo.spline(q, t, ends)
    velocity = motion.derivative()
    acceleration = velocity.derivative()
    size = 1.0 + np.abs(acceleration.coefficients[:, 0]).max()
    for values in (motion(t), motion(t, from_left=True)):
        np.testing.assert_allclose(values, q, atol=1e-9 * size)
    for part in (velocity, acceleration):
        jumps = part(t[1:-1]) - part(t[1:-1], from_left=True)
        np.testing.assert_allclose(jumps, 0.0, atol=1e-9 * size)
    at_ends = (velocity if ends == "clamped" else acceleration)(t[[0, -1]])
    np.testing.assert_allclose(at_ends, 0.0, atol=1e-9 * size)


def curvature(motion):
    t = np.linspace(motion.breaks[0], motion.breaks[-1], 20_001)
    values = motion.derivative().derivative()(t) ** 2
    return np.trapezoid(values, t, axis=0)


def test_no_other_cubic_through_the_points_has_less_curvature():
    q, t = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]]), [0.0, 2.0, 4.0]
    best = curvature(mo.spline(q, t))
    rng = np.random.default_rng(0)
    inner = mo.spline(q, t).derivative()(2.0)
    for _ in range(10):
        qd = np.vstack([np.zeros(3), inner + rng.normal(size=3), np.zeros(3)])
        assert (curvature(mo.cubic(q, t, qd)) > best).all()
    assert (curvature(mo.spline(q, t, "natural")) < best).all()


def test_given_end_velocities_give_a_cubic_back():
    """A polynomial of degree three is its own clamped spline."""
    t = np.array([0.0, 0.7, 1.0, 2.5])
    cubic = (t**3 - 2 * t)[:, None]
    motion = mo.spline(cubic, t, end_qd=[[-2.0], [3 * 2.5**2 - 2]])
    times = np.linspace(0.0, 2.5, 50)
    np.testing.assert_allclose(motion(times)[:, 0], times**3 - 2 * times, atol=1e-12)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: mo.spline([[0.0]], [0.0]), ("via_q", "two", "joint", "[1, 1]")),
        (
            lambda: mo.spline([[0.0], [1.0]], [0.0, 1.0], "loose"),
            ("ends", "clamped, natural", "'loose'"),
        ),
        (
            lambda: mo.spline([[0.0], [1.0]], [0, 1], "natural", [[0.0], [0.0]]),
            ("end_qd", "natural"),
        ),
        (
            lambda: mo.spline([[0.0], [1.0]], [0, 1], end_qd=[0.0, 0.0]),
            ("end_qd", "shape [2, 1]", "[2]"),
        ),
    ],
)
def test_bad_inputs(call, message):
    with refused(*message):
        call()
