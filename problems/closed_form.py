"""The equations of motion in closed form, readable: finite Fourier series of the joint angles.

Every entry of the mass matrix of a chain of revolute joints is a trigonometric polynomial of degree
at most 2 in each angle, its gravity torque one of degree at most 1. A discrete Fourier transform of
5 values a joint therefore finds all coefficients exactly, and no computer algebra is needed. The
Christoffel symbols follow term by term (Craig, *Introduction to Robotics*, 3rd ed., section 6.8).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

import microbot_ocp as mo

POINTS = 5  # a joint: enough for degree 2
NEGLIGIBLE = 1e-11  # relative to the largest coefficient
Index = tuple[int, ...]


@dataclass(frozen=True)
class Series:
    """A sum of ``a cos(k . q) + b sin(k . q)``: ``terms`` maps the whole numbers k to (a, b)."""

    terms: dict[Index, tuple[float, float]]

    def __call__(self, q: ArrayLike) -> float:
        """Value at joint angles q [n], rad."""
        angles = np.asarray(q, dtype=float)
        return sum(
            a * np.cos(np.dot(k, angles)) + b * np.sin(np.dot(k, angles))
            for k, (a, b) in self.terms.items()
        )

    def __str__(self) -> str:
        parts = []
        for k, pair in sorted(self.terms.items(), key=lambda item: _order(item[0])):
            for value, name in zip(pair, ("cos", "sin"), strict=True):
                if value:
                    wave = f" {name}({_angle(k)})" if any(k) else ""
                    size = "" if wave and abs(value) == 1 else f"{abs(value):.10g}"
                    parts.append(("-" if value < 0 else "+", f"{size}{wave}".strip()))
        if not parts:
            return "0"
        first = ("-" if parts[0][0] == "-" else "") + parts[0][1]
        return " ".join([first, *(f"{sign} {term}" for sign, term in parts[1:])])

    def slope(self, joint: int) -> Series:
        """Partial derivative with respect to the angle of joint index ``joint``."""
        changing = {k: pair for k, pair in self.terms.items() if k[joint]}
        return Series({k: (b * k[joint], -a * k[joint]) for k, (a, b) in changing.items()})


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """``M(q) qdd + C(q, qd) qd + G(q) = tau``, kg m^2 and N m.

    Attributes
    ----------
    mass : tuple of tuple of Series
        M [n][n].
    christoffel : tuple of tuple of tuple of Series
        c [n][n][n]: ``C[i][j] = sum over k of c[i][j][k] qd[k]``.
    gravity : tuple of Series
        G [n].
    """

    mass: tuple[tuple[Series, ...], ...]
    christoffel: tuple[tuple[tuple[Series, ...], ...], ...]
    gravity: tuple[Series, ...]

    def coriolis_text(self, i: int, j: int) -> str:
        """Entry C[i][j] (from 0) in words of ``qd1``, ``qd2`` and so on."""
        parts = []
        for k, series in enumerate(self.christoffel[i][j]):
            text = str(series)
            if text != "0":
                parts.append(f"({text}) qd{k + 1}")
        return " + ".join(parts) or "0"

    def lines(self) -> list[str]:
        """Every entry as a line of text; M above its diagonal only, being symmetric."""
        count = len(self.gravity)
        pairs = [(i, j) for i in range(count) for j in range(count)]
        found = [f"M{i + 1}{j + 1} = {self.mass[i][j]}" for i, j in pairs if j >= i]
        found += [f"C{i + 1}{j + 1} = {self.coriolis_text(i, j)}" for i, j in pairs]
        return found + [f"G{i + 1} = {series}" for i, series in enumerate(self.gravity)]


def closed_form(robot: mo.Robot) -> ClosedForm:
    """Mass matrix, Coriolis matrix and gravity torque of a robot in closed form.

    Parameters
    ----------
    robot : Robot
        A robot with masses and at most six joints, all revolute. Friction is left out.

    Returns
    -------
    ClosedForm

    Raises
    ------
    InputError
        A prismatic joint, no masses, more than six joints.

    Examples
    --------
    >>> form = closed_form(mo.load_robot("microbot"))
    >>> print(form.mass[1][1])
    68 + 48 cos(q3)
    >>> print(form.coriolis_text(2, 1))
    (24 sin(q3)) qd2
    >>> print(form.gravity[2])
    78.4 cos(q2 + q3)
    """
    count = robot.joint_count
    if "prismatic" in robot.joint_types or count > 6:
        raise mo.InputError("closed_form needs a robot of at most six joints, all revolute")
    angles = 2 * np.pi * np.arange(POINTS) / POINTS
    grid = np.array(list(product(angles, repeat=count))).T
    masses = np.array(mo.mass_matrix(robot).map(grid.shape[1])(grid)).reshape(count, -1, count)
    weights = np.array(mo.gravity_torque(robot).map(grid.shape[1])(grid))
    size = float(np.abs(masses).max())
    mass = [[_series(masses[i, :, j], count, size) for j in range(count)] for i in range(count)]
    pull = max(float(np.abs(weights).max()), 1e-300)
    gravity = [_series(row, count, pull) for row in weights]
    every = range(count)
    symbols = [[[_christoffel(mass, i, j, k) for k in every] for j in every] for i in every]
    return ClosedForm(
        tuple(map(tuple, mass)),
        tuple(tuple(map(tuple, rows)) for rows in symbols),
        tuple(gravity),
    )


def _christoffel(mass: list[list[Series]], i: int, j: int, k: int) -> Series:
    """``c[i][j][k] = (dM[i][j]/dq[k] + dM[i][k]/dq[j] - dM[j][k]/dq[i]) / 2``."""
    slopes = (mass[i][j].slope(k), mass[i][k].slope(j), mass[j][k].slope(i))
    return _combined(list(zip((0.5, 0.5, -0.5), slopes, strict=True)))


def _series(values: np.ndarray, count: int, size: float) -> Series:
    """Coefficients of values on the grid, those that are only rounding left out."""
    spectrum = np.fft.fftn(values.reshape((POINTS,) * count)) / values.size
    terms = {}
    for place in product(range(POINTS), repeat=count):
        k = tuple((entry + POINTS // 2) % POINTS - POINTS // 2 for entry in place)
        if k < (0,) * count:
            continue  # the conjugate of its opposite
        factor = 2.0 if any(k) else 1.0
        a, b = factor * spectrum[place].real, -factor * spectrum[place].imag
        terms[k] = (_clean(a, size), _clean(b, size))
    return Series({k: pair for k, pair in terms.items() if any(pair)})


def _clean(value: float, size: float) -> float:
    """The value without its rounding, as a number with few decimals would be."""
    if abs(value) < NEGLIGIBLE * size:
        return 0.0
    rounded = round(float(value), 9)
    return rounded if abs(rounded - value) < NEGLIGIBLE * size else float(value)


def _combined(weighted: list[tuple[float, Series]]) -> Series:
    total: dict[Index, tuple[float, float]] = {}
    for weight, series in weighted:
        for k, (a, b) in series.terms.items():
            before = total.get(k, (0.0, 0.0))
            total[k] = (before[0] + weight * a, before[1] + weight * b)
    return Series({k: pair for k, pair in total.items() if max(map(abs, pair)) > 1e-12})


def _order(k: Index) -> tuple[int, Index]:
    return sum(map(abs, k)), tuple(-entry for entry in k)


def _angle(k: Index) -> str:
    text = ""
    for joint, factor in enumerate(k, start=1):
        if factor:
            sign = "-" if factor < 0 else "+" if text else ""
            size = "" if abs(factor) == 1 else f"{abs(factor)} "
            text += f" {sign} {size}q{joint}" if text else f"{sign}{size}q{joint}"
    return text
