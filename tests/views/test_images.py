"""Figures pixel by pixel against stored pictures, so that no change of looks goes unseen.

The data are closed forms, or have one optimum only, and nothing shown depends on the machine. After
a wanted change: ``python -m pytest tests/views/test_images.py -n 0
--mpl-generate-path=tests/views/baseline``, and look at each new picture before it is kept.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

import microbot_ocp as mo
from limits.test_limit_history import bang_cruise_bang
from microbot_ocp import ocp
from microbot_ocp.motion import Outcome
from microbot_ocp.tasks import Comparison
from planning.shared import slider

MADE_WITH = "3.11"  # 3.10 sets text and layout otherwise: 21 to 39 grey levels RMS away
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not matplotlib.__version__.startswith(f"{MADE_WITH}."),
        reason=f"the pictures are those of matplotlib {MADE_WITH}, not {matplotlib.__version__}",
    ),
]
DPI = 50
TOLERANCE = 2.0  # grey levels RMS: rounding of edges, far less than one moved line
pictured = pytest.mark.mpl_image_compare(
    style="default", tolerance=TOLERANCE, savefig_kwargs={"dpi": DPI}, deterministic=True
)


def motion_of(comparison: Comparison, name: str) -> mo.Motion:
    motion = comparison[name].motion
    assert motion is not None
    return motion


@pictured
def test_comparison_with_a_failed_method(comparison: Comparison) -> Figure:
    return mo.plots.comparison(comparison).figure


@pytest.mark.thorough
@pictured
def test_paths(comparison: Comparison) -> Figure:
    return mo.plots.paths(comparison).figure


@pictured
def test_saturation(comparison: Comparison) -> Figure:
    return mo.plots.figure_of(mo.plots.saturation(comparison))


@pictured
def test_limit_use(comparison: Comparison) -> Figure:
    return mo.plots.limit_use(comparison.robot, motion_of(comparison, "time_optimal")).figure


@pictured
def test_limit_use_of_a_slider_at_its_limits() -> Figure:
    robot = slider(tau_max=4.0, qd_max=1.0)
    motion = mo.Motion.from_polynomial(robot, bang_cruise_bang(), label="bang, cruise, bang")
    return mo.plots.limit_use(robot, motion).figure


@pytest.mark.thorough
@pictured
def test_motion_that_was_not_solved(comparison: Comparison) -> Figure:
    motion = motion_of(comparison, "cubic")
    failed = replace(motion, outcome=Outcome.of(mo.Status.ITERATION_LIMIT))
    return failed.plot(comparison.robot).figure


@pictured
def test_one_joint_with_its_via_points(comparison: Comparison) -> Figure:
    motion = motion_of(comparison, "cubic_report")
    times = np.array([mark.time for mark in motion.marks])
    return mo.plots.curves(
        comparison.robot,
        [mo.plots.Curve.of(motion), mo.plots.Curve.of(motion_of(comparison, "cubic"))],
        ("q", "qd", "qdd", "tau"),
        joints=[1],
        limits=comparison.limits,
        via=(times, comparison.via_q),
        title="shoulder",
    ).figure


@pytest.mark.thorough
@pictured
def test_seven_joints() -> Figure:
    robot = mo.load_robot("panda")
    middle = 0.5 * (robot.limits.q_min + robot.limits.q_max)
    shape = mo.cubic([middle, middle + 0.3], [0.0, 1.0])
    return mo.Motion.from_polynomial(robot, shape, label="cubic", step=0.02).plot(robot).figure


@pictured
def test_phase_plane(comparison: Comparison) -> Figure:
    path = mo.straight_path(comparison.via_q)
    axes = mo.plots.phase_plane(comparison.robot, path, unit="rad")
    return mo.plots.figure_of(axes)


@pytest.mark.thorough
@pictured
def test_solution_of_the_least_effort() -> Figure:
    """From rest to rest in 1 s: u = 6 - 12 t."""
    problem = mo.OptimalControlProblem("least effort")
    phase: Any = problem.phase("only", duration=1.0)
    x = phase.state("x", initial=0.0, final=1.0, unit="m")
    v = phase.state("v", initial=0.0, final=0.0, unit="m/s", upper=1.6)
    u = phase.control("u", lower=-7.0, upper=7.0, shape="linear", unit="m/s^2")
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.running_cost(u**2)
    return mo.plots.solution(ocp.solve(problem, mesh=20), title="least effort").figure


@pictured
def test_arms(comparison: Comparison) -> Figure:
    poses = {f"via {k + 1}": q for k, q in enumerate(comparison.via_q)}
    axes = mo.plots.arms(comparison.robot, poses)
    return mo.plots.figure_of(axes)
