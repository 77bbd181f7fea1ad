"""libfranka's ``limitRate`` for joint positions, written again from its published formulas.

github.com/frankaemika/libfranka, src/rate_limiting.cpp: the command of a step is left as it is
where its velocity, acceleration and jerk by differences stay within bounds.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

STEP = 1e-3
EPSILON = 1e-3
Bounds = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def limited(q: np.ndarray, velocity: Bounds, acceleration: np.ndarray, jerk: np.ndarray):
    """Commands [N,n] after the limiter, each step from the limited ones before it."""
    out = [q[0]]
    v = a = np.zeros(q.shape[1])
    for wanted in q[1:]:
        lower, upper = velocity(out[-1])
        asked = (wanted - out[-1]) / STEP
        wanted_jerk = ((asked - v) / STEP - a) / STEP
        new = a + np.clip(wanted_jerk, -jerk, jerk) * STEP
        most = np.minimum(jerk / acceleration * (upper - v), acceleration)
        least = np.maximum(jerk / acceleration * (lower - v), -acceleration)
        a = np.maximum(np.minimum(new, most), least)
        v = v + a * STEP
        out.append(out[-1] + v * STEP)
    return np.array(out)


A_PANDA = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0]) - EPSILON
J_PANDA = np.array([7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0]) - EPSILON
V_PANDA = np.array([2.175] * 4 + [2.61] * 3) - EPSILON - 3.0 * STEP * A_PANDA


def panda(q: np.ndarray) -> np.ndarray:
    return limited(q, lambda _: (-V_PANDA, V_PANDA), A_PANDA, J_PANDA)


V_FR3 = np.array([2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26])
OFFSET = np.array([0.30, 0.20, 0.20, 0.30, 0.35, 0.35, 0.35])
SLOPE = np.array([12.0, 5.17, 7.0, 8.0, 34.0, 11.0, 34.0])
TOP = np.array([2.7501, 1.7918, 2.9065, -0.1458, 2.8101, 4.5205, 3.0196])
BOTTOM = np.array([-2.7501, -1.7918, -2.9065, -3.0481, -2.8101, 0.54092, -3.0196])


def fr3(q: np.ndarray) -> np.ndarray:
    def velocity(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        up = np.sqrt(np.maximum(0.0, SLOPE * (TOP - at))) - OFFSET
        down = np.sqrt(np.maximum(0.0, SLOPE * (at - BOTTOM))) - OFFSET
        upper = np.minimum(V_FR3, np.maximum(0.0, up)) - EPSILON
        return EPSILON - np.minimum(V_FR3, np.maximum(0.0, down)), upper

    return limited(q, velocity, np.full(7, 10.0 - EPSILON), np.full(7, 5000.0 - EPSILON))
