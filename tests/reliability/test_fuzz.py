"""Whatever a file, a command or a call holds: a result, or an InputError with a short sentence."""

import random

import fuzz
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import microbot_ocp as mo
from helpers import refused, sampled

CASES = 12  # of each kind; `make fuzz` tries more


@pytest.mark.parametrize("target", sampled(fuzz.TARGETS, 2))
def test_every_case_ends_well(target, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    count = CASES * (5 if target == "border" else 1)
    counts, wrong = fuzz.series(target, count)
    assert wrong == []
    assert sum(counts.values()) == count


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.complex_numbers() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=2),
    max_leaves=8,
)


@pytest.mark.thorough
@settings(
    max_examples=CASES, deadline=10_000, suppress_health_check=list(HealthCheck), database=None
)
@given(value=anything)
def test_arrays_of_anything(value):
    robot = fuzz.robot()
    for call in (
        lambda: mo.solve_ik(robot, value, time_limit=0.02),
        lambda: robot.with_limits(qd_max=value),
        lambda: mo.cubic(value, [0.0, 1.0]),
    ):
        try:
            call()
        except mo.InputError as problem:
            assert len(str(problem)) < 400, problem  # noqa: PT017


def test_the_files_are_good_before_they_are_damaged(monkeypatch):
    monkeypatch.setattr(fuzz, "edited", lambda document, draw: document)
    monkeypatch.setattr(fuzz, "damaged", lambda content, draw: content)
    for name in ("comparison", "robot_file", "urdf", "task", "cell", "study", "sweep", "scene"):
        assert fuzz.attempt(name, random.Random(0)) == "", name


def test_what_is_wrong_is_seen(monkeypatch):
    """The harness tells a foreign exception, a long message and a hang."""
    monkeypatch.setattr(fuzz, "SLOW", 0.05)

    def hang(draw):
        while True:
            pass

    class Long(mo.InputError):
        def __str__(self):
            return "x" * 400

    def long(draw):
        raise Long("x")

    monkeypatch.setitem(fuzz.TARGETS, "zero", lambda draw: 1 / 0)
    monkeypatch.setitem(fuzz.TARGETS, "hang", hang)
    monkeypatch.setitem(fuzz.TARGETS, "long", long)
    said = [fuzz.attempt(name, random.Random(0)) for name in ("zero", "hang", "long")]
    assert "ZeroDivisionError" in said[0]
    assert "Hang" in said[1]
    assert "400 characters" in said[2]


@pytest.mark.parametrize("kind", ["motion", "solution"])
def test_a_file_that_was_changed_is_refused(kind, tmp_path):
    path = tmp_path / "changed.npz"
    path.write_bytes(fuzz.saved(kind))
    read = {"motion": mo.Motion.load, "solution": mo.ocp.load_solution}[kind]
    read(path)
    with np.load(path) as stored:
        arrays = dict(stored)
    name = {"motion": "tau", "solution": "phase0.value0"}[kind]
    np.savez(path, **{**arrays, name: arrays[name] * (1 + 1e-12)})
    with refused("changed.npz", f"saved {kind}", "it was changed"):
        read(path)
