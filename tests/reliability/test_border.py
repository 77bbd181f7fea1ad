"""What is public refuses arguments of the wrong type by a sentence that names them."""

import subprocess
import sys

import casadi as ca
import numpy as np
import pytest
from border_calls import _deep, declared, public

import microbot_ocp as mo
from helpers import refused, tells
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
    ("call", "said"),
    [
        (lambda: mo.certify(3, 4), ("robot", "a Robot", "not 3")),
        (
            lambda: mo.time_optimal(ROBOT, VIA, settings=4),
            ("settings", "TimeOptimalSettings", "not 4"),
        ),
        (lambda: mo.time_optimal(ROBOT, VIA, progress=1), ("progress", "function", "not 1")),
        (lambda: mo.forward_kinematics([1]), ("robot", "a Robot", "[1]")),
        (lambda: mo.motion.Mark("a", "b"), ("time", "number", "'a'")),
        (lambda: mo.load_robot(None), ("robot", "microbot, panda", "'None'")),
        (lambda: mo.solve_ik(ROBOT, np.array([1j, 0, 0])), ("position", "numbers", "1.j")),
        (lambda: ROBOT.with_limits(qd_max=1j), ("qd_max", "numbers", "1j")),
        (lambda: mo.cubic(VIA, [0.0, 1 + 0j]), ("via_t", "numbers", "(1+0j)")),
        (
            lambda: mo.planning.TimeOptimalSettings(compiled="no"),
            ("compiled", "True or False", "'no'"),
        ),
        (lambda: mo.ocp.solve(ROBOT), ("problem", "OptimalControlProblem", "Robot")),
        (lambda: clearances(ROBOT, iter([1]), VIA), ("pairs", "a list", "a Pair")),
        (lambda: clearances(ROBOT, (), np.zeros((2, 3, 4))), ("q", "[any, 3]", "[2, 3, 4]")),
        (
            lambda: mo.ocp.explain(solvable(), 5, max_iterations=-1),
            ("max_iterations", "at least 0", "-1"),
        ),
        (
            lambda: mo.ocp.SolverSettings(max_iterations=10**12),
            ("max_iterations", "1e+09", "1000000000000"),
        ),
        (lambda: mo.limits.power(_deep()), ("upper bound", "limit 'power'", "numbers")),
        (lambda: mo.trajectories.first_splits([0.0, 1.0]), ("via_q", "[any, any]", "[2]")),
        (
            lambda: mo.cubic(np.ma.masked_equal(VIA, 1), [0, 1]),
            ("via_q", "numbers", "masked_array"),
        ),
        (lambda: mo.compare(ROBOT, np.tile(VIA, (251, 1))), ("via_q", "500 points", "502")),
        (
            lambda: mo.time_optimal(ROBOT, [[0, 0, 0], [0, 9e-7, 0]]),
            ("via points 1 and 2", "9e-07 rad", "1e-06"),
        ),
        (lambda: mo.time_optimal(ROBOT, np.array(3), duration=9.0), ("via_q", "stops or poses")),
        (lambda: mo.ocp.SolverSettings(solver=()), ("solver", "at least one", "'auto'")),
        (lambda: mo.Circle(ca.SX.sym("s")), ("through", "[3]", "[]")),
        (lambda: mo.ocp.SolverSettings(gap=np.ones(2)), ("gap", "a number", "[1., 1.]")),
        (lambda: ROBOT.position_text(0, np.ones(2)), ("value", "a number", "[1., 1.]")),
        (lambda: phase_of("a"), ("interior_points", "a list", "'a'")),
        (
            lambda: mo.execution.differing_plants(ROBOT, payload=1.0),
            ("payload", "list of 2", "1.0"),
        ),
        (lambda: phase_of().derivative([1, 2], 0.0), ("derivative", "phase 'b'", "[1, 2]")),
    ],
)
def test_the_sentence_names_the_argument(call, said):
    with refused(*said):
        call()


def test_python_refuses_what_does_not_fit_the_signature():
    with refused("solve_ik()", "'nothing'", error=TypeError):
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
    with refused("scale", "number", "'a'"):
        checked(ROBOT, "a")


def test_names_stay_what_they_are():
    import pickle

    assert pickle.loads(pickle.dumps(mo.time_optimal)) is mo.time_optimal
    assert mo.certify.__module__ == "microbot_ocp.certificate"
    assert mo.fast_call.cache_info().maxsize


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (
            "from microbot_ocp.motion._motion import Mark; Mark('soon', 3)",
            ("time", "number", "'soon'"),
        ),
        (
            "from microbot_ocp.robot._links import Link; Link('a', mass='b')",
            ("mass", "number", "'a'"),
        ),
        (
            "from microbot_ocp.robot._dynamics import mass_matrix; mass_matrix('ur5e')",
            ("robot", "a Robot", "'ur5e'", "mo.load_robot"),
        ),
        (
            "import microbot_ocp as mo; "
            "mo.ocp.OptimalControlProblem('a').phase('b', duration=1.0).parameter('c', 'text')",
            ("value", "numbers", "'text'"),
        ),
    ],
)
def test_checks_apply_from_the_definition_on_whatever_was_asked_for_before(code, said):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    tells(done.stderr.splitlines()[-1], "InputError: ", *said)
