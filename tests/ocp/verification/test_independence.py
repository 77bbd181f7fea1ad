"""Verification shares no formula with what it verifies: faults planted in the solve are found."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from helpers import sampled, sampled_rows, tells
from microbot_ocp.ocp import OptimalControlProblem, SolverSettings, Transcription, verify
from microbot_ocp.ocp.solution import unpack
from microbot_ocp.ocp.transcription import (
    SCHEMES,
    Collocation,
    Shooting,
    _kernels,
    _transcription,
    assemble,
)
from microbot_ocp.ocp.transcription.schemes import _shooting
from microbot_ocp.ocp.verification import Recomputation, scaled_rows
from ocp.textbook import everything, solve_once as solve

SETTINGS = SolverSettings("ipopt", tolerance=1e-9)


def cart(drag: float = 0.3) -> OptimalControlProblem:
    """From rest to rest with drag and a limit of power, in two phases with scales of their own."""
    problem = OptimalControlProblem("cart")
    phases = []
    for name, scale, first in (("out", 1.0, True), ("on", 10.0, False)):
        phase = problem.phase(name, (0.1, 10.0))
        x = phase.state("x", initial=0.0 if first else None, final=None if first else 2.0, unit="m")
        v = phase.state(
            "v", initial=0.0 if first else None, final=None if first else 0.0, scale=scale
        )
        u = phase.control("u", lower=-2.0, upper=2.0, shape="linear", unit="N")
        phase.derivative(x, v)
        phase.derivative(v, u - drag * v)
        phase.constraint("power", u * v, upper=0.4, unit="W")
        phase.running_cost(1.0 + u**2)
        phases.append(phase)
    problem.link(phases[0], phases[1])
    return problem


@pytest.mark.slow
@pytest.mark.parametrize(
    "scheme",
    sampled(
        [*SCHEMES.values(), Shooting(3), Collocation("radau", 1), Collocation("legendre", 6)], 3
    ),
    ids=str,
)
def test_rows_and_cost_of_the_declared_expressions_are_those_of_the_program(scheme):
    problem = everything()
    program = assemble(Transcription(problem, scheme=scheme).layouts([[0.0, 0.2, 0.5, 1.0], 4]))
    random = np.random.default_rng(3)
    x = random.uniform(0.2, 0.8, program.variable_lower.size)
    x[[i for i, label in enumerate(program.variable_labels) if label.kind == "duration"]] = 0.9
    again = [Recomputation(phase) for phase in unpack(program.layouts, x)]
    rows = scaled_rows(problem, again)
    own = [i for i, label in enumerate(program.row_labels) if label.kind != "link"]
    np.testing.assert_allclose(rows[own], program.row_values(x)[own], rtol=1e-9, atol=1e-10)
    cost = float(program.functions["gradient"](x, [])[0])
    assert sum(part.costs.sum() for part in again) == pytest.approx(cost, rel=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize(
    "scheme",
    sampled(
        [
            s if s in ("radau", "shooting") else pytest.param(s, marks=pytest.mark.thorough)
            for s in SCHEMES
        ],
        2,
    ),
)
def test_what_is_right_passes(scheme):
    problem = cart()
    certificate = verify(problem, solve(problem, 50, scheme=scheme, settings=SETTINGS))
    assert certificate.ok, certificate.verdict
    assert certificate.cost.error < 1e-7
    assert certificate.cost.integration_error < 1e-3


def test_a_cost_that_is_not_that_of_the_values_is_found():
    problem = cart()
    solution = solve(problem, 20, settings=SETTINGS)
    certificate = verify(problem, replace(solution, cost=solution.cost * (1 + 1e-5)))
    assert not certificate.ok
    tells(certificate.verdict, "Failed", f"cost is {solution.cost:.8g}", "given")


def altered_step(monkeypatch, change):
    step = _shooting._runge_kutta
    monkeypatch.setattr(_shooting, "_runge_kutta", lambda *a: change(*step(*a)))


def lost_running_cost(monkeypatch):
    altered_step(monkeypatch, lambda x, cost: (x, 0.9 * cost))


def wrong_dynamics(monkeypatch):
    altered_step(monkeypatch, lambda x, cost: (1.001 * x, cost))


def halved_constraint(monkeypatch):
    add = _kernels._Rows.add

    def altered(self, kind, items, value, fraction=0.0):
        add(self, kind, items, 0.5 * value if kind == "constraint" else value, fraction)

    monkeypatch.setattr(_kernels._Rows, "add", altered)


def constraint_left_out(monkeypatch):
    monkeypatch.setattr(_kernels, "_holds", lambda *_: False)


def altered_layout(monkeypatch, change):
    lay_out = _transcription.lay_out
    monkeypatch.setattr(_transcription, "lay_out", lambda *a, **k: change(lay_out(*a, **k)))


def wrong_link(monkeypatch):
    altered_layout(monkeypatch, lambda layout: replace(layout, factors=1.02 * layout.factors))


def lost_end_condition(monkeypatch):
    def without(layout):
        none = replace(layout.final, entries=(), places=layout.final.places[:, :0])
        return replace(layout, final=none)

    altered_layout(monkeypatch, without)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "said"),
    sampled_rows(
        [
            (lost_running_cost, ("cost", "given")),
            (wrong_dynamics, ("not feasible", "step of")),
            (halved_constraint, ("constraint power", "phase 'out'")),
            (constraint_left_out, ("constraint power", "phase 'out'")),
            (wrong_link, ("not feasible", "link of")),
            (lost_end_condition, ("end of x", "phase 'on'")),
        ],
        3,
    ),
)
def test_a_fault_in_what_makes_the_program_is_found(plant, said, monkeypatch):
    plant(monkeypatch)
    problem = cart()
    solution = solve(problem, 20, scheme="shooting", settings=SETTINGS)
    assert not solution.status.solved  # a solve is judged as verify judges
    certificate = verify(problem, solution)
    assert not certificate.ok
    tells(certificate.verdict, *said)


@pytest.mark.thorough
def test_a_fault_in_a_prepared_kernel_is_found():
    def altered(_, make):
        functions = make()
        v, c = (ca.SX.sym(f"i{k}", functions[0].size1_in(k)) for k in range(2))
        following, *others = functions[0](v, c)
        stage = ca.Function(functions[0].name(), [v, c], [1.01 * following, *others])
        return _kernels.with_derivatives([stage, functions[3]])

    problem = cart()
    solution = solve(
        Transcription(problem, scheme="shooting", prepare=altered), 20, settings=SETTINGS
    )
    assert solution.attempts[-1].status.solved
    certificate = verify(problem, solution)
    assert not certificate.ok
    tells(certificate.verdict, "not feasible", "step of")


@pytest.mark.thorough
def test_a_fault_in_a_cost_that_is_evaluated_apart_is_found(monkeypatch):
    light = _kernels.light_cost

    def altered(function):
        cost = light(function)
        given = cost.sx_in()
        return ca.Function("cost", given, [1.01 * part for part in cost(*given)])

    monkeypatch.setattr(_kernels, "light_cost", altered)
    problem = cart()
    solution = solve(problem, 20, scheme="shooting", settings=SETTINGS)
    assert solution.attempts[-1].status.solved
    certificate = verify(problem, solution)
    assert not certificate.ok
    tells(certificate.verdict, "the cost", f"{solution.cost:.8g} given")


@pytest.mark.thorough
def test_a_solution_of_other_dynamics_is_not_one_of_the_problem():
    solution = solve(cart(), 20, settings=SETTINGS, scheme="shooting")
    certificate = verify(cart(drag=0.31), solution)
    assert not certificate.ok
    tells(certificate.verdict, "not feasible", "step of v")
