"""The staged program: its derivatives, its rows, and guesses laid into it."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solution import pack, unpack
from microbot_ocp.ocp.solvers import SolverSettings
from microbot_ocp.ocp.transcription import Guess, Transcription, assemble
from ocp.textbook import everything, spline

MESHES = [[0.0, 0.2, 0.35, 0.7, 1.0], 3]


def program_of(problem, meshes):
    transcription = Transcription(problem, scheme="shooting", duration_scale=0.7)
    return assemble(transcription.layouts(meshes))


@pytest.fixture(scope="module")
def program():
    return program_of(everything(), MESHES)


@pytest.fixture(scope="module")
def automatic(program):
    """Derivatives of the program's expressions by CasADi itself."""
    x, f, g = (program.nlp[key] for key in "xfg")
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.shape[0])
    lagrangian = lam_f * f + ca.dot(lam_g, g)
    return {
        "first": ca.Function("first", [x], [f, g, ca.gradient(f, x), ca.jacobian(g, x)]),
        "second": ca.Function(
            "second", [x, lam_f, lam_g], [ca.gradient(lagrangian, x), ca.hessian(lagrangian, x)[0]]
        ),
    }


def random_point(program, seed):
    random = np.random.default_rng(seed)
    x = random.uniform(0.2, 1.5, program.variable_lower.size)
    return x, random.normal(), random.normal(size=program.row_lower.size)


