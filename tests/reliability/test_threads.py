"""Everything public answers from several threads as it does from one, to the bit."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp import ocp
from microbot_ocp._base import deadline
from microbot_ocp._base.codegen import compiles, interpreted
from microbot_ocp.inverse_kinematics import solve_ik_batch, solve_ik_each
from microbot_ocp.robot import Shape
from microbot_ocp.tasks import time_effort_front

THREADS, CALLS = 3, 36
VIA = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])


@cache
def robot() -> mo.Robot:
    return mo.load_robot("microbot")


@cache
def with_rates() -> mo.Robot:
    return robot().with_limits(taud_max=[2000.0, 2500.0, 1000.0])


def ends(k: int) -> np.ndarray:
    return np.array([[0.0, 0.1, 0.2], [0.5 + 0.1 * k, 0.6, -0.4 + 0.2 * k]])


def halved(k: int) -> np.ndarray:
    return np.vstack([ends(k)[0], [0.2, 0.5, 0.1 * k], ends(k)[1]])


def path(k: int) -> mo.motion.PiecewisePolynomial:
    return mo.cubic(halved(k), [0.0, 1.0, 2.0])


@cache
def scene() -> mo.Scene:
    return mo.Scene([mo.Sphere([0.9, 0.6, 0.4], 0.2)], 0.02, self_collision=False)


@cache
def motion() -> mo.Motion:
    return mo.time_optimal_path(robot(), path(1))


@cache
def prepared() -> mo.TimeOptimalSolver:
    return mo.TimeOptimalSolver(robot(), VIA, mesh=12)


def double_integrator(
    duration: tuple[float, float] = (0.1, 10.0), drag: float = 0.1
) -> ocp.OptimalControlProblem:
    problem = ocp.OptimalControlProblem("double integrator")
    phase = problem.phase("move", duration=duration)
    x = phase.state("x", initial=0.0, final=1.0)
    v = phase.state("v", initial=0.0, final=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    mass = phase.parameter("mass", 1.0)
    phase.derivative(x, v)
    phase.derivative(v, u / mass - drag * v**3)
    phase.end_cost(phase.duration)
    return problem


@cache
def parametric() -> ocp.ParametricSolver:
    return ocp.ParametricSolver(double_integrator(), mesh=20)


def with_mass(solver: ocp.ParametricSolver, k: int) -> np.ndarray:
    return solver.solve(parameters={"move": {"mass": 1.0 + 0.1 * k}}).variables


@cache
def torque() -> Callable[..., Any]:
    return mo.fast_call(mo.inverse_dynamics(robot()))


def problem_of(k: int) -> Any:
    return ocp.solve(double_integrator(), mesh=10 + k).variables


def simulated(k: int) -> Any:
    found = mo.simulate(robot(), q0=ends(k)[0], qd0=np.zeros(3), tau=np.zeros(3), t=[0.0, 0.1, 0.2])
    return found.q, found.qd


def tracked(k: int) -> Any:
    found = mo.track(robot(), motion(), mo.ComputedTorque(50.0 + k), step=0.02)
    return found.q


@cache
def stops() -> list[mo.Stop]:
    return [mo.Stop(q=ends(1)[0]), mo.Stop(q=[0.3, 0.4, 0.0], payload=0.2), mo.Stop(q=ends(1)[1])]


@cache
def through_stops() -> mo.Motion:
    return mo.time_optimal(robot(), stops(), mesh=12, starts=1)


def certified_segments(k: int) -> Any:
    limits = mo.Limits(qd_max=1.0 + 0.1 * k)
    found = mo.certify(robot(), through_stops(), limits, via_q=stops())
    return [check.utilisation for check in found.limit_checks], found.defect


def poses(k: int) -> np.ndarray:
    return np.linspace(reachable(k), reachable(k) - [0.0, 0.0, 0.05], 4)


def histories(k: int) -> Any:
    found = mo.limits.limit_history(robot().with_payload(0.1 * k), motion())
    return list(found.use.values())


def capsules(k: int) -> Any:
    shape = Shape(1, np.eye(4), "box", np.array([0.1, 0.2, 0.3 + 0.1 * k]))
    found = mo.fit_capsules(replace(robot(), shapes=(shape,)))
    return [(c.start, c.end, c.radius) for row in found.values() for c in row]


def read(k: int) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        mo.save_robot(robot().with_payload(0.1 * k), f"{folder}/arm.urdf")
        again = mo.load_robot(f"{folder}/arm.urdf")
    return again.a, again.d, [link.mass for link in again.links]


def verified(k: int) -> Any:
    problem = double_integrator()
    verdict = ocp.verify(problem, ocp.solve(problem, mesh=10 + k)).verdict
    return np.frombuffer(verdict.encode(), np.uint8)


def explained(k: int) -> Any:
    problem = double_integrator(duration=(0.1, 1.5 + 0.1 * k))
    return [row.amount for row in ocp.explain(problem, 10).gives]


def refined(k: int) -> Any:
    return ocp.solve(double_integrator(drag=0.1 * k), 20, accuracy=1e-6).variables


def split(k: int) -> Any:
    best = mo.best_split(robot(), lambda d: mo.cubic(halved(k), [0.0, *np.cumsum(d)]), [1.0, 1.0])
    return best.duration, best.polynomial.coefficients


def switching(k: int) -> Any:
    found = ocp.solve_switching_times(double_integrator(drag=0.1 + 0.1 * k))
    assert found.status.solved
    return found.junctions[0].time, found.state_error


def arrays_of(answer: Any) -> bytes:
    """The bits of an answer; a motion's are its samples."""
    if isinstance(answer, mo.Motion):
        return arrays_of((answer.t, answer.q, answer.qd, answer.qdd, answer.tau))
    if isinstance(answer, tuple | list):
        return b"|".join(map(arrays_of, answer))
    return np.asarray(answer, dtype=float).tobytes()


