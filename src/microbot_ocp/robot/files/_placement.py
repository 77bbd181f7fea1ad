"""Modified-DH rows of any serial chain, from its joint axes at the zero position.

Craig, *Introduction to Robotics*, 3rd ed., section 3.4: Z of link frame i lies along axis i, X
along the common normal from axis i to axis i+1. If that normal is not unique (parallel or
coincident axes, the last axis), the frame stays as close to the previous one as possible. If axes
are almost but not quite parallel, the row has Hayati's angle beta instead of a distant normal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot._transforms import NEGLIGIBLE, PARALLEL, dh_transform, transform_of

NEARLY_PARALLEL = 0.02  # sine of the angle of two axes, below which their common normal is distant


class Rows(NamedTuple):
    """Modified-DH rows [n], frame 0 in the base frame, and all link frames at zero in the base."""

    alpha: FloatArray
    a: FloatArray
    d: FloatArray
    theta: FloatArray
    beta: FloatArray
    base: FloatArray  # [4,4]
    frames: list[FloatArray]  # n of [4,4]


def dh_rows(points: FloatArray, axes: FloatArray, parallel_tolerance: float) -> Rows:
    """Return the rows of a chain with axes through ``points`` along unit vectors ``axes``.

    Parameters
    ----------
    points, axes : array [n,3]
        Points, m, and directions of the axes at the zero position, in the base frame.
    parallel_tolerance : float
        Angle below which axes count as parallel, rad.
    """
    count = len(points)
    base = placed = _frame_zero(points[0], axes[0])
    # The sines are those between successive axes, the first from the base's Z; 0 if parallel.
    sines = np.linalg.norm(np.cross([base[:3, 2], *axes[:-1]], axes), axis=1)
    sines = np.where(sines > parallel_tolerance, sines, 0.0)
    table, frames = np.zeros((count, 5)), []
    for i in range(count):
        x, z, z_next = placed[:3, 0], placed[:3, 2], axes[i]
        alpha, a, beta, foot = _to_axis(placed, points[i], z_next, sines[i])
        if i + 1 < count:
            pair = slice(i, i + 2)
            x_next, origin_next = _normal(points[pair], axes[pair], x, foot, sines[i + 1])
        else:
            x_next, origin_next = _across(x, z_next), foot
        # X is turned by alpha about X and by beta about the new Y.
        z_turned = np.cos(alpha) * z - np.sin(alpha) * np.cross(z, x)
        turned = np.cos(beta) * x - np.sin(beta) * z_turned
        theta = np.arctan2(z_next @ np.cross(turned, x_next), turned @ x_next)
        row = np.array([alpha, a, z_next @ (origin_next - foot), theta, beta])
        table[i] = np.where(np.abs(row) < NEGLIGIBLE, 0.0, row)
        # The rows themselves place the next frame, so that rounding does not accumulate.
        placed = placed @ dh_transform(*table[i])
        frames.append(placed)
    return Rows(*table.T, base=base, frames=frames)


def _frame_zero(point: FloatArray, axis: FloatArray) -> FloatArray:
    """Return frame 0 [4,4] in the base frame; the base frame itself if possible."""
    if axis[2] > 0 and max(np.hypot(*axis[:2]), np.hypot(*point[:2])) < PARALLEL:
        return np.eye(4)
    x = _across(np.eye(3)[0], axis)
    return transform_of(np.column_stack([x, np.cross(axis, x), axis]), point)


def _across(x: FloatArray, z: FloatArray) -> FloatArray:
    """Return the unit vector normal to ``z`` that is closest to ``x``."""
    for candidate in (x, *np.eye(3)):
        normal = candidate - (candidate @ z) * z
        if np.linalg.norm(normal) > 0.5:
            # A second projection makes the vector normal to the last digit.
            normal = normal / np.linalg.norm(normal)
            normal = normal - (normal @ z) * z
            return normal / np.linalg.norm(normal)
    raise AssertionError("one of three unit vectors is always more than 30 degrees off an axis")


def _to_axis(
    frame: FloatArray, point: FloatArray, z_next: FloatArray, sine: float
) -> tuple[float, float, float, FloatArray]:
    """Return twist, length, beta, and the foot of a frame's X, normal to both axes, on the next.

    For nearly parallel axes X leads to the point at which the next axis crosses the plane normal
    to Z.
    """
    x, z, origin = frame[:3, 0], frame[:3, 2], frame[:3, 3]
    across, beside, along = x @ z_next, np.cross(z, x) @ z_next, z @ z_next
    alpha, beta = float(np.arctan2(-beside, along)), 0.0
    if sine == 0.0:
        alpha = 0.0 if along > 0 else np.pi
    elif sine < NEARLY_PARALLEL:
        beta = float(np.arcsin(across))
        point = _crossing(origin, z, point, z_next)
    a = float((point - origin) @ x)
    return alpha, a, beta, origin + a * x


def _crossing(
    origin: FloatArray, z: FloatArray, point_next: FloatArray, z_next: FloatArray
) -> FloatArray:
    """Return the point at which an axis crosses the plane through ``origin`` normal to ``z``."""
    return point_next + (origin - point_next) @ z / (z_next @ z) * z_next


def _normal(
    points: FloatArray, axes: FloatArray, x: FloatArray, foot: FloatArray, sine: float
) -> tuple[FloatArray, FloatArray]:
    """Return unit X along the common normal from one axis [2,3] to the next, and its foot."""
    (point, point_next), (z, z_next) = points, axes
    gap = point_next - point
    if sine < NEARLY_PARALLEL:
        if sine > 0.0:
            gap = _crossing(foot, z, point_next, z_next) - foot
        beside = gap - (gap @ z) * z
        distance = np.linalg.norm(beside)
        return (beside / distance if distance > PARALLEL else _across(x, z)), foot
    cross = np.cross(z, z_next)
    unit = cross / sine
    reach = gap @ unit
    if reach < -PARALLEL or (abs(reach) <= PARALLEL and unit @ x < 0):
        unit = -unit
    return unit, point + (np.cross(gap, z_next) @ cross / sine**2) * z
