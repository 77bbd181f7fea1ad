"""Compiled functions in problems and limits: what they were made of is differentiated."""

import subprocess

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, sampled
from microbot_ocp import ocp
from microbot_ocp._base.codegen import compile_function

needs_compiler = pytest.mark.skipif(mo.compiler() is None, reason="no C compiler")
ROBOT = mo.load_robot("microbot")
GOAL = np.radians([-90.0, 90.0, 90.0])


def arm(dynamics):
    """Rest to rest of an arm, its forward dynamics in whatever form."""
    problem = ocp.OptimalControlProblem("arm")
    phase = problem.phase("move", 2.0)
    q, qd = (phase.state(n, 3, initial=np.zeros(3), final=e) for n, e in (("q", GOAL), ("qd", 0.0)))
    tau = phase.control("tau", 3, scale=100.0)
    phase.derivative(q, qd)
    phase.derivative(qd, dynamics(q, qd, tau))
    phase.running_cost(1e-4 * ca.sumsqr(tau))
    return problem


def in_a_function(dynamics):
    given = [ca.MX.sym(name, 3) for name in ("q", "qd", "tau")]
    return ca.Function("mine", given, [dynamics(*given)])


FORMS = {
    "itself": lambda f: f,
    "in a function": in_a_function,
    "in a function of one": lambda f: in_a_function(in_a_function(f)),
    "mapped": lambda f: lambda *given: f.map(2)(*(ca.repmat(k, 1, 2) for k in given))[:, 1],
    "of its own result": lambda f: lambda q, qd, tau: f(q, qd, tau + 1e-6 * f(q, qd, tau)),
}


@needs_compiler
@pytest.mark.parametrize("form", sampled(FORMS, 4))
def test_compiled_dynamics_are_solved_as_the_others(form):
    solutions = [
        ocp.solve(
            arm(FORMS[form](mo.forward_dynamics(ROBOT, compiled=compiled))),
            6,
            settings=ocp.SolverSettings("ipopt", max_iterations=20, gap=np.inf),
        )
        for compiled in (False, True)
    ]
    assert np.isfinite(solutions[0].cost)
    assert solutions[1].cost == pytest.approx(solutions[0].cost, rel=1e-6)
    assert len(solutions[1].attempts) == len(solutions[0].attempts)


@needs_compiler
def test_any_compiled_function_is_taken_by_its_origin_everywhere():
    x = ca.SX.sym("x")
    spring = compile_function(ca.Function("spring", [x], [ca.sin(x) * x]))
    assert spring.class_name() == "External"
    problem = ocp.OptimalControlProblem("springs")
    phase = problem.phase("a", 1.0)
    y, u = phase.state("y", initial=0.1), phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(y, u - spring(y))
    phase.constraint("force", spring(y), upper=1.0)
    phase.running_cost(spring(u) ** 2)
    phase.end_cost(spring(y - 1.0))
    phase.end_constraint("end", spring(y), lower=0.01)
    phase.point_constraint("start", spring(y), upper=0.5, at=0.0)
    assert ocp.solve(problem, 6).solved


@pytest.mark.thorough
@needs_compiler
def test_a_limit_may_call_a_compiled_function():
    speed = mo.jacobian(ROBOT, compiled=True)
    limit = mo.Limit("tool", lambda k: ca.norm_2(speed(k.q)[:3, :] @ k.qd), upper=5.0)
    motion = mo.time_optimal_path(
        ROBOT.with_limits(also=[limit]), mo.straight_path([np.zeros(3), GOAL])
    )
    assert motion.solved
    named = ROBOT.with_limits(also=[mo.limits.tool_speed(upper=5.0)])
    again = mo.time_optimal_path(named, mo.straight_path([np.zeros(3), GOAL]))
    assert motion.duration == pytest.approx(again.duration, rel=1e-3)


class Sine(ca.Callback):
    def __init__(self):
        ca.Callback.__init__(self)
        self.construct("sine", {})

    def eval(self, arguments):
        return [ca.sin(arguments[0])]


def external(folder, *derivatives, **options):
    x = ca.SX.sym("x")
    function = ca.Function("spring", [x], [ca.sin(x) * x])
    generator = ca.CodeGenerator("spring.c")
    for each in (function, *(make(function) for make in derivatives)):
        generator.add(each)
    generator.generate(f"{folder}/")
    library = folder / "spring.so"
    subprocess.run(
        ["cc", "-shared", "-fPIC", "-o", library, folder / "spring.c", "-lm"], check=True
    )
    return ca.external("spring", str(library), options)


def first_derivatives(folder):
    makers = (lambda f: f.forward(1), lambda f: f.reverse(1), lambda f: f.jacobian())
    return external(folder, *makers)


FOREIGN = {
    "a library": external,
    "with first derivatives": first_derivatives,
    "in Python": lambda _: Sine(),
    "in a function": lambda folder: in_one(external(folder)),
}


def in_one(function):
    x = ca.MX.sym("x")
    return ca.Function("mine", [x], [2.0 * function(x)])


def mass(function, where="dynamics"):
    problem = ocp.OptimalControlProblem("spring")
    phase = problem.phase("a", 2.0)
    x, v = phase.state("x", initial=0.0, final=1.0), phase.state("v", initial=0.0, final=0.0)
    u = phase.control("u")
    phase.derivative(x, v)
    phase.derivative(v, u - (function(x) if where == "dynamics" else 0.0))
    phase.running_cost(u**2 + (function(x) if where == "cost" else 0.0))
    return problem


@needs_compiler
@pytest.mark.parametrize("where", ["dynamics", "cost"])
@pytest.mark.parametrize("kind", FOREIGN)
def test_what_has_none_is_refused_before_a_solver_starts(kind, where, tmp_path, no_solver):
    function = FOREIGN[kind](tmp_path)
    with refused("phase 'a'", "second derivatives", "enable_fd"):
        ocp.solve(mass(function, where), 5)


@pytest.mark.thorough
@needs_compiler
def test_what_has_them_by_differences_is_solved(tmp_path):
    solution = ocp.solve(mass(external(tmp_path, enable_fd=True)), 8)
    exact = ocp.solve(mass(lambda x: ca.sin(x) * x), 8)
    assert solution.cost == pytest.approx(exact.cost, rel=1e-5)
