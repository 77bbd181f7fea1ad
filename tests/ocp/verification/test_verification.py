"""Certificates of solutions with known multipliers; tampered solutions are found out."""

import json
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from helpers import crossed, refused, sampled_rows, tells
from microbot_ocp._base.growth import carry, transition_matrices
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solution import PhaseSolution, Solution, Status, unpack
from microbot_ocp.ocp.solvers import SolverSettings
from microbot_ocp.ocp.transcription import Transcription, assemble
from microbot_ocp.ocp.transcription.schemes import SCHEMES, Collocation, IntegratorShooting
from microbot_ocp.ocp.verification import (
    Thresholds,
    differentiate,
    lagrangian_gradient,
    verify,
)
from ocp.textbook import (
    bryson_denham,
    double_integrator,
    everything,
    regulator,
    spline,
    through_half_way,
)

by_both = pytest.mark.parametrize("solver", ["fatrop", "ipopt"])
by_every_scheme = pytest.mark.parametrize("scheme", SCHEMES)


def solved(problem, mesh, scheme="shooting", solver="ipopt", tolerance=1e-9):
    settings = SolverSettings(solver, tolerance=tolerance)
    solution = solve(problem, mesh, scheme=scheme, settings=settings)
    assert solution.status in (Status.SOLVED, Status.TOO_COARSE)  # the solver converged
    return solution


# known multipliers --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scheme", "solver"),
    [
        *((scheme, "ipopt") for scheme in SCHEMES),
        ("shooting", "fatrop"),
        *(
            pytest.param(scheme, "fatrop", marks=pytest.mark.thorough)
            for scheme in SCHEMES
            if scheme != "shooting"
        ),
    ],
)
def test_the_shortest_move_has_its_costates_its_hamiltonian_and_its_switch(scheme, solver):
    """Costates -1 (position) and t - 1 (speed): H = 1 * 0 - v + (t - 1) u = -1 all along."""
    problem = double_integrator()
    certificate = verify(problem, solved(problem, 20, scheme, solver))
    assert certificate.ok, certificate.verdict
    assert certificate.verdict.startswith("Passed: ")
    costates = certificate.costate("move")
    np.testing.assert_allclose(costates["x"].ravel(), -1.0, atol=1e-6)
    np.testing.assert_allclose(costates["v"].ravel(), costates.t - 1, atol=1e-6)
    hamiltonian = certificate.hamiltonian("move")
    np.testing.assert_allclose(hamiltonian.values, -1.0, atol=1e-6)
    assert hamiltonian.autonomous
    assert hamiltonian.expected == -1.0
    assert hamiltonian.drift < 1e-6
    assert hamiltonian.duration_price == pytest.approx(0.0, abs=1e-6)
    arcs = [(a.name, a.side, round(a.start, 4), round(a.end, 4)) for a in certificate.arcs]
    assert arcs == [("u", "upper", 0.0, 1.0), ("u", "lower", 1.0, 2.0)]
    # with a as the limit on both sides the duration is 2 / sqrt(a): half of -1 from either side
    assert [a.price for a in certificate.arcs] == pytest.approx([0.5, 0.5], abs=1e-5)


def quadratic(shape="linear"):
    """Least integral of x' Q x + u^2 over 2 s for a damped oscillator."""
    a, b, q = np.array([[0.0, 1.0], [-1.0, -0.2]]), np.array([0.0, 1.0]), np.diag([2.0, 1.0])
    problem = OptimalControlProblem("quadratic")
    phase = problem.phase("calm", 2.0)
    # scales far from one: costates are per unit of the state
    x = phase.state("x", 2, initial=[1.0, -0.5], scale=[5.0, 0.2])
    u = phase.control("u", shape=shape, scale=3.0)
    phase.derivative(x, ca.DM(a) @ x + ca.DM(b) * u)
    phase.running_cost(ca.bilin(ca.DM(q), x, x) + u**2)

    def riccati(_, p):
        p = p.reshape(2, 2)
        return -(a.T @ p + p @ a - np.outer(p @ b, b @ p) + q).ravel()

    backwards = solve_ivp(
        riccati, (2.0, 0.0), np.zeros(4), rtol=1e-11, atol=1e-12, dense_output=True
    )
    return problem, lambda t: backwards.sol(t).T.reshape(-1, 2, 2)


