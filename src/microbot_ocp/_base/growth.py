"""Growth of small errors along a differential equation: transition matrices and carried defects.

A trajectory is verified segment by segment, each simulated from the trajectory's own state at its
start. The error at the end of a segment is its defect. One simulation over the whole time would
multiply every defect by the transition matrices of the later segments. An unstable system amplifies
small defects; the amplification is reported, not judged.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray

LARGE = 1e6  # growth from which only the exponent is printed
TAYLOR_TERMS = 13  # truncation below rounding for matrices of norm 1/2


class Carried(NamedTuple):
    """Defects carried to later segments, to first order.

    Attributes
    ----------
    errors : array [K,n]
        Error after every segment.
    amplification : float
        Largest norm of the transition matrices from a segment's end to the end of the last one.
    """

    errors: FloatArray
    amplification: float


def transition_matrices(slopes: FloatArray, lengths: FloatArray) -> FloatArray:
    """Return matrix exponentials [K,n,n] of the linearised dynamics [K,n,n] over the lengths [K].

    The method is scaling and squaring of a Taylor series (Moler and Van Loan, 2003, *Nineteen
    dubious ways to compute the exponential of a matrix*, method 3).
    """
    matrices = slopes * lengths[:, None, None]
    size = float(np.abs(matrices).sum(axis=2).max(initial=0.0))
    # exp(A) = exp(A / 2^k)^(2^k) with a norm of at most 1/2 of A / 2^k.
    halvings = max(0, int(np.ceil(np.log2(size))) + 1) if 0 < size < np.inf else 0
    matrices = matrices / 2.0**halvings
    total = np.broadcast_to(np.eye(slopes.shape[1]), matrices.shape)
    term = total
    for k in range(1, TAYLOR_TERMS + 1):
        term = term @ matrices / k
        total = total + term
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(halvings):
            total = total @ total
    return total


def carry(defects: FloatArray, transitions: FloatArray) -> Carried:
    """Return the error after each segment from defects [K,n], in units that make them comparable.

    The errors are e[k] = Phi[k] e[k-1] + d[k] with the transition matrices Phi [K,n,n].
    """
    error, errors = np.zeros(defects.shape[1]), np.zeros_like(defects)
    rest, amplification = np.eye(defects.shape[1]), 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        for k, (transition, defect) in enumerate(zip(transitions, defects, strict=True)):
            errors[k] = error = transition @ error + defect
        # Products formed from the end need one multiplication a segment.
        for transition in transitions[:0:-1]:
            rest = rest @ transition
            norm = float(np.linalg.norm(rest, 2)) if np.isfinite(rest).all() else np.inf
            amplification = max(amplification, norm)
            if not norm < np.inf:
                break
    return Carried(np.where(np.isfinite(errors), errors, np.inf), amplification)


def growth_said(amplification: float) -> str:
    """Return the factor by which errors grow as text; large ones by their exponent.

    >>> growth_said(37.88), growth_said(358.1), growth_said(1.1e77), growth_said(np.inf)
    ('38-fold', '360-fold', '10^77-fold', 'more than 10^308-fold')
    """
    if not amplification >= LARGE:
        return f"{float(f'{amplification:.2g}'):.7g}-fold"
    if amplification == np.inf:
        return f"more than 10^{sys.float_info.max_10_exp}-fold"
    return f"10^{np.log10(amplification):.0f}-fold"
