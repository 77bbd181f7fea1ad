"""Rotations and homogeneous transforms from angles, DH rows and quaternions.

Fixed angles are roll, pitch, yaw about the axes of the base (Craig, 3rd ed., equation 2.64).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError, warn_user


def transform_of(rotation: ArrayLike, position: ArrayLike) -> FloatArray:
    """Return the homogeneous transform [4,4] of a rotation [3,3] and a position [3]."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position
    return matrix


NEGLIGIBLE = 4 * np.finfo(float).eps  # relative to the largest value: rounding of a transform
PARALLEL = 1e-12  # rad and m, rounding in the computed angle or distance between equal axes


def without_rounding(matrix: FloatArray) -> FloatArray:
    """Return the matrix with rounding errors of right angles set to zero."""
    return np.where(np.abs(matrix) < NEGLIGIBLE, 0.0, matrix)


def rotation_of(angles: ArrayLike) -> FloatArray:
    """Return the rotation [3,3] from roll, pitch, yaw [3] about the base axes, rad."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles), np.sin(angles)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def fixed_angles(rotation: ArrayLike) -> FloatArray:
    """Return roll, pitch, yaw [3], rad, of a rotation [3,3]; yaw is 0 at a pitch of a quarter turn.
    >>> fixed_angles(rotation_of([0.1, 0.2, 0.3])).round(6).tolist()
    [0.1, 0.2, 0.3]
    """
    m = checks.array("rotation", rotation, (3, 3))
    vertical = np.hypot(m[0, 0], m[1, 0]) < NEGLIGIBLE  # roll and yaw are about one axis
    yaw = 0.0 if vertical else np.arctan2(m[1, 0], m[0, 0])
    # The order yaw, pitch, roll keeps full precision for any pitch.
    cos, sin = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-m[2, 0], cos * m[0, 0] + sin * m[1, 0])
    roll = np.arctan2(sin * m[0, 2] - cos * m[1, 2], cos * m[1, 1] - sin * m[0, 1])
    return np.array([roll, pitch, yaw])


def dh_transform(alpha: float, a: float, d: float, theta: float, beta: float = 0.0) -> FloatArray:
    """Return the transform [4,4] of a modified-DH row (Craig, equation 3.6) with Hayati's beta."""
    # The inverse of Rot_x(alpha) Rot_y(beta) Rot_z(theta) turns about Z last, as fixed angles do.
    rotation = rotation_of([-alpha, -beta, -theta]).T
    matrix = transform_of(rotation, np.array([a, 0.0, 0.0]) + d * rotation[:, 2])
    return matrix + 0.0  # + 0.0 turns -0.0, which would be printed, into 0.0


# Relative errors of numbers written with six digits and with four: of rotations (R R' against the
# identity), unit vectors, inertias.
EXACT, ROUNDED = 1e-6, 1e-3


def nearest_rotation(matrix: ArrayLike) -> FloatArray:
    """Return the rotation [3,3] with the least sum of squared differences from a matrix [3,3].

    The method is in Golub and Van Loan, *Matrix Computations*, 4th ed., section 6.4.1.

    Examples
    --------
    >>> nearest_rotation([[0.71, -0.71, 0.0], [0.71, 0.71, 0.0], [0.0, 0.0, 1.0]])[0].round(6)
    array([ 0.707107, -0.707107,  0.      ])
    """
    left, _, right = np.linalg.svd(checks.array("matrix", matrix, (3, 3)))
    # A reflection becomes a rotation in the direction of the least singular value.
    left[:, 2] *= np.sign(np.linalg.det(left @ right))
    return left @ right


def checked_rotations(name: str, matrices: FloatArray) -> FloatArray:
    """Return rotations [...,3,3]; rounded ones become the nearest rotation, with a warning.

    ``name`` may contain {} for the index of the matrix.
    """
    slip = np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)).max(axis=(-2, -1))
    mirrored = np.linalg.det(matrices) <= 0.0
    for i in np.argwhere((slip > ROUNDED) | mirrored)[:1]:
        at = tuple(i)
        why = "it mirrors" if mirrored[at] else f"R R' is {slip[at]:.2g} off the identity"
        remedy = "" if mirrored[at] else "; mo.robot.nearest_rotation(R) is the nearest one"
        raise InputError(
            f"{name.format(*i)} must be a rotation (orthonormal to {ROUNDED:g}, determinant +1), "
            f"but {why}: {matrices[at].tolist()}{remedy}"
        )
    rounded, exact = slip > EXACT, np.array(matrices)
    for i in np.argwhere(rounded):
        exact[tuple(i)] = nearest_rotation(matrices[tuple(i)])
    if rounded.any():
        warn_user(
            f"{name.format('')} has few digits, R R' is {slip.max():.1g} off the identity: the "
            "nearest rotation is taken"
        )
    return exact


def rigid_transform(name: str, value: ArrayLike | None) -> FloatArray:
    """Return a read-only transform [4,4] from one, from a DH row [4], or the identity for None."""
    if value is None:
        matrix = np.eye(4)
    elif np.ndim(np.asarray(value, dtype=object)) == 1:
        matrix = dh_transform(*checks.array(name, value, (4,)))
    else:
        matrix = np.array(checks.array(name, value, (4, 4)))
        if np.abs(matrix[3] - [0, 0, 0, 1]).max() > ROUNDING:
            raise InputError(
                f"{name} must be a homogeneous transform with a last row 0 0 0 1, not "
                f"{matrix.tolist()}"
            )
        matrix[:3, :3] = checked_rotations(f"{name}[:3, :3]", matrix[:3, :3])
    matrix.setflags(write=False)
    return matrix


def of_quaternion(quaternion: ArrayLike) -> FloatArray:
    """Return the rotation [3,3] of a quaternion w, x, y, z of any nonzero length."""
    w, x, y, z = np.asarray(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