@pytest.mark.parametrize(
    ("scheme", "shape", "error"),
    sampled_rows(
        [
            ("shooting", "linear", 1e-4),
            ("trapezoidal", "linear", 1.5e-2),
            ("hermite_simpson", "linear", 1e-4),
            ("radau", "linear", 1e-4),
            ("radau", "polynomial", 1e-7),
            ("gauss", "polynomial", 1e-7),
        ],
        3,
    ),
)
def test_costates_of_a_linear_regulator_are_those_of_the_riccati_equation(scheme, shape, error):
    """The optimal cost from (t, x) on is x' P x, its slope 2 P x."""
    problem, riccati = quadratic(shape)
    solution = solved(problem, 20, scheme)
    certificate = verify(problem, solution, thresholds=Thresholds(state_error=0.01))
    assert certificate.ok, certificate.verdict
    costates = certificate.costate("calm")
    exact = 2 * np.einsum("kij,kj->ki", riccati(costates.t), solution["calm"]["x"])
    np.testing.assert_allclose(costates["x"], exact, atol=error)
    np.testing.assert_allclose(costates.after["x"], costates["x"][:-1], atol=1e-9)
    hamiltonian = certificate.hamiltonian("calm")
    assert hamiltonian.drift < 10 * error
    assert hamiltonian.expected is None
    if shape == "polynomial":
        x = solution["calm"].sample(costates.point_t)["x"]
        inside = 2 * np.einsum("kij,kj->ki", riccati(costates.point_t), x)
        np.testing.assert_allclose(costates.point_values["x"], inside, atol=1e-3)


@by_every_scheme
def test_the_price_of_the_duration_is_the_slope_of_the_cost(scheme):
    """The least cost over T is tanh(T) / 2, its slope 1 / (2 cosh(T)^2), and that is H."""
    problem = regulator()
    hamiltonian = verify(problem, solved(problem, 40, scheme)).hamiltonian("calm")
    exact = 0.5 / np.cosh(1.0) ** 2
    assert hamiltonian.duration_price == pytest.approx(exact, abs=2e-4)
    assert hamiltonian.mean == pytest.approx(exact, abs=2e-4)
    np.testing.assert_allclose(hamiltonian.values, exact, atol=4e-4)


@pytest.mark.parametrize(
    ("scheme", "solver"),
    crossed(["shooting", "radau", "gauss", "hermite_simpson"], ["fatrop", "ipopt"]),
)
def test_bryson_and_denham_run_along_their_ceiling(scheme, solver):
    """From 3 top to 1 - 3 top; a ceiling higher by d lowers the cost by 4 / (9 top^2) d."""
    problem, top = bryson_denham(1 / 9), 1 / 9
    certificate = verify(problem, solved(problem, 36, scheme, solver))
    assert certificate.ok, certificate.verdict
    (arc,) = certificate.arcs
    assert (arc.kind, arc.name, arc.side) == ("state", "x", "upper")
    assert arc.start == pytest.approx(1 / 3, abs=1.2 / 36)
    assert arc.end == pytest.approx(2 / 3, abs=1.2 / 36)
    assert arc.price == pytest.approx(4 / (9 * top**2), rel=1e-3)
    # the costate of the speed is -u = 2 / (3 top) (1 - t / (3 top)), its slope minus that of the
    # position, which jumps where the ceiling is touched and left
    x = certificate.costate("fly")["x"].ravel()
    np.testing.assert_allclose(x[[2, 18, -3]], [18, 0, -18], atol=0.2)


