"""Whether two studies are the same: what counts is what rows follow from, with all its bits."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st

import microbot_ocp as mo
from helpers import refused
from microbot_ocp.sweeps import Study

ENDS: dict[str, Any] = {"start_q": [0.0, 0.0, 0.0], "goal_q": [1.0, 0.5, 0.5]}
ROBOT = mo.load_robot("microbot")
GAIN = 1.0


def helper(via: np.ndarray) -> mo.PolynomialMotion:
    return mo.cubic(via, [0.0, GAIN])


def own(robot: mo.Robot, via: np.ndarray) -> mo.Motion:
    return mo.Motion.from_polynomial(robot, helper(via))


def with_duration(duration: Any, kind: str = "cubic") -> Any:
    def method(robot: mo.Robot, via: np.ndarray) -> mo.Motion:
        return mo.Motion.from_polynomial(robot, getattr(mo, kind)(via, [0.0, duration]))

    return method


def digest(robot: mo.Robot = ROBOT, methods: Any = ("cubic",), **quantities: Any) -> str:
    return Study(robot, mo.sweeps.Cases.grid(**{**ENDS, **quantities}), methods).digest


def limited(exponent: float) -> mo.Robot:
    height = mo.Limit("height", lambda state: state.tool[2, 3] ** exponent, upper=9.0)
    return ROBOT.with_limits(also=[height])


def of_casadi(factor: float) -> Any:
    x = ca.SX.sym("x")
    function = ca.Function("f", [x], [factor * x])
    return lambda robot, via: function(via)


LONG = np.linspace(0.0, 1.0, 1001)
ANOTHER = np.where(np.arange(1001) == 500, 0.123, LONG)
DIFFERENT = {
    "one of many values": ({"payload": mo.OneOf(LONG)}, {"payload": mo.OneOf(ANOTHER)}),
    "the last bits": ({"payload": mo.OneOf(np.array([0.5, 1.0]))},
                      {"payload": mo.OneOf(np.array([0.5, 1.0 + 1e-10]))}),
    "a constant of a method": ({"methods": {"own": with_duration(2.0)}},
                               {"methods": {"own": with_duration(3.0)}}),
    "an array of a method": ({"methods": {"own": with_duration(np.ones(2000))}},
                             {"methods": {"own": with_duration(np.ones(2001))}}),
    "code of a method": ({"methods": {"own": own}}, {"methods": {"own": helper}}),
    "what a method calls": ({"methods": {"own": with_duration(2.0, "cubic")}},
                            {"methods": {"own": with_duration(2.0, "quintic")}}),
    "a function of CasADi": ({"methods": {"own": of_casadi(1.0)}},
                             {"methods": {"own": of_casadi(1.0 + 1e-15)}}),
    "a limit of one's own": ({"robot": limited(1.0)}, {"robot": limited(2.0)}),
    "a bound of a limit": (
        {"robot": ROBOT.with_limits(also=[mo.limits.tool_speed(1.0)])},
        {"robot": ROBOT.with_limits(also=[mo.limits.tool_speed(1.0 + 1e-15)])},
    ),
    "the order of a grid": (
        {"payload": mo.Between(0, 1, 2), "qd_max": mo.OneOf([1, 2])},
        {"qd_max": mo.OneOf([1, 2]), "payload": mo.Between(0, 1, 2)},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", DIFFERENT)
def test_another_study_has_another_digest(name: str) -> None:
    one, other = DIFFERENT[name]
    assert digest(**one) != digest(**other)
    assert digest(**one) == digest(**one)


def test_a_global_that_a_method_of_a_method_uses_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    before = digest(methods={"own": own})
    monkeypatch.setattr(sys.modules[__name__], "GAIN", 2.0)
    assert digest(methods={"own": own}) != before


def test_the_text_of_a_module_that_a_method_imports_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def method(robot: mo.Robot, via: np.ndarray) -> Any:
        import study_helper_of_a_test  # type: ignore[import-not-found]

        return study_helper_of_a_test.move(robot, via)

    monkeypatch.syspath_prepend(tmp_path)
    digests = set()
    for text in ("def move(*given): return 1", "def move(*given): return 2"):
        (tmp_path / "study_helper_of_a_test.py").write_text(text)
        digests.add(digest(methods={"own": method}))
    assert len(digests) == 2


numbers = st.floats(0.0, 3.0, allow_subnormal=False)
quantities = st.fixed_dictionaries(
    {"goal_q": st.lists(numbers, min_size=3, max_size=3)},
    optional={
        "payload": st.lists(numbers, min_size=2, max_size=3).map(mo.OneOf),
        "gravity": st.lists(numbers, min_size=3, max_size=3),
        "tau_max": numbers.map(lambda value: 100.0 + value),
    },
)


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(one=quantities, other=quantities)
def test_equal_digests_mean_equal_cases(one: dict[str, Any], other: dict[str, Any]) -> None:
    first, second = (mo.sweeps.Cases.grid(**{**ENDS, **given}).of(ROBOT) for given in (one, other))
    assert digest(**one) == digest(**dict(one))
    same = first.columns == second.columns and first.count == second.count
    same = same and first.rows(0, first.count).tobytes() == second.rows(0, first.count).tobytes()
    assume(not same)
    assert digest(**one) != digest(**other)


SCRIPT = """
import sys
sys.path.insert(0, {tests!r})
import sweeps.test_study_digest as t
tags = {{"tags": {{"a", "b", "c"}}}}
methods = {{"own": t.own, "made": t.with_duration(2.0), "held": t.with_duration(tags)}}
print(t.digest(t.limited(2.0), methods, payload=t.mo.OneOf(t.LONG), gravity=[0, 0, -1.62]))
"""


@pytest.mark.slow
def test_every_process_finds_the_same_digest() -> None:
    tags = {"tags": {"a", "b", "c"}}
    methods = {"own": own, "made": with_duration(2.0), "held": with_duration(tags)}
    here = digest(limited(2.0), methods, payload=mo.OneOf(LONG), gravity=[0, 0, -1.62])
    code = SCRIPT.format(tests=str(Path(__file__).parent.parent))
    seed = "1" if os.environ.get("PYTHONHASHSEED") != "1" else "2"
    there = subprocess.run([sys.executable, "-c", code], env={**os.environ, "PYTHONHASHSEED": seed},
                           capture_output=True, text=True, check=True).stdout  # fmt: skip
    assert there == f"{here}\n"


@pytest.mark.parametrize(
    ("held", "name"), [(threading.Lock(), "lock"), ((k for k in "ab"), "generator")]
)
def test_what_cannot_be_told_is_refused_by_name(held: Any, name: str) -> None:
    with refused("methods.own.duration", name):
        digest(methods={"own": with_duration(held)})


def test_compiled_code_cannot_be_told_apart() -> None:
    with refused("methods.own.duration", "forward_kinematics"):
        digest(methods={"own": with_duration(mo.forward_kinematics(ROBOT, compiled=True))})
