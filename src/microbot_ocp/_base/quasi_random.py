"""Points that fill the unit cube evenly, by an additive recurrence.

Source: Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from microbot_ocp._base.checks import FloatArray


@lru_cache(maxsize=16)
def evenly_spread_step(dimensions: int) -> FloatArray:
    """Return the step [d] of an additive recurrence that fills the unit cube evenly (modulo 1).

    The steps are powers of 1/x with the root x of x^(d+1) = x + 1, the golden ratio for d = 1.
    """
    root = 2.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    step = root ** -np.arange(1.0, dimensions + 1)
    step.setflags(write=False)
    return step


def quasi_random(count: int, dimensions: int, skip: int = 0) -> FloatArray:
    """Return points [count, dimensions] that fill the unit cube evenly, from number ``skip`` on."""
    places = np.arange(skip, skip + count)[:, None]
    return (0.5 + places * evenly_spread_step(dimensions)) % 1.0
