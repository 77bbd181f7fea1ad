"""Whether an interval is to be divided or raised in degree: by the decay of Legendre coefficients.

Where the states and polynomial controls of an interval are smooth, the coefficients of their
Legendre series fall like ``10^(-rate i)`` with the index i, and a degree more takes that much from
the error (twice that at the mesh points, where collocation is superconvergent); at a corner or jump
they hardly fall, and only a shorter interval helps. Source: F. Liu, W. W. Hager and A. V. Rao,
*Adaptive mesh refinement method for optimal control using decay rates of Legendre polynomial
coefficients*, IEEE Trans. Control Syst. Technol. 26 (2018) 1475-1483.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.ocp.mesh import DIVISION
from microbot_ocp.ocp.solution import PhaseSolution
from microbot_ocp.ocp.transcription import IntArray, Mesh
from microbot_ocp.ocp.transcription.schemes import Collocation
from microbot_ocp.ocp.verification import phase_layout, state_weights


@dataclass(frozen=True)
class DegreeSettings:
    """When a degree is raised or lowered.

    Attributes
    ----------
    smooth : rate from which a degree more is worth it: each coefficient a third of the last one
    rounding : coefficients below, relative to the size of their variable, say nothing
    most_raised : degrees at once: the rate may be estimated badly
    spare : share of the accuracy below which an interval may do with a degree less
    """

    smooth: float = 0.5
    rounding: float = 1e-9
    most_raised: int = 3
    spare: float = 1e-3


SETTINGS = DegreeSettings()


@dataclass(frozen=True)
class Degrees:
    """Least and most degree of an interval."""

    least: int = 3
    most: int = 8

    def __post_init__(self) -> None:
        if not 1 <= self.least <= self.most <= 9:
            raise InputError(
                f"degrees must be (least, most) with 1 <= least <= most <= 9, not "
                f"({self.least}, {self.most})"
            )


def decay_rates(phase: PhaseSolution) -> FloatArray:
    """Return decay of the Legendre coefficients in every interval [N], in powers of ten an index.

    The slowest of all states and polynomial controls; infinite where there is nothing but rounding
    beyond the first coefficient.
    """
    layout = phase_layout(phase)
    assert phase.stages is not None
    polynomials = [c.name for c in layout.phase.controls if c.shape == "polynomial"]
    weights = state_weights(phase)
    rates = np.full(layout.intervals, np.inf)
    for group in layout.groups:
        scheme, intervals = group.kind.scheme, group.intervals
        assert isinstance(scheme, Collocation)
        for count, controls in ((scheme.degree + 1, False), (scheme.degree, True)):
            if controls and not polynomials:
                continue
            nodes, quadrature = np.polynomial.legendre.leggauss(count)
            places = np.tile((nodes + 1) / 2, intervals.size)
            sampled = layout.interpolated(phase.stages, np.repeat(intervals, count), places)
            names = polynomials if controls else [s.name for s in layout.phase.states]
            table = np.hstack([sampled[name] for name in names]).T
            scale = np.abs(table).max(axis=1) if controls else weights
            series = np.polynomial.legendre.legvander(nodes, count - 1)
            series = (2 * np.arange(count) + 1) / 2 * quadrature[:, None] * series
            values = table.reshape(-1, intervals.size, count)
            coefficients = np.abs(values @ series) / np.maximum(scale, 1e-300)[:, None, None]
            rates[intervals] = np.minimum(rates[intervals], _slowest(coefficients))
    return rates


def _slowest(coefficients: FloatArray) -> FloatArray:
    """Return rates [M] from coefficients [variables, M, indices]; the slowest variable counts."""
    # the largest of those that follow: odd or even ones alone may vanish
    envelope = np.maximum.accumulate(coefficients[..., ::-1], axis=-1)[..., ::-1][..., 1:]
    rates = np.full(envelope.shape[:2], np.inf)
    for place in np.ndindex(*rates.shape):
        seen = np.flatnonzero(envelope[place] > SETTINGS.rounding)
        if seen.size == 1 and envelope[place].size > 1:
            rates[place] = -np.log10(SETTINGS.rounding / envelope[place][0])
        elif seen.size > 1:
            rates[place] = -np.polyfit(seen, np.log10(envelope[place][seen]), 1)[0]
    return rates.min(axis=0)


def refine_hp(
    mesh: Mesh,
    errors: FloatArray,
    rates: FloatArray,
    accuracy: float,
    degrees: Degrees,
) -> Mesh:
    """Return a mesh for an accuracy: degrees raised where the solution is smooth, intervals divided
    else.

    Parameters
    ----------
    mesh : Mesh
        With degrees d [N]. The error at the end of an interval falls with 2 d - 1 powers of its
        length, and with twice the rate a degree.
    errors : array [N]
        Relative state errors.
    rates : array [N]
        See :func:`decay_rates`.
    accuracy : float
    degrees : Degrees
    """
    assert mesh.degrees is not None
    points: list[float] = []
    chosen: list[int] = []
    goal = DIVISION.safety * accuracy
    for k, degree in enumerate(mesh.degrees.tolist()):
        begin, end = mesh.fractions[k : k + 2]
        pieces, wanted = _choice(int(degree), float(errors[k]), float(rates[k]), goal, degrees)
        points += np.linspace(begin, end, pieces, endpoint=False).tolist()
        chosen += [wanted] * pieces
    return Mesh([*points, 1.0], chosen)


def _choice(
    degree: int, error: float, rate: float, goal: float, degrees: Degrees
) -> tuple[int, int]:
    """Return pieces of an interval and their degree."""
    if error <= goal / DIVISION.safety:
        spare = (
            error <= SETTINGS.spare * goal and rate >= SETTINGS.smooth and degree > degrees.least
        )
        return 1, degree - spare
    missing = np.log10(max(error / goal, 1.0)) if np.isfinite(error) else np.inf
    if rate >= SETTINGS.smooth and np.isfinite(missing):
        raised = int(np.clip(np.ceil(missing / (2 * rate)), 1, SETTINGS.most_raised))
        if degree + raised <= degrees.most:
            return 1, degree + raised
    pieces = np.ceil(10 ** min(missing / (2 * degree), 1.0))
    return int(np.clip(pieces, 2, DIVISION.most_pieces)), degree


def degrees_on(fractions: FloatArray, mesh: Mesh) -> IntArray:
    """Return degrees of the intervals between other fractions: those of where their middles lie."""
    assert mesh.degrees is not None
    middles = (fractions[:-1] + fractions[1:]) / 2
    return mesh.degrees[np.searchsorted(mesh.fractions, middles) - 1]
