"""Whatever is called with a time limit ends soon after it, with the best so far and its status."""

import inspect
import time

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp._base import deadline
from microbot_ocp.cli import main
from microbot_ocp.planning.free import flat_form
from microbot_ocp.planning.search import _through_stops

ROBOT = mo.load_robot("microbot")
VIA = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
SHAPE = mo.quintic([[0.0, 0.0, 0.0], [0.5, 0.8, 0.4]], [0.0, 30.0])
MANY = np.random.default_rng(0).normal(scale=3.0, size=(2000, 3))
LATE = mo.Status.TIME_LIMIT
GRACE = 3.0  # s, on a loaded machine
LIMITS = {"time_optimal_path": 1e-3, "track": 1e-3}  # s; the others: 0.05
LIMITS |= dict.fromkeys(("shortest_duration", "best_split", "time_path", "phase_plane"), 1e-6)

CALLS = {
    "time_optimal": lambda t: mo.time_optimal(ROBOT, VIA, mesh=30, time_limit=t).status,
    "time_optimal_path": lambda t: (
        mo.time_optimal_path(ROBOT, mo.straight_path(VIA), time_limit=t).status
    ),
    "compare": lambda t: (
        mo.compare(ROBOT, VIA, ["cubic", "time_optimal"], time_limit=t)["time_optimal"].status
    ),
    "time_path": lambda t: mo.planning.time_path(ROBOT, mo.straight_path(VIA), time_limit=t).status,
    "phase_plane": lambda t: (
        mo.planning.phase_plane(ROBOT, mo.straight_path(VIA), time_limit=t).status
    ),
    "shortest_duration": lambda t: mo.shortest_duration(ROBOT, SHAPE, time_limit=t).status,
    "best_split": lambda t: (
        mo.best_split(
            ROBOT, lambda parts: mo.cubic(VIA, np.cumsum([0.0, *parts])), [1.0, 1.0], time_limit=t
        ).status
    ),
    "simulate": lambda t: (
        mo.simulate(ROBOT, q0=[0, 0.5, 0.5], t=np.linspace(0, 3000, 200_001), time_limit=t).status
    ),
    "track": lambda t: mo.track(ROBOT, SHAPE, mo.ComputedTorque(kp=100.0), time_limit=t).status,
    "solve_ik_batch": lambda t: (
        mo.inverse_kinematics.solve_ik_batch(ROBOT, MANY, time_limit=t)[-1][0].status
    ),
    "solve_ik_each": lambda t: (
        mo.inverse_kinematics.solve_ik_each(ROBOT, MANY, time_limit=t)[-1].status
    ),
    "follow_ik": lambda t: mo.follow_ik(ROBOT, MANY, time_limit=t).statuses[-1],
}


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    """What is compiled where there is time for it."""
    mo.time_optimal(ROBOT, VIA, mesh=10, starts=1)
    mo.compare(ROBOT, VIA, ["cubic", "straight_path"], mesh=10)
    mo.TimeOptimalSolver(ROBOT, VIA, mesh=10)()
    mo.follow_ik(ROBOT, MANY[:3])
    mo.inverse_kinematics.solve_ik_each(ROBOT, MANY[:3])
    mo.inverse_kinematics.solve_ik_batch(ROBOT, MANY[:3])


LONGER = ("compare", "time_path", "solve_ik_each", "best_split")  # as others, by other loops


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.thorough if n in LONGER else ()) for n in CALLS],
)
def test_the_limit_is_kept(name):
    begin = time.perf_counter()
    status = CALLS[name](LIMITS.get(name, 0.05))
    assert status is LATE
    assert time.perf_counter() - begin < 0.05 + GRACE


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, "5", None, 1j, [1.0]])
def test_what_is_no_time_is_refused(value):
    with refused("time_limit"):
        mo.solve_ik(ROBOT, [3, -1, 4.5], time_limit=value)


def test_every_solver_call_takes_one():
    solving = [mo.certify, mo.TimeOptimalSolver.__call__, mo.solve_ik, mo.solve_ik_all]
    solving += [mo.ocp.solve, mo.ocp.solve_switching_times]
    rooms = (mo, mo.planning, mo.inverse_kinematics)
    for name in CALLS:
        if name not in ("time_optimal", "compare", "phase_plane"):
            solving.append(next(getattr(room, name) for room in rooms if name in room.__all__))
    for call in solving:
        if call is not mo.time_optimal_path:  # whose settings have it
            assert "time_limit" in inspect.signature(call).parameters, call


