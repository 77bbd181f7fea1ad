import numpy as np
import pytest
from matplotlib.figure import Figure

import microbot_ocp as mo
from helpers import refused
from microbot_ocp import ocp


@pytest.fixture(scope="module")
def problem():
    problem = mo.OptimalControlProblem("two pushes")
    for name in ("first", "second"):
        phase = problem.phase(name, duration=1.0)
        x = phase.state("x", initial=0.0 if name == "first" else None, unit="m")
        v = phase.state("v", initial=0.0 if name == "first" else None, unit="m/s", upper=1.2)
        u = phase.control("u", lower=-1.0, upper=1.0, unit="m/s^2")
        phase.derivative(x, v)
        phase.derivative(v, u)
    phase.end_cost(-x + 10 * v**2)
    problem.link(*problem.phases)
    return problem


@pytest.fixture(scope="module")
def solved(problem):
    return ocp.solve(problem, mesh=10)


def test_every_variable_has_a_panel_with_its_unit(solved):
    panels = mo.plots.solution(solved)
    assert [(p.get_title(), p.get_ylabel()) for p in panels] == [
        ("x", "[m]"), ("v", "[m/s]"), ("u", "[m/s^2]")]  # fmt: skip
    assert panels[0].get_xlabel() == "t [s]"


def test_curves_are_the_solution_over_all_phases(solved):
    (panel,) = solved.plot(names=["x"])
    first, second = (line for line in panel.lines if len(line.get_xdata()) > 2)
    assert np.interp(0.3, *first.get_data()) == pytest.approx(
        solved["first"].sample(0.3)["x"], 1e-4
    )
    assert second.get_xdata()[[0, -1]] == pytest.approx([1.0, 2.0])
    assert np.ravel(second.get_ydata())[-1] == pytest.approx(solved["second"]["x"][-1, 0])


def test_near_limits_are_drawn(solved):
    (panel,) = mo.plots.solution(solved, names=["u"])
    dashed = {line.get_ydata()[0] for line in panel.lines if line.get_linestyle() == "--"}
    assert dashed == {-1.0, 1.0}


def test_several_solutions_have_a_legend_and_given_axes_are_used(problem, solved):
    both = {"shooting": solved, "radau": ocp.solve(problem, mesh=10, scheme="radau")}
    panels = mo.plots.solution(both, names=["x", "u"])
    (legend,) = panels.figure.legends
    assert [text.get_text() for text in legend.get_texts()] == list(both)
    axes = Figure().subplots(1, 2)
    assert list(mo.plots.solution(both, axes, names=["x", "u"])) == list(axes)


def test_what_was_not_solved_says_so(problem):
    failed = ocp.solve(problem, mesh=10, settings=ocp.SolverSettings("ipopt", max_iterations=1))
    (legend,) = mo.plots.solution(failed).figure.legends
    assert "not solved" in legend.get_title().get_text()


@pytest.mark.parametrize(
    ("given", "names", "message"),
    [({}, None, ("solution", "one")), (None, ["w"], ("name", "x, v, u", "'w'"))],
)
def test_bad_arguments_are_refused(solved, given, names, message):
    with refused(*message):
        mo.plots.solution(solved if given is None else given, names=names)
