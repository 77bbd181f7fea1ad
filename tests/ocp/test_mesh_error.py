"""State errors by re-integration, and meshes that become as fine as an accuracy asks for."""

import json

import casadi as ca
import numpy as np
import pytest

from microbot_ocp.checks import InputError
from microbot_ocp.ocp.mesh_error import (
    RefinementStatus,
    Switch,
    divide,
    find_switches,
    move_to_switches,
    solve_refined,
    state_errors,
)
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.reintegration import each_interval, mesh_states, open_loop
from microbot_ocp.ocp.schemes import SCHEMES
from microbot_ocp.ocp.solvers import SolverSettings, solve
from microbot_ocp.ocp.transcription import Transcription
from microbot_ocp.ocp.verification import verify
from ocp.textbook import bryson_denham, double_integrator, through_half_way

FINE = SolverSettings("ipopt", tolerance=1e-10)
by_every_scheme = pytest.mark.parametrize("scheme", SCHEMES)


def oscillator():
    """Van der Pol's oscillator brought to rest, without bounds that act."""
    problem = OptimalControlProblem("oscillator")
    phase = problem.phase("calm", 4.0)
    x = phase.state("x", 2, initial=[0.0, 1.0])
    u = phase.control("u", lower=-2.0, upper=2.0, shape="linear")
    phase.derivative(x, ca.vertcat((1 - x[1] ** 2) * x[0] - x[1] + u, x[0]))
    phase.running_cost(ca.sumsqr(x) + u**2)
    return problem


def pendulum():
    """The shortest swing up with a torque of less than the weight, one switch."""
    problem = OptimalControlProblem("pendulum")
    phase = problem.phase("swing", (0.5, 10.0))
    q = phase.state("q", initial=0.0, final=np.pi, unit="rad")
    w = phase.state("w", initial=0.0, final=0.0, scale=3.0, unit="rad/s")
    u = phase.control("u", lower=-2.0, upper=2.0, unit="1/s^2")
    phase.derivative(q, w)
    phase.derivative(w, u - ca.sin(q))
    phase.end_cost(phase.duration)
    return problem


# the estimate -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scheme", "order"), [("shooting", 4), ("trapezoidal", 2), ("hermite_simpson", 4)]
)
def test_local_errors_go_with_the_order_of_the_scheme(scheme, order):
    meshes = np.array([16, 32, 64])
    transcription = Transcription(oscillator(), scheme=scheme)
    errors = [state_errors(solve(transcription, int(n), settings=FINE))[0].max() for n in meshes]
    slope = np.polyfit(np.log(1 / meshes), np.log(errors), 1)[0]
    assert slope == pytest.approx(order + 1, abs=0.6)


@by_every_scheme
def test_what_a_scheme_integrates_exactly_has_no_error(scheme):
    solution = solve(double_integrator(), 10, scheme=scheme, settings=FINE)
    assert state_errors(solution)[0].max() < 1e-9
    arrived, status = open_loop(solution["move"])
    assert status == "ok"
    np.testing.assert_allclose(arrived, mesh_states(solution["move"])[1:], atol=1e-9)


def test_dynamics_that_break_down_are_a_status_and_an_infinite_error():
    problem = OptimalControlProblem("root")
    phase = problem.phase("down", 1.0)
    x = phase.state("x", initial=1.0, final=0.3)
    u = phase.control("u", shape="linear")
    phase.derivative(x, u)
    phase.running_cost(u**2)
    solution = solve(problem, 4, settings=FINE)
    phase.derivative(x, u + 1e-3 * ca.sqrt(x - 0.5))
    _, status = each_interval(solution["down"])
    assert status.startswith("the integrator failed: ")
    assert np.isinf(state_errors(solution)[0]).all()


# meshes -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "order", "pieces"),
    [(1e-7, 4, 1), (1e-6, 4, 2), (1e-5, 4, 2), (1e-4, 4, 3), (1e-4, 2, 6), (1.0, 2, 6)],
)
def test_an_interval_is_divided_as_the_order_predicts(error, order, pieces):
    mesh = divide(np.array([0.0, 0.5, 1.0]), np.array([error, 2e-6]), 1e-6, order)
    np.testing.assert_allclose(mesh[: pieces + 1], np.linspace(0, 0.5, pieces + 1))
    assert mesh.size == pieces + 3


