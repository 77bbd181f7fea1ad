"""What "use", "at the limit" and "excess" of a limit mean: for the whole package, here only."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError

AT_LIMIT = 0.99
"""Share of a limit from which on it counts as used up."""
LIMIT_TOLERANCE = 5e-3
"""Excess, relative to the limit, that a certificate lets pass unless it is told otherwise."""
ROUNDING = 1e-9
"""Excess, relative to the limit, that is put down to rounding."""


def use_of(
    values: FloatArray, lower: FloatArray, upper: FloatArray, *, from_middle: bool = False
) -> FloatArray:
    """Return the share [..., k] of a limit that values [..., k] use; bounds are [k] or [..., k].

    0 at rest, 1 at the limit, minus infinity where there is none. It is the value divided by the
    bound that it is nearer to or beyond. ``from_middle`` is for quantities whose bounds need not
    have zero between them, such as positions: the distance from the middle of the range, divided by
    half the range, and with one bound only the distance from it, 0 from its own size on. The excess
    over a limit is its use minus 1.
    """
    try:
        values, lower, upper = (np.asarray(each, dtype=float) for each in (values, lower, upper))
        np.broadcast_shapes(values.shape, lower.shape, upper.shape)
    except (TypeError, ValueError) as problem:
        raise InputError(f"values and bounds must be arrays that fit together: {problem}") from None
    with np.errstate(invalid="ignore"):  # a diverged value may be infinite, as its bound
        use = np.maximum(*_sides(values, lower, upper, from_middle))
    limited = ~(np.isneginf(lower) & np.isposinf(upper))
    return np.maximum(use, 0.0) if np.all(limited) else np.where(limited, np.maximum(use, 0.0), use)


def nearest_bound(
    values: FloatArray, lower: FloatArray, upper: FloatArray, *, from_middle: bool = False
) -> FloatArray:
    """Return the bound, lower or upper, that each value is nearer to or beyond."""
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
    excess /= scale  # of the caller no longer
    if np.all(bound):
        excess += 1.0
        return excess
    # A limit of zero (a joint that must not move that way) is not "used" at rest.
    at_zero = (bound == 0) & (excess <= ROUNDING)
    return np.where(at_zero, np.minimum(excess, 0.0), 1.0 + excess)
