"""Equations of an arm in closed form: sums of products of cosines and sines.

Every entry of a pose is a trigonometric polynomial of degree 1 in each joint angle and a polynomial
of degree 1 in each displacement of a prismatic joint. The mass matrix has degree 2, the gravity
torque degree 1. A discrete Fourier transform of 3 or 5 values per joint, or interpolation at 2 or 3
displacements, therefore gives all coefficients, without computer algebra. Angles of joints with
parallel axes share one cosine (``cos(q2 + q3)``); those of other joints are separate factors. The
Christoffel symbols have degree 2, too (Craig, *Introduction to Robotics*, 3rd ed., section 6.8).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Literal, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.writing import write_whole
from microbot_ocp.robot._dynamics import coriolis_matrix, gravity_torque, mass_matrix
from microbot_ocp.robot._kinematics import forward_kinematics
from microbot_ocp.robot._model import Robot
from microbot_ocp.robot._transforms import NEGLIGIBLE, PARALLEL

MOST_JOINTS = 6  # the mass matrix of the Panda, with seven joints, has 15 000 terms
ENDINGS = {".tex": "latex", ".py": "python", ".c": "c", ".m": "matlab"}
Runs = tuple[tuple[int, ...], ...]
Language = Literal["latex", "python", "c", "matlab"]


class Term(NamedTuple):
    """Product of waves and powers that a coefficient multiplies.

    ``powers`` has one integer per joint: the exponent of a displacement, or the factor of an angle
    in its wave. ``waves`` has "cos", "sin" or "" for each run of parallel joints.
    """

    powers: tuple[int, ...]
    waves: tuple[str, ...]


@dataclass(frozen=True)
class Series:
    """A sum of products of waves and displacements.

    Attributes
    ----------
    terms : dict
        Coefficients by :class:`Term`.
    runs : tuple
        Indices of the revolute joints, grouped by parallel axes.
    """

    terms: dict[Term, float]
    runs: Runs

    def __call__(self, q: ArrayLike) -> float:
        """Return the value at joint positions q [n], rad (prismatic: m)."""
        at = np.asarray(q, dtype=float)
        total = 0.0
        for term, value in self.terms.items():
            for wave, run in zip(term.waves, self.runs, strict=True):
                if wave:
                    angle = sum(term.powers[joint] * at[joint] for joint in run)
                    value *= np.cos(angle) if wave == "cos" else np.sin(angle)
            for joint in self.displacements:
                value *= at[joint] ** term.powers[joint]
            total += value
        return float(total)

    def __str__(self) -> str:
        from microbot_ocp.robot._equation_text import plain

        return plain(self)

    @cached_property
    def displacements(self) -> list[int]:
        """Indices of the prismatic joints in the terms."""
        turning = {joint for run in self.runs for joint in run}
        count = max((len(term.powers) for term in self.terms), default=0)
        return [joint for joint in range(count) if joint not in turning]


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """Pose of the tool, and ``M(q) qdd + C(q, qd) qd + g(q) = tau``, kg m^2 and N m.

    :func:`closed_form` makes it. Friction is not included. A robot without masses has a pose only;
    the other attributes are empty.

    Attributes
    ----------
    robot : Robot
    pose : tuple of tuple of Series
        Pose ``T[4][4]`` of the tool in the base frame.
    mass : tuple of tuple of Series
        Mass matrix ``M[n][n]``.
    christoffel : tuple of tuple of tuple of Series
        Symbols ``c[n][n][n]`` with ``C[i][j] = sum over k of c[i][j][k] qd[k]`` and
        ``c[i][j][k] = c[i][k][j]``.
    gravity : tuple of Series
        Gravity torque ``g[n]``.
    """

    robot: Robot
    pose: tuple[tuple[Series, ...], ...]
    mass: tuple[tuple[Series, ...], ...]
    christoffel: tuple[tuple[tuple[Series, ...], ...], ...]
    gravity: tuple[Series, ...]

    def coriolis_text(self, i: int, j: int) -> str:
        """Return the entry ``C[i][j]`` (from 0) as text with ``qd1``, ``qd2`` and so on."""
        entry = enumerate(self.christoffel[i][j], start=1)
        return " + ".join(f"({series}) qd{k}" for k, series in entry if series.terms) or "0"

    def lines(self) -> list[str]:
        """Return the entries of M, C and G, one per line; of M only the upper triangle."""
        count = len(self.gravity)
        pairs = [(i, j) for i in range(count) for j in range(count)]
        lines = [f"M{i + 1}{j + 1} = {self.mass[i][j]}" for i, j in pairs if j >= i]
        lines += [f"C{i + 1}{j + 1} = {self.coriolis_text(i, j)}" for i, j in pairs]
        return lines + [f"G{i + 1} = {series}" for i, series in enumerate(self.gravity)]

    def text(self, language: Language) -> str:
        """Return all equations as a LaTeX document, or as source text independent of this package.
        Parameters
        ----------
        language : {"latex", "python", "c", "matlab"}
            LaTeX has six digits of every coefficient, the others have all. Programs have the
            functions ``forward_kinematics``, ``mass_matrix``, ``coriolis_matrix`` and
            ``gravity_torque``; a MATLAB file has another that returns all four results.

        Returns
        -------
        str

        Raises
        ------
        InputError
            The language is unknown.

        Examples
        --------
        >>> import microbot_ocp as mo
        >>> program = {}
        >>> exec(mo.robot.closed_form(mo.load_robot("planar_2r")).text("python"), program)
        >>> [round(row[3], 6) for row in program["forward_kinematics"]([0.0, 0.0])]
        [1.0, 0.0, 0.0, 1.0]
        """
        checks.one_of("language", language, ENDINGS.values())
        from microbot_ocp.robot import _equation_text

        if language == "latex":
            return _equation_text.latex(self)
        return _equation_text.program(self, language)

    def export(self, path: str | Path) -> Path:
        """Write :meth:`text` in the language of the path's suffix: .tex, .py, .c or .m.

        Raises
        ------
        InputError
            The suffix is unknown.
        NotWritten
            The file cannot be written.
        """
        checks.one_of("ending", Path(path).suffix, ENDINGS)
        return write_whole(path, self.text(ENDINGS[Path(path).suffix]))  # type: ignore[arg-type]


def closed_form(robot: Robot) -> ClosedForm:
    """Return the pose, mass matrix, Coriolis matrix and gravity torque of a robot in closed form.

    Parameters
    ----------
    robot : Robot
        Robot with at most six joints, revolute or prismatic, including those that follow others.

    Returns
    -------
    ClosedForm
        Pose, mass matrix, Christoffel symbols and gravity torques as series.

    Raises
    ------
    InputError
        The robot has more than six joints, or a revolute joint follows another by a factor that is
        no whole number, or follows a prismatic joint: its equations are no finite sum of sines.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> form = mo.robot.closed_form(mo.load_robot("microbot"))
    >>> print(form.pose[0][3])
    3 cos(q1) cos(q2) + 4 cos(q1) cos(q2 + q3)
    >>> print(form.mass[1][1])
    68 + 48 cos(q3)
    >>> print(form.coriolis_text(2, 1))
    (24 sin(q3)) qd2
    >>> print(mo.robot.closed_form(mo.load_robot("stanford")).gravity[2])
    63.4707 cos(q2)
    """
    if robot.link_count > MOST_JOINTS:
        raise InputError(
            f"closed_form needs a robot of at most {MOST_JOINTS} joints, not {robot.link_count}"
        )
    turns = (np.array(robot.chain.joint_types) == "revolute") @ np.abs(robot.transmission)
    for joint in np.flatnonzero((turns > 0) & ~robot.whole_turns).tolist():
        raise InputError(
            "closed_form needs joints that turn others by whole numbers: "
            f"{robot.joint_names[joint]!r} does not"
        )
    pose = _expanded(robot, forward_kinematics(robot), 1)
    if not robot.has_dynamics:
        return ClosedForm(robot, pose, (), (), ())
    count = robot.joint_count
    q, qd = ca.SX.sym("q", count), ca.SX.sym("qd", count)
    # The Coriolis matrix is linear in the speeds; its slopes are the Christoffel symbols.
    slopes = ca.jacobian(ca.vec(coriolis_matrix(robot)(q, qd)), qd)
    symbols = _expanded(robot, ca.Function("christoffel", [q], [ca.densify(slopes)]), 2)
    # Row i + n j has the symbols of the entry C[i][j].
    christoffel = tuple(symbols[i::count] for i in range(count))
    mass = _expanded(robot, mass_matrix(robot), 2)
    gravity = _expanded(robot, gravity_torque(robot), 1)
    return ClosedForm(robot, pose, mass, christoffel, tuple(row[0] for row in gravity))


def _expanded(robot: Robot, function: ca.Function, degree: int) -> tuple[tuple[Series, ...], ...]:
    """Return the entries of a function of q of at most this degree."""
    count = robot.joint_count
    turns = [kind == "revolute" for kind in robot.joint_types]
    q = ca.SX.sym("q", count)
    value = function(q)
    joints = [joint for joint in range(count) if ca.depends_on(value, q[joint])]
    along = np.linspace(-1.0, 1.0, degree + 1)
    # An angle of degree k needs 2 k + 1 samples; joints that follow raise the degree.
    around = 2 * degree * np.abs(robot.transmission).sum(axis=0).astype(int) + 1
    axes = [
        np.arange(around[joint]) * 2 * np.pi / around[joint] if turns[joint] else along
        for joint in joints
    ]
    grid = np.zeros((count, int(np.prod([axis.size for axis in axes]))))
    grid[joints] = np.array(list(product(*axes))).T.reshape(len(joints), grid.shape[1])
    rows, columns = value.shape
    values = np.array(function.map(grid.shape[1])(grid)).reshape(rows, -1, columns)
    size = float(np.abs(values).max())
    # Axis by axis, values become Fourier coefficients of angles or coefficients of powers.
    spectrum = np.moveaxis(values, 1, 2).reshape(rows, columns, *(axis.size for axis in axes))
    for place, (joint, axis) in enumerate(zip(joints, axes, strict=True), start=2):
        if turns[joint]:
            spectrum = np.fft.fft(spectrum, axis=place) / axis.size
        else:
            inverse = np.linalg.inv(np.vander(axis, increasing=True))
            spectrum = np.moveaxis(np.tensordot(inverse, spectrum, axes=(1, place)), 0, place)
    runs = _runs(robot)

    def series(entry: np.ndarray) -> Series:
        terms: dict[Term, float] = {}
        for place in map(tuple, np.argwhere(np.abs(entry) > NEGLIGIBLE / 2 * size)):
            powers = [0] * count
            for joint, axis, at in zip(joints, axes, place, strict=True):
                # The upper half of a discrete spectrum has the negative frequencies.
                folded = turns[joint] and at > axis.size // 2
                powers[joint] = int(at) - (axis.size if folded else 0)
            _add_wave(terms, complex(entry[place]), powers, runs)
        return Series(_cleaned(terms, size), runs)

    return tuple(tuple(series(entry) for entry in row) for row in spectrum)


def _runs(robot: Robot) -> Runs:
    """Return revolute joints grouped by parallel neighbours; each alone if any joint follows."""
    runs: list[list[int]] = []
    parallel = (np.abs(np.sin(robot.alpha)) < PARALLEL) & (robot.beta == 0)
    for joint, kind in enumerate(robot.joint_types):
        if joint == 0 or robot.coupling is not None or not parallel[joint]:
            runs.append([])
        if kind == "revolute":
            runs[-1].append(joint)
    return tuple(tuple(run) for run in runs if run)


def _add_wave(
    terms: dict[Term, float], coefficient: complex, powers: list[int], runs: Runs
) -> None:
    """Add the real part of ``coefficient exp(i k . q)``, multiplied out between the runs."""
    powers = list(powers)
    signs = []
    for run in runs:
        leading = next((powers[joint] for joint in run if powers[joint]), 0)
        signs.append((leading > 0) - (leading < 0))
        if leading < 0:
            for joint in run:
                powers[joint] = -powers[joint]
    # Each run has exp(i s x) = cos x + i s sin x, with the sign s of its leading factor.
    for waves in product(*(("cos", "sin") if sign else ("",) for sign in signs)):
        factor = coefficient
        for wave, sign in zip(waves, signs, strict=True):
            if wave == "sin":
                factor *= 1j * sign
        term = Term(tuple(powers), waves)
        terms[term] = terms.get(term, 0.0) + factor.real


def _cleaned(terms: dict[Term, float], size: float) -> dict[Term, float]:
    """Return the terms above rounding, each with as few digits as necessary."""
    close = NEGLIGIBLE * size
    amplitudes = {}
    for term, value in sorted(terms.items(), key=lambda item: _place(item[0])):
        if abs(value) > 2 * close:
            texts = (float(f"{value:.{digits}g}") for digits in range(1, 18))
            amplitudes[term] = next(text for text in texts if abs(text - value) <= close)
    return amplitudes


def _place(term: Term) -> tuple[int, tuple[int, ...], tuple[str, ...]]:
    """Return a sort key: short terms first, ties by joint."""
    return sum(map(abs, term.powers)), tuple(-power for power in term.powers), term.waves
