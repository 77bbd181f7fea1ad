"""Curves of the variables of any optimal-control problem, for figures and recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp.ocp.solution import PhaseSolution

CURVE_POINTS = 400  # samples of a solution's curve per phase

Key = tuple[str, int | None, str]  # name, index of the component (None for a scalar), unit


@dataclass(frozen=True, eq=False)
class BoundedCurve:
    """Values [M] over times t [M], s, with their limits, in drawn units."""

    t: FloatArray
    values: FloatArray
    lower: float = -np.inf
    upper: float = np.inf


def dense_times(phase: PhaseSolution) -> FloatArray:
    """Return even times and both sides of every mesh point (controls may jump there), s."""
    edges, gap = phase.t[1:-1], ROUNDING * phase.duration
    even = np.linspace(0.0, phase.duration, CURVE_POINTS)
    return np.unique(np.concatenate([even, edges - gap, edges + gap]))


def variable_curves(
    phases: Sequence[PhaseSolution], times: Callable[[PhaseSolution], FloatArray]
) -> dict[Key, list[BoundedCurve]]:
    """Return the curves of all components of states, controls and algebraic variables per phase.

    The phases follow each other on one time axis; ``times`` returns the sample times of a phase.
    """
    curves: dict[Key, list[BoundedCurve]] = {}
    begin = 0.0
    for phase in phases:
        if phase.layout is None:
            raise InputError(
                f"phase {phase.name!r} was not made by a solve: it has mesh values only"
            )
        t, declared = times(phase), phase.layout.phase
        table = phase.sample(t)
        for variable in (*declared.states, *declared.controls, *declared.algebraics):
            for k in range(variable.size):
                bounds = float(variable.lower[k]), float(variable.upper[k])
                curve = BoundedCurve(begin + t, table[variable.name][:, k], *bounds)
                index = k if variable.size > 1 else None
                curves.setdefault((variable.name, index, variable.unit), []).append(curve)
        begin += phase.duration
    return curves