@by_both
def test_two_phases_have_a_certificate_each(solver):
    problem = through_half_way(("x", "v"))
    certificate = verify(problem, solved(problem, 24, solver=solver))
    assert certificate.ok, certificate.verdict
    assert [h.mean for h in certificate.hamiltonians] == pytest.approx([-1.0, -1.0], abs=1e-6)
    first, second = certificate.costates
    for name in ("x", "v"):
        if name == "v":  # the place of the border is fixed, so its costate may jump
            assert first[name][-1, 0] == pytest.approx(second[name][0, 0], abs=1e-6)
    assert [(a.phase, a.side) for a in certificate.arcs] == [
        ("first", "upper"),
        ("second", "upper"),
        ("second", "lower"),
    ]
    switch = certificate.arcs[1].end
    exact = np.sqrt(1.5) / 2 - 0.5  # v: 1 + 2 s up, then down at 2
    step = certificate.costates[1].t[1]
    assert abs(switch - exact) < step


@pytest.mark.thorough
def test_a_fixed_duration_of_two_phases_has_its_hamiltonians():
    problem = spline((1.0, 0.5), 0.3)
    certificate = verify(problem, solved(problem, 6))
    for own in certificate.hamiltonians:
        assert own.drift < 1e-9
        assert own.duration_price == pytest.approx(own.mean)


# other kinds of problems --------------------------------------------------------------------------


def pulled(kind):
    """Least effort with the acceleration given by an algebraic equation, or a plain expression."""
    problem = OptimalControlProblem(kind)
    phase = problem.phase("move", 1.0)
    x = phase.state("x", initial=0.0, final=1.0)
    v = phase.state("v", initial=0.0, final=0.0)
    u = phase.control("u", shape="constant", lower=-30.0, upper=30.0)
    phase.derivative(x, v)
    if kind == "algebraic":
        a = phase.algebraic("a")
        phase.algebraic_equation(a + 0.1 * a**3 - u)
        phase.derivative(v, a)
    else:
        phase.derivative(v, u - 0.1 * phase.time * v)
    phase.running_cost(u**2)
    return problem


def test_algebraic_equations_are_integrated_again():
    problem = pulled("algebraic")
    certificate = verify(problem, solved(problem, 12, Collocation("radau", 3)))
    assert certificate.ok, certificate.verdict
    assert certificate.resimulations[0].error < 1e-7


@pytest.mark.thorough
def test_a_program_without_a_scalar_graph_is_checked_as_well():
    problem = pulled("timed")
    solution = solved(problem, 6, IntegratorShooting("rk", {"number_of_finite_elements": 6}))
    certificate = verify(problem, solution)
    assert certificate.ok, certificate.verdict
    assert not certificate.hamiltonian("move").autonomous


def test_a_phase_solved_with_other_numbers_is_checked_with_those():
    """The layout of a solution holds the limits and parameters that it was solved with."""

    def pushed(weight, top):
        problem = OptimalControlProblem("pushed")
        phase = problem.phase("move", (0.1, 10.0))
        x = phase.state("x", initial=0.0, final=1.0)
        v = phase.state("v", initial=0.0, final=0.0)
        u = phase.control("u", lower=-1.0, upper=1.0)
        mass = phase.parameter("mass", weight)
        phase.derivative(x, v)
        phase.derivative(v, u / mass)
        phase.constraint("speed", v, upper=top)
        phase.end_cost(phase.duration)
        return problem

    solution = solved(pushed(2.0, 0.5), 20)
    certificate = verify(pushed(1.0, 10.0), solution)
    assert certificate.ok, certificate.verdict
    assert "speed" in {arc.name for arc in certificate.arcs}


