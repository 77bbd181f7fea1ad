"""The symbolic forms of the course: readable, and equal to the numbers."""

from __future__ import annotations

import math
from functools import reduce

import numpy as np
import pytest

from microbot_ocp.robot import dh_transform
from symbolic import (
    Expression,
    Matrix,
    matrix_text,
    product,
    symbolic_row,
    symbolic_velocities,
)


def value(expression: Expression, q: np.ndarray, **names: float) -> float:
    total = 0.0
    for atoms, factor in expression.terms.items():
        for kind, joints in atoms:
            angle = sum(q[joint - 1] for joint in joints)
            factor *= {"c": math.cos, "s": math.sin}[kind](angle) if joints else names[kind]
        total += factor
    return total


def microbot_rows() -> list[Matrix]:
    half_pi = np.pi / 2
    return [
        symbolic_row(0, 0, "h", joint=1),
        symbolic_row(half_pi, 0, 0, joint=2),
        symbolic_row(0, "e", 0, joint=3),
        symbolic_row(0, "f", 0),
    ]


def test_position_is_the_expression_of_the_report() -> None:
    """Course report, part 2: c1 (f c23 + e c2), s1 (f c23 + e c2), f s23 + e s2 + h."""
    pose = reduce(product, microbot_rows())
    assert [str(row[3]) for row in pose] == [
        "c1*(f*c23 + e*c2)",
        "s1*(f*c23 + e*c2)",
        "f*s23 + e*s2 + h",
        "1",
    ]
    assert [str(entry) for entry in pose[0][:3]] == ["c1*c23", "-c1*s23", "s1"]


def test_velocities_are_those_of_craigs_example() -> None:
    """Craig, example 5.3; frame 3 is fixed to link 2."""
    rows = [symbolic_row(0, 0, 0, joint=1), symbolic_row(0, "L1", 0, joint=2)]
    rows.append(symbolic_row(0, "L2", 0))
    found = symbolic_velocities(rows, ["w1", "w2", None])
    text = [([*map(str, v)], [*map(str, omega)]) for v, omega in found]
    assert text[0] == (["0", "0", "0"], ["0", "0", "w1"])
    assert text[1] == (["L1*w1*s2", "L1*w1*c2", "0"], ["0", "0", "w1 + w2"])
    assert text[2][0] == ["L1*w1*s2", "L1*w1*c2 + L2*w1 + L2*w2", "0"]
    assert text[2][1] == ["0", "0", "w1 + w2"]


@pytest.mark.parametrize("seed", range(4))
def test_symbols_equal_the_numbers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 5
    alpha = rng.choice([0.0, 0.0, np.pi / 2, -np.pi / 2, np.pi, 0.3], count)
    a, d, q = rng.uniform(-1, 1, (3, count))
    rows = [symbolic_row(alpha[i], a[i], d[i], joint=i + 1) for i in range(count)]
    pose = reduce(product, rows)
    expected = reduce(np.matmul, [dh_transform(alpha[i], a[i], d[i], q[i]) for i in range(count)])
    ours = np.array([[value(entry, q) for entry in row] for row in pose])
    assert ours == pytest.approx(expected, abs=1e-10)


def test_squares_and_sums_of_angles_are_joined() -> None:
    row, back = symbolic_row(0, 0, 0, joint=1), symbolic_row(0, 0, 0, joint=2)
    transposed = [list(column) for column in zip(*row, strict=True)]
    assert matrix_text(product(row, transposed)).split() == matrix_text(np.eye(4), 0).split()
    assert [str(entry) for entry in product(row, back)[0]] == ["c12", "-s12", "0", "0"]


def test_numbers_are_aligned_and_never_negative_zero() -> None:
    assert matrix_text(np.array([[1.0, -0.00001], [-12.5, 2.0]]), 2).split("\n") == [
        "  [   1.00  0.00 ]",
        "  [ -12.50  2.00 ]",
    ]
