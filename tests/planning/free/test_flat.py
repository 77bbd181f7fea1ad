"""The flat program: its derivatives, its optimum, and the band solver behind IPOPT."""

import ctypes
import shutil
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from helpers import tells
from microbot_ocp._base import codegen
from microbot_ocp.limits import LimitFamily
from microbot_ocp.ocp import SolverSettings
from microbot_ocp.ocp.solvers import SolveContext, _ldl
from microbot_ocp.planning.free import (
    FlatTranscription,
    flat_form,
    initial_guesses,
    phase_names,
    transcription,
)
from microbot_ocp.planning.free._flat_loops import NumpyLoops
from microbot_ocp.planning.free._flat_program import GROSS_EXCESS, FlatProgram
from microbot_ocp.planning.task import SMOOTHING, WINDOW, Task, dry_friction, task_of
from planning.shared import VIA_Q, arm

needs_a_compiler = pytest.mark.skipif(codegen.compiler() is None, reason="there is no C compiler")
TIGHT = SolverSettings("ipopt", tolerance=1e-8, gap=1e-7)


def solve_on(kernels, mesh, guess, settings, **how):
    """Return the solution of kernels on a mesh, from a guess."""
    return SolveContext(kernels, settings).solve(mesh, guess, **how)


def flat_of(robot, via, payload=False, conditions=None) -> FlatTranscription:
    given = np.ascontiguousarray(via).tobytes(), len(via)
    form = flat_form(robot, *given, payload=payload, conditions=conditions)
    assert form is not None
    return form


def guess_of(robot, via):
    first, *_ = initial_guesses(LimitFamily.of(robot), via, phase_names(len(via) - 1), 3, 0)
    return first.guesses


def uneven_program(robot, via, seed=1, conditions=None) -> tuple[FlatProgram, np.ndarray]:
    """Return a small program on an uneven mesh, and unknowns near a guess."""
    rng, form = np.random.default_rng(seed), flat_of(robot, via, conditions=conditions)
    if dry_friction(robot).any():  # windows as wide as the velocities, so that all terms count
        numbers = {WINDOW: 0.05, SMOOTHING: 0.5}
        form = form.with_parameters(dict.fromkeys(phase_names(len(via) - 1), numbers))
    meshes = [np.r_[0.0, np.sort(rng.uniform(0.02, 0.98, 6)), 1.0] for _ in via[1:]]
    program = form.program(meshes)
    x = form.starting_point(program, guess_of(robot, via)).x
    return program, x + 0.01 * rng.normal(size=x.size)


def dense(sparsity, entries):
    return np.array(ca.DM(sparsity, entries))


def differences(function, x, step=1e-6):
    columns = [(function(x + d) - function(x - d)) / (2 * step) for d in step * np.eye(x.size)]
    return np.array(columns).T


LIMITED = {
    "torques": {},
    "accelerations": {"qdd_max": 30.0},
    "rates": {"taud_max": 2000.0, "qddd_max": 500.0},
}


def rubbing(robot, **limits):
    """Return an arm with dry friction in every joint, of a fifth of the torque limit at most."""
    size = 0.2 * np.minimum(robot.limits.tau_max, 50.0)
    pairs = zip(robot.links, size, strict=True)
    links = [replace(link, coulomb_friction=float(f)) for link, f in pairs]
    return robot.with_links(links).with_limits(**limits)


@pytest.mark.parametrize("dry", [False, True], ids=["", "dry"])
@pytest.mark.parametrize("changes", LIMITED.values(), ids=LIMITED)
def test_derivatives_are_those_of_differences(microbot, changes, dry):
    arm = rubbing(microbot, **changes) if dry else microbot.with_limits(**changes)
    check_derivatives(*uneven_program(arm, VIA_Q))


@pytest.mark.thorough
def test_derivatives_with_dry_friction_are_right_from_six_joints_on():
    """Torques have derivatives of their own there."""
    via = 0.5 * np.random.default_rng(3).normal(size=(3, 6))
    check_derivatives(*uneven_program(rubbing(mo.load_robot("ur5e"), **LIMITED["rates"]), via))


def test_derivatives_of_distances_are_those_of_differences(microbot):
    """One segment has obstacles and the other has none."""
    robot = microbot.with_capsules(mo.robot.link_capsules(microbot))
    bodies = mo.scene.Sphere([0.5, 0.5, 0.5], 0.1), mo.scene.Box([0.2, 0.3, 0.4], [0.8, -0.6, 0.2])
    among = robot.with_limits(also=[mo.Scene(bodies).limit(robot)])
    conditions = replace(
        Task.through(LimitFamily.of(robot), VIA_Q).conditions, robots=(among, robot)
    )
    program, x = uneven_program(among, VIA_Q, conditions=conditions)
    assert {entry.name for block in program.layouts[0].rows for entry in block.entries} > {
        "distance"
    }
    check_derivatives(program, x)