def test_a_transcription_serves_as_well_and_values_are_plain():
    transcription = Transcription(bryson_denham(1 / 9), duration_scale=2.0)
    certificate = verify(transcription, solved(transcription, 36))
    assert certificate.ok, certificate.verdict
    stored = json.loads(json.dumps(certificate.as_dict(), allow_nan=False))
    assert stored["ok"] is True
    assert stored["arcs"][0]["name"] == "x"
    assert len(stored["costates"][0]["values"]["x"]) == 37


@by_every_scheme
def test_the_gradient_of_the_lagrangian_is_that_of_the_assembled_program(scheme):
    transcription = Transcription(everything(), scheme=scheme)
    layouts = transcription.layouts([3, 4])
    program = assemble(layouts)
    random = np.random.default_rng(3)
    x = random.uniform(0.2, 0.8, program.variable_lower.size)
    lam = random.normal(size=program.row_lower.size)
    # one duration a phase, as a solution has it
    for label, i in zip(program.variable_labels, range(x.size), strict=True):
        x[i] = 0.9 if label.kind == "duration" else x[i]
    parts = [differentiate(phase, lam) for phase in unpack(program.layouts, x)]
    expected = program.functions["lagrangian"](x, [], 1.0, lam)[2]
    found = lagrangian_gradient(parts, lam)
    np.testing.assert_allclose(found, np.array(expected).ravel(), atol=1e-11)


@by_every_scheme
def test_every_row_and_variable_has_its_name(scheme):
    problem = everything()
    transcription = Transcription(problem, scheme=scheme)
    program = assemble(transcription.layouts([3, 4]))
    rows, variables = program.row_labels, program.variable_labels
    assert len(rows) == program.row_lower.size
    assert len(variables) == program.variable_lower.size
    declared = {
        (phase.name, own.name): own
        for phase in problem.phases
        for own in (*phase.states, *phase.controls, *phase.constraints)
    }
    for label, low, high in zip(rows, program.row_lower, program.row_upper, strict=True):
        own = declared.get((label.phase, label.name))
        if label.kind in ("constraint", "bound"):
            assert low * label.scale == pytest.approx(own.lower[label.component])
            assert high * label.scale == pytest.approx(own.upper[label.component])
        elif label.kind in ("initial", "final"):
            ends = getattr(own, label.kind)
            assert low * label.scale == pytest.approx(ends[0][label.component])
        else:
            assert low == high == 0.0
    for label, low in zip(variables, program.variable_lower, strict=True):
        own = declared.get((label.phase, label.name))
        if label.kind == "state" or (label.kind == "control" and own.shape == "constant"):
            assert low * label.scale == pytest.approx(own.lower[label.component])
    assert str(rows[1]) == "step of x[1] in phase 'first', interval 1"
    kinds = {label.kind for label in rows}
    assert {"step", "constraint", "bound", "initial", "link", "final"} <= kinds
    assert ("defect" in kinds) == (scheme != "shooting")
    # each row depends on what its name says
    jacobian = np.array(program.functions["jacobian"].sparsity_out(1))
    for label, row in zip(rows, jacobian, strict=True):
        if label.kind in ("initial", "final"):
            (column,) = np.flatnonzero(row)
            named = variables[column]
            assert (named.phase, named.name, named.component) == (
                label.phase,
                label.name,
                label.component,
            )
            assert named.interval == label.interval


# what is wrong is said ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def flight():
    problem = bryson_denham(1 / 9)
    return problem, solved(problem, 36, "hermite_simpson")


def tampered(solution: Solution, change) -> Solution:
    """The solution with its scaled stages [N, ...] changed and the values with them."""
    (phase,) = solution.phases
    layout = phase.layout
    stages = phase.stages.reshape(layout.intervals, -1).copy()
    change(stages)
    nodes = stages[:, : layout.node_size] * layout.node_scale
    values = dict(phase.values)
    for offset, name in enumerate(("x", "v", "u")):
        column = values[name].copy()
        column[:-1, 0] = nodes[:, offset]
        values[name] = column
    made = PhaseSolution(phase.name, phase.duration, phase.mesh, values, layout, stages.ravel())
    return replace(solution, phases=(made,))


