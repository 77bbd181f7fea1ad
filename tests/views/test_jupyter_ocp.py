"""What Jupyter and the interpreter show of solutions of optimal-control problems."""

import re

import pytest

import microbot_ocp as mo
from helpers import tells
from microbot_ocp import ocp
from ocp.textbook import bryson_denham


@pytest.fixture(scope="module")
def refined():
    return ocp.solve(bryson_denham(1 / 9, "polynomial"), 10, accuracy=1e-6)


def cells(html, tag="td"):
    return re.findall(rf"<{tag}[^>]*>(.*?)</{tag}>", html)


def test_a_solution_is_one_line_and_a_table_of_its_attempts(refined):
    solution = refined
    assert re.fullmatch(r"<Solution: solved, cost [\d.]+ \(at most .*\), 1 s, \w+>", repr(solution))
    assert re.fullmatch(
        r"<PhaseSolution '.*': 1 s, \d+ intervals; x, v, u>", repr(solution.phases[0])
    )
    found = cells(solution._repr_html_())
    assert len(found) == 6 * len(solution.attempts)
    assert found[-6] == solution.attempts[-1].solver
    assert float(found[-3]) == pytest.approx(solution.cost, rel=1e-7)


def test_a_history_shows_a_row_a_mesh(refined):
    html = refined.history._repr_html_()
    assert html.count("<tr>") == 1 + len(refined.history)
    assert len(cells(html)) == len(cells(html, "th")) * len(refined.history)


def test_a_certificate_shows_its_verdict_and_its_arcs(refined):
    certificate = ocp.verify(bryson_denham(1 / 9, "polynomial"), refined)
    html = certificate._repr_html_()
    assert repr(certificate).endswith("passed>" if certificate.ok else "FAILED>")
    assert "complementarity" in html
    tells(html, "state x", "upper limit")


def test_a_branch_is_one_line():
    (first, *_) = mo.solve_ik_all(mo.load_robot("microbot"), [3.0, -1.0, 4.5])
    assert re.fullmatch(r"<IKSolution \[.*\]: solved, .* m off>", repr(first))