@pytest.mark.parametrize("cycle", [False, True], ids=["poses", "cycle"])
def test_derivatives_of_conditions_at_stops_are_those_of_differences(microbot, cycle):
    at = np.array(mo.forward_kinematics(microbot)(VIA_Q[1]))[:3, 3]
    stops = [mo.Stop(q=VIA_Q[0], velocity="any" if cycle else None)]
    stops.append(mo.Stop(position=at, velocity="any"))
    stops += [] if cycle else [mo.Stop(position=at + 0.01)]
    conditions = task_of(microbot, stops, cycle=cycle).conditions
    assert conditions.closed == (("qd",) if cycle else ())
    check_derivatives(*uneven_program(microbot, VIA_Q, conditions=conditions))


def check_derivatives(program, x):
    lam = np.random.default_rng(0).normal(size=program.row_lower.size)
    slope, _, entries = program.slopes(x)
    jacobian = dense(program.structure.jacobian, entries)

    def close(found, wanted):
        # Edges of friction windows are narrow, so differences across them have errors of 1e-6.
        np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-8 * np.abs(wanted).max())

    close(slope, differences(program.cost, x))
    close(jacobian, differences(program.row_values, x))
    upper = dense(program.structure.hessian, program.evaluation.hessian(x, 0.7, lam))

    def gradient(x):
        slope, _, entries = program.slopes(x)
        return 0.7 * slope + dense(program.structure.jacobian, entries).T @ lam

    close(upper + np.triu(upper, 1).T, differences(gradient, x))
    np.testing.assert_allclose(program.stationarity(x, lam)[0], slope + jacobian.T @ lam)


@needs_a_compiler
@pytest.mark.parametrize(
    "name",
    [
        "microbot",
        pytest.param("ur5e", marks=pytest.mark.thorough),
        "with rates",
        "with dry friction",
    ],
)
def test_numpy_and_c_do_the_same(name):
    rated = mo.load_robot("ur5e").with_limits(**LIMITED["rates"])
    changed = {"with rates": rated, "with dry friction": rubbing(rated)}
    robot = changed[name] if name in changed else mo.load_robot(name)
    via = VIA_Q if name == "microbot" else 0.5 * np.random.default_rng(3).normal(size=(3, 6))
    program, x = uneven_program(robot, via)
    lam = np.random.default_rng(0).normal(size=program.row_lower.size)
    evaluation = program.evaluation
    assert type(evaluation.loops) is not NumpyLoops

    def everything():
        evaluation._at = b""
        return evaluation.gradient(x)[1], *evaluation.jacobian(x), evaluation.hessian(x, 0.7, lam)

    in_c = [part.copy() for part in everything()]
    evaluation.loops = NumpyLoops(evaluation.loops.moved)
    for fast, slow in zip(in_c, everything(), strict=True):
        np.testing.assert_allclose(fast, slow, rtol=1e-10, atol=1e-12 * np.abs(slow).max())


def test_the_derivative_test_of_ipopt_finds_no_error(capfd):
    robot, via = arm(), np.array([[0.0, 0.0], [1.0, 0.5], [0.5, 1.0]])
    options = {
        "derivative_test": "second-order",
        "derivative_test_perturbation": 1e-7,
        "derivative_test_tol": 0.1,  # differences to one side: a missing entry is all wrong
        "max_iter": 0,
        "print_level": 3,
    }
    settings = SolverSettings("ipopt", gap=np.inf, options={"ipopt": options})
    solve_on(flat_of(robot, via), 6, guess_of(robot, via), settings)
    tells(capfd.readouterr().out, "No errors", "derivative")


def test_its_optimum_is_that_of_the_program_with_states(microbot):
    """Both keep limits at mesh points and in the middles of intervals."""
    stated = transcription(microbot, VIA_Q.tobytes(), len(VIA_Q), False)
    guess = guess_of(microbot, VIA_Q)
    with_states = solve_on(stated, 20, guess, TIGHT)
    without = solve_on(flat_of(microbot, VIA_Q), 20, guess, TIGHT)
    assert with_states.status.solved
    assert without.status.solved
    assert without.cost == pytest.approx(with_states.cost, rel=1e-6)
    for before, after in zip(with_states.phases, without.phases, strict=True):
        np.testing.assert_allclose(after["q"], before["q"], atol=1e-3)


