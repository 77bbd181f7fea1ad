"""Random robots and states, seeded, and the relative difference the tests speak of."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from itertools import product
from typing import Any

import casadi as ca
import numpy as np
import pytest
from _pytest.mark import ParameterSet

import microbot_ocp as mo
from microbot_ocp.robot import dh_transform

# Name -> (seed, joint types: r revolute, p prismatic). All have full inertias, offsets, rotor
# inertia, tilted gravity and a turned tool.
RANDOM_CHAINS = {
    "rr": (1, "rr"),
    "rp": (2, "rp"),
    "prr": (3, "prr"),
    "rprr": (4, "rprr"),
    "rrprp": (5, "rrprp"),
    "rrrrrr": (6, "rrrrrr"),
    "rrrprrr": (7, "rrrprrr"),
}


@contextmanager
def refused(
    *parts: object, error: type[BaseException] = mo.InputError
) -> Iterator[pytest.ExceptionInfo[BaseException]]:
    """Require an error whose message holds these names, values, units and allowed values.

    The sentence around them is free: a test that asserted it would break with every rewording.
    """
    with pytest.raises(error) as caught:
        yield caught
    tells(str(caught.value), *parts)


@contextmanager
def warned(
    *parts: object, category: type[Warning] = UserWarning
) -> Iterator[pytest.WarningsRecorder]:
    """Require a warning whose message holds these names, values, units and allowed values."""
    with pytest.warns(category) as caught:
        yield caught
    messages = [str(one.message) for one in caught if issubclass(one.category, category)]
    assert any(not missing_in(text, parts) for text in messages), f"{parts} in none of {messages}"


def tells(text: str, *parts: object) -> None:
    """Assert that a text holds these names, values and units."""
    missing = missing_in(text, parts)
    assert not missing, f"{missing} missing in {text!r}"


def missing_in(text: str, parts: Iterable[object]) -> list[str]:
    """Return the parts that a text does not hold, each from the beginning of a word or number."""
    return [part for part in map(str, parts) if not re.search(whole(part), text)]


def whole(part: str) -> str:
    """Return a pattern that finds a part, but not within a longer name or number."""
    begin = r"(?<!\w)" * part[:1].isalnum() + r"(?<!\.)" * part[:1].isdigit()
    end = r"(?!\w)" * part[-1:].isalnum() + r"(?!\.\d)" * part[-1:].isdigit()
    return begin + re.escape(part) + end


def crossed(*axes: Iterable[Any]) -> list[Any]:
    """All combinations, thorough beyond the fewest in which each value of each axis stands."""
    values = [list(axis) for axis in axes]
    few = {tuple(v[k % len(v)] for v in values) for k in range(max(map(len, values)))}
    return [
        case if case in few else pytest.param(*case, marks=pytest.mark.thorough)
        for case in product(*values)
    ]


def sampled(cases: Iterable[Any], every: int) -> list[Any]:
    """All cases, thorough but for the first of every so many."""
    return sampled_rows(
        (case if isinstance(case, ParameterSet) else (case,) for case in cases), every
    )


def sampled_rows(cases: Iterable[Any], every: int) -> list[Any]:
    """As ``sampled`` for cases of several arguments."""
    rows = [case if isinstance(case, ParameterSet) else pytest.param(*case) for case in cases]
    return [
        row._replace(marks=(*row.marks, pytest.mark.thorough)) if k % every else row
        for k, row in enumerate(rows)
    ]


def random_link(rng: np.random.Generator, armature: bool = True) -> mo.Link:
    """A link whose inertia comes from a second moment of mass, so that a body could have it."""
    spread = rng.normal(size=(3, 3))
    second_moment = 0.1 * spread @ spread.T + 0.01 * np.eye(3)
    return mo.Link(
        mass=rng.uniform(0.5, 5.0),
        center_of_mass=rng.uniform(-0.5, 0.5, 3),
        inertia=np.trace(second_moment) * np.eye(3) - second_moment,
        armature=rng.uniform(0.0, 0.5) if armature else 0.0,
    )


@lru_cache
def random_robot(name: str) -> mo.Robot:
    """One of ``RANDOM_CHAINS``, always the same."""
    seed, kinds = RANDOM_CHAINS[name]
    rng = np.random.default_rng(seed)
    count = len(kinds)
    return mo.Robot.from_dh(
        alpha=rng.uniform(-np.pi, np.pi, count),
        a=rng.uniform(-1.0, 1.0, count),
        d=rng.uniform(-1.0, 1.0, count),
        theta_offset=rng.uniform(-np.pi, np.pi, count),
        joint_type=["revolute" if kind == "r" else "prismatic" for kind in kinds],
        links=[random_link(rng) for _ in kinds],
        gravity=rng.uniform(-10.0, 10.0, 3),
        tool=dh_transform(*rng.uniform(-1.0, 1.0, 4)),
        name=name,
        convention="modified",
    )


def any_robot(name: str) -> mo.Robot:
    """A packaged robot or one of ``RANDOM_CHAINS``."""
    return random_robot(name) if name in RANDOM_CHAINS else mo.load_robot(name)


def two_link_arm(
    first: float, second: float, masses: tuple[float, float] = (1.0, 1.0), gravity: float = 9.81
) -> mo.Robot:
    """Craig's planar two-link arm: point masses at the link ends, gravity along -Y."""
    return mo.Robot.from_dh(
        alpha=[0.0, 0.0],
        a=[0.0, first],
        d=[0.0, 0.0],
        links=[mo.Link(masses[0], [first, 0, 0]), mo.Link(masses[1], [second, 0, 0])],
        gravity=(0.0, -gravity, 0.0),
        tool=(0.0, second, 0.0, 0.0),
        name="two-link arm",
    )


def random_states(robot: mo.Robot, count: int, seed: int = 0) -> tuple[np.ndarray, ...]:
    """Positions, velocities and accelerations, each [count, n]."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-np.pi, np.pi, (count, robot.joint_count))
    qd = rng.uniform(-3.0, 3.0, q.shape)
    qdd = rng.uniform(-10.0, 10.0, q.shape)
    return q, qd, qdd


def batch(function: ca.Function, *arrays: np.ndarray) -> np.ndarray:
    """Outputs [N, rows] or [N, rows, columns] of a function at arrays [N, .], in one call."""
    count = len(arrays[0])
    rows, columns = function.size_out(0)
    flat = np.array(function.map(count)(*(a.T for a in arrays)))
    blocks = flat.reshape(rows, count, columns).transpose(1, 0, 2)
    return blocks[:, :, 0] if columns == 1 else blocks


def difference(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Largest difference at any state, relative to the size (at least 1) of what it should be."""
    ours, theirs = np.asarray(ours), np.asarray(theirs)
    assert ours.shape == theirs.shape
    axes = tuple(range(1, theirs.ndim))
    size = np.maximum(1.0, np.abs(theirs).max(axis=axes))
    return float((np.abs(ours - theirs).max(axis=axes) / size).max())
