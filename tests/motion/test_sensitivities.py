"""Slopes of the duration by multipliers against central differences of whole solves."""

from __future__ import annotations

import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp import ocp
from microbot_ocp.limits import LimitFamily
from microbot_ocp.planning.free import initial_guesses, phase_names, transcription
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
    ("key", "name", "joint"), [("tau", "torque", 2), ("tau", "torque", 1), ("qd", "qd", 0)]
)
def test_of_limits(program, key, name, joint):
    robot, solver, solution = program
    lower, upper = robot.limits.bounds(key)
    found, step = multipliers_of(solution), 0.002 * upper[joint]
    assert found is not None
    for side, bounds in (("lower", (1.0, 0.0)), ("upper", (0.0, 1.0))):
        costs = []
        for change in np.eye(3)[joint] * step * np.array([[-1.0], [1.0]]):
            pair = lower + bounds[0] * change, upper + bounds[1] * change
            given = {f"phase {k}": {name: pair} for k in (1, 2)}
            costs.append(solver.solve(bounds=given, guess=solution).cost)
        slope = (costs[1] - costs[0]) / (2.0 * step)
        assert found[side][key][joint] == pytest.approx(slope, rel=0.01, abs=1e-7)


@pytest.mark.parametrize("joint", range(3))
def test_of_via_points(program, joint):
    _, solver, solution = program
    found, step = multipliers_of(solution), 1e-3
    assert found is not None
    for point in range(3):
        costs = []
        for change in np.eye(3)[joint] * step * np.array([[-1.0], [1.0]]):
            when = {"final": "phase 2"} if point == 2 else {"initial": f"phase {point + 1}"}
            given = {w: {phase: {"q": VIA_Q[point] + change}} for w, phase in when.items()}
            costs.append(solver.solve(**given, guess=solution).cost)
        slope = (costs[1] - costs[0]) / (2.0 * step)
        assert found["via"][point][joint] == pytest.approx(slope, rel=0.01, abs=1e-5)


def test_of_the_payload(solver):
    slopes = solver(payload=0.5).sensitivities(solver.robot, 0.5)
    step = 0.01
    found = difference(solver(payload=0.5 - step), solver(payload=0.5 + step), step)
    assert slopes.payload_mass == pytest.approx(found, rel=0.01)


@pytest.mark.thorough
@pytest.mark.slow
def test_of_the_place_of_the_payload():
    robot, step = mo.load_robot("microbot"), 0.02
    via = VIA_Q[[0, 2]]

    def motion(along: float) -> mo.Motion:
        held = robot.with_payload(1.0, [along, 0.0, 0.0])
        return mo.TimeOptimalSolver(held, via, rounds=0)()

    slopes = motion(0.0).sensitivities(robot, 1.0)
    found = difference(motion(-step), motion(step), step)
    assert slopes.payload_place[0] == pytest.approx(found, rel=0.02)


def test_the_table_and_the_bars(solver):
    slopes = solver().sensitivities(solver.robot)
    table = slopes.table()
    assert table.rows[0][0] == "torque of elbow, upper"
    assert "one more kg at the tool costs" in table.notes[0]
    assert len(slopes.plot()[0].patches) == len(table.rows)


def test_multipliers_are_saved_with_the_motion(solver, tmp_path):
    motion = solver()
    loaded = mo.Motion.load(motion.save(tmp_path / "motion.npz"))
    first, second = (each.sensitivities(solver.robot) for each in (motion, loaded))
    assert first.payload_mass == second.payload_mass
    np.testing.assert_array_equal(first.via, second.via)


def test_motions_without_multipliers(solver, microbot):
    shape = mo.Motion.from_polynomial(microbot, mo.cubic(VIA_Q, [0, 1, 2]), label="cubic")
    with pytest.raises(mo.InputError, match="motion has no multipliers"):
        shape.sensitivities(microbot)
    with pytest.raises(mo.InputError, match="motion has 3 joints, but the robot has 6"):
        solver().sensitivities(mo.load_robot("ur5e"))
