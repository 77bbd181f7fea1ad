"""One phase an arc: where arcs meet, against closed forms."""

from dataclasses import replace
from math import sqrt
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from external.published_problems import PROBLEMS
from microbot_ocp import ocp
from microbot_ocp.ocp.arcs import distance, hold, place_junctions
from microbot_ocp.ocp.problem import OptimalControlProblem, with_shapes
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solution import Status
from microbot_ocp.ocp.solvers import SolverSettings, solve_on
from microbot_ocp.ocp.transcription.schemes import SCHEMES
from ocp.textbook import bryson_denham, double_integrator, oscillator, solved_to

FINE = SolverSettings("ipopt", tolerance=1e-10)
BY_NAME = {problem.name: problem for problem in PROBLEMS}


def along(top_speed: float = np.inf, *, growing: bool = False) -> OptimalControlProblem:
    """5 m from rest to rest in the shortest time; |u| <= 1, which may grow with the time."""
    problem = OptimalControlProblem("along")
    phase = problem.phase("move", (0.1, 10.0))
    x = phase.state("x", initial=0.0, final=5.0)
    v = phase.state("v", initial=0.0, final=0.0, upper=top_speed)
    u = phase.control("u", lower=-1.0, upper=1.0, shape="constant")
    phase.derivative(x, v)
    phase.derivative(v, u * (1 + phase.time) if growing else u)
    phase.end_cost(phase.duration)
    return problem


def two_moves() -> OptimalControlProblem:
    """1 m to rest, and back with twice the force: two switches, in two phases."""
    problem = OptimalControlProblem("there and back")
    for name, ends, force in (("there", (0.0, 1.0), 1.0), ("back", (None, 0.0), 2.0)):
        phase = problem.phase(name, (0.1, 10.0))
        x = phase.state("x", initial=ends[0], final=ends[1])
        v = phase.state("v", initial=0.0, final=0.0)
        u = phase.control("u", lower=-force, upper=force)
        strength = phase.parameter("strength", 1.0)
        phase.derivative(x, v)
        phase.derivative(v, u * strength)
        phase.end_cost(phase.duration)
    problem.link(*problem.phases, ("x",))
    return problem


def placed(problem, mesh, scheme="radau", guess=None):
    solution = solve(problem, mesh, guess, FINE, scheme=scheme)
    return solution, place_junctions(problem, solution, SCHEMES[scheme], FINE)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_switch_of_a_double_integrator_is_in_the_middle(scheme):
    solution, places = placed(double_integrator(), 7, scheme)
    assert solution.cost > 2.001
    assert places is not None
    np.testing.assert_allclose(places[0], [0.5], atol=1e-6)


def test_entry_to_and_exit_from_a_limit_of_a_state():
    """With v <= 2: 2 s, 0.5 s and 2 s."""
    problem = along(2.0)
    solution, places = placed(problem, 10)
    assert solution.cost > 4.52
    assert places is not None
    assert np.abs(places[0] - 2.0 / 4.5).min() < 1e-6
    assert np.abs(places[0] - 2.5 / 4.5).min() < 1e-6
    mesh = hold(solution["move"].mesh, places[0], 1e-6)
    again = solve(problem, [mesh], solution, FINE, scheme="radau")
    assert again.cost == pytest.approx(4.5, abs=1e-6)


def test_a_limit_of_second_order():
    """Bryson and Ho: on the ceiling from 3 L to 1 - 3 L.

    The contact is of third order: the cost hardly depends on the place.
    """
    _, places = placed(bryson_denham(1 / 9), 40)
    assert places is not None
    np.testing.assert_allclose(places[0], [1 / 3, 2 / 3], atol=5e-3)
    refined = solved_to(bryson_denham(1 / 9), 1e-8, 10, "radau", settings=FINE)
    assert refined.history[0].cost == pytest.approx(4.0, abs=2e-3)
    assert refined.cost == pytest.approx(4.0, abs=2e-5)
    assert abs(refined.history[0].cost - 4.0) > 1e-3


