"""What is public refuses arguments of the wrong type by a sentence that names them."""

import subprocess
import sys

import casadi as ca
import numpy as np
import pytest
from border_calls import _deep, declared, public

import microbot_ocp as mo
from microbot_ocp._base.border import checking
from microbot_ocp.scene import clearances

ROBOT = mo.load_robot("microbot")
VIA = [[0, 0, 0], [1, 1, 1]]


def solvable():
    return declared()["problem"]


def phase_of(*inner):
    problem = mo.ocp.OptimalControlProblem("a")
    phase = problem.phase("b", 1.0, interior_points=np.array(inner) if inner else None)
    phase.state("x")
    return phase


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: mo.certify(3, 4), "robot must be a Robot, not 3"),
        (lambda: mo.time_optimal(ROBOT, VIA, settings=4), "settings must be a TimeOptimalSettings"),
        (lambda: mo.time_optimal(ROBOT, VIA, progress=1), "progress must be a function or None"),
        (lambda: mo.forward_kinematics([1]), "robot must be a Robot"),
        (lambda: mo.motion.Mark("a", "b"), "time must be a number, not 'a'"),
        (lambda: mo.load_robot(None), "robot must be one of"),
        (lambda: mo.solve_ik(ROBOT, np.array([1j, 0, 0])), "position must be an array of numbers"),
        (lambda: ROBOT.with_limits(qd_max=1j), "qd_max must be"),
        (lambda: mo.cubic(VIA, [0.0, 1 + 0j]), "via_t must be an array of numbers"),
        (lambda: mo.planning.TimeOptimalSettings(compiled="no"), "compiled must be True or False"),
        (lambda: mo.ocp.solve(ROBOT), "problem must be an OptimalControlProblem"),
        (lambda: clearances(ROBOT, iter([1]), VIA), "pairs must be a list, each entry a Pair"),
        (lambda: clearances(ROBOT, (), np.zeros((2, 3, 4))), "q must have shape [any, 3]"),
        (lambda: mo.ocp.explain(solvable(), 5, max_iterations=-1), "max_iterations must be at"),
        (lambda: mo.ocp.SolverSettings(max_iterations=10**12), "max_iterations must be at most"),
        (lambda: mo.limits.power(_deep()), "upper bound of limit 'power' must be an array"),
        (lambda: mo.trajectories.first_splits([0.0, 1.0]), "via_q must have shape [any, any]"),
        (lambda: mo.cubic(np.ma.masked_equal(VIA, 1), [0, 1]), "via_q must be an array of numbers"),
        (lambda: mo.compare(ROBOT, np.tile(VIA, (251, 1))), "via_q must have at most 500 points"),
        (lambda: mo.time_optimal(ROBOT, [[0, 0, 0], [0, 9e-7, 0]]), "9e-07 rad (m) apart"),
        (lambda: mo.time_optimal(ROBOT, np.array(3), duration=9.0), "via_q must be stops or poses"),
        (lambda: mo.ocp.SolverSettings(solver=()), "solver must name at least one solver"),
        (lambda: mo.Circle(ca.SX.sym("s")), "through must have shape [3]"),
        (lambda: mo.ocp.SolverSettings(gap=np.ones(2)), "gap must be a number"),
        (lambda: ROBOT.position_text(0, np.ones(2)), "value must be a number"),
        (lambda: phase_of("a"), "interior_points must be a list, each entry a number"),
        (
            lambda: mo.execution.differing_plants(ROBOT, payload=1.0),
            "must be a list of 2, each entry a number",
        ),
        (lambda: phase_of().derivative([1, 2], 0.0), "derivative needs a state of phase 'b'"),
    ],
)
def test_the_sentence_names_the_argument(call, words):
    with pytest.raises(mo.InputError) as caught:
        call()
    assert words in str(caught.value)


def test_python_refuses_what_does_not_fit_the_signature():
    with pytest.raises(TypeError, match="unexpected keyword argument 'nothing'"):
        mo.solve_ik(ROBOT, [3, -1, 4.5], nothing=1)


def test_every_function_of_the_pages_checks_its_arguments():
    functions = {
        name: thing for name, thing in public().items() if name.rpartition(".")[2].islower()
    }
    unchecked = {name for name, thing in functions.items() if not hasattr(thing, "_is_checked")}
    assert len(functions) > 100
    assert unchecked == set()


def test_a_fault_of_ours_stays_what_it_is():
    def broken(robot: mo.Robot, scale: float) -> float:
        return robot.nothing * scale  # type: ignore[attr-defined]

    checked = checking(broken)
    with pytest.raises(AttributeError, match="nothing") as caught:
        checked(ROBOT, 1.0)
    assert caught.traceback[1].name == "broken"
    with pytest.raises(mo.InputError, match="scale must be a number, not 'a'"):
        checked(ROBOT, "a")


def test_names_stay_what_they_are():
    import pickle

    assert pickle.loads(pickle.dumps(mo.time_optimal)) is mo.time_optimal
    assert mo.certify.__module__ == "microbot_ocp.certificate"
    assert mo.fast_call.cache_info().maxsize


@pytest.mark.parametrize(
    ("code", "sentence"),
    [
        ("from microbot_ocp.motion._motion import Mark; Mark('soon', 3)", "time must be a number"),
        ("from microbot_ocp.robot._links import Link; Link('a', mass='b')", "mass must be a"),
        (
            "from microbot_ocp.robot._dynamics import mass_matrix; mass_matrix('ur5e')",
            "robot must be a Robot, not 'ur5e'; mo.load_robot(name_or_path) makes one",
        ),
        (
            "import microbot_ocp as mo; "
            "mo.ocp.OptimalControlProblem('a').phase('b', duration=1.0).parameter('c', 'text')",
            "value must be an array of numbers, not 'text'",
        ),
    ],
)
def test_checks_apply_from_the_definition_on_whatever_was_asked_for_before(code, sentence):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "InputError: " in done.stderr
    assert sentence in done.stderr.splitlines()[-1]