def test_a_state_that_is_not_reached_is_found(flight):
    problem, solution = flight
    moved = tampered(solution, lambda stages: stages.__setitem__((10, 1), stages[10, 1] + 0.01))
    certificate = verify(problem, moved)
    assert not certificate.ok
    tells(certificate.verdict, "re-simulation", "phase 'fly'")
    tells(certificate.optimality.feasibility.where, "step of v", "phase 'fly'", "interval 10")
    assert certificate.optimality.feasibility.value == pytest.approx(0.01, rel=0.01)


@pytest.fixture(scope="module")
def upright():
    """A pendulum brought upright and held there for 8 s: errors grow by exp(40)."""
    problem = OptimalControlProblem("upright")
    phase = problem.phase("fly", 8.0)
    x = phase.state("x", initial=1.0, final=0.0)
    v = phase.state("v", initial=0.0, final=0.0)
    u = phase.control("u", shape="linear")
    phase.derivative(x, v)
    phase.derivative(v, 25.0 * x + u)
    phase.running_cost(u**2)
    return problem, solved(problem, 120, "hermite_simpson")


def test_a_right_answer_of_an_unstable_system_passes(upright):
    certificate = verify(*upright)
    assert certificate.ok, certificate.verdict
    (check,) = certificate.resimulations
    assert 1e16 < check.amplification < 1e19  # exp(40) is 2e17
    assert check.open_loop_error > 1.0
    assert check.local_error < check.error < 1e-3


@pytest.mark.parametrize(
    "change",
    [
        lambda stages: np.multiply(stages[:, 2], 1.01, out=stages[:, 2]),
        lambda stages: np.multiply(stages[:, 1], -1.0, out=stages[:, 1]),
        lambda stages: np.add(stages[20, 0], 0.01, out=stages[20, :1]),
    ],
)
def test_a_wrong_answer_of_an_unstable_system_does_not(upright, change):
    problem, solution = upright
    certificate = verify(problem, tampered(solution, change))
    tells(certificate.verdict, "re-simulation", "phase 'fly'")
    assert certificate.resimulations[0].error > 2e-3


def test_the_growth_is_that_of_the_transition_matrix():
    slopes = np.array([[[0.0, 1.0], [4.0, 0.0]]] * 5 + [[[0.0, 1.0], [-9.0, -2.0]]])
    lengths = np.array([0.1, 0.3, 0.2, 0.05, 0.4, 3.0])
    found = transition_matrices(slopes, lengths)
    for slope, length, matrix in zip(slopes, lengths, found, strict=True):
        values, vectors = np.linalg.eig(slope)
        exact = (vectors * np.exp(values * length)) @ np.linalg.inv(vectors)
        np.testing.assert_allclose(matrix, exact.real, rtol=1e-12, atol=1e-14)
    defects = np.random.default_rng(1).normal(size=(6, 2))
    carried = carry(defects, found)
    np.testing.assert_allclose(carried.errors[1], found[1] @ defects[0] + defects[1])
    rest = [np.linalg.multi_dot([np.eye(2), *found[:k:-1], np.eye(2)]) for k in range(6)]
    assert carried.amplification == pytest.approx(max(np.linalg.norm(m, 2) for m in rest))


def test_a_limit_that_is_exceeded_is_named(flight):
    problem, solution = flight
    moved = tampered(solution, lambda stages: stages.__setitem__((18, 0), 0.12))
    certificate = verify(problem, moved)
    tells(certificate.verdict, "state x", "phase 'fly'", "0.12 m", "0.5 s")
    worst = certificate.worst_limit
    assert worst is not None
    assert worst.excess == pytest.approx(0.12 - 1 / 9, rel=1e-6)
    assert worst.relative == pytest.approx(0.08, rel=1e-6)


