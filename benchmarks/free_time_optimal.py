"""Fastest motion through a via point: ours against rockit with IPOPT.

Every repetition runs in its own process; the time from the robot to the solution counts, with the
building of the problem, without imports. Both have one starting guess, one mesh of 100 intervals
per phase, torque limits at both ends of every interval, and IPOPT's default tolerances. rockit
holds the acceleration constant over an interval, ours is linear in time and reaches the same
optimum on 20 intervals. With its defaults, ours also tries several starts and refines the mesh.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np

import microbot_ocp as mo
from benchmarks.measure import Benchmark, in_fresh_process

GOAL = 10.0
MESH = 100
VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
LIKE_FOR_LIKE = {"mesh": MESH, "starts": 1, "limit_tolerance": 1.0}  # one guess, no refinement


def rockit_duration(robot: mo.Robot, *, guess_by_rockit: bool = False) -> float:
    """Solve two stages with free durations by multiple shooting; return the duration, s.

    The states are q and qd, torques come from inverse dynamics. The expanded graph halves the time
    of the solver. rockit's own ``set_initial`` takes longer than the solver, so by default the
    guess is given to the transcribed problem directly.
    """
    import casadi as ca
    from rockit import FreeTime, MultipleShooting, Ocp

    torque, limits, count = mo.inverse_dynamics(robot), robot.limits, robot.joint_count
    ocp = Ocp()
    stages = []
    for start, end in pairwise(VIA_Q):
        stage = ocp.stage(t0=0, T=FreeTime(1.0))
        q, qd, qdd = stage.state(count), stage.state(count), stage.control(count)
        stage.set_der(q, qd)
        stage.set_der(qd, qdd)
        for quantity, value in (("q", q), ("qd", qd)):
            lower, upper = limits.bounds(quantity)
            stage.subject_to(lower <= (value <= upper))
        lower, upper = limits.bounds("tau")
        at_start, at_end = torque(q, qd, qdd), torque(stage.next(q), stage.next(qd), qdd)
        for tau in (at_start, at_end):
            stage.subject_to(lower <= (tau <= upper), include_last=False)
        stage.subject_to(stage.at_t0(q) == start)
        stage.subject_to(stage.at_tf(q) == end)
        stage.subject_to(stage.T >= 0.01)
        stage.add_objective(stage.T)
        stage.method(MultipleShooting(N=MESH, M=1, intg="rk"))
        guess = np.linspace(start, end, MESH + 1).T, np.tile((end - start)[:, None], MESH + 1)
        if guess_by_rockit:
            stage.set_initial(q, guess[0])
            stage.set_initial(qd, guess[1])
        stages.append((stage, q, qd, np.vstack(guess)))
    (first, _, first_qd, _), (second, _, second_qd, _) = stages
    ocp.subject_to(first.at_t0(first_qd) == 0)
    ocp.subject_to(first.at_tf(first_qd) == second.at_t0(second_qd))
    ocp.subject_to(second.at_tf(second_qd) == 0)
    ocp.solver("ipopt", {"expand": True, "print_time": False, "ipopt.print_level": 0})
    if not guess_by_rockit:
        ocp.transcribe()
        for stage, q, qd, guess in stages:
            _, sampled = stage.sample(ca.vertcat(q, qd), grid="control")
            ca.Opti.set_initial(ocp._method.opti, sampled, guess)
    solution = ocp.solve()
    return sum(float(solution.value(stage.T)) for stage, *_ in stages)


def our_duration(robot: mo.Robot, **settings: float) -> float:
    """Solve by :func:`microbot_ocp.time_optimal`; return the duration, s."""
    return mo.time_optimal(robot, VIA_Q, **settings).duration


WAYS: dict[str, Callable[[mo.Robot], float]] = {
    "rockit": rockit_duration,
    "rockit, its own set_initial": partial(rockit_duration, guess_by_rockit=True),
    "time_optimal, one start": partial(our_duration, **LIKE_FOR_LIKE),
    "time_optimal, one start, no compiler": partial(
        our_duration, **LIKE_FOR_LIKE | {"compiled": False}
    ),
    "time_optimal, one start, 20 intervals": partial(our_duration, **LIKE_FOR_LIKE | {"mesh": 20}),
    "time_optimal as it comes": partial(our_duration, mesh=MESH),
}
EMPTY_CACHE = ", nothing compiled before"


def child(way: str) -> None:
    """Time one method in this fresh process and print the result."""
    import casadi as ca

    if way.startswith("rockit"):
        import rockit  # noqa: F401  imports are not part of the time
    for solver in ("ipopt", "fatrop"):  # loading a solver counts as an import
        ca.load_nlpsol(solver)
    assert callable(mo.time_optimal)  # the first access imports it, which does not count
    begin = time.perf_counter()
    duration = WAYS[way](mo.load_robot("microbot"))
    print(json.dumps({"seconds": time.perf_counter() - begin, "duration": duration}))


def seconds_of(name: str, cache: str, durations: dict[str, float]) -> float:
    """Return the time of a method, s; store the duration of its motion in ``durations``."""
    with tempfile.TemporaryDirectory() as empty:
        folder = empty if name.endswith(EMPTY_CACHE) else cache
        answer = in_fresh_process(__name__, [name.removesuffix(EMPTY_CACHE)], folder)
    durations[name] = answer["duration"]
    return answer["seconds"]


def run(repetitions: int = 0) -> None:
    """Run few fresh processes in turns, because each takes seconds."""
    names = list(WAYS)[1:]
    names.insert(2, "time_optimal, one start" + EMPTY_CACHE)
    names.append("time_optimal as it comes" + EMPTY_CACHE)
    durations: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as cache:
        ways = {name: partial(seconds_of, name, cache, durations) for name in names}
        Benchmark(
            f"Free time-optimal motion, 2 phases of {MESH} intervals, fresh processes",
            ("rockit", partial(seconds_of, "rockit", cache, durations)),
            ways,
            {"time_optimal, one start": GOAL, "time_optimal, one start" + EMPTY_CACHE: GOAL},
        ).run(repetitions or 5)
    print("  optima: " + ", ".join(f"{name} {found:.4f} s" for name, found in durations.items()))


if __name__ == "__main__":
    child(sys.argv[1])
