"""Motions: exact between samples, honest at jumps, the same after a round trip through a file."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
from numpy.polynomial import Polynomial

import microbot_ocp as mo
from helpers import batch, refused, tells
from microbot_ocp._base.outcome import SOLVED, Advice, Outcome
from microbot_ocp.motion import (
    JUMP_GAP,
    SCHEMA,
    Mark,
    Motion,
    PiecewisePolynomial,
    State,
    polynomial_of,
    sample_times,
)


def smooth_quintics(lengths: list[float], seed: int) -> PiecewisePolynomial:
    """Random quintic pieces whose position, velocity and acceleration meet; the jerk jumps."""
    rng = np.random.default_rng(seed)
    breaks = np.concatenate([[0.0], np.cumsum(lengths)])
    ends = rng.uniform(-2.0, 2.0, (breaks.size, 3, 3))  # break, derivative, joint
    pieces = []
    for h, start, end in zip(lengths, ends[:-1], ends[1:], strict=True):
        powers = np.arange(6)
        rows = []
        for at in (0.0, h):
            for order in range(3):
                factor = np.array(
                    [np.prod(np.arange(p, p - order, -1)) if p >= order else 0 for p in powers]
                )
                rows.append(factor * at ** np.maximum(powers - order, 0))
        pieces.append(np.linalg.solve(np.array(rows, dtype=float), np.concatenate([start, end])))
    return PiecewisePolynomial(breaks, np.array(pieces))


# Two parabolas for three joints: the acceleration jumps from (2, 0, -2) to (-2, 0, 2) at t = 1,
# position and velocity do not.
BANG_BANG = PiecewisePolynomial(
    [0.0, 1.0, 2.0],
    [
        [[0.0, 0.5, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, -1.0]],
        [[1.0, 0.5, -1.0], [2.0, 0.0, -2.0], [-1.0, 0.0, 1.0]],
    ],
)


@pytest.fixture(scope="module")
def bang_bang() -> Motion:
    return Motion.from_polynomial(
        mo.load_robot("microbot"),
        BANG_BANG,
        label="bang-bang",
        marks=[Mark(0.0, "start"), Mark(1.0, "switch")],
        provenance={"method": "by hand", "iterations": 3, "nested": {"a": [1, 2.5, None]}},
        remark="a note",
    )


# ---- piecewise polynomials


@given(
    coefficients=arrays(float, (2, 4, 3), elements=st.floats(-5.0, 5.0)),
    t=st.floats(0.0, 1.5),
)
def test_polynomial_and_derivative_are_those_of_numpy(coefficients: np.ndarray, t: float) -> None:
    polynomial = PiecewisePolynomial([0.0, 0.5, 1.5], coefficients)
    piece, start = (0, 0.0) if t < 0.5 else (1, 0.5)
    for joint in range(3):
        theirs = Polynomial(coefficients[piece, :, joint])
        assert polynomial(t)[0, joint] == pytest.approx(theirs(t - start), abs=1e-12)
        slope = polynomial.derivative()(t)[0, joint]
        assert slope == pytest.approx(theirs.deriv()(t - start), abs=1e-12)


def test_value_at_a_break_is_the_later_one_unless_asked_from_the_left() -> None:
    steps = PiecewisePolynomial([0.0, 1.0, 2.0], [[[1.0]], [[2.0]]])
    assert steps([0.0, 1.0, 2.0])[:, 0].tolist() == [1.0, 2.0, 2.0]
    assert steps([0.0, 1.0, 2.0], from_left=True)[:, 0].tolist() == [1.0, 1.0, 2.0]
    assert steps.derivative()([0.5, 1.5])[:, 0].tolist() == [0.0, 0.0]


@given(factor=st.floats(0.1, 10.0), x=st.floats(0.0, 1.0), seed=st.integers(0, 20))
def test_stretched_is_the_same_shape_slower(factor: float, x: float, seed: int) -> None:
    shape = smooth_quintics([0.5, 0.8], seed)
    slower = shape.stretched(factor)
    assert slower.duration == pytest.approx(factor * shape.duration)
    t = x * shape.duration
    assert slower(factor * t) == pytest.approx(shape(t), abs=1e-9)
    velocity, slower_velocity = shape.derivative(), slower.derivative()
    assert slower_velocity(factor * t) * factor == pytest.approx(velocity(t), abs=1e-8)


def test_stretching_keeps_the_start() -> None:
    late = PiecewisePolynomial([2.0, 3.0], [[[0.0], [1.0]]]).stretched(4.0)
    assert late.breaks.tolist() == [2.0, 6.0]


@pytest.mark.parametrize(
    ("breaks", "coefficients", "said"),
    [
        ([0.0], np.zeros((0, 2, 3)), ("breaks", "two", "increasing", "s, not [0.0]")),
        ([0.0, 0.0], np.zeros((1, 2, 3)), ("breaks[1] is 0 s", "breaks[0]", "0 s")),
        ([1.0, 0.0], np.zeros((1, 2, 3)), ("breaks[1] is 0 s", "breaks[0]", "1 s")),
        ([0.0, np.inf], np.zeros((1, 2, 3)), ("breaks", "[1]", "inf s")),
        ([0.0, 1.0], np.zeros((2, 2, 3)), ("coefficients", "[1, any, any]", "[2, 2, 3]")),
        ([0.0, 1.0], np.zeros((1, 2)), ("coefficients", "[1, any, any]", "[1, 2]")),
        ([0.0, 1.0], np.zeros((1, 0, 3)), ("coefficients", "empty", "(1, 0, 3)")),
        ([0.0, 1.0], np.full((1, 2, 3), np.nan), ("coefficients", "finite", "[0, 0, 0]", "nan")),
    ],
)
def test_impossible_polynomial_is_refused(
    breaks: list[float], coefficients: np.ndarray, said: tuple[str, ...]
) -> None:
    with refused(*said):
        PiecewisePolynomial(breaks, coefficients)  # type: ignore[arg-type]


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf, "2"])
def test_impossible_stretch_is_refused(factor: float) -> None:
    with refused("factor must"):
        BANG_BANG.stretched(factor)


def test_jerks_are_those_of_the_side_of_a_jump():
    robot = mo.load_robot("microbot")
    steady = np.array(BANG_BANG.coefficients)
    cubic = np.concatenate([steady, np.full_like(steady[:, :1], 0.25)], axis=1)
    cubic[1, :2] += [[0.25], [0.75]]  # what the first piece adds to position and velocity
    cubic[1, 3] = 0.5
    motion = Motion.from_polynomial(robot, PiecewisePolynomial([0.0, 1.0, 2.0], cubic), label="")
    few, many = np.array([0.5, 1.0 - 5e-7, 1.0, 1.5]), np.linspace(0.0, 2.0, 4001)
    for t in (few, many):
        samples = motion.samples(t)
        np.testing.assert_allclose(
            samples.qddd.T, np.broadcast_to(np.where(t < 1.0, 1.5, 3.0), (3, t.size)), atol=1e-3
        )
        np.testing.assert_array_equal(samples[:3], motion.sample(t))


# ---- sampling


@settings(max_examples=25)
@given(
    lengths=st.lists(st.floats(0.05, 1.0), min_size=1, max_size=4),
    seed=st.integers(0, 1000),
    step=st.sampled_from([1e-3, 0.02, 10.0]),
    x=arrays(float, 20, elements=st.floats(0.0, 1.0)),
)
def test_sample_of_piecewise_quintics_is_exact(
    microbot: mo.Robot, lengths: list[float], seed: int, step: float, x: np.ndarray
) -> None:
    shape = smooth_quintics(lengths, seed)
    motion = Motion.from_polynomial(microbot, shape, label="quintics", step=step)
    t = np.sort(x) * motion.duration
    velocity = shape.derivative()
    acceleration = velocity.derivative()
    state = motion.sample(t)
    for ours, theirs, rounding in (
        (state.q, shape(t), 1e-12),
        (state.qd, velocity(t), 1e-9),
        (state.qdd, acceleration(t), 1e-6),  # rounding of q over the square of a 1 ms step
    ):
        size = 1.0 + np.abs(acceleration(motion.t)).max()
        assert ours == pytest.approx(theirs, abs=rounding * size)


@pytest.mark.parametrize("step", [1e-3, 0.1, 5.0])
def test_sample_is_exact_on_both_sides_of_a_jump(microbot: mo.Robot, step: float) -> None:
    motion = Motion.from_polynomial(microbot, BANG_BANG, label="bang-bang", step=step)
    t = np.array([0.25, 0.999, 1.0 - 2 * JUMP_GAP, 1.0, 1.001, 1.75])
    state = motion.sample(t)
    assert state.q == pytest.approx(BANG_BANG(t), abs=1e-12)
    assert state.qdd[:3] == pytest.approx(np.tile([2.0, 0.0, -2.0], (3, 1)), abs=1e-6)
    assert state.qdd[3:] == pytest.approx(np.tile([-2.0, 0.0, 2.0], (3, 1)), abs=1e-6)


def test_jump_has_two_samples_a_microsecond_apart(bang_bang: Motion) -> None:
    late = int(np.flatnonzero(bang_bang.t == 1.0)[0])
    assert bang_bang.t[late] - bang_bang.t[late - 1] == pytest.approx(JUMP_GAP, rel=1e-6)
    assert bang_bang.qdd[late - 1].tolist() == [2.0, 0.0, -2.0]
    assert bang_bang.qdd[late].tolist() == [-2.0, 0.0, 2.0]
    assert np.sum(np.diff(bang_bang.t) < 1e-4) == 1
    assert np.abs(bang_bang.tau[late] - bang_bang.tau[late - 1]).max() > 1.0


def test_inside_a_jump_the_earlier_acceleration_goes_on(bang_bang: Motion) -> None:
    state = bang_bang.sample(1.0 - 0.5 * JUMP_GAP)
    assert state.qdd[0].tolist() == [2.0, 0.0, -2.0]


def test_a_motion_as_polynomials_has_no_piece_of_its_own_before_a_jump(
    microbot: mo.Robot, bang_bang: Motion
) -> None:
    shape = polynomial_of(bang_bang)
    assert np.diff(shape.breaks).min() > 1e-4
    t = np.linspace(0.0, 2.0, 500)
    assert shape(t) == pytest.approx(BANG_BANG(t), abs=1e-12)
    again = Motion.from_polynomial(microbot, shape)
    assert np.sum(np.diff(again.t) < 1e-4) == 1


def test_smooth_breaks_have_one_sample(microbot: mo.Robot) -> None:
    motion = Motion.from_polynomial(microbot, smooth_quintics([0.3, 0.4], 1), label="smooth")
    assert np.diff(motion.t).min() > 1e-4
    assert 0.3 in motion.t
    assert motion.breaks.tolist() == [0.0, 0.3, 0.7]


@settings(max_examples=100)
@given(
    lengths=st.lists(st.floats(1e-7, 2.0), min_size=1, max_size=6),
    step=st.floats(1e-3, 3.0),
    data=st.data(),
)
def test_sample_times_increase_hold_every_break_and_keep_the_step(
    lengths: list[float], step: float, data: st.DataObject
) -> None:
    breaks = np.concatenate([[0.0], np.cumsum(lengths)])
    inner = breaks[1:-1].tolist()
    jumps = data.draw(st.lists(st.sampled_from(inner), unique=True)) if inner else []
    t = sample_times(breaks, np.array(jumps), step)
    assert np.all(np.diff(t) > 0)
    assert set(breaks.tolist()) <= set(t.tolist())
    assert (t[0], t[-1]) == (breaks[0], breaks[-1])
    assert np.diff(t).max() <= step * (1 + 1e-6)


@pytest.mark.parametrize("t", [-0.1, 2.1, np.nan, [0.5, 3.0], "0.5"])
def test_sample_outside_the_motion_is_refused(bang_bang: Motion, t: Any) -> None:
    with refused("t must"):
        bang_bang.sample(t)


def test_sample_outside_names_the_duration_and_the_time(bang_bang: Motion) -> None:
    with refused("t", "0 to 2 s", "not 2.5 s"):
        bang_bang.sample([1.0, 2.5])


def test_torques_of_a_motion_are_its_inverse_dynamics(
    microbot: mo.Robot, bang_bang: Motion
) -> None:
    expected = batch(mo.inverse_dynamics(microbot), bang_bang.q, bang_bang.qd, bang_bang.qdd)
    assert bang_bang.tau == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("rate", "count"), [(10.0, 21), (100.0, 201), (3.0, 7), (0.9, 3), (0.5, 2), (0.01, 2)]
)
def test_resampled_motion_is_on_a_uniform_grid_with_both_ends(
    bang_bang: Motion, rate: float, count: int
) -> None:
    uniform = bang_bang.resample(rate)
    assert uniform.t.size == count
    assert uniform.t[0] == 0.0
    assert uniform.duration == bang_bang.duration
    assert uniform.t[:-1] == pytest.approx(np.arange(count - 1) / rate)
    assert uniform.q == pytest.approx(bang_bang.sample(uniform.t).q)
    assert uniform.label == bang_bang.label
    assert uniform.marks == bang_bang.marks


def test_resampled_torques_are_its_inverse_dynamics(microbot: mo.Robot, bang_bang: Motion) -> None:
    uniform = bang_bang.resample(50.0)
    expected = batch(mo.inverse_dynamics(microbot), uniform.q, uniform.qd, uniform.qdd)
    assert uniform.tau == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("rate", [0.0, -1.0, np.inf, "fast"])
def test_impossible_rate_is_refused(bang_bang: Motion, rate: float) -> None:
    with refused("rate must"):
        bang_bang.resample(rate)


# ---- making one


def still(**changes: Any) -> Motion:
    arrays_given: dict[str, Any] = {"t": [0.0, 1.0]}
    arrays_given |= {name: np.zeros((2, 3)) for name in ("q", "qd", "qdd", "tau")}
    return Motion(**(arrays_given | changes))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"t": [0.0]}, ("t", "two", "increasing", "s, not [0.0]")),
        ({"t": [0.0, 0.0]}, ("t", "increasing", "t[1] is 0 s", "t[0] of 0 s")),
        ({"t": [1.0, 2.0]}, ("t", "from 0, s", "[1.0, 2.0]")),
        ({"t": [0.0, np.nan]}, ("t", "[1]", "nan s")),
        ({"q": np.zeros((3, 3))}, ("q", "[2, any]", "[3, 3]")),
        ({"q": np.zeros(2)}, ("q", "[2, any]", "not [2]")),
        ({"qd": np.zeros((2, 2))}, ("qd", "[2, 3]", "[2, 2]")),
        ({"tau": np.full((2, 3), np.inf)}, ("tau", "[0, 0]", "inf N m")),
        ({"breaks": [0.0]}, ("breaks", "increasing", "0 to 1 s", "[0.0]")),
        ({"breaks": [0.0, 0.5]}, ("breaks", "increasing", "0 to 1 s", "[0.0, 0.5]")),
        ({"breaks": [0.0, 1.5, 1.0]}, ("breaks", "increasing", "0 to 1 s", "[0.0, 1.5, 1.0]")),
    ],
)
def test_impossible_motion_is_refused(changes: dict[str, Any], said: tuple[str, ...]) -> None:
    with refused(*said):
        still(**changes)


def test_the_outcome_tells_status_advice_and_note(bang_bang: Motion, tmp_path) -> None:
    assert bang_bang.status is mo.Status.SOLVED
    assert bang_bang.note == bang_bang.remark
    row = Advice("limit", "too fast by 2 rad/s", "speed", 2.0, "rad/s")
    failed = bang_bang.ended(Outcome.of(mo.Status.ITERATION_LIMIT).and_(row), tries=3)
    assert failed.status is mo.Status.ITERATION_LIMIT
    assert not failed.solved
    assert "iteration limit" in repr(failed)
    assert failed.note == f"not solved: {mo.Status.ITERATION_LIMIT.sentence}\n{row.sentence}"
    assert failed.provenance["tries"] == 3
    assert Motion.load(failed.save(tmp_path / "failed.npz")).outcome == failed.outcome


def test_an_unknown_status_is_not_taken_for_solved() -> None:
    written = SOLVED.as_dict() | {"status": "almost"}
    assert Outcome.read(written).status is mo.Status.FAILED


def test_motion_for_another_robot_is_refused(microbot: mo.Robot) -> None:
    narrow = PiecewisePolynomial([0.0, 1.0], np.ones((1, 3, 2)))
    with refused("q", "[any, 3]", "[1001, 2]"):
        Motion.from_polynomial(microbot, narrow, label="narrow")
    with refused("q", "[any, 3]", "[2, 2]"):
        Motion.from_state(microbot, [0.0, 1.0], State(*np.zeros((3, 2, 2))), label="narrow")


def test_polynomial_of_too_high_a_degree_or_too_small_a_step_is_refused(
    microbot: mo.Robot,
) -> None:
    steep = PiecewisePolynomial([0.0, 1.0], np.ones((1, 7, 3)))
    with refused("polynomial", "degree", "5", "not 6"):
        Motion.from_polynomial(microbot, steep, label="steep")
    with refused("step", "above 0 s", "not 0"):
        Motion.from_polynomial(microbot, BANG_BANG, label="stuck", step=0)


# ---- files


def assert_same(ours: Motion, theirs: Motion) -> None:
    for name in ("t", "q", "qd", "qdd", "tau", "breaks"):
        assert np.array_equal(getattr(ours, name), getattr(theirs, name))
    for name in ("label", "marks", "provenance", "note", "duration", "joint_count"):
        assert getattr(ours, name) == getattr(theirs, name)


def test_saved_motion_comes_back_the_same(bang_bang: Motion, tmp_path: Path) -> None:
    path = bang_bang.save(tmp_path / "motion.npz")
    assert_same(Motion.load(path), bang_bang)
    assert_same(Motion.load(str(path)), bang_bang)
    assert [p.name for p in tmp_path.iterdir()] == ["motion.npz"]


@given(seed=st.integers(0, 10_000), label=st.text(), name=st.text())
@settings(max_examples=10)
def test_any_motion_comes_back_the_same(
    microbot: mo.Robot, tmp_path: Path, seed: int, label: str, name: str
) -> None:
    motion = Motion.from_polynomial(
        microbot,
        smooth_quintics([0.2, 0.3], seed),
        label=label,
        marks=[Mark(0.2, name)],
        remark=name,
    )
    assert_same(Motion.load(motion.save(tmp_path / "any.npz")), motion)


def test_saving_over_a_motion_replaces_it_and_a_failed_save_keeps_it(
    bang_bang: Motion, tmp_path: Path
) -> None:
    path = still(label="first").save(tmp_path / "motion.npz")
    bang_bang.save(path)
    assert Motion.load(path).label == "bang-bang"
    with refused("provenance", "JSON"):
        still(provenance={"solver": object()}).save(path)
    assert Motion.load(path).label == "bang-bang"
    assert [p.name for p in tmp_path.iterdir()] == ["motion.npz"]


def test_saved_motion_is_read_by_numpy_alone(bang_bang: Motion, tmp_path: Path) -> None:
    with np.load(bang_bang.save(tmp_path / "motion.npz"), allow_pickle=False) as stored:
        assert np.array_equal(stored["tau"], bang_bang.tau)
        metadata = json.loads(str(stored["metadata"]))
    assert metadata["schema"] == SCHEMA
    assert metadata["marks"] == [[0.0, "start"], [1.0, "switch"]]


def edited(path: Path, **changes: Any) -> None:
    """Rewrite a saved motion; metadata keys by name, arrays as arrays, None takes a key out."""
    with np.load(path) as stored:
        content = dict(stored)
    metadata = json.loads(str(content["metadata"]))
    for key, value in changes.items():
        target = content if key in content else metadata
        if value is None:
            del target[key]
        else:
            target[key] = value
    if "metadata" not in changes:
        content["metadata"] = np.array(json.dumps(metadata))
    np.savez(path, **content)


def flip(path: Path) -> None:
    """One bit of the compressed data of the first array."""
    data = bytearray(path.read_bytes())
    data[200] ^= 0x55
    path.write_bytes(bytes(data))


def only_an_array(path: Path) -> None:
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(3))
    path.write_bytes(buffer.getvalue())


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.unlink(),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_text("not a motion"),
        lambda path: path.write_bytes(path.read_bytes()[:-200]),
        flip,
        only_an_array,
        lambda path: edited(path, tau=None),
        lambda path: edited(path, label=None),
        lambda path: edited(path, schema=None),
        lambda path: edited(path, schema="new"),
        lambda path: edited(path, marks=[[1.0]]),
        lambda path: edited(path, marks=3),
        lambda path: edited(path, metadata=np.array("{")),
        lambda path: edited(path, metadata=np.array("[1, 2]")),
        lambda path: edited(path, tau=np.zeros((2, 3))),
        lambda path: edited(path, q=np.array(["a", "b"])),
    ],
    ids=[
        *("missing", "empty", "text", "truncated", "bit error", "npy", "no tau", "no label"),
        *("no schema", "schema text", "short mark", "marks number", "broken JSON", "JSON list"),
        *("wrong shape", "text array"),
    ],
)
def test_broken_file_is_refused_by_name(
    bang_bang: Motion, tmp_path: Path, spoil: Callable[[Path], object]
) -> None:
    path = bang_bang.save(tmp_path / "motion.npz")
    spoil(path)
    with refused("motion.npz is ", "saved motion"):
        Motion.load(path)


def test_file_of_a_newer_version_is_refused_as_such(bang_bang: Motion, tmp_path: Path) -> None:
    path = bang_bang.save(tmp_path / "motion.npz")
    edited(path, schema=SCHEMA + 1)
    with refused("motion.npz", f"schema {SCHEMA + 1}", f"up to {SCHEMA}"):
        Motion.load(path)


def test_resampled_torques_are_those_of_the_robot(microbot):
    shape = mo.lspb([[0, 0, 0], [0.9, 0.7, 0.8]], [0.0, 1.0], 0.3)
    motion = mo.Motion.from_polynomial(microbot, shape, label="lspb")
    sampled = motion.resample(730.0, microbot)
    tau = np.array(mo.inverse_dynamics(microbot).map(sampled.t.size)(
        sampled.q.T, sampled.qd.T, sampled.qdd.T
    )).T  # fmt: skip
    np.testing.assert_allclose(sampled.tau, tau, rtol=1e-12, atol=1e-9)
    assert np.abs(motion.resample(730.0).tau - tau).max() > 1e-6
    # what it carries is not left out
    loaded = microbot.with_payload(2.0)
    held = mo.Motion.from_polynomial(loaded, shape, label="held").resample(730.0, microbot)
    carried = loaded.torques_along(held.q, held.qd, held.qdd)["tau"]
    np.testing.assert_allclose(held.tau, carried, atol=1e-3 * np.abs(carried).max())


def test_short_intervals_far_from_zero_tell_how_the_acceleration_bends():
    """Positions near 10,000 rad say nothing of 50 microseconds; velocities do."""
    t = np.linspace(0.0, 1e-3, 21)[:, None]
    q, qd, qdd = 1e4 + np.sin(300 * t), 300 * np.cos(300 * t), -9e4 * np.sin(300 * t)
    motion = mo.Motion(t.ravel(), q, qd, qdd, np.zeros_like(q))
    middle = 0.5 * (t[1:] + t[:-1])
    found = motion.sample(middle.ravel()).qdd
    assert np.abs(found + 9e4 * np.sin(300 * middle)).max() < 1e-6 * 9e4


def test_a_stretched_motion_is_that_of_the_stretched_polynomial():
    robot = mo.load_robot("microbot")
    shape = mo.quintic([[0.0, 0.1, 0.2], [0.5, -0.4, 0.9]], [0.0, 0.7])
    marks = (Mark(0.7, "via 2"),)
    fast = Motion.from_polynomial(robot, shape, label="quintic", marks=marks)
    slow = fast.stretched(robot, 1.5)
    expected = Motion.from_polynomial(robot, shape.stretched(1.5), label="quintic")
    assert slow.duration == pytest.approx(1.05)
    for there, here in zip(expected.sample(slow.t), slow.sample(slow.t), strict=True):
        np.testing.assert_allclose(here, there, atol=1e-12)
    np.testing.assert_allclose(
        slow.tau, batch(mo.inverse_dynamics(robot), slow.q, slow.qd, slow.qdd)
    )
    assert [(mark.time, mark.name) for mark in slow.marks] == [(pytest.approx(1.05), "via 2")]
    np.testing.assert_allclose(slow.breaks, [0.0, 1.05])
    with refused("factor", "above 0", "not 0.0"):
        fast.stretched(robot, 0.0)


def test_a_stretched_motion_has_no_slopes_of_the_faster_one():
    robot = mo.load_robot("microbot")
    shape = mo.quintic([[0.0, 0.1, 0.2], [0.5, -0.4, 0.9]], [0.0, 0.7])
    given = {"multipliers": {"rows": {}}, "method": "search"}
    fast = Motion.from_polynomial(robot, shape, label="quintic", provenance=given)
    slow = fast.stretched(robot, 2.0)
    named = {"robot": robot.name, "robot_digest": robot.chain_digest}
    assert slow.provenance == {"method": "search", **named}
    with refused("motion", "no multipliers"):
        slow.sensitivities(robot)


def test_a_motion_names_its_robot_and_certify_says_so_of_another(tmp_path):
    robot = mo.load_robot("microbot")
    shape = mo.quintic([[0.0, 0.0, 0.0], [0.5, 0.5, 0.5]], [0.0, 5.0])
    motion = Motion.load(
        Motion.from_polynomial(robot, shape, label="quintic").save(tmp_path / "a.npz")
    )
    assert motion.provenance["robot"] == "microbot"
    assert motion.provenance["robot_digest"] == robot.chain_digest
    longer = replace(robot, d=robot.d + 0.1)
    heavier = robot.with_payload(1.0)
    renamed = replace(robot, name="other")
    for arm, parts in (
        (robot, ()),
        (heavier, ()),
        (renamed, ()),
        (robot.with_limits(qd_max=0.1), ()),
        (longer, ("other rows",)),
        (mo.load_robot("planar_3r"), ("'planar_3r'",)),
    ):
        head, _, verdict = mo.certify(arm, motion).verdict.partition(": ")
        assert head in ("Passed", "Failed")
        first = verdict.split("; ")[0].split(": ")[0]
        tells(first, *parts)
        assert ("robot 'microbot'" in first) == ("robot 'microbot'" in verdict) == bool(parts)