def certified(k: int) -> Any:
    found = mo.certify(robot().with_payload(0.1 * k), motion())
    return found.final_position_error, found.defect


def written(k: int) -> Any:
    text = mo.robot.closed_form(robot().with_payload(0.1 * k)).text("c")
    return np.frombuffer(text.encode(), np.uint8)


def reachable(k: int) -> np.ndarray:
    pose = np.array(mo.forward_kinematics(robot())(ends(k)[1]))
    return pose[:3, 3]


def far(k: int) -> np.ndarray:
    return np.array([2.0 + 0.1 * k, 1.0, 3.0])


QUICK: dict[str, Callable[[int], Any]] = {
    "fast_call": lambda k: torque()(ends(k), 0.1 * ends(k), ends(k)),
    "solve_ik": lambda k: mo.solve_ik(robot(), reachable(k)).q,
    "solve_ik, out of reach": lambda k: mo.solve_ik(robot(), far(k)).q,
    "solve_ik_all": lambda k: [s.q for s in mo.solve_ik_all(robot(), reachable(k))],
    "follow_ik": lambda k: (
        mo.follow_ik(robot(), np.linspace(reachable(k), reachable(k) - [0.0, 0.0, 0.05], 5)).q
    ),
    "time_path": lambda k: mo.planning.time_path(robot(), path(k)).duration,
    "time_optimal_path": lambda k: mo.time_optimal_path(robot(), path(k)),
    "phase_plane": lambda k: mo.planning.phase_plane(robot(), path(k)).duration,
    "shortest_duration": lambda k: (
        mo.shortest_duration(robot(), lambda t: mo.cubic(ends(k), [0.0, t])).duration
    ),
    "certify": certified,
    "closed_form": written,
    "simulate": simulated,
    "clearance": lambda k: (
        mo.clearance(robot(), mo.time_optimal_path(robot(), path(k)), scene()).minimum
    ),
    "TimeOptimalSolver": lambda k: prepared()(payload=0.1 * k),
    "ParametricSolver": lambda k: with_mass(parametric(), k),
}
SLOW: dict[str, Callable[[int], Any]] = {
    "solve_ik_batch": lambda k: [s.q for row in solve_ik_batch(robot(), poses(k)) for s in row],
    "solve_ik_each": lambda k: [s.q for s in solve_ik_each(robot(), poses(k))],
    "best_split": split,
    "certify, stops": certified_segments,
    "limit_history": histories,
    "fit_capsules": capsules,
    "load_urdf": read,
    "time_effort_front": lambda k: [
        p.effort for p in time_effort_front(robot(), ends(k), slacks=(0.1,), mesh=12).points
    ],
    "ocp.solve": problem_of,
    "ocp.verify": verified,
    "ocp.explain": explained,
    "ocp.solve to an accuracy": refined,
    "ocp.solve_switching_times": switching,
    "time_optimal": lambda k: mo.time_optimal(robot(), ends(k), mesh=12, starts=2),
    "time_optimal, stops": lambda k: mo.time_optimal(
        robot(),
        [mo.Stop(q=ends(k)[0]), mo.Stop(q=[0.3, 0.4, 0.0], velocity="rest"), mo.Stop(q=ends(k)[1])],
        mesh=12,
        starts=1,
    ),
    "time_optimal, scene": lambda k: mo.time_optimal(robot(), ends(k), scene=scene()),
    "time_optimal_path, torque rates": lambda k: mo.time_optimal_path(
        with_rates(), mo.cubic(ends(k), [0.0, 1.0])
    ),
    "compare": lambda k: mo.compare(robot(), ends(k), ["straight_path"]).motions["straight_path"],
    "track": tracked,
}  # fmt: skip


