"""Joint paths to be timed: straight lines, checks, and the segments between stops."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.planning.path._curve import VANISHING, PathCurve, vanishing_orders
from microbot_ocp.planning.task import check_pace, check_positions, check_rest, locked_joints

CORNER = 1e-6  # relative jump of the tangent that counts as a corner


def straight_path(via_q: ArrayLike) -> PiecewisePolynomial:
    """Draw straight lines in joint space through via points [m,n]; s is the distance, rad."""
    via = checks.array("via_q", via_q, (None, None), "rad")
    if via.shape[0] < 2:
        raise InputError(f"via_q must have at least 2 points, not {via.shape[0]}")
    return straight_through(via)


def straight_through(via: FloatArray) -> PiecewisePolynomial:
    """Do as :func:`straight_path` with via points [m,n] that are checked."""
    steps = np.diff(via, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    if np.any(lengths == 0):
        i = int(np.argmax(lengths == 0)) + 1
        raise InputError(f"via points {i} and {i + 1} are the same: no path between them")
    breaks = np.concatenate([[0.0], np.cumsum(lengths)])
    return PiecewisePolynomial(breaks, np.stack([via[:-1], steps / lengths[:, None]], axis=1))


def check_path(family: LimitFamily, path: PiecewisePolynomial) -> FloatArray:
    """Raise InputError where a path cannot be timed, whatever the timing; else give its stops."""
    robot = family.robot
    if path.coefficients.shape[2] != robot.joint_count:
        raise InputError(
            f"path must have {robot.joint_count} joints, not {path.coefficients.shape[2]}"
        )
    if not np.isfinite(path.coefficients).all():
        raise InputError("path must be finite")
    places = path(np.linspace(path.breaks[0], path.breaks[-1], 101))
    check_pace(family, places)
    for joint in np.flatnonzero(locked_joints(family) & (np.ptp(places, axis=0) > 0)):
        raise InputError(
            f"path moves joint {robot.joint_names[joint]!r}, which cannot move: a limit of its "
            "velocity, acceleration or jerk is 0"
        )
    s = np.linspace(path.breaks[:-1], path.breaks[1:], 51, axis=1).ravel()
    check_positions(family, lambda i: f"path at s = {s[i]:g}", path(s, from_left=True))
    between = stops(path, family)
    rests = np.array([path.breaks[0], *between, path.breaks[-1]])
    check_rest(family, lambda i: f"path at s = {rests[i]:g}", path(rests))
    return between


def corners(path: PiecewisePolynomial) -> FloatArray:
    """Find the breaks at which the tangent jumps, or vanishes while its direction jumps."""
    before, after, size = _at_breaks(path, path.derivative())
    rests = np.maximum(np.abs(before), np.abs(after)).max(axis=1) <= VANISHING * size
    turns = [
        bool(rest) and _turns(path, float(s))
        for s, rest in zip(path.breaks[1:-1], rests, strict=True)
    ]
    return path.breaks[1:-1][_jumps(before, after, size) | np.array(turns, dtype=bool)]


def stops(path: PiecewisePolynomial, family: LimitFamily) -> FloatArray:
    """Find the breaks at which the arm has to stop.

    At corners, and under limits of the jerk or the torque rate wherever the curvature jumps, too:
    in motion the acceleration would jump with it.
    """
    turns = corners(path)
    if not family.jerk_matters:
        return turns
    bends = _jumps(*_at_breaks(path, path.derivative().derivative()))
    return np.union1d(turns, path.breaks[1:-1][bends])


def segments(
    path: PiecewisePolynomial, between: FloatArray, leaves_like: int = 2
) -> list[PathCurve]:
    """Give what lies between two stops, with a parameter of which an end at rest is this power."""
    if not between.size:
        return [PathCurve.of(path, leaves_like)]
    ends = [path.breaks[0], *between, path.breaks[-1]]
    curves = []
    for before, after in itertools.pairwise(ends):
        keep = (path.breaks[:-1] >= before) & (path.breaks[:-1] < after)
        breaks = np.append(path.breaks[:-1][keep], after)
        curves.append(
            PathCurve.of(PiecewisePolynomial(breaks, path.coefficients[keep]), leaves_like)
        )
    return curves


def _turns(path: PiecewisePolynomial, s: float) -> bool:
    """Tell whether the path comes to rest by itself at a break and goes on in another direction."""
    directions = []
    for from_left, sign in ((False, 1.0), (True, -1.0)):
        (order,) = vanishing_orders(path, np.array([s]), from_left=from_left)
        if order == 0:
            return False
        curve = path
        for _ in range(order + 1):
            curve = curve.derivative()
        direction = sign**order * curve(s, from_left=from_left)[0]
        directions.append(direction / np.linalg.norm(direction))
    return bool(np.abs(directions[0] - directions[1]).max() > CORNER)


def _at_breaks(
    path: PiecewisePolynomial, curve: PiecewisePolynomial
) -> tuple[FloatArray, FloatArray, float]:
    """Give a derivative of the path before and after inner breaks [K-1,n], and its largest size."""
    inner, places = path.breaks[1:-1], np.linspace(path.breaks[0], path.breaks[-1], 101)
    size = float(np.abs(curve(places)).max())
    return curve(inner, from_left=True), curve(inner), size


def _jumps(before: FloatArray, after: FloatArray, size: float) -> NDArray[np.bool_]:
    """Tell at which breaks a derivative of the path jumps."""
    return np.abs(after - before).max(axis=1) > CORNER * size
