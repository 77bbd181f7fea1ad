"""Whether a point where a solver stopped without success is an optimum all the same.

fatrop leaves the multipliers of equations as they are once its steps have become zero, and goes on
to its limit of iterations, or gives up: of a linear-quadratic problem without inequalities it has
the solution after one iteration and never knows. Its multipliers of the equations are therefore
found anew, by least squares, before the conditions of Karush, Kuhn and Tucker are judged.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.transcription import Program

REGULAR = 1e-14  # against equations that say the same twice


@dataclass(frozen=True, eq=False)
class Accepted:
    """Multipliers with which a point is an optimum, and the largest error of its conditions."""

    row_multipliers: FloatArray
    variable_multipliers: FloatArray
    error: float


def accepted(
    program: Program,
    x: FloatArray,
    row_multipliers: FloatArray,
    variable_multipliers: FloatArray,
    tolerance: float,
) -> Accepted | None:
    """Multipliers that prove x within the tolerance, or None where these do not.

    Multipliers of inequalities stay as the solver left them, without those that are smaller than
    the distance to their limit, which a barrier leaves: they must have the right sign and vanish
    away from their limits. Errors are of the scaled program, the cost divided by its scale,
    and judged as IPOPT does (Waechter and Biegler, 2006, equation 5).
    """
    g, jacobian = program.functions["jacobian"](x, program.parameters)
    _, slope = program.functions["gradient"](x, program.parameters)
    rows = np.array(g).ravel()
    finite = all(np.isfinite(v).all() for v in (x, rows, row_multipliers, variable_multipliers))
    if not finite or not program.violations(x, rows).max() <= tolerance:
        return None
    lam_g, lam_x = (
        np.array(lam) / program.cost_scale for lam in (row_multipliers, variable_multipliers)
    )
    equal = np.flatnonzero(program.row_lower == program.row_upper)
    fixed = np.flatnonzero(program.variable_lower == program.variable_upper)
    lam_g[equal], lam_x[fixed] = 0.0, 0.0
    lam_g[np.abs(lam_g) < _distance(lam_g, rows, program.row_lower, program.row_upper)] = 0.0
    own = _distance(lam_x, x, program.variable_lower, program.variable_upper)
    lam_x[np.abs(lam_x) < own] = 0.0
    given = np.array(slope).ravel() / program.cost_scale
    given = given + np.array(ca.mtimes(jacobian.T, ca.DM(lam_g))).ravel() + lam_x
    try:
        lam_g[equal], lam_x[fixed], left = _least_squares(jacobian, equal, fixed, given)
    except RuntimeError:  # the matrix has no factors
        return None
    size = max(100.0, float(np.mean(np.abs(np.concatenate([lam_g, lam_x]))))) / 100.0
    error = max(
        float(np.abs(left).max()),
        _wrong(lam_g, rows, program.row_lower, program.row_upper),
        _wrong(lam_x, x, program.variable_lower, program.variable_upper),
    )
    error /= size
    if not error <= tolerance:
        return None
    return Accepted(lam_g * program.cost_scale, lam_x * program.cost_scale, error)


def _least_squares(
    jacobian: ca.DM, equal: np.ndarray, fixed: np.ndarray, given: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Multipliers of equations and fixed variables that leave least of a slope, and the rest."""
    pick = ca.DM.triplet(
        list(range(fixed.size)), fixed.tolist(), ca.DM.ones(fixed.size), fixed.size, given.size
    )
    rows = ca.vertcat(jacobian[equal.tolist(), :], pick)
    count = rows.shape[0]
    matrix = ca.blockcat([[ca.DM.eye(given.size), rows.T], [rows, -REGULAR * ca.DM.eye(count)]])
    right = ca.DM(np.concatenate([-given, np.zeros(count)]))
    solved = np.array(ca.solve(matrix, right, "qr")).ravel()
    lam = solved[given.size :]
    left = given + np.array(ca.mtimes(rows.T, ca.DM(lam))).ravel()
    return lam[: equal.size], lam[equal.size :], left


def _distance(
    lam: FloatArray, value: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """Distance to the limit that a multiplier is of."""
    return np.where(lam > 0, upper - value, value - lower)


def _wrong(lam: FloatArray, value: FloatArray, lower: FloatArray, upper: FloatArray) -> float:
    """Largest multiplier times distance to its limit, or multiplier of a limit that is none."""
    distance = _distance(lam, value, lower, upper)
    acts = (lam != 0) & (lower < upper)
    weight = np.where(np.isfinite(distance), np.maximum(distance, 0.0), 1.0)
    return float(np.max(np.abs(lam) * weight, where=acts, initial=0.0))
