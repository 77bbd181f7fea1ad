"""Uneven meshes, one a phase."""

import casadi as ca
import numpy as np
import pytest

from helpers import refused
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.solution import pack, unpack
from microbot_ocp.ocp.solvers import SolverSettings, load_solution, save_solution
from microbot_ocp.ocp.transcription import Transcription, assemble, mesh_of
from microbot_ocp.ocp.transcription.schemes import Collocation
from microbot_ocp.ocp.verification import each_interval, mesh_states, verify
from ocp.textbook import everything, regulator, solve_once as solve
from ocp.transcription.test_transcription import guesses

GAUSS = Collocation("legendre", 8)
UNEVEN = [[0.0, 0.2, 0.35, 0.7, 1.0], 3]
EXACT = SolverSettings("ipopt", tolerance=1e-10)


def pendulum():
    """A swing with a polynomial control, an algebraic variable and a parameter."""
    problem = OptimalControlProblem("pendulum")
    phase = problem.phase("swing", 2.0)
    q = phase.state("q", initial=0.0, final=1.0)
    w = phase.state("w", initial=0.0, final=0.0)
    u = phase.control("u", shape="polynomial")
    pull = phase.algebraic("pull")
    gravity = phase.parameter("gravity", 1.0)
    phase.derivative(q, w)
    phase.derivative(w, u - pull)
    phase.algebraic_equation(pull - gravity * ca.sin(q))
    phase.running_cost(u**2)
    return problem


@pytest.fixture(scope="module", params=["radau", "gauss"])
def program(request):
    problem = everything()
    transcription = Transcription(problem, scheme=request.param, duration_scale=0.7)
    return assemble(transcription.layouts(UNEVEN))


def test_derivatives_are_those_of_the_expressions(program):
    x, f, g = (program.nlp[key] for key in "xfg")
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.shape[0])
    lagrangian = lam_f * f + ca.dot(lam_g, g)
    outputs = [f, g, ca.gradient(f, x), ca.jacobian(g, x), ca.hessian(lagrangian, x)[0]]
    automatic = ca.Function("automatic", [x, lam_f, lam_g], outputs)
    random = np.random.default_rng(5)
    point = random.uniform(0.2, 1.5, x.shape[0]), random.normal(), random.normal(size=g.shape[0])
    f, g, gradient, jacobian, hessian = map(np.array, automatic(*point))
    again, block = program.functions["jacobian"](point[0], [])
    np.testing.assert_allclose(again, g, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(np.array(block), jacobian, rtol=1e-10, atol=1e-11)
    value, slope = program.functions["gradient"](point[0], [])
    np.testing.assert_allclose(value, f, rtol=1e-12)
    np.testing.assert_allclose(slope, gradient, rtol=1e-11, atol=1e-11)
    block = program.functions["hessian"].call([point[0], [], *point[1:]])[-1]
    size = np.abs(hessian).max()
    np.testing.assert_allclose(np.array(block), hessian, rtol=1e-9, atol=1e-12 * size)


def test_every_row_and_variable_has_its_place_and_name(program):
    sizes = program.variable_lower.size, program.row_lower.size
    nodes, controls, constraints = program.stage_sizes
    assert nodes.sum() + controls.sum() == sizes[0]
    assert nodes[1:].sum() + constraints.sum() == sizes[1]
    assert (len(program.variable_labels), len(program.row_labels)) == sizes
    defects = [
        k for k in program.row_labels if (k.kind, k.phase, k.name) == ("defect", "first", "y")
    ]
    assert [k.interval for k in defects] == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]


def test_a_guess_comes_back_as_it_was_given(program):
    given = guesses()
    for phase in unpack(program.layouts, pack(program, given)):
        assert phase.duration == pytest.approx(given[phase.name].duration, rel=1e-14)
        for name, value in given[phase.name].values.items():
            np.testing.assert_allclose(phase[name], value, rtol=1e-14)


@pytest.fixture(scope="module")
def swing():
    mesh = [0.0, 0.1, 0.4, 0.5, 1.0]
    return solve(pendulum(), [mesh], settings=EXACT, scheme=GAUSS)


@pytest.mark.thorough
@pytest.mark.slow
def test_a_solution_on_an_uneven_mesh_passes_the_certificate(swing):
    assert swing.status.solved
    assert swing.cost == pytest.approx(
        solve(pendulum(), 30, settings=EXACT, scheme="gauss").cost, rel=1e-9
    )
    certificate = verify(pendulum(), swing)
    assert certificate.ok, certificate.verdict
    assert certificate.hamiltonians[0].drift < 1e-6
    costates = certificate.costates[0]
    assert costates.point_t.size == 32
    assert np.all(np.diff(costates.point_t) > 0)
    # the control minimises u^2 + costate * u
    u = swing["swing"]["u"]
    assert u.shape == (4, 8, 1)
    np.testing.assert_allclose(u.reshape(32, 1), -costates.point_values["w"] / 2, atol=1e-7)


def test_it_is_integrated_again_interval_by_interval(swing):
    phase = swing["swing"]
    again = each_interval(phase)
    assert not again.failure
    np.testing.assert_allclose(again.states, mesh_states(phase)[1:], atol=1e-6)


def test_it_is_sampled_between_the_points(swing):
    phase = swing["swing"]
    t = np.linspace(0.0, 2.0, 201)
    sampled = phase.sample(t)
    np.testing.assert_allclose(sampled["pull"], np.sin(sampled["q"]), atol=1e-5)
    np.testing.assert_allclose(
        np.gradient(sampled["q"].ravel(), t)[1:-1], sampled["w"][1:-1, 0], atol=1e-4
    )


def test_it_is_saved_and_starts_another_mesh(swing, tmp_path):
    transcription = Transcription(pendulum(), scheme=GAUSS)
    path = save_solution(swing, tmp_path / "swing.npz")
    loaded = load_solution(path, transcription)
    np.testing.assert_array_equal(loaded["swing"].mesh, swing["swing"].mesh)
    again = solve(transcription, [loaded["swing"].mesh], loaded, EXACT)
    assert again.attempts[-1].iterations <= 1
    other = [0.0, 0.3, 0.5, 0.6, 1.0]
    moved = solve(transcription, [other], loaded, EXACT)
    assert moved.attempts[-1].iterations <= 4
    assert moved.cost == pytest.approx(swing.cost, rel=1e-8)
    bare = load_solution(path)
    assert solve(transcription, [other], bare, EXACT).cost == pytest.approx(swing.cost, rel=1e-8)


# bad meshes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [0, 10])
def test_a_degree_that_there_is_not_is_refused(degree, no_solver):
    with refused("degree", "1 to 9", f"not {degree}"):
        solve(regulator(), 2, scheme=Collocation("radau", degree))


def test_a_mesh_is_fractions_or_a_number_of_intervals():
    assert mesh_of(4).tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    with refused("mesh", "increasing", "0 to 1"):
        mesh_of([0.0, 0.6, 0.5, 1.0])
