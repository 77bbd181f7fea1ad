"""Ctrl-C at any instant: an answer says that it was interrupted, or there is none."""

import os
import signal
import threading
import time
from functools import cache, partial

import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp import ocp
from microbot_ocp.ocp import Status
from ocp.textbook import double_integrator

VIA = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
STOPS = [mo.Stop(q=VIA[0]), mo.Stop(position=[3.0, 1.0, 4.0]), mo.Stop(q=VIA[2])]
QUICK = {"mesh": 20, "starts": 2}


def robot():
    return mo.load_robot("microbot")


@cache
def solved():
    problem = double_integrator()
    return problem, ocp.solve(problem)


@cache
def planned():
    return mo.time_optimal(robot(), VIA, **QUICK)


@cache
def prepared():
    return mo.planning.TimeOptimalSolver(robot(), VIA, mesh=20)


@cache
def too_narrow():
    problem = double_integrator()
    (phase,) = problem.phases
    phase.constraint("narrow", phase.states[0].symbol[0], upper=0.01)
    return problem


def rated_path():
    limits = robot().with_limits(taud_max=4000.0).limits
    return mo.time_optimal_path(robot(), mo.quintic(VIA, [0.0, 2.0, 4.0]), limits)


def many_poses():
    return tuple(mo.solve_ik_all(robot(), [3.0, y, 4.0]) for y in np.linspace(-1.0, 1.0, 60))


CALLS = {
    "free motion": lambda: mo.time_optimal(robot(), VIA, **QUICK),
    "front": lambda: mo.tasks.time_effort_front(robot(), VIA, slacks=[0.02, 0.1], **QUICK),
    "problem": lambda: ocp.solve(double_integrator(), accuracy=1e-6),
    "path": rated_path,
    "stops": lambda: mo.time_optimal(robot(), STOPS, **QUICK),
    "comparison": lambda: mo.compare(robot(), VIA, **QUICK),
    "prepared": lambda: prepared()(via_q=VIA),
    "certificate": lambda: mo.certify(robot(), planned(), via_q=VIA),
    "verification": lambda: ocp.verify(*solved()),
    "explanation": lambda: ocp.explain(too_narrow(), 20),
    "poses": many_poses,
}
HERE = ("problem", "prepared", "explanation")


@pytest.fixture(autouse=True)
def listening():
    """Take SIGINT as a terminal's program does: what runs in the background ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupted(call, after):
    """Return what a call answers that gets SIGINT so many seconds later, or None where it raises.

    The other value tells whether there was a signal before it was done.
    """
    lock, done, sent = threading.Lock(), [], []

    def send():
        with lock:
            if not done:
                sent.append(after)
                os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(after, send)
    try:
        timer.start()
        answer = call()
        with lock:
            done.append(True)
        return answer, bool(sent)
    except KeyboardInterrupt:
        return None, True
    finally:
        timer.cancel()
        timer.join()


def check(name, ratios, least):
    call = CALLS[name]
    call()  # compiled by then
    begin = time.perf_counter()
    assert getattr(call(), "status", None) is not Status.INTERRUPTED
    seconds, signals = time.perf_counter() - begin, 0
    for ratio in ratios:
        answer, was_sent = interrupted(call, ratio * seconds)
        signals += was_sent
        if was_sent and answer is not None:
            assert answer.status is Status.INTERRUPTED
            assert not answer.solved
    assert signals >= least
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert getattr(call(), "status", None) is not Status.INTERRUPTED  # the next one is as before


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=pytest.mark.thorough if n in ("explanation", "problem") else ())
        for n in HERE
    ],
)
def test_no_answer_passes_for_a_whole_one(name):
    check(name, [0.3, 0.7], least=1)


@pytest.mark.thorough
@pytest.mark.parametrize("name", CALLS)
def test_no_answer_passes_for_a_whole_one_at_twenty_instants(name):
    check(name, np.linspace(0.02, 0.97, 20), least=10)


@pytest.mark.parametrize("method", [ocp.solve, partial(ocp.solve, accuracy=1e-6)])
def test_a_progress_function_that_stops_one_solve_stops_all(method):
    seen = []

    def stop(step):
        seen.append(step)
        raise KeyboardInterrupt

    solution = method(double_integrator(), progress=stop)
    assert solution.status is Status.INTERRUPTED
    assert len(seen) == 1