def test_rows_of_rates_are_rates_at_the_ends_of_intervals_to_second_order(microbot):
    robot = microbot.with_limits(taud_max=2000.0)
    form, guess = flat_of(robot, VIA_Q), guess_of(robot, VIA_Q)

    def error(mesh):
        program = form.program(mesh)
        x = form.starting_point(program, guess).x
        rows, scales = program.structure.rows, program.scales
        spans = rows.lengths() * scales.durations[rows.phase]
        there = rows.of_rates[:, 0] >= 0
        rates = program.row_values(x)[rows.of_rates[there]] * scales.rate / spans[there, None]
        expected = []
        for layout in program.layouts:
            phase = layout.unpacked(x)
            motion = [phase[key] for key in ("q", "qd", "qdd")]
            jerk = np.diff(motion[2], axis=0) / np.diff(phase.t)[:, None]
            ends = [
                robot.torques_along(*(table[part] for table in motion), jerk)["taud"]
                for part in (slice(None, -1), slice(1, None))
            ]
            expected.append(np.stack(ends, axis=1).reshape(-1, 3))
        return np.abs(rates - np.concatenate(expected)).mean()

    errors = [error(mesh) for mesh in (20, 40, 80)]
    assert errors[1] < 0.3 * errors[0]
    assert errors[2] < 0.3 * errors[1]


def test_its_mesh_points_are_one_spline(microbot):
    solution = solve_on(flat_of(microbot, VIA_Q), 12, guess_of(microbot, VIA_Q), TIGHT)
    for phase in solution.phases:
        t = np.linspace(0.0, phase.duration, 50)
        values, h = phase.sample(t), 1e-6
        slope = (phase.sample(t[1:-1] + h)["q"] - phase.sample(t[1:-1] - h)["q"]) / (2 * h)
        np.testing.assert_allclose(slope, values["qd"][1:-1], atol=1e-5)
    for before, after in zip(solution.phases[:-1], solution.phases[1:], strict=True):
        for key in ("q", "qd", "qdd"):
            np.testing.assert_allclose(before[key][-1], after[key][0], atol=1e-12)


# A rate is a difference of torques to second order in the interval.
@pytest.mark.parametrize(("limits", "within"), [({}, 1e-6), ({"taud_max": 2000.0}, 1e-3)])
def test_with_dry_friction_its_optimum_is_that_of_the_program_with_states(limits, within):
    robot, via = rubbing(arm(), **limits), np.array([[0.0, 0.0], [1.0, -0.5], [0.2, 0.6]])
    numbers = {name: {WINDOW: 0.02, SMOOTHING: 0.1} for name in phase_names(2)}
    stated = transcription(robot, via.tobytes(), len(via), False).with_parameters(numbers)
    flat, guess = flat_of(robot, via).with_parameters(numbers), guess_of(robot, via)
    # The last bits of a start may decide between two optima.
    slower = {name: replace(g, duration=1.05 * g.duration) for name, g in guess.items()}
    best = list[float]()
    for form in (stated, flat):
        solutions = [solve_on(form, 20, start, TIGHT) for start in (guess, slower)]
        assert all(solution.status.solved for solution in solutions)
        best.append(min(solution.cost for solution in solutions))
    assert best[1] == pytest.approx(best[0], rel=within)


def test_a_guess_far_beyond_the_limits_is_slowed_down():
    robot, via = arm().with_limits(taud_max=100.0), np.array([[0.0, 0.0], [1.0, -0.5]])
    fast = {name: replace(g, duration=0.01) for name, g in guess_of(robot, via).items()}
    form = flat_of(robot, via)
    program = form.program(20)
    x = form.starting_point(program, fast).x
    rows = program.row_values(x)
    assert np.max([rows - program.row_upper, program.row_lower - rows]) <= GROSS_EXCESS
    (T,) = x[program.structure.rows.layout.durations]
    assert T > 0.01


def test_a_finer_mesh_begins_with_the_multipliers_of_the_coarser_one(microbot):
    form, guess = flat_of(microbot, VIA_Q), guess_of(microbot, VIA_Q)
    rough = SolverSettings("ipopt", tolerance=1e-6, gap=np.inf)
    coarse = solve_on(form, 20, guess, rough)
    mesh = [np.linspace(0.0, 1.0, 41)] * 2  # every interval halved
    warm, cold = solve_on(form, mesh, coarse, rough), solve_on(form, mesh, guess, rough)
    assert warm.duration == pytest.approx(cold.duration, rel=1e-5)
    assert warm.attempts[0].iterations < cold.attempts[0].iterations