def test_the_clock_goes_on_from_arc_to_arc():
    """v' = u (1 + t): full force up to a, full brake to T: 2 (1 + a)^2 = 1 + (1 + T)^2."""
    problem = along(growing=True)
    solution, places = placed(problem, 12)
    assert places is not None
    refined = solved_to(problem, 1e-8, 12, "radau", settings=FINE, switches=1e-7)
    assert refined.status.solved
    (switch,) = refined.history[-1].switches[0]
    a, whole = switch.place * refined.duration, refined.duration
    assert a == pytest.approx(sqrt((1 + (1 + whole) ** 2) / 2) - 1, abs=1e-6)
    assert places[0][0] == pytest.approx(switch.place, abs=1e-6)
    assert solution.cost > whole + 1e-5


def test_every_phase_is_cut_by_itself():
    solution, places = placed(two_moves(), [7, 9])
    assert solution.cost > 2 + sqrt(2) + 1e-4
    assert places is not None
    for own in places:
        np.testing.assert_allclose(own, [0.5], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "mesh", "before", "after"),
    [
        ("van_der_pol_time", 20, 1e-4, 1e-7),
        ("pendulum", 40, 1e-3, 2e-7),
        ("cart_pole", 40, 1e-3, 1e-7),
        pytest.param("goddard_rocket", 20, 2e-7, 1e-7, marks=pytest.mark.thorough),
    ],
)
def test_the_cost_gains_digits(name, mesh, before, after):
    problem = BY_NAME[name]
    optimum = {"goddard_rocket": 1.01283691}.get(name, problem.optimum)
    built = with_shapes(problem.build(), "constant")
    refined = solved_to(built, 1e-7, mesh, "radau", problem.guess, FINE, switches=1e-4)
    errors = [abs(problem.sign * step.cost / optimum - 1) for step in refined.history]
    assert errors[0] > before
    assert errors[-1] < after


def test_nothing_is_placed_where_nothing_changes():
    _, places = placed(oscillator("polynomial"), 10)
    assert places is None


def test_dynamics_with_the_duration_of_their_phase_are_not_cut():
    problem = double_integrator()
    phase = problem.phases[0]
    phase.derivatives["v"] = phase.derivatives["v"] * (1 + 0.1 * ca.sin(phase.duration))
    assert placed(problem, 7)[1] is None


def test_an_interruption_is_not_taken_for_a_failure(monkeypatch):
    from microbot_ocp.ocp.arcs import _mesh_points as arcs

    def interrupted(*arguments, **options):
        return replace(solve_on(*arguments, **options), status=Status.INTERRUPTED)

    monkeypatch.setattr(arcs, "solve_on", interrupted)
    refined = solved_to(double_integrator(), 1e-8, 7, "radau", settings=FINE)
    assert refined.status is Status.INTERRUPTED
    assert refined.cost == pytest.approx(2.0, rel=0.02)
    assert len(refined.history) == 1


def test_points_are_moved_or_added():
    mesh = np.linspace(0, 1, 6)
    np.testing.assert_allclose(
        hold(mesh, np.array([0.45]), 1e-3), [0, 0.2, 0.435, 0.45, 0.465, 0.6, 0.8, 1]
    )
    np.testing.assert_allclose(hold(mesh, np.array([0.4005]), 1e-3)[2], 0.4005)
    assert hold(mesh, np.array([0.4005]), 1e-3).size == 6
    two = hold(mesh, np.array([0.4, 0.45]), 1e-3)
    assert {0.4, 0.45} <= set(two)
    assert distance(mesh, np.array([0.45, 0.2])) == pytest.approx(0.05)
    assert distance(mesh, np.zeros(0)) == 0.0


def test_arcs_and_errors_know_nothing_of_refinement():
    """Refinement uses them, so the other way round would be a circle."""
    folder = Path(ocp.__file__).parent
    for path in (*(folder / "arcs").glob("*.py"), *(folder / "mesh").glob("*.py")):
        assert "ocp.refinement" not in path.read_text(encoding="utf-8"), path.name