def from_threads(call: Callable[[int], Any], calls: int = CALLS, different: int = 4) -> int:
    """How many of several calls have other bits from threads than one after the other."""
    cases, streams = [number % different for number in range(calls)], (sys.stdout, sys.stderr)
    with ThreadPoolExecutor(THREADS) as pool:
        found = list(pool.map(lambda k: arrays_of(call(k)), cases))
    assert (sys.stdout, sys.stderr) == streams
    expected = [arrays_of(call(k)) for k in range(different)]
    return sum(bits != expected[k] for bits, k in zip(found, cases, strict=True))


LONGER = ("certify", "shortest_duration", "TimeOptimalSolver")
# By the same code as a case beside it.
ALIKE = ("solve_ik, out of reach", "follow_ik", "phase_plane")
MARKS = dict.fromkeys([*LONGER, *ALIKE], pytest.mark.thorough)
MARKS["clearance"] = pytest.mark.skipif(find_spec("coal") is None, reason="no coal")


@pytest.mark.parametrize("name", [pytest.param(n, marks=MARKS.get(n, ())) for n in QUICK])
def test_threads_get_the_answers_of_one(name):
    assert from_threads(QUICK[name], 3 if name in LONGER else 6, different=2) == 0


@pytest.mark.thorough
@pytest.mark.parametrize("name", [*QUICK, *SLOW])
def test_many_calls_from_threads_get_the_answers_of_one(name):
    assert from_threads((QUICK | SLOW)[name]) == 0


@pytest.mark.parametrize(
    "copied",
    [
        copy.deepcopy,
        pytest.param(copy.copy, marks=pytest.mark.thorough),
        pytest.param(lambda x: pickle.loads(pickle.dumps(x)), marks=pytest.mark.thorough),
    ],
)
def test_copies_of_prepared_solvers_give_the_same_bits(copied):
    prepared()(), with_mass(parametric(), 0)
    for solver, call in ((prepared(), lambda s: s(payload=0.5)), (parametric(), partial_mass)):
        assert arrays_of(call(copied(solver))) == arrays_of(call(solver))


@pytest.mark.thorough
@pytest.mark.slow
def test_prepared_solvers_sent_to_another_process_give_the_same_bits():
    prepared()()
    calls = {with_payload: prepared(), partial_mass: parametric()}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        for call, solver in calls.items():
            assert arrays_of(pool.submit(call, solver).result()) == arrays_of(call(solver))


def with_payload(solver: mo.TimeOptimalSolver) -> mo.Motion:
    return solver(payload=0.5)


def partial_mass(solver: ocp.ParametricSolver) -> np.ndarray:
    return with_mass(solver, 3)


def test_a_prepared_answer_does_not_depend_on_what_was_asked_before():
    first, second = (ocp.ParametricSolver(double_integrator(), mesh=10) for _ in range(2))
    with_mass(first, 1)
    assert arrays_of(with_mass(first, 3)) == arrays_of(with_mass(second, 3))


@pytest.mark.skipif(mo.compiler() is None, reason="no C compiler")
def test_limits_of_time_and_of_compilers_are_those_of_a_thread():
    with deadline.within(1e-3), interpreted(), ThreadPoolExecutor(1) as pool:
        assert pool.submit(deadline.left).result() == np.inf
        assert pool.submit(compiles).result() != compiles()
