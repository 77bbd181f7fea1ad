"""An arm at rest is held: limits of rates count at the ends of a motion, at stops and in dwells."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import microbot_ocp as mo
from helpers import tells, two_link_arm
from microbot_ocp.limits import LimitFamily, jumps_of, largest_use, limit_history
from microbot_ocp.motion import Mark, PiecewisePolynomial
from planning.shared import slider

ARM = two_link_arm(1.0, 0.8)
POSES = np.array([[0.0, 0.3], [0.9, -0.4], [0.2, 0.8]])
RATES = {
    "torque rate": mo.Limits(taud_max=500.0),
    "jerk": mo.Limits(qddd_max=200.0),
    "own": mo.Limits(
        also=[mo.Limit("sum of jerks", lambda s: s.qddd[0] + s.qddd[1], -200.0, 200.0)]
    ),
}


def motion_of(shape: PiecewisePolynomial, robot: mo.Robot = ARM, **more) -> mo.Motion:
    return mo.Motion.from_polynomial(robot, shape, label="mine", **more)


def joined(*shapes: PiecewisePolynomial) -> PiecewisePolynomial:
    """Shapes one after the other."""
    width = max(shape.coefficients.shape[1] for shape in shapes)
    breaks, pieces = [np.zeros(1)], []
    for shape in shapes:
        breaks.append(breaks[-1][-1] + shape.breaks[1:] - shape.breaks[0])
        table = shape.coefficients
        pieces.append(np.pad(table, ((0, 0), (0, width - table.shape[1]), (0, 0))))
    return PiecewisePolynomial(np.concatenate(breaks), np.concatenate(pieces))


def dwell(q: np.ndarray, duration: float) -> PiecewisePolynomial:
    return PiecewisePolynomial([0.0, duration], np.array(q, dtype=float)[None, None])


def there_and_back(make, rests: float = 0.4) -> PiecewisePolynomial:
    parts = [make(POSES[k : k + 2], [0.0, 1.5]) for k in (0, 1)]
    return joined(parts[0], dwell(POSES[1], rests), parts[1])


def part_of(shape: PiecewisePolynomial, start: float, end: float) -> PiecewisePolynomial:
    """What a shape of one piece does from one time to another."""
    orders, factorial = [shape], 1.0
    table = []
    for k in range(6):
        table.append(orders[-1](start)[0] / factorial)
        factorial *= k + 1
        orders.append(orders[-1].derivative())
    return PiecewisePolynomial([0.0, end - start], np.array(table)[None])


def limits_passed(certificate: mo.Certificate) -> bool:
    return certificate.worst_violation <= 5e-3


@pytest.mark.parametrize("kind", RATES)
def test_what_begins_at_rest_is_judged_from_the_torque_that_holds_it(kind):
    shapes = {make: make(POSES[:2], [0.0, 1.5]) for make in (mo.quintic, mo.cubic)}
    smooth, sudden = (mo.certify(ARM, motion_of(s), RATES[kind]) for s in shapes.values())
    assert smooth.ok
    assert not sudden.ok
    tells(sudden.verdict, "acceleration jumps")
    assert sudden.limit_checks[-1].jump
    assert sudden.limit_checks[-1].time in (0.0, 1.5)


@pytest.mark.parametrize("make", [mo.quintic, mo.cubic])
@pytest.mark.parametrize("kind", RATES)
def test_three_ways_to_ask_are_one_verdict(kind, make):
    shape = there_and_back(make)
    marks = [Mark(time, f"stop {k}") for k, time in enumerate((0.0, 1.5, 3.4))]
    motion = motion_of(shape, marks=marks)
    stops = [mo.Stop(POSES[0]), mo.Stop(POSES[1], dwell=0.4), mo.Stop(POSES[2])]
    answers = [mo.certify(ARM, motion, RATES[kind], via_q=via) for via in (None, POSES, stops)]
    assert {answer.ok for answer in answers} == {make is mo.quintic}
    for answer in answers[1:]:
        np.testing.assert_array_equal(
            answer.limit_checks[-1].utilisation, answers[0].limit_checks[-1].utilisation
        )


@pytest.mark.parametrize("kind", RATES)
@pytest.mark.parametrize("braking", [0.0, -1.5])
def test_acceleration_vanishes_where_a_dwell_begins(kind, braking):
    arrives = mo.quintic(POSES[:2], [0.0, 1.5], via_qdd=[[0.0, 0.0], [braking, 0.0]])
    whole = joined(arrives, dwell(POSES[1], 0.4), mo.quintic(POSES[1:], [0.0, 1.5]))
    certificate = mo.certify(ARM, motion_of(whole), RATES[kind])
    assert certificate.ok == (braking == 0.0)
    assert certificate.ok or certificate.limit_checks[-1].time == pytest.approx(1.5)


@pytest.mark.parametrize("kind", RATES)
def test_an_end_that_moves_on_has_no_history(kind):
    cut = part_of(mo.cubic(POSES[:2], [0.0, 1.5]), 0.3, 1.1)
    family = LimitFamily.of(ARM, RATES[kind])
    assert mo.certify(ARM, motion_of(cut), RATES[kind]).ok
    assert largest_use(family, cut, family.keys).use <= 1.0


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(
    st.sampled_from([mo.quintic, mo.cubic]),
    st.lists(st.floats(-2.0, 2.0), min_size=4, max_size=4),
    st.floats(0.1, 5.0),
    st.sampled_from(list(RATES)),
)
def test_a_dwell_before_and_after_changes_nothing(make, values, duration, kind):
    ends = np.reshape(values, (2, 2))
    shape, family = make(ends, [0.0, duration]), LimitFamily.of(ARM, RATES[kind])
    longer = joined(dwell(ends[0], 0.3), shape, dwell(ends[1], 0.7))
    (key,) = family.keys
    uses = [limit_history(ARM, motion_of(s), RATES[kind]).judged(key)[2] for s in (shape, longer)]
    # a peak lies between samples: of a wave that turns five times in so many at most by this share
    count = len(uses[1]) * duration / longer.duration
    share = (5 * np.pi / count) ** 2 / 8
    np.testing.assert_allclose(uses[1].max(axis=0), uses[0].max(axis=0), rtol=share, atol=1e-6)
    peaks = [largest_use(family, s, family.keys).use for s in (shape, longer)]
    assert peaks[1] == pytest.approx(peaks[0], rel=1e-9, abs=1e-9)


def test_jumps_are_those_of_the_acceleration_by_its_time():
    """6 L / T^2 at the start of a cubic of 1.5 m in 1 s, and back to zero at its end."""
    shape = mo.cubic([[0.0], [1.5]], [0.0, 1.0])
    np.testing.assert_allclose(jumps_of(shape).qddd[:, 0], [9e6, 9e6])
    history = limit_history(slider(qddd_max=20.0), motion_of(shape, slider()))
    np.testing.assert_allclose(history.jumps.values["qddd"][:, 0], [9e6, 9e6])
    np.testing.assert_allclose(history.values["qddd"], -18.0, rtol=1e-5)


@pytest.mark.slow
def test_a_limit_of_the_torque_rate_alone_takes_its_time():
    """From rest to rest over L with jerks of P/m and -P/m: 32 L m / P = T^3."""
    motion = mo.time_optimal(slider(mass=2.0, taud_max=3.0), [[0.0], [1.5]], starts=1)
    assert motion.duration == pytest.approx(np.cbrt(32 * 1.5 * 2.0 / 3.0), rel=1e-4)