def test_a_solve_ends_at_the_wanted_gap_or_where_the_next_one_begins(microbot):
    form, guess = flat_of(microbot, VIA_Q), guess_of(microbot, VIA_Q)
    exact = solve_on(form, 20, guess, TIGHT)
    rough = solve_on(form, 20, guess, SolverSettings("ipopt", tolerance=1e-6, gap=np.inf))
    assert len(exact.attempts) == 1
    assert exact.gap.total <= TIGHT.gap * exact.cost
    assert TIGHT.gap < rough.cost / exact.cost - 1.0 < 2e-4
    assert rough.attempts[0].iterations < exact.attempts[0].iterations


def test_a_program_through_40_via_points_is_solved():
    """Of seven joints and short phases: its durations would make a band as wide as the program."""
    robot = mo.load_robot("panda")
    low, high = robot.limits.q_min, robot.limits.q_max
    rng, middle = np.random.default_rng(0), 0.5 * (low + high)
    via = middle + 0.3 * rng.uniform(-1.0, 1.0, (40, 7)) * (high - middle)
    robot = robot.with_links([replace(link, coulomb_friction=0.0) for link in robot.links])
    rough = SolverSettings("ipopt", tolerance=1e-5, gap=np.inf)
    guess = guess_of(robot, via)
    solution = solve_on(flat_of(robot, via), 6, guess, rough, once=True)
    assert solution.status.solved
    assert solution.duration < sum(guess[name].duration for name in phase_names(39))


def test_the_payload_is_a_number_of_the_program(microbot):
    form, guess = flat_of(microbot, VIA_Q, payload=True), guess_of(microbot, VIA_Q)
    numbers = {name: {"payload": 1.0} for name in phase_names(2)}
    held = solve_on(form.with_parameters(numbers), 20, guess, TIGHT)
    other = solve_on(flat_of(microbot.with_payload(1.0), VIA_Q), 20, guess, TIGHT)
    assert held.duration == pytest.approx(other.duration, rel=1e-6)


def test_what_it_cannot_state_is_left_to_the_program_with_states():
    via = np.array([[0.0, 0.0], [1.0, 0.5]])
    averaged = arm().with_limits(also=[mo.limits.rms_torque(50.0)])
    assert flat_form(averaged, via.tobytes(), 2) is None


# the band solver ----------------------------------------------------------------------------------


def banded_matrix(rng, unknowns=30, rows=50, width=4, border=2, equations=0):
    """Return IPOPT's matrix of a program and its number of rows, of which equations are the first.

    H is positive definite, except across the equations.
    """
    size = unknowns + border
    hessian, jacobian = np.zeros((size, size)), np.zeros((rows, size))
    for k in range(unknowns):
        hessian[k, max(0, k - width) : k] = rng.normal(size=min(k, width))
    hessian[unknowns:, :unknowns] = 0.1 * rng.normal(size=(border, unknowns))
    hessian = hessian + hessian.T + np.diag(rng.uniform(10.0, 20.0, size))
    for r in range(rows):
        first = rng.integers(0, unknowns - width)
        jacobian[r, first : first + width] = rng.normal(size=width)
        jacobian[r, unknowns + rng.integers(border)] = rng.normal()
    hessian -= 100.0 * jacobian[:equations].T @ jacobian[:equations]
    sigma, delta = 10.0 ** rng.uniform(-3, 5, rows), rng.uniform(0.0, 1e-6, rows)
    matrix = np.block(
        [
            [hessian, np.zeros((size, rows)), jacobian.T],
            [np.zeros((rows, size)), np.diag(sigma), -np.eye(rows)],
            [jacobian, -np.eye(rows), -np.diag(delta)],
        ]
    )
    gone = size + np.arange(equations)
    return np.delete(np.delete(matrix, gone, 0), gone, 1), rows