@pytest.mark.filterwarnings("ignore::microbot_ocp._base.codegen.NotCompiled")
def test_a_search_that_there_is_no_time_to_prepare_returns_what_needs_none(monkeypatch):
    """The kernels of seven joints take seconds, and a limit may be over before they are made."""
    robot = mo.load_robot("panda")
    via = np.array([[0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.0], [0.5, 0.2, 0.3, -1.5, 0.4, 1.8, 0.6]])

    def late(*arguments, search_of=_through_stops.search_of):
        time.sleep(max(deadline.left(), 0.0))
        return search_of(*arguments)

    monkeypatch.setattr(_through_stops, "search_of", late)
    monkeypatch.setattr(_through_stops, "motion_from", None)
    flat_form.cache_clear()
    motion = mo.time_optimal(robot, via, compiled=False, time_limit=0.5)
    assert motion.status is LATE
    tells(motion.note, mo.Status.TIME_LIMIT.sentence, "every limit")
    assert np.allclose(motion.q[[0, -1]], via)
    assert mo.certify(robot, motion).ok


@pytest.mark.filterwarnings("ignore::microbot_ocp._base.codegen.NotCompiled")
def test_no_other_problem_is_made_where_there_was_no_time_for_torque_rates(monkeypatch):
    robot = ROBOT.with_limits(taud_max=1000.0)
    path = mo.spline(VIA, [0.0, 1.0, 2.0])
    monkeypatch.setattr("microbot_ocp.planning.timing._places_timing.program_of", None)
    motion = mo.time_optimal_path(robot, path, time_limit=1e-3)
    assert motion.status is LATE
    tells(motion.note, "torque rate")
    assert motion.duration == motion.provenance["reachability_duration"]


def test_a_prepared_solver_keeps_its_limit_and_goes_on():
    solver = mo.TimeOptimalSolver(ROBOT, VIA, mesh=10)
    assert solver(time_limit=1e-3).status is LATE
    assert solver().solved


@pytest.mark.thorough
def test_a_simulation_that_is_stopped_has_what_it_reached():
    t = np.linspace(0, 80_000, 800_000)  # takes twenty times the last of the limits
    for limit in (0.1, 0.4, 1.6):  # a loaded machine reaches nothing in the first
        stopped = mo.simulate(ROBOT, q0=[0, 0.5, 0.5], t=t, time_limit=limit)
        known = np.isfinite(stopped.q).all(axis=1)
        reached = int(known.sum())
        if reached > 200:
            break
    assert stopped.status is LATE
    tells(stopped.advice, str(LATE))
    assert 200 < reached < known.size
    assert known[:reached].all()
    whole = mo.simulate(ROBOT, q0=[0, 0.5, 0.5], t=stopped.t[:200])
    assert np.allclose(whole.q, stopped.q[:200], atol=1e-6)


def test_limits_nest():
    with deadline.within(100.0):
        outer = deadline.until()
        with deadline.within(1000.0):
            assert deadline.until() == outer
        with deadline.within(1.0):
            assert deadline.left() <= 1.0
        assert deadline.until() == outer
    assert deadline.until() == np.inf


def test_a_busy_machine_does_not_shorten_the_default_limit():
    with mo.planning.TimeOptimalSettings().within(5.0) as begin:
        assert deadline.left() <= 5.0 < deadline.until() - time.perf_counter()
        assert begin.busy == ""
        with deadline.within(1e-3, work=5.0) as inner:
            time.sleep(2e-3)
            assert deadline.over()
            tells(inner.busy, "wall time", "processor")
        with deadline.within(5.0, work=1e-9) as inner:
            assert deadline.over()
            assert inner.busy == ""
    with mo.planning.TimeOptimalSettings(time_limit=1.0).within(5.0):
        assert deadline.until() - time.perf_counter() <= 1.0


def test_the_command_line_says_so(capsys):
    options = ["--via-deg", "0,0,0 -90,90,90", "--time-limit", "0.05", "--json"]
    assert main(["time-optimal", "microbot", *options]) == 1
    assert '"status": "time limit"' in capsys.readouterr().out
