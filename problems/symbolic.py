"""Transforms and velocities of a modified-DH table in symbols such as c1, s23, L1.

Expressions are sums of products of cosines, sines and names; they are simplified by the addition
theorems for parallel axes (c2 c3 - s2 s3 = c23, s2 c3 + c2 s3 = s23) and c^2 + s^2 = 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np


class Atom(NamedTuple):
    """Cosine or sine ("c", "s") of a sum of joint angles, or a name."""

    kind: str
    joints: tuple[int, ...] = ()

    def __str__(self) -> str:
        separator = "_" if any(joint > 9 for joint in self.joints) else ""
        return self.kind + separator.join(map(str, self.joints))


Product = tuple[Atom, ...]


class Expression:
    """Immutable sum of products of atoms."""

    def __init__(self, terms: dict[Product, float]) -> None:
        self.terms = _simplified({k: v for k, v in terms.items() if abs(v) > 1e-12})

    @classmethod
    def of(cls, value: float | str | Expression) -> Expression:
        """Convert a number, a name or an expression."""
        if isinstance(value, Expression):
            return value
        if isinstance(value, str):
            return cls({(Atom(value),): 1.0})
        return cls({(): float(value)})

    def __add__(self, other: Expression) -> Expression:
        terms = dict(self.terms)
        for product, factor in other.terms.items():
            terms[product] = terms.get(product, 0.0) + factor
        return Expression(terms)

    def __mul__(self, other: Expression) -> Expression:
        terms: dict[Product, float] = {}
        for ours, first in self.terms.items():
            for theirs, second in other.terms.items():
                product = tuple(sorted(ours + theirs))
                terms[product] = terms.get(product, 0.0) + first * second
        return Expression(terms)

    def __neg__(self) -> Expression:
        return Expression({product: -factor for product, factor in self.terms.items()})

    def __sub__(self, other: Expression) -> Expression:
        return self + -other

    def __str__(self) -> str:
        if not self.terms:
            return "0"
        shared = _shared(list(self.terms))
        if not shared or len(self.terms) == 1:
            return _sum(self.terms)
        inner = {_without(product, shared): factor for product, factor in self.terms.items()}
        return "*".join(map(str, sorted(shared, key=_reading_order))) + "*(" + _sum(inner) + ")"


def _sum(terms: dict[Product, float]) -> str:
    text = ""
    for product, factor in sorted(terms.items(), key=_place):
        size = f"{abs(factor):.6g}"
        names = "*".join(map(str, sorted(product, key=_reading_order)))
        body = names if names and size == "1" else "*".join(filter(None, (size, names)))
        sign = "-" if factor < 0 else "+"
        text += f" {sign} {body}" if text else ("-" if factor < 0 else "") + body
    return text


def _reading_order(atom: Atom) -> tuple[tuple[int, ...], str]:
    """Return the sort key of an atom: names first, angles in the order of the joints."""
    return atom.joints, atom.kind


def _place(term: tuple[Product, float]) -> tuple[int, int, list[str]]:
    """Return the sort key of a term: sums of many angles first, numbers last."""
    product = term[0]
    return -sum(len(a.joints) for a in product), -len(product), [str(a) for a in product]


def _shared(products: list[Product]) -> list[Atom]:
    left = [list(product) for product in products]
    found = []
    for atom in products[0]:
        if all(atom in rest for rest in left):
            for rest in left:
                rest.remove(atom)
            found.append(atom)
    return found


def _without(product: Product, atoms: Sequence[Atom]) -> Product:
    rest = list(product)
    for atom in atoms:
        rest.remove(atom)
    return tuple(rest)


def _simplified(terms: dict[Product, float]) -> dict[Product, float]:
    """Apply the theorems until none fits."""
    going = True
    while going:
        going = False
        for product in list(terms):
            replaced = next(_fitting(terms, product), None)
            if replaced is not None:
                other, result, factor = replaced
                del terms[product], terms[other]
                terms[result] = terms.get(result, 0.0) + factor
                terms = {k: v for k, v in terms.items() if abs(v) > 1e-12}
                going = True
                break
    return terms


def _fitting(
    terms: dict[Product, float], product: Product
) -> Iterator[tuple[Product, Product, float]]:
    """Yield every theorem that fits a product: its partner, their sum, and the sum's factor."""
    factor = terms[product]
    for first, second in combinations(product, 2):
        if not (first.joints and second.joints):
            continue
        rest = _without(product, (first, second))
        union = tuple(sorted(first.joints + second.joints))
        pair = first.kind + second.kind
        if first == second and pair == "cc":  # c^2 + s^2 = 1
            partner, result, sign = (Atom("s", first.joints),) * 2, (), 1.0
        elif pair == "cc" and not set(first.joints) & set(second.joints):
            partner = (Atom("s", first.joints), Atom("s", second.joints))
            result, sign = (Atom("c", union),), -1.0
        elif pair == "cs" and not set(first.joints) & set(second.joints):
            partner = (Atom("s", first.joints), Atom("c", second.joints))
            result, sign = (Atom("s", union),), 1.0
        else:
            continue
        other = tuple(sorted(rest + partner))
        if other != product and abs(terms.get(other, 0.0) - sign * factor) < 1e-12:
            yield other, tuple(sorted(rest + result)), factor