def factored(matrix, rows, library=None, left=0):
    """Return the number of negative eigenvalues of a matrix by the band solver, a function that
    solves, and its integers, whose memory has what is ``left`` there at first.
    """
    library, size = library or ctypes.CDLL(str(_ldl.linear_solver_library(_ldl.BAND))), len(matrix)
    row, column = np.nonzero(np.tril(matrix))
    slack = size - rows + np.arange(rows)  # Delta stands in the structure where it is zero
    missing = slack[matrix[slack, slack] == 0.0]
    row, column = (np.concatenate([part, missing]) for part in (row, column))
    irn, icn = (np.ascontiguousarray(part + 1, dtype=np.intc) for part in (row, column))
    integers = [np.zeros(n, dtype=np.intc) for n in (3 * size, 2 * size, 30, 20)]
    keep, work, icntl, info = integers
    count, n = ctypes.c_int(row.size), ctypes.c_int(size)
    one, real = ctypes.c_int(1), (ctypes.c_double * 5)()
    at = lambda array: ctypes.c_void_p(array.ctypes.data)  # noqa: E731
    by = ctypes.byref
    library.ma27ad_(
        by(n), by(count), at(irn), at(icn), None, None, at(keep), at(work), by(one), by(one),
        at(icntl), real, at(info), real,
    )  # fmt: skip
    assert info[0] == 0
    a, iw = np.zeros(info[4]), np.array(np.broadcast_to(left, info[5]), dtype=np.intc)
    a[: row.size] = matrix[row, column]
    library.ma27bd_(
        by(n), by(count), at(irn), at(icn), at(a), None, at(iw), None, at(keep), by(one), by(one),
        at(work), at(icntl), real, at(info),
    )  # fmt: skip

    def solve(right):
        x = right.copy()
        library.ma27cd_(
            by(n), at(a), None, at(iw), None, None, by(one), at(x), at(work), by(one), at(icntl),
            real,
        )  # fmt: skip
        return x

    return info[14], solve, iw


@needs_a_compiler
@pytest.mark.parametrize("equations", [0, 1, 6])
@pytest.mark.parametrize("seed", range(5))
def test_the_band_solver_solves_and_tells_the_inertia(seed, equations):
    rng = np.random.default_rng(seed)
    width, border = int(rng.integers(2, 12)), int(rng.integers(1, 4))
    matrix, rows = banded_matrix(rng, width=width, border=border, equations=equations)
    negative, solve, _ = factored(matrix, rows)
    assert negative == rows == (np.linalg.eigvalsh(matrix) < 0).sum()
    right = rng.normal(size=len(matrix))
    np.testing.assert_allclose(matrix @ solve(right), right, atol=1e-8)
    np.testing.assert_allclose(solve(right), np.linalg.solve(matrix, right), rtol=1e-6, atol=1e-6)


@needs_a_compiler
def test_durations_of_many_short_phases_are_the_border_of_the_band():
    """They are coupled to hardly more unknowns than a coefficient is, but widen the band by far."""
    rng, phases, inside, width = np.random.default_rng(0), 40, 8, 3
    unknowns, each, rows = phases * inside, 2 * inside, 2 * phases * inside
    jacobian = np.zeros((rows, unknowns + phases))
    for r, first in enumerate(
        rng.integers(0, inside - width, rows) + np.arange(rows) // each * inside
    ):
        jacobian[r, first : first + width] = rng.normal(size=width)
        jacobian[r, unknowns + r // each] = rng.normal()
    hessian = np.diag(rng.uniform(10.0, 20.0, unknowns + phases)) + 0.1 * jacobian.T @ jacobian
    eye, nothing = np.eye(rows), np.zeros((unknowns + phases, rows))
    blocks = [[hessian, nothing, jacobian.T], [nothing.T, eye, -eye], [jacobian, -eye, -1e-6 * eye]]
    matrix = np.block(blocks)
    negative, solve, integers = factored(matrix, rows)
    assert (negative, integers[3]) == (rows, phases)
    right = rng.normal(size=len(matrix))
    np.testing.assert_allclose(matrix @ solve(right), right, atol=1e-8)


@needs_a_compiler
def test_the_band_solver_trusts_nothing_that_another_one_left_in_its_memory(tmp_path):
    """IPOPT unloads the library with a solver; malloc gives the next one the same memory."""
    matrix, rows = banded_matrix(np.random.default_rng(0))
    libraries = []
    for name in "ab":
        path = shutil.copy(_ldl.linear_solver_library(_ldl.BAND), tmp_path / f"{name}.so")
        libraries.append(ctypes.CDLL(path))
    *_, left = factored(matrix, rows, libraries[0])
    left[left.size // 2 :] = 0
    negative, solve, _ = factored(matrix, rows, libraries[1], left)
    assert negative == rows
    right = np.random.default_rng(1).normal(size=len(matrix))
    np.testing.assert_allclose(matrix @ solve(right), right, atol=1e-8)


@needs_a_compiler
@pytest.mark.parametrize("equations", [0, 6])
def test_the_band_solver_tells_what_is_not_positive_definite(equations):
    matrix, rows = banded_matrix(np.random.default_rng(0), equations=equations)
    matrix[0, 0] = -1e9
    assert factored(matrix, rows)[0] > rows
