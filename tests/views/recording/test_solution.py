"""Recordings of solutions of optimal-control problems."""

from dataclasses import replace

import numpy as np
import pytest
from every_kind import solution
from reading import read, scalars, static

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp.ocp.search import solve
from microbot_ocp.views.recording import of_solution


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    return solution().save(tmp_path_factory.mktemp("rrd") / "cart.rrd")


def test_cart_has_its_closed_form(cart):
    """It accelerates at 1 to its bound of 0.7, coasts, and brakes at 0.5."""
    t, x = scalars(cart, "/plots/x/solution")
    _, v = scalars(cart, "/plots/v/solution")
    peak = 0.7  # without the bound it would be sqrt(2 / 3)
    assert v.max() == pytest.approx(peak, abs=1e-6)
    assert x[[0, -1]] == pytest.approx([0.0, 1.0], abs=1e-6)
    coasting = (1.0 - peak**2 / 2 - peak**2) / peak
    assert t[-1] == pytest.approx(peak + coasting + peak / 0.5, abs=2e-3)


def test_phases_and_bounds(cart):
    begins, names = read(cart, "/phases", "StateChange:state")
    assert names == [["push"], ["brake"]]
    assert begins[0] == 0.0
    t, rows = read(cart, "/plots/a/limit_upper", "Scalars:scalars")
    before = {tuple(row) for row, time in zip(rows, t, strict=True) if time < begins[1] - 1e-3}
    after = {tuple(row) for row, time in zip(rows, t, strict=True) if time > begins[1] + 1e-3}
    assert (before, after) == ({(1.0,), ()}, {(0.0,), ()})
    assert not read(cart, "/plots/x/limit_upper", "Scalars:scalars")[0].size


@pytest.mark.thorough
def test_what_failed_says_so(tmp_path):
    problem = mo.OptimalControlProblem("short of time")
    phase = problem.phase("go", duration=(0.1, 0.2))
    x = phase.state("x", initial=0.0, final=1.0)
    speed = phase.control("speed", lower=-1.0, upper=1.0)
    phase.derivative(x, speed)
    phase.end_cost(phase.duration)
    failed = solve(problem, mesh=5)
    assert not failed.status.solved
    path = of_solution(failed, "short of time").save(tmp_path / "failed.rrd")
    tells(static(path, "/summary", "TextDocument:text")[0], "short of time", "infeasible")
    bare = replace(failed, phases=(replace(failed.phases[0], layout=None),))
    with refused("'go'", "solve"):
        of_solution(bare)


def test_samples_are_those_of_the_scheme(cart):
    t, a = scalars(cart, "/plots/a/solution")
    assert np.isclose(a, 1.0, atol=1e-4).any()
    assert (np.diff(t) >= 0).all()