def test_a_mesh_that_is_good_enough_stays():
    mesh = np.array([0.0, 0.3, 1.0])
    np.testing.assert_array_equal(divide(mesh, np.array([9e-7, 1e-9]), 1e-6, 4), mesh)


def test_an_infinite_error_is_divided_as_far_as_allowed():
    assert divide(np.array([0.0, 0.5, 1.0]), np.array([np.inf, 0.0]), 1e-6, 4).size == 8


@by_every_scheme
def test_the_switch_inside_an_interval_is_where_its_value_says(scheme):
    """On 5 intervals the third holds the switch in its middle, at the value zero."""
    phase = solve(double_integrator(), 5, scheme=scheme, settings=FINE)["move"]
    (switch,) = find_switches(phase)
    assert (switch.begin, switch.end) == pytest.approx((0.4, 0.6))
    assert switch.place == pytest.approx(0.5, abs=1e-6)
    assert not switch.rising
    assert switch.offset == pytest.approx(0.1, abs=1e-6)


def test_a_switch_at_a_mesh_point_is_no_way_off():
    (switch,) = find_switches(solve(double_integrator(), 6, settings=FINE)["move"])
    assert switch.place == switch.begin == switch.end == pytest.approx(0.5)
    assert switch.offset == 0.0


def test_the_nearest_point_moves_to_a_switch_unless_it_is_taken_and_others_gather():
    mesh = np.linspace(0, 1, 6)

    def at(place, begin, end, continuous=False):
        offset = (end - begin) / 2 if continuous else np.abs(mesh - place).min()
        return Switch("u", 0, place, begin, end, True, continuous, offset)

    moved = move_to_switches(mesh, [at(0.45, 0.4, 0.6)], 1e-3)
    np.testing.assert_allclose(moved, [0, 0.2, 0.435, 0.45, 0.465, 0.6, 0.8, 1])
    held = move_to_switches(mesh, [at(0.4, 0.4, 0.4), at(0.45, 0.4, 0.6)], 1e-3)
    np.testing.assert_allclose(held, [0, 0.2, 0.4, 0.445, 0.45, 0.455, 0.6, 0.8, 1])
    early = move_to_switches(mesh, [at(0.05, 0.0, 0.2)], 1e-3)
    np.testing.assert_allclose(early, [0, 0.045, 0.05, 0.055, 0.2, 0.4, 0.6, 0.8, 1])
    ramp = move_to_switches(mesh, [at(0.5, 0.2, 0.8, continuous=True)], 1e-3)
    np.testing.assert_allclose(ramp, [0, 0.2, 0.425, 0.575, 0.8, 1])
    near = move_to_switches(mesh, [at(0.4005, 0.4, 0.6)], 1e-3)
    np.testing.assert_array_equal(near, mesh)


# refinement ---------------------------------------------------------------------------------------


@by_every_scheme
def test_the_accuracy_is_reached_and_the_errors_fall(scheme):
    refined = solve_refined(oscillator(), 1e-6, mesh=10, scheme=scheme)
    assert refined.status is RefinementStatus.REACHED
    assert "reached" in refined.advice
    errors = [step.state_error for step in refined.history]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 1e-6 >= errors[-1]
    assert refined.history[-1].intervals[0] == refined.solution["calm"].mesh.size - 1 > 10
    assert refined.history[-1].cost == refined.solution.cost
    assert max(e.max() for e in state_errors(refined.solution)) == errors[-1]
    assert refined.solution.cost == pytest.approx(COST, rel=1e-3)
    certificate = verify(oscillator(), refined.solution)
    assert certificate.ok, certificate.verdict
    assert certificate.resimulations[0].error < 1e-3


COST = solve(oscillator(), 200, settings=FINE).cost


