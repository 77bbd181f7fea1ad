"""From where the arms among obstacles are seen best."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import Capsule
from microbot_ocp.scene import Box, ConvexMesh, Cylinder, HalfSpace, Sphere

ALONG = 40  # points of a line of sight
ENOUGH = 0.1  # share of what is to be seen that may be hidden
TURNS = np.radians([0.0, -45.0, 45.0, -90.0, 90.0, -135.0, 135.0, 180.0])


def hidden_share(eye: FloatArray, points: FloatArray, obstacles: Sequence[Any]) -> float:
    """Share of points [N,3] that an obstacle hides from an eye [3]."""
    share = np.linspace(0.02, 0.98, ALONG)[:, None, None]
    between = (eye + share * (points - eye)).reshape(-1, 3)
    hidden = np.zeros(len(points), dtype=bool)
    for obstacle in obstacles:
        hidden |= _inside(obstacle, between).reshape(ALONG, -1).any(axis=0)
    return float(hidden.mean())


def _inside(obstacle: Any, points: FloatArray) -> Any:
    """Which points [N,3] are inside of an obstacle; of a mesh inside of a box around it."""
    if isinstance(obstacle, HalfSpace):
        return points @ obstacle.normal < obstacle.offset
    if isinstance(obstacle, Sphere):
        return np.linalg.norm(points - obstacle.center, axis=1) < obstacle.radius
    if isinstance(obstacle, Capsule):
        along = obstacle.end - obstacle.start
        length = max(float(along @ along), 1e-12)
        place = np.clip((points - obstacle.start) @ along / length, 0.0, 1.0)
        nearest = obstacle.start + place[:, None] * along
        return np.linalg.norm(points - nearest, axis=1) < obstacle.radius
    own = (points - obstacle.pose[:3, 3]) @ obstacle.pose[:3, :3]
    if isinstance(obstacle, Box):
        return (np.abs(own) < obstacle.size / 2).all(axis=1)
    if isinstance(obstacle, Cylinder):
        round_ = np.linalg.norm(own[:, :2], axis=1) < obstacle.radius
        return round_ & (np.abs(own[:, 2]) < obstacle.length / 2)
    assert isinstance(obstacle, ConvexMesh)
    low, high = obstacle.vertices.min(axis=0), obstacle.vertices.max(axis=0)
    return ((own > low) & (own < high)).all(axis=1)
