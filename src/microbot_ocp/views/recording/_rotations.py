"""Quaternions as Rerun takes them: (x, y, z, w), of unit length."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.checks import FloatArray


def quaternions(rotations: FloatArray) -> FloatArray:
    """Quaternions [N,4] of rotation matrices [N,3,3].

    4 q q' is linear in the matrix, and every row of it is a multiple of q; the row with the
    largest diagonal entry is far from zero.
    """
    r = rotations
    square = np.empty((len(r), 4, 4))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        square[:, i, i] = 1 + r[:, i, i] - r[:, j, j] - r[:, k, k]
        square[:, i, j] = square[:, j, i] = r[:, i, j] + r[:, j, i]
        square[:, i, 3] = square[:, 3, i] = r[:, k, j] - r[:, j, k]
    square[:, 3, 3] = 1 + np.trace(r, axis1=1, axis2=2)
    best = np.diagonal(square, axis1=1, axis2=2).argmax(axis=1)
    rows = square[np.arange(len(r)), best]
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def along_z(vectors: FloatArray) -> FloatArray:
    """Quaternions [N,4] that turn the z axis into the directions of vectors [N,3]."""
    length = np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    x, y, z = (vectors / length).T
    turned = np.column_stack([-y, x, np.zeros_like(x), 1 + z])
    turned[z < -1 + 1e-9] = (1.0, 0.0, 0.0, 0.0)  # half a turn, about any level axis
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)
