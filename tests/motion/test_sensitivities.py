"""Slopes of the duration by multipliers against central differences of whole solves."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, sampled, sampled_rows, tells
from microbot_ocp import ocp
from microbot_ocp.limits import LimitFamily
from microbot_ocp.planning.free import initial_guesses, phase_names, polynomial, transcription
from microbot_ocp.planning.task import multipliers_of

VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])


@pytest.fixture(scope="module")
def solver():
    """On one mesh for all numbers: what differs between two solves is the numbers alone."""
    return mo.TimeOptimalSolver(mo.load_robot("microbot"), VIA_Q, rounds=0)


def difference(low, high, step):
    return (high.duration - low.duration) / (2.0 * step)


@pytest.fixture(scope="module")
def program():
    """The free motion on one mesh, solved as exactly as it goes: its cost, with the smoothing."""
    robot = mo.load_robot("microbot")
    kernels = transcription(robot, VIA_Q.tobytes(), len(VIA_Q), True)
    exact = ocp.SolverSettings("ipopt", tolerance=1e-10, max_iterations=300)
    solver = ocp.ParametricSolver(kernels, 40, exact)
    guess = next(iter(initial_guesses(LimitFamily.of(robot), VIA_Q, phase_names(2), 1, 0)))
    return robot, solver, solver.solve(guess=guess.guesses)


@pytest.mark.parametrize(
    ("key", "name", "joint"),
    sampled_rows([("tau", "torque", 2), ("tau", "torque", 1), ("qd", "qd", 0)], 3),
)
def test_of_limits(program, key, name, joint):
    robot, solver, solution = program
    lower, upper = robot.limits.bounds(key)
    found, step = multipliers_of(solution, LimitFamily.of(robot)), 0.002 * upper[joint]
    assert found is not None
    for side, bounds in (("lower", (1.0, 0.0)), ("upper", (0.0, 1.0))):
        costs = []
        for change in np.eye(3)[joint] * step * np.array([[-1.0], [1.0]]):
            pair = lower + bounds[0] * change, upper + bounds[1] * change
            given = {f"phase {k}": {name: pair} for k in (1, 2)}
            costs.append(solver.solve(bounds=given, guess=solution).cost)
        slope = (costs[1] - costs[0]) / (2.0 * step)
        assert found[side][key][joint] == pytest.approx(slope, rel=0.01, abs=1e-7)


@pytest.mark.parametrize("joint", sampled(range(3), 3))
def test_of_via_points(program, joint):
    robot, solver, solution = program
    found, step = multipliers_of(solution, LimitFamily.of(robot)), 1e-3
    assert found is not None
    for point in range(3):
        costs = []
        for change in np.eye(3)[joint] * step * np.array([[-1.0], [1.0]]):
            when = {"final": "phase 2"} if point == 2 else {"initial": f"phase {point + 1}"}
            given = {w: {phase: {"q": VIA_Q[point] + change}} for w, phase in when.items()}
            costs.append(solver.solve(**given, guess=solution).cost)
        slope = (costs[1] - costs[0]) / (2.0 * step)
        assert found["via"][point][joint] == pytest.approx(slope, rel=0.01, abs=1e-5)


@pytest.mark.thorough
def test_of_the_payload(solver):
    slopes = solver(payload=0.5).sensitivities(solver.robot, 0.5)
    step = 0.01
    found = difference(solver(payload=0.5 - step), solver(payload=0.5 + step), step)
    assert slopes.payload_mass == pytest.approx(found, rel=0.01)


@pytest.mark.thorough
@pytest.mark.slow
def test_of_the_place_of_the_payload():
    robot, step = mo.load_robot("microbot"), 0.2
    via = VIA_Q[[0, 2]]

    def motion(along: float) -> mo.Motion:
        held = robot.with_payload(1.0, [along, 0.0, 0.0])
        return mo.TimeOptimalSolver(held, via, tolerance=1e-8)()

    slopes = motion(0.0).sensitivities(robot, 1.0)
    found = difference(motion(-step), motion(step), step)
    assert slopes.payload_place[0] == pytest.approx(found, rel=0.02)


def test_the_table_and_the_bars(solver):
    slopes = solver().sensitivities(solver.robot)
    table = slopes.table()
    assert table.rows[0][0] == "torque of elbow, upper"
    tells(table.notes[0], "kg at the tool", "ms")
    assert len(slopes.plot()[0].patches) == len(table.rows)
    sure = {row[0] for row in table.rows if row[4] == "yes"}
    assert sure == slopes.binding
    # of a limit that nothing of the motion comes near to a barrier still says something
    assert not {"velocity of shoulder, lower"} & slopes.binding


@pytest.mark.thorough
def test_where_more_digits_are_asked_for_the_smoothing_costs_fewer():
    """A wrist whose torque saves little, but whose jerks the smoothing feels: slopes were 6 %
    off.
    """
    via = [[0.16, -2.44, -2.91], [0.05, 2.54, -1.35], [0.58, -1.55, -0.72], [-0.74, -1.27, 2.23]]
    robot, step = mo.load_robot("planar_3r"), np.array([0.0, 0.0, 0.1])
    solver = mo.TimeOptimalSolver(robot, via, mesh=40, starts=2, rounds=0, tolerance=1e-8)
    slopes, least = solver().sensitivities(robot), robot.limits.tau_min
    low, high = (
        sum(solver(robot.limits.changed({"tau_min": bound})).provenance["phase_durations"])
        for bound in (least - step, least + step)
    )
    assert slopes.lower["tau"][2] == pytest.approx((high - low) / 0.2, rel=0.01)
    assert {"torque of wrist, lower", "torque of elbow, lower"} <= slopes.binding
    roughly = mo.TimeOptimalSolver(robot, via, mesh=40, starts=2, rounds=0)
    assert not {"torque of wrist, lower"} & roughly().sensitivities(robot).binding


def test_torques_and_masses_together_change_nothing(program):
    """Twice the torques and twice the masses: the same motion."""
    robot, _, solution = program
    motion = replace(
        mo.Motion.from_polynomial(robot, polynomial(solution), label="free"),
        provenance={"multipliers": multipliers_of(solution, LimitFamily.of(robot))},
    )
    slopes, rows = motion.sensitivities(robot), motion.provenance["multipliers"]["rows"]["tau"]
    tau = robot.torques_along(*motion.sample(np.array(rows["t"])))["tau"]
    masses = float((np.array(rows["slopes"]) * tau).sum())
    lower, upper = robot.limits.bounds("tau")
    torques = float(slopes.lower["tau"] @ lower + slopes.upper["tau"] @ upper)
    assert abs(masses) > 0.1
    assert masses + torques == pytest.approx(0.0, abs=1e-6 * motion.duration)


@pytest.mark.thorough
@pytest.mark.slow
def test_of_a_payload_under_limits_of_the_torque_rate_and_the_power():
    """Slopes of all that a payload changes count, not of torques alone."""
    robot = mo.load_robot("microbot").with_limits(
        taud_max=3000.0, also=[mo.limits.power(upper=[200.0, 300.0, 100.0])]
    )
    solver = mo.TimeOptimalSolver(robot, VIA_Q[[0, 2]], mesh=30, starts=1, rounds=0, tolerance=1e-8)
    slopes, step = solver(payload=0.5).sensitivities(robot, 0.5), 0.02
    found = difference(solver(payload=0.5 - step), solver(payload=0.5 + step), step)
    assert slopes.payload_mass == pytest.approx(found, rel=0.02)


@pytest.mark.thorough
def test_along_a_line(solver):
    line = solver.along("payload", [0.0, 0.02, 0.04])
    steps = np.diff(line.duration) / 0.02
    means = 0.5 * (line.slope[1:] + line.slope[:-1])
    assert steps == pytest.approx(means, rel=0.02)
    assert line.changes.tolist() == [False, *(a != b for a, b in pairwise(line.binding))]
    reserve = solver.along("reserve", [0.0, 0.02], joint=2)
    torque = solver.along("tau_max", [200.0, 196.0], joint=2)
    assert reserve.duration == pytest.approx(torque.duration, rel=1e-6)
    assert reserve.slope == pytest.approx(-200.0 * torque.slope, rel=1e-6)
    assert torque.table().rows[0][0] == 200.0
    assert len(line.plot()[0].lines) >= 3
    with refused("name", "payload", "'mass'"):
        solver.along("mass", [1.0])
    with refused("payload 1000", "via point 1", "at rest"):
        solver.along("payload", [0.02, 1000.0])


def test_multipliers_are_saved_with_the_motion(solver, tmp_path):
    motion = solver()
    loaded = mo.Motion.load(motion.save(tmp_path / "motion.npz"))
    first, second = (each.sensitivities(solver.robot) for each in (motion, loaded))
    assert first.payload_mass == second.payload_mass
    np.testing.assert_array_equal(first.via, second.via)


def test_motions_without_multipliers(solver, microbot):
    shape = mo.Motion.from_polynomial(microbot, mo.cubic(VIA_Q, [0, 1, 2]), label="cubic")
    with refused("motion", "no multipliers"):
        shape.sensitivities(microbot)
    with refused("motion", "3 joints", "robot has 6"):
        solver().sensitivities(mo.load_robot("ur5e"))