@pytest.mark.parametrize("seed", range(4))
def test_first_derivatives_are_those_of_the_expressions(program, automatic, seed):
    x, _, _ = random_point(program, seed)
    f, g, gradient, jacobian = map(np.array, automatic["first"](x))
    again, block = program.functions["jacobian"](x, [])
    np.testing.assert_allclose(again, g, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(np.array(block), jacobian, rtol=1e-11, atol=1e-11)
    value, slope = program.functions["gradient"](x, [])
    np.testing.assert_allclose(value, f, rtol=1e-12)
    np.testing.assert_allclose(slope, gradient, rtol=1e-11, atol=1e-11)
    np.testing.assert_array_equal(program.functions["gradient_only"](x, []), slope)


@pytest.mark.parametrize("seed", range(4))
def test_second_derivatives_are_those_of_the_expressions(program, automatic, seed):
    x, lam_f, lam_g = random_point(program, seed)
    slope, hessian = map(np.array, automatic["second"](x, lam_f, lam_g))
    _, _, stationarity, _ = program.functions["lagrangian"](x, [], lam_f, lam_g)
    np.testing.assert_allclose(stationarity, slope, rtol=1e-10, atol=1e-10)
    size = np.abs(hessian).max()
    for name, expected in (("hessian", hessian), ("hessian_upper", np.triu(hessian))):
        block = np.array(program.functions[name].call([x, [], lam_f, lam_g])[-1])
        np.testing.assert_allclose(block, expected, rtol=1e-10, atol=1e-12 * size)


@pytest.mark.parametrize("problem", [everything(), spline((1.0, 0.5), 0.3)], ids=lambda p: p.name)
def test_the_gradient_is_dense_as_solvers_take_it(problem):
    functions = program_of(problem, [4, 3]).functions
    for name, output in (("gradient", 1), ("gradient_only", 0), ("lagrangian", 2)):
        assert functions[name].sparsity_out(output).is_dense()


def test_no_derivative_is_asked_for_where_all_terms_vanish(program, automatic):
    x, lam_f, lam_g = random_point(program, 0)
    exact = np.array(automatic["second"](x, lam_f, lam_g)[1])
    sparsity = program.functions["hessian"].sparsity_out(1)
    assert np.all(np.array(ca.DM(sparsity, 1.0))[exact != 0] == 1)
    inside = np.array(ca.DM(program.functions["jacobian"].sparsity_out(1), 1.0))
    assert inside.mean() < 0.2  # blocks on a band, not a full matrix


def test_stage_sizes_add_up_to_the_program(program):
    nodes, controls, constraints = program.stage_sizes
    assert nodes.sum() + controls.sum() == program.variable_lower.size
    assert nodes[1:].sum() + constraints.sum() == program.row_lower.size
    assert np.all(program.variable_lower <= program.variable_upper)
    assert np.all(program.row_lower <= program.row_upper)


def guesses(seed=0):
    random = np.random.default_rng(seed)
    first = {
        "x": random.uniform(0, 1, (5, 2)),
        "y": random.uniform(0, 1, (5, 1)),
        "pull": random.uniform(-1, 1, (5, 2)),
        "push": random.uniform(-1, 1, (4, 1)),
    }
    second = {name: random.uniform(-1, 1, (4, 2)) for name in ("z", "x", "pull")}
    return {"first": Guess(0.9, first), "second": Guess(1.5, second)}


def test_a_guess_comes_back_as_it_was_given(program):
    given = guesses()
    for phase in unpack(program.layouts, pack(program, given)):
        assert phase.duration == pytest.approx(given[phase.name].duration, rel=1e-14)
        for name, value in given[phase.name].values.items():
            np.testing.assert_allclose(phase[name], value, rtol=1e-14)


def test_the_guess_of_what_jumps_leaves_no_gap_at_the_link(program):
    given = guesses()
    given["second"].values["x"][0] = given["first"].values["x"][-1]
    given["second"].values["pull"][0] = given["first"].values["pull"][-1]
    g = np.array(program.functions["jacobian"](pack(program, given), [])[0]).ravel()
    np.testing.assert_allclose(g[program.layouts[0].link.places], 0.0, atol=1e-14)


def runge_kutta(slope, x, h, u0, u1):
    """One step of the classical method with a linear control."""
    um = (u0 + u1) / 2
    k1 = slope(x, u0)
    k2 = slope(x + h / 2 * k1, um)
    k3 = slope(x + h / 2 * k2, um)
    k4 = slope(x + h * k3, u1)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def van_der_pol():
    problem = OptimalControlProblem("van der Pol")
    phase = problem.phase("calm", 3.0)
    x = phase.state("x", 2, initial=[0.0, 1.0], scale=[2.0, 0.5])
    u = phase.control("u", lower=-0.75, upper=0.75, shape="linear")
    phase.derivative(x, ca.vertcat((1 - x[1] ** 2) * x[0] - x[1] + u, x[0]))
    phase.running_cost(ca.sumsqr(x) + u**2)
    return problem


def van_der_pol_slope(x, u):
    return np.array([(1 - x[1] ** 2) * x[0] - x[1] + u, x[0]])


def test_gaps_between_stages_are_those_of_a_runge_kutta_step():
    program = program_of(van_der_pol(), [[0.0, 0.3, 0.55, 1.0]])
    random = np.random.default_rng(2)
    x, u = random.normal(size=(4, 2)), random.normal(size=(4, 1))
    start = pack(program, {"calm": Guess(3.0, {"x": x, "u": u})})
    g = np.array(program.functions["jacobian"](start, [])[0]).ravel()
    layout = program.layouts[0]
    h = 3.0 * np.diff(layout.mesh)
    for k in range(3):
        arrived = runge_kutta(van_der_pol_slope, x[k], h[k], u[k, 0], u[k + 1, 0])
        row = layout.stage_rows[k, 0]
        np.testing.assert_allclose(g[row : row + 2], (x[k + 1] - arrived) / [2.0, 0.5], atol=1e-13)
        np.testing.assert_allclose(g[row + 2 : row + 4], 0.0, atol=1e-15)


def test_a_solution_is_a_trajectory_of_the_dynamics():
    solution = solve(van_der_pol(), 60)
    assert solution.status.solved
    phase = solution["calm"]

    def slope(t, x):
        return van_der_pol_slope(x, np.interp(t, phase.t, phase["u"].ravel()))

    exact = solve_ivp(
        slope, (0.0, 3.0), [0.0, 1.0], t_eval=phase.t, max_step=0.05, rtol=1e-10, atol=1e-12
    )
    np.testing.assert_allclose(phase["x"], exact.y.T, atol=2e-6)
    assert np.abs(phase["u"]).max() == pytest.approx(0.75, abs=1e-6)


@pytest.mark.parametrize("solver", ["ipopt", "fatrop"])
def test_a_problem_without_a_cost_is_one_of_feasibility(solver):
    problem = OptimalControlProblem("reach")
    phase = problem.phase("run", 1.0)
    x = phase.state("x", initial=1.0, final=0.0)
    phase.derivative(x, phase.control("u", lower=-3.0, upper=3.0) - x)
    solution = solve(problem, 5, settings=SolverSettings(solver))
    assert solution.status.solved
    assert solution.cost == 0.0


def test_kernels_are_built_once_for_all_meshes():
    made = []

    def prepare(_, make):
        functions = make()
        made.append([function.name() for function in functions])
        return functions

    transcription = Transcription(spline((1.0, 0.5), 0.3), prepare=prepare)
    costs = [solve(transcription, mesh).cost for mesh in (2, 5)]
    assert len(made) <= 2  # at most one set a phase
    assert costs[0] == pytest.approx(costs[1], rel=1e-8)


def test_a_prepared_kernel_takes_the_place_of_the_built_one():
    def arriving_nowhere(_, make):
        functions = make()

        def altered(function):
            v, c = (ca.SX.sym(f"i{k}", function.size1_in(k)) for k in range(2))
            outputs = list(function(v, c))
            outputs[0] = 0 * outputs[0]
            return ca.Function(function.name(), [v, c], outputs)

        return [altered(functions[0]), *functions[1:]]

    problem = spline((1.0, 0.5), 0.3)
    guess = {
        name: Guess(duration, {"x": 0.0, "v": 0.0, "u": 1.0})
        for name, duration in (("first", 1.0), ("second", 0.5))
    }
    transcription = Transcription(problem, prepare=arriving_nowhere)
    program = assemble(transcription.layouts(3))
    x, layout = pack(program, guess), program.layouts[0]
    rows = np.array(ca.Function("g", [program.nlp["x"]], [program.nlp["g"]])(x)).ravel()
    steps = rows[layout.stage_rows[:, : layout.node_size]]
    # a step is the next mesh point less what the stage arrives at
    np.testing.assert_allclose(steps, x[layout.nodes[1:]])
