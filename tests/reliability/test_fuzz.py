"""Whatever a file or a call holds: a result, or an InputError with a short sentence."""

import os

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import microbot_ocp as mo
from microbot_ocp.robot.files import robot_text

CASES = int(os.environ.get("MICROBOT_OCP_FUZZ", "30"))
fuzzed = settings(
    max_examples=CASES, deadline=10_000, suppress_health_check=list(HealthCheck), database=None
)
ROBOT = mo.load_robot("microbot")
TOML = robot_text("microbot", None)


def refused_or_done(call):
    try:
        call()
    except mo.InputError as problem:
        assert len(str(problem)) < 300, problem  # noqa: PT017


def damaged(content, edits):
    data = bytearray(content)
    for place, value in edits:
        if data:
            data[place % len(data)] = value
    return bytes(data)


edits = st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=8)
cuts = st.integers(0, 10**6)


@pytest.fixture(scope="module")
def motion_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("fuzz") / "motion.npz"
    mo.Motion.from_polynomial(ROBOT, mo.quintic([[0, 0, 0], [1, 1, 1]], [0, 1]), label="a").save(
        path
    )
    return path.read_bytes()


@fuzzed
@given(edits=edits, cut=cuts)
def test_damaged_robot_files(tmp_path_factory, edits, cut):
    path = tmp_path_factory.getbasetemp() / "robot.toml"
    content = damaged(TOML.encode(), edits)
    path.write_bytes(content[: cut % len(content)] if cut % 3 == 0 else content)
    refused_or_done(lambda: mo.load_robot(path))


@fuzzed
@given(edits=edits, cut=cuts)
def test_damaged_motions(tmp_path_factory, motion_file, edits, cut):
    path = tmp_path_factory.getbasetemp() / "motion.npz"
    content = damaged(motion_file, edits)
    path.write_bytes(content[: cut % len(content)] if cut % 3 == 0 else content)
    refused_or_done(lambda: mo.Motion.load(path))


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.complex_numbers() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=2),
    max_leaves=8,
)


@fuzzed
@given(value=anything)
def test_arrays_of_anything(value):
    refused_or_done(lambda: mo.solve_ik(ROBOT, value))
    refused_or_done(lambda: ROBOT.with_limits(qd_max=value))
    refused_or_done(lambda: mo.cubic(value, [0.0, 1.0]))