Matrix = list[list[Expression]]


def symbolic_row(
    alpha: float, a: float | str, d: float | str, theta: float = 0.0, joint: int | None = None
) -> Matrix:
    """Return the transform [4][4] of one modified-DH row (Craig, equation 3.6).

    Parameters
    ----------
    alpha : float
        Twist, rad.
    a, d : float or str
        Lengths, m, or their names.
    theta : float
        Angle, rad; without meaning where ``joint`` is given.
    joint : int, optional
        Number of the joint whose angle is the variable.
    """
    cos_alpha, sin_alpha = (Expression.of(x) for x in _rounded(alpha))
    if joint is None:
        cos_theta, sin_theta = (Expression.of(x) for x in _rounded(theta))
    else:
        cos_theta = Expression({(Atom("c", (joint,)),): 1.0})
        sin_theta = Expression({(Atom("s", (joint,)),): 1.0})
    zero, one, length, offset = (Expression.of(x) for x in (0.0, 1.0, a, d))
    return [
        [cos_theta, -sin_theta, zero, length],
        [sin_theta * cos_alpha, cos_theta * cos_alpha, -sin_alpha, -(sin_alpha * offset)],
        [sin_theta * sin_alpha, cos_theta * sin_alpha, cos_alpha, cos_alpha * offset],
        [zero, zero, zero, one],
    ]


def _rounded(angle: float) -> tuple[float, float]:
    """Return cosine and sine, exact at right angles."""
    return round(float(np.cos(angle)), 12), round(float(np.sin(angle)), 12)


def product(first: Matrix, second: Matrix) -> Matrix:
    """Return the product of two matrices of expressions."""
    zero = Expression.of(0.0)
    columns = list(zip(*second, strict=True))
    return [
        [sum((x * y for x, y in zip(row, column, strict=True)), zero) for column in columns]
        for row in first
    ]


def symbolic_velocities(
    rows: Sequence[Matrix], rates: Sequence[str | None]
) -> list[tuple[list[Expression], list[Expression]]]:
    """Return linear and angular velocity of every frame in that frame (Craig, 5.45 and 5.47).

    ``rates`` names the speed of every revolute joint; None marks a fixed row.
    """
    zero = Expression.of(0.0)
    v, omega = [zero] * 3, [zero] * 3
    found = []
    for row, rate in zip(rows, rates, strict=True):
        step = [row[i][3] for i in range(3)]
        moved = [
            v[i] + omega[(i + 1) % 3] * step[(i + 2) % 3] - omega[(i + 2) % 3] * step[(i + 1) % 3]
            for i in range(3)
        ]
        v = [sum((row[i][j] * moved[i] for i in range(3)), zero) for j in range(3)]
        omega = [sum((row[i][j] * omega[i] for i in range(3)), zero) for j in range(3)]
        if rate is not None:
            omega[2] = omega[2] + Expression.of(rate)
        found.append((v, omega))
    return found


def matrix_text(matrix: Matrix | np.ndarray, digits: int = 4) -> str:
    """Format a matrix of expressions or numbers as aligned lines."""
    cells = [[_cell(entry, digits) for entry in row] for row in matrix]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ("  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)) for row in cells)
    return "\n".join(f"  [ {line} ]" for line in lines)


def _cell(entry: Expression | float, digits: int) -> str:
    if isinstance(entry, Expression):
        return str(entry)
    return f"{round(float(entry), digits) + 0.0:.{digits}f}"  # adding 0.0 turns -0 into 0
