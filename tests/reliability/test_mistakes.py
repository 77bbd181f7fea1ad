"""Mistakes that people make, and what each says."""

from __future__ import annotations

import copy
import math
import pickle
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, tells, warned
from microbot_ocp import ocp

VIA = np.radians([[0, 0, 0], [20, 60, -30], [-60, 30, 80]])
DEGREES = [[0, 0, 0], [20, 60, -30], [-60, 30, 80]]
SAYS_DEGREES = ("degrees", "np.radians")


@cache
def arm(name: str = "microbot") -> mo.Robot:
    return mo.load_robot(name)


def cart(longest: float = 10.0) -> ocp.OptimalControlProblem:
    """From rest to rest over 1 m by at most 1 m/s^2: 2 s."""
    problem = ocp.OptimalControlProblem("cart")
    phase = problem.phase("move", duration=(0.1, longest))
    x = phase.state("position", initial=0.0, final=1.0, unit="m")
    v = phase.state("velocity", initial=0.0, final=0.0, unit="m/s")
    u = phase.control("force", lower=-1.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.end_cost(phase.duration)
    return problem


@cache
def solution() -> ocp.Solution:
    return ocp.solve(cart(), mesh=10)


def cart_of(acceleration: Callable[..., Any]) -> None:
    phase = ocp.OptimalControlProblem("cart").phase("move", duration=1.0)
    phase.running_cost(acceleration(phase.state("position"), phase.state("velocity")))


def lifted(mass: float) -> mo.Motion:
    """Lift a mass."""
    stops = [mo.Stop(q=VIA[0], payload=mass), mo.Stop(q=VIA[1])]
    return mo.time_optimal(arm().with_limits(tau_max=1e6), stops, mesh=5, time_limit=20)


def still(*rows: list[float]) -> Any:
    return mo.inverse_dynamics(arm())(*rows)


REFUSED: dict[str, tuple[Callable[[], Any], tuple[str, ...]]] = {
    "via points in degrees": (
        lambda: mo.time_optimal(arm(), DEGREES),
        ("via point 2", "'waist'", "1145.92 deg", *SAYS_DEGREES),
    ),
    "a comparison in degrees": (
        lambda: mo.compare(arm(), DEGREES),
        ("via point 2", "'waist'", *SAYS_DEGREES),
    ),
    "values for what makes a function": (
        lambda: mo.forward_kinematics(arm(), [0, 0, 0]),  # type: ignore[arg-type]
        ("function", "forward_kinematics(robot)(q)"),
    ),
    "three of them": (
        lambda: mo.inverse_dynamics(arm(), *np.zeros((3, 3))),  # type: ignore[call-arg]
        ("function", "inverse_dynamics(robot)(q, qd, qdd)"),
    ),
    "symbols for what makes a function": (
        lambda: mo.jacobian(arm(), ca.SX.sym("q", 3)),  # type: ignore[call-arg]
        ("function", "jacobian(robot)(q)"),
    ),
    "a joint too few": (
        lambda: mo.forward_kinematics(arm())([0, 0]),
        ("q of forward_kinematics", "[3]", "[2]"),
    ),
    "poses in rows": (
        lambda: mo.forward_kinematics(arm())(np.zeros((5, 3))),
        ("q of forward_kinematics", "[3, N]", "[5, 3]", "transpose"),
    ),
    "an argument too few": (
        lambda: still([0, 0, 0]),
        ("inverse_dynamics(q, qd, qdd)", "3 arguments", "not 1"),
    ),
    "one of another length": (
        lambda: still([0] * 3, [0] * 2, [0] * 3),
        ("qd of inverse_dynamics", "[3]", "not [2]"),
    ),
    "an unknown argument": (lambda: mo.mass_matrix(arm())(x=[0, 0, 0]), ("mass_matrix(q)", "'x'")),
    "a state for a phase": (
        lambda: solution()["position"],
        ("'position'", "solution['move']['position']"),
    ),
    "a misspelt state": (
        lambda: solution().phases[0]["velocty"],
        ("phase 'move'", "'velocty'", "mean 'velocity'", "'position', 'velocity', 'force'"),
    ),
    "no such state": (
        lambda: solution()["move"]["x"],
        ("phase 'move'", "'x'", "'position', 'velocity', 'force'"),
    ),
    "no such costate": (
        lambda: ocp.verify(cart(), solution()).costates[0]["x"],
        ("costates", "'x'", "'position', 'velocity'"),
    ),
    "via points of another arm": (
        lambda: mo.time_optimal(arm("ur5e"), VIA),
        ("via_q", "[any, 6]", "[3, 3]"),
    ),
    "one via point": (lambda: mo.time_optimal(arm(), VIA[:1]), ("via_q", "2 points", "not 1")),
    "a limit by another name": (
        lambda: arm().with_limits(v_max=1.0),  # type: ignore[call-arg]
        ("'v_max'", "'qd_max'"),
    ),
    "limits for two of three": (
        lambda: arm().with_limits(tau_max=[1, 2]),
        ("tau_max", "[3]", "[2]"),
    ),
    "too weak to hold itself": (
        lambda: mo.time_optimal(arm().with_limits(tau_max=10.0), VIA),
        ("via point 1", "'shoulder'", "196 N m", "-10 to 10 N m"),
    ),
    "no limits": (
        lambda: mo.time_optimal(mo.Robot.from_dh([0, 0], [0, 1], [0, 0]), [[0, 0], [1, 1]]),
        ("'joint 1'", "velocity, acceleration", "without masses"),
    ),
    "a misspelt robot": (lambda: mo.load_robot("microbt"), ("'microbt'", "mean 'microbot'")),
    "a robot in capitals": (lambda: mo.load_robot("UR5e"), ("'UR5e'", "mean 'ur5e'")),
    "a start in degrees": (
        lambda: mo.simulate(arm(), None, [0, 90, 0], t=[0.0, 1.0]),
        ("q0 of shoulder", "90 rad", "[-6.28319, 6.28319] rad", *SAYS_DEGREES),
    ),
    "one time for times": (
        lambda: mo.simulate(arm(), None, [0, 1, 0], t=1.0),
        ("t", "increasing times", "1.0"),
    ),
    "a pose for a position": (
        lambda: mo.solve_ik(arm(), np.eye(4)),
        ("position", "[3]", "[4, 4]", "pose[:3, 3]"),
    ),
    "angles for a rotation": (
        lambda: mo.solve_ik(arm("ur5e"), [0.4, 0.2, 0.3], [180, 0, 0]),
        ("orientation", "[3, 3]", "mo.robot.rotation_of(rpy)"),
    ),
    "a quaternion for a rotation": (
        lambda: mo.solve_ik(arm("ur5e"), [0.4, 0.2, 0.3], [0, 0, 0, 1]),
        ("orientation", "matrix [3, 3]"),
    ),
    "a quantity that a state has not": (
        lambda: mo.time_optimal(
            arm().with_limits(also=[mo.Limit("height", lambda s: s.position[2], upper=9)]), VIA
        ),
        ("limit 'height'", "'position'", "it has q, qd, qdd", "tool_velocity"),
    ),
    "a time after the end": (
        lambda: ocp.solve(cart(), mesh=10).phases[0].sample(99.0),
        ("t", "0 to 2 s", "99 s"),
    ),
    "no such file": (lambda: mo.load_robot("mine.toml"), ("'mine.toml'", "No such file")),
    "a misspelt scheme": (
        lambda: ocp.solve(cart(), scheme="radua"),
        ("scheme", "shooting, radau", "mean 'radau'"),
    ),  # type: ignore[arg-type]
    "a generator of via points": (
        lambda: mo.time_optimal(arm(), (q for q in VIA)),
        ("via_q", "numbers", "a list"),
    ),  # type: ignore[arg-type]
    "a function for via points": (
        lambda: mo.compare(arm(), lambda: VIA),
        ("via_q", "numbers", "call it"),
    ),  # type: ignore[arg-type]
    "nothing for via points": (lambda: mo.time_optimal(arm(), None), ("via_q", "numbers", "None")),  # type: ignore[arg-type]
    "a name for a robot": (
        lambda: mo.time_optimal("microbot", VIA),
        ("robot", "a Robot", "mo.load_robot"),
    ),  # type: ignore[arg-type]
    "a path for a scene": (
        lambda: mo.time_optimal(arm(), VIA, scene="scene.toml"),  # type: ignore[arg-type]
        ("scene", "a Scene", "mo.load_scene"),
    ),
    "a polynomial for a motion": (
        lambda: mo.certify(arm(), mo.cubic(VIA, [0.0, 1.0, 2.0])),  # type: ignore[arg-type]
        ("motion", "a Motion", "mo.Motion.from_polynomial"),
    ),
    "poses for a path": (
        lambda: mo.time_optimal_path(arm(), VIA),
        ("path", "PiecewisePolynomial", "mo.straight_path"),
    ),  # type: ignore[arg-type]
    "one method as text": (
        lambda: mo.compare(arm(), VIA, methods="cubic"),
        ("methods", "list", "'cubic'"),
    ),
    "a misspelt method": (
        lambda: mo.compare(arm(), VIA, methods=["cubik"]),
        ("'cubik'", "mean 'cubic'"),
    ),
    "expressions in a list": (
        lambda: cart().phases[0].running_cost([ca.MX(1), ca.MX(2)]),  # type: ignore[arg-type]
        ("expression", "MX", "ca.vertcat"),
    ),
    "an if about a state": (
        lambda: cart_of(lambda x, v: v if 2 * x > 1 else -v),
        ("(1<(2.*move.position))", "casadi.if_else(condition, a, b)"),
    ),
    "math of a state": (
        lambda: cart_of(lambda x, v: math.sin(v)),
        ("move.velocity", "casadi.sin", "math.sin"),
    ),
    "a state in a list": (
        lambda: cart_of(lambda x, v: v in [x, 1]),
        ("(move.position==move.velocity)", "truth value"),
    ),
    "a speed below zero": (
        lambda: mo.limits.tool_speed(-1),
        ("limit 'tool speed'", "above 0 m/s", "-1"),
    ),
    "a payload in milligrams": (
        lambda: lifted(1e5),
        ("payload", "'stop 1'", "100000 kg", "1000 times", "8 kg", "grams"),
    ),
    "a profile for seven joints": (
        lambda: mo.execution.load_profile("panda").limits_of(arm()),
        ("profile panda", "microbot", "[3]", "[7]"),
    ),
    "times between for times": (lambda: mo.cubic(VIA, [1.0, 1.0]), ("via_t", "[3]", "[2]")),
    "arrays for a motion": (lambda: mo.certify(arm(), VIA), ("motion", "a Motion", "array")),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("mistake", REFUSED)
def test_what_a_mistake_says(mistake: str) -> None:
    make, says = REFUSED[mistake]
    with refused(*says) as caught:
        make()
    assert "\n" not in str(caught.value)


DOUBTFUL: dict[str, tuple[Callable[[], Any], tuple[str, ...]]] = {
    "lengths in millimetres": (
        lambda: mo.Robot.from_dh([0, 1.5, 0], [0, 0, 425], [163, 0, 0]),
        ("robot: a is [0.0, 0.0, 425.0] m", "millimetres"),
    ),
    "a payload in grams": (
        lambda: lifted(3000),
        ("payload", "'stop 1'", "3000 kg", "8 kg", "grams"),
    ),
    "limits in degrees": (
        lambda: arm().with_limits(q_min=-170, q_max=170),
        ("q_max", "170.0] rad;", *SAYS_DEGREES),
    ),
    "speeds in degrees": (
        lambda: arm().with_limits(qd_max=180),
        ("qd_max", "180.0] rad/s;", *SAYS_DEGREES),
    ),
}


@pytest.mark.parametrize("mistake", DOUBTFUL)
def test_what_may_be_a_mistake_is_warned_of(mistake: str) -> None:
    make, says = DOUBTFUL[mistake]
    with warned(*says) as caught:
        make()
    assert {warning.filename for warning in caught} == {__file__}


def test_radians_and_metres_are_warned_of_by_nobody() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mo.Robot.from_dh([0, np.pi / 2, 0], [0, 0, 3], [2, 0, 0])
        arm().with_limits(q_min=-2 * np.pi, q_max=np.inf)


def test_a_name_that_is_none_is_a_key_error_too() -> None:
    with pytest.raises(KeyError):
        solution()["x"]
    with refused("'time_optimum'", "mean 'time_optimal'", error=AttributeError):
        _ = mo.time_optimum  # type: ignore[attr-defined]


def test_a_target_in_millimetres_says_so() -> None:
    answer = mo.solve_ik(arm("ur5e"), [400, 200, 300])
    assert not answer.solved
    tells(answer.advice, "537.457 m", "millimetres")
    assert "millimetres" not in mo.solve_ik(arm("ur5e"), [2.0, 0.0, 0.5]).advice


def test_what_cannot_be_solved_names_explain() -> None:
    assert "explain(" in ocp.solve(cart(longest=1.0), mesh=10).advice


@pytest.mark.thorough
def test_a_failed_verification_names_the_accuracy() -> None:
    problem = ocp.OptimalControlProblem("pendulum")
    phase = problem.phase("swing", duration=3.0)
    angle = phase.state("angle", initial=0.0, final=1.0)
    speed = phase.state("speed", initial=0.0, final=0.0)
    torque = phase.control("torque")
    phase.derivative(angle, speed)
    phase.derivative(speed, torque - 10 * ca.sin(angle))
    phase.running_cost(torque**2)
    coarse = ocp.verify(problem, ocp.solve(problem, mesh=3, scheme="trapezoidal"))
    assert not coarse.ok
    assert "accuracy=1e-6" in coarse.verdict
    fine = ocp.verify(problem, ocp.solve(problem, accuracy=1e-6))
    assert "accuracy=" not in fine.verdict


def test_functions_of_a_robot_are_casadi_functions(tmp_path: Path) -> None:
    pose = mo.forward_kinematics(arm())
    assert isinstance(pose, ca.Function)
    assert pose is mo.forward_kinematics(arm())
    for other in (pickle.loads(pickle.dumps(pose)), copy.copy(pose), pose.map(1), pose.expand()):
        assert float(ca.norm_inf(other([1, 2, 3]) - pose([1, 2, 3]))) == 0.0
    many = np.array(pose(np.zeros((3, 2))))
    assert many.shape == (4, 8)


def test_states_are_expressions_for_numpy_and_casadi_too() -> None:
    phase = ocp.OptimalControlProblem("turn").phase("move", duration=1.0)
    x = phase.state("x", 3)
    for value in (np.dot(np.eye(3), x), np.eye(3) @ x, ca.DM.eye(3) @ x, np.sin(x), x[:2] * 2):
        assert np.abs(ca.Function("value", [x], [value])([0.0] * 3)).max() == 0.0
    assert bool(ca.is_equal(copy.deepcopy(x), x))