@by_every_scheme
def test_a_mesh_point_moves_to_the_switch(scheme):
    refined = solve_refined(pendulum(), 1e-6, mesh=11, scheme=scheme)
    assert refined.status is RefinementStatus.REACHED
    (switch,) = refined.history[-1].switches[0]
    mesh = refined.solution["swing"].mesh
    assert np.abs(mesh - switch.place).min() <= 1e-3
    before = refined.history[0]
    assert before.switch_offset > 0.01
    assert refined.history[-1].switch_offset <= 1e-3
    assert refined.solution.cost == pytest.approx(2.56664, abs=2e-4)
    assert refined.solution.cost < before.cost + 1e-4 or scheme == "trapezoidal"


def test_points_gather_at_the_ramp_of_a_continuous_control():
    refined = solve_refined(double_integrator("linear"), 1e-6, mesh=10)
    assert refined.status is RefinementStatus.REACHED
    costs = [step.cost for step in refined.history]
    offsets = [step.switch_offset for step in refined.history]
    assert costs == sorted(costs, reverse=True)
    assert offsets == sorted(offsets, reverse=True)
    mesh = refined.solution["move"].mesh
    assert np.count_nonzero(np.abs(mesh - 0.5) < 0.05) > 3
    assert mesh.size < 20
    assert refined.solution.cost == pytest.approx(2.0, abs=2e-6)


def test_every_phase_has_its_own_mesh():
    refined = solve_refined(through_half_way(("x", "v")), mesh=[4, 7], switch_accuracy=1e-4)
    assert refined.status is RefinementStatus.REACHED
    assert refined.solution.duration == pytest.approx(0.5 + np.sqrt(1.5), abs=1e-5)
    assert refined.history[-1].intervals[0] == 4


def test_a_certificate_follows_a_refinement():
    settings = SolverSettings("ipopt")
    refined = solve_refined(pendulum(), 1e-7, 11, settings=settings, switch_accuracy=1e-5)
    certificate = verify(pendulum(), refined.solution)
    assert certificate.ok, certificate.verdict
    hamiltonian = certificate.hamiltonian("swing")
    assert hamiltonian.mean == pytest.approx(-1.0, abs=1e-5)
    assert hamiltonian.drift < 0.01
    assert [(a.name, a.side) for a in certificate.arcs] == [("u", "upper"), ("u", "lower")]


def test_what_is_not_reached_is_said():
    late = solve_refined(oscillator(), 1e-6, mesh=10, scheme="trapezoidal", rounds=1)
    assert late.status is RefinementStatus.ROUND_LIMIT
    assert len(late.history) == 2
    large = solve_refined(oscillator(), 1e-6, mesh=10, scheme="trapezoidal", most_intervals=30)
    assert large.status is RefinementStatus.SIZE_LIMIT
    assert large.solution.status.ok
    settings = SolverSettings("ipopt", max_iterations=2)
    broken = solve_refined(bryson_denham(1 / 9), mesh=10, settings=settings)
    assert broken.status is RefinementStatus.NOT_SOLVED
    assert not broken.status.ok
    for refined in (late, large, broken):
        assert refined.advice == refined.status.value


def test_a_finer_mesh_that_is_not_accepted_ends_the_refinement(monkeypatch):
    from microbot_ocp.ocp import refinement

    monkeypatch.setattr(refinement.Refiner, "finer", lambda self, before, meshes: before)
    refined = solve_refined(oscillator(), 1e-6, mesh=10)
    assert refined.status is RefinementStatus.NOT_ACCEPTED
    assert len(refined.history) == 1


def test_the_history_is_plain_values_and_progress_is_told():
    lines = []
    refined = solve_refined(oscillator(), 1e-4, mesh=10, progress=lines.append)
    stored = json.loads(json.dumps([step.as_dict() for step in refined.history]))
    assert stored[0]["intervals"] == [10]
    assert stored[0]["status"] == "solved"
    assert any("state error" in line for line in lines)


@pytest.mark.parametrize("accuracy", [0.0, -1.0, np.nan, "fine"])
def test_a_bad_accuracy_is_refused(accuracy, no_solver):
    with pytest.raises(InputError, match="accuracy"):
        solve_refined(oscillator(), accuracy)