def test_values_that_are_not_those_of_the_stages_are_found(flight):
    problem, solution = flight
    (phase,) = solution.phases
    values = {**phase.values, "v": phase.values["v"] * 1.001}
    certificate = verify(problem, replace(solution, phases=(replace(phase, values=values),)))
    tells(certificate.verdict, "values of v", "phase 'fly'")


def test_wrong_multipliers_are_not_stationary(flight):
    problem, solution = flight
    multipliers = solution.row_multipliers.copy()
    multipliers[40] += 0.1
    certificate = verify(problem, replace(solution, row_multipliers=multipliers))
    assert not certificate.ok
    tells(certificate.verdict, "not stationary")
    assert "re-simulation" not in certificate.verdict


def test_multipliers_at_bounds_that_do_not_act_are_found(flight):
    problem, solution = flight
    transcription = Transcription(problem, scheme="hermite_simpson")
    program = assemble(transcription.layouts([36]))
    names = [(label.kind, label.name, label.interval) for label in program.variable_labels]
    for name, interval, amount, said in (
        ("x", 3, 0.5, ("complementary", "state x", "phase 'fly'", "interval 4")),
        ("x", 3, -0.5, ("wrong sign", "state x", "phase 'fly'", "interval 4")),
        ("v", 5, 0.5, ("wrong sign", "state v", "phase 'fly'", "interval 6")),
    ):
        multipliers = solution.variable_multipliers.copy()
        multipliers[names.index(("state", name, interval))] += amount
        certificate = verify(problem, replace(solution, variable_multipliers=multipliers))
        tells(certificate.verdict, "not stationary", *said)


def test_without_multipliers_of_the_bounds_they_follow_from_the_others(flight):
    problem, solution = flight
    certificate = verify(problem, replace(solution, variable_multipliers=None))
    assert certificate.ok, certificate.verdict
    assert certificate.optimality.computed_bounds
    assert not verify(problem, solution).optimality.computed_bounds


def test_a_worse_motion_is_feasible_but_not_stationary():
    problem = double_integrator()
    settings = SolverSettings("ipopt", max_iterations=5)
    solution = solve(problem, 20, settings=settings)
    certificate = verify(problem, solution)
    tells(certificate.verdict, str(Status.ITERATION_LIMIT))
    assert not certificate.ok


def test_a_coarse_trapezoidal_mesh_does_not_pass(flight):
    problem, _ = flight
    certificate = verify(problem, solved(problem, 12, "trapezoidal"))
    tells(certificate.verdict, "re-simulation", "phase 'fly'")
    assert certificate.resimulations[0].error > 1e-3


def test_a_limit_exceeded_between_mesh_points_is_found():
    problem = OptimalControlProblem("bulge")
    phase = problem.phase("fly", 1.0, interior_points=())
    x = phase.state("x", initial=0.0, final=0.0)
    v = phase.state("v", initial=1.0, final=-1.0, unit="m/s")
    u = phase.control("u", shape="linear")
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.constraint("height", x, upper=0.1, unit="m", scale=0.1)
    phase.running_cost(u**2)
    certificate = verify(problem, solved(problem, 5))
    tells(certificate.verdict, "constraint height", "phase 'fly'", "0.1048 m", "0.28 s")
    worst = certificate.worst_limit
    assert worst is not None
    assert worst.name == "height"
    assert worst.unit == "m"


def test_a_solution_of_another_problem_is_refused(flight):
    problem, solution = flight
    with refused("['fly']", "'double integrator'", "['move']"):
        verify(double_integrator(), solution)
    with refused("3 row multipliers", "256 rows"):
        verify(problem, replace(solution, row_multipliers=np.zeros(3)))
    other = OptimalControlProblem("other")
    phase = other.phase("fly", 1.0)
    x = phase.state("x")
    phase.derivative(x, -x)
    with refused("phase 'fly'", "['x', 'v']", "['x']"):
        verify(other, solution)
