"""Bounds by which segments of paths are proved to keep clear, against sampled exact distances."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from tests.scene.test_distance import NEEDLE, OBSTACLES

import microbot_ocp as mo
from microbot_ocp._base.codegen import interpreted
from microbot_ocp.scene import Surroundings
from microbot_ocp.scene._contact import parting

PANDA = mo.load_robot("panda")
ARMS = [(NEEDLE, kind) for kind in OBSTACLES] + [(PANDA, kind) for kind in ("box", "capsule")]


def surroundings(robot: mo.Robot, kind: str) -> Surroundings:
    return Surroundings(robot, mo.Scene((OBSTACLES[kind],)))


@pytest.mark.parametrize(("robot", "kind"), ARMS)
def test_no_pair_comes_nearer_than_its_bound(robot: mo.Robot, kind: str) -> None:
    around, random = surroundings(robot, kind), np.random.default_rng(1)
    function, row_of, bodies = around.model.motions
    n, bounded = robot.joint_count, 0
    for size in (0.01, 0.1, 0.5):
        middles, ways = random.uniform(-1.5, 1.5, (40, n)), size * random.normal(size=(40, n))
        bends = 0.5 * ways[::-1]
        for middle, way, bend in zip(middles, ways, bends, strict=True):
            slopes = np.abs(way) + np.abs(bend)  # over parameters from -1 to 1
            rates = around.rates(slopes, np.abs(bend))
            motions = function(middle[None], way[None])[1][0, row_of]
            now, least, approach = parting()(motions, bodies, rates, 1.0).T
            s = np.linspace(-1.0, 1.0, 9)[:, None]
            exact = around.model.distances(middle + s * way + 0.5 * s**2 * bend)
            there = around.model.distances(middle[None])[0]
            apart = exact.min(axis=0)
            assert np.all((now <= there + 2e-6) | (now < 0.0))
            assert np.all((least <= apart + 2e-6) | (least < 0.0))
            assert np.all((there - approach <= apart + 2e-6) | (apart < 0.0))
            bounded += np.sum(least > 0.0)
    assert bounded > 40


@pytest.mark.parametrize(("robot", "kind"), [(NEEDLE, "box"), (PANDA, "capsule")])
def test_proved_segments_are_free_and_equal_without_a_compiler(robot: mo.Robot, kind: str) -> None:
    around, random = surroundings(robot, kind), np.random.default_rng(2)
    poses = random.uniform(-1.5, 1.5, (60, robot.joint_count))
    clear = [around.is_clear(*ends) for ends in pairwise(poses)]
    assert 3 < sum(clear) < 57
    for (one, two), proved in zip(pairwise(poses), clear, strict=True):
        way = one + np.linspace(0.0, 1.0, 33)[:, None] * (two - one)
        assert not proved or around.model.distances(way).min() > 0.0
    with interpreted():
        parting.cache_clear()
        again = surroundings(robot, kind)
        again.model.__dict__.pop("motions", None)
        for (one, two), proved in zip(pairwise(poses), clear, strict=True):
            assert again.is_clear(one, two) == proved
    parting.cache_clear()
    assert again.checks == around.checks
