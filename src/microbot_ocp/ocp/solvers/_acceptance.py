"""Whether a point where a solver stopped without success is an optimum all the same.

fatrop leaves the multipliers of equations as they are once its steps have become zero, and goes on
to its limit of iterations, or gives up: of a linear-quadratic problem without inequalities it has
the solution after one iteration and never knows. Its multipliers of the equations are therefore
found anew, by least squares, before the conditions of Karush, Kuhn and Tucker are judged.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.solution import StartingPoint
from microbot_ocp.ocp.transcription import Program

REGULAR = 1e-14  # against equations that say the same twice


def accepted(
    program: Program, point: StartingPoint, tolerance: float
) -> tuple[StartingPoint, float] | None:
    """Return the point with multipliers that prove it an optimum within the tolerance, and the
    largest error of its conditions; None where none do.

    Multipliers of inequalities stay as the solver left them, without those that are smaller than
    the distance to their limit, which a barrier leaves: they must have the right sign and vanish
    away from their limits. Errors are of the scaled program, the cost divided by its scale,
    and judged as IPOPT does (Waechter and Biegler, 2006, equation 5).
    """
    x, multipliers = point.x, point.multipliers
    g, jacobian = program.functions["jacobian"](x, program.parameters)
    _, slope = program.functions["gradient"](x, program.parameters)
    rows = np.array(g).ravel()
    finite = all(np.isfinite(v).all() for v in (x, rows, *multipliers))
    if not finite or not program.violations(x, rows).max() <= tolerance:
        return None
    low, high, value = program.lower, program.upper, np.concatenate([rows, x])
    lam = np.concatenate(multipliers) / program.cost_scale
    decided = np.flatnonzero(low == high)
    lam[decided] = 0.0
    lam[np.abs(lam) < np.where(lam > 0, high - value, value - low)] = 0.0
    given = np.array(slope).ravel() / program.cost_scale
    given = given + np.array(ca.mtimes(jacobian.T, ca.DM(lam[: rows.size]))).ravel()
    given = given + lam[rows.size :]
    slopes = ca.vertcat(jacobian, ca.DM.eye(x.size))[decided.tolist(), :]
    try:
        lam[decided], left = _least_squares(slopes, given)
    except RuntimeError:  # the matrix has no factors
        return None
    # a multiplier times the distance to its limit, or one of a limit that is none
    distance = np.where(lam > 0, high - value, value - low)
    weight = np.where(np.isfinite(distance), np.maximum(distance, 0.0), 1.0)
    acts = (lam != 0) & (low < high)
    error = max(np.abs(left).max(), np.max(np.abs(lam) * weight, where=acts, initial=0.0))
    error /= max(100.0, np.mean(np.abs(lam))) / 100.0
    if not error <= tolerance:
        return None
    lam *= program.cost_scale
    return StartingPoint(x, lam[: rows.size], lam[rows.size :]), float(error)


def _least_squares(slopes: ca.DM, given: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return multipliers of equations and fixed variables that leave least of a slope, and the
    rest.
    """
    count = slopes.shape[0]
    matrix = ca.blockcat([[ca.DM.eye(given.size), slopes.T], [slopes, -REGULAR * ca.DM.eye(count)]])
    right = ca.DM(np.concatenate([-given, np.zeros(count)]))
    lam = np.array(ca.solve(matrix, right, "qr")).ravel()[given.size :]
    return lam, given + np.array(ca.mtimes(slopes.T, ca.DM(lam))).ravel()
