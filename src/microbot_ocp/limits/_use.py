"""Definitions of "use", "at the limit" and "excess" of a limit, for the whole package."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError

AT_LIMIT = 0.99
"""Share of a limit from which the limit counts as reached."""
LIMIT_TOLERANCE = 5e-3
"""Excess, relative to the limit, that a certificate accepts by default."""


def use_of(
    values: FloatArray, lower: FloatArray, upper: FloatArray, *, from_middle: bool = False
) -> FloatArray:
    """Return the share [..., k] of a limit that values [..., k] use; bounds are [k] or [..., k].

    The use is the value divided by its nearest or violated bound: 0 at rest, 1 at the limit, minus
    infinity without a limit. The excess over a limit is its use minus 1. ``from_middle`` is for
    quantities whose range need not contain zero, such as positions: the use is the distance from
    the middle divided by half the range. With one bound only, it is 1 minus the distance to the
    bound divided by the bound's size, and at least 0.
    """
    try:
        values, lower, upper = (np.asarray(each, dtype=float) for each in (values, lower, upper))
        np.broadcast_shapes(values.shape, lower.shape, upper.shape)
    except (TypeError, ValueError) as problem:
        raise InputError(f"values and bounds must be arrays that fit together: {problem}") from None
    with np.errstate(invalid="ignore"):  # a diverged value and its bound may both be infinite
        use = np.maximum(*_sides(values, lower, upper, from_middle))
    limited = ~(np.isneginf(lower) & np.isposinf(upper))
    return np.maximum(use, 0.0) if np.all(limited) else np.where(limited, np.maximum(use, 0.0), use)


def nearest_bound(
    values: FloatArray, lower: FloatArray, upper: FloatArray, *, from_middle: bool = False
) -> FloatArray:
    """Return the bound, lower or upper, that is nearest to or violated by each value."""
    above, below = _sides(values, lower, upper, from_middle)
    return np.where(above >= below, upper, lower)


def _sides(
    values: FloatArray, lower: FloatArray, upper: FloatArray, from_middle: bool
) -> tuple[FloatArray, FloatArray]:
    span = upper - lower if from_middle else None
    return _side(values - upper, upper, span), _side(lower - values, lower, span)


def _side(excess: FloatArray, bound: FloatArray, span: FloatArray | None) -> FloatArray:
    scale = np.where(np.isfinite(bound) & (bound != 0), np.abs(bound), 1.0)
    if span is not None:
        two_sided = np.isfinite(span) & (span > 0)
        return 1.0 + excess / np.where(two_sided, 0.5 * span, scale)
    excess /= scale  # the array is a difference that nobody else uses
    if np.all(bound):
        excess += 1.0
        return excess
    # At rest a limit of zero (a joint that must not move in one direction) is not used.
    at_zero = (bound == 0) & (excess <= ROUNDING)
    return np.where(at_zero, np.minimum(excess, 0.0), 1.0 + excess)
