"""Trapezoidal and Hermite-Simpson collocation, with the next state as a value of the interval.

Source: Betts, *Practical Methods for Optimal Control*, 2nd ed., section 4.5 (compressed forms);
orders two and four.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from microbot_ocp.ocp.problem import Phase
from microbot_ocp.ocp.transcription.schemes._base import (
    Fraction,
    Interval,
    IntervalStep,
    StageVariable,
    refuse_pointwise,
)


def _next_state(phase: Phase, scheme: str) -> tuple[StageVariable, ...]:
    refuse_pointwise(phase, scheme)
    return tuple(StageVariable(state, 1.0) for state in phase.states)


@dataclass(frozen=True)
class Trapezoidal:
    """The slope runs linearly over the interval."""

    points: tuple[float, ...] = ()
    order: int = 2

    def variables(self, phase: Phase) -> tuple[StageVariable, ...]:
        """Return the state at the end."""
        return _next_state(phase, "trapezoidal")

    def step(self, phase: Phase, interval: Interval, values: Sequence[ca.MX]) -> IntervalStep:
        """Return one defect, from the slopes at both ends."""
        h, after = interval.length, ca.vertcat(*values)
        f0, l0 = interval.f(interval.x, interval.control(0.0), 0.0)
        f1, l1 = interval.f(after, interval.control(1.0), 1.0)
        defect = after - interval.x - h / 2 * (f0 + f1)

        def at(s: Fraction) -> tuple[ca.MX, ca.MX]:
            state = interval.x + h * (s * f0 + s**2 / 2 * (f1 - f0))
            return state, interval.control(s)

        return IntervalStep(after, h / 2 * (l0 + l1), ((0.5, defect),), at)


@dataclass(frozen=True)
class HermiteSimpson:
    """The state is a cubic over the interval that fulfils the dynamics in the middle, too."""

    points: tuple[float, ...] = (0.5,)
    order: int = 4

    def variables(self, phase: Phase) -> tuple[StageVariable, ...]:
        """Return the state at the end."""
        return _next_state(phase, "hermite_simpson")

    def step(self, phase: Phase, interval: Interval, values: Sequence[ca.MX]) -> IntervalStep:
        """Return one defect, by Simpson's rule with the Hermite cubic's middle."""
        h, x, after = interval.length, interval.x, ca.vertcat(*values)
        f0, l0 = interval.f(x, interval.control(0.0), 0.0)
        f1, l1 = interval.f(after, interval.control(1.0), 1.0)
        middle = (x + after) / 2 + h / 8 * (f0 - f1)
        fm, lm = interval.f(middle, interval.control(0.5), 0.5)
        defect = after - x - h / 6 * (f0 + 4 * fm + f1)

        def at(s: Fraction) -> tuple[ca.MX, ca.MX]:
            # cubic with the given ends and end slopes
            state = (
                (1 + 2 * s) * (1 - s) ** 2 * x
                + s * (1 - s) ** 2 * h * f0
                + s**2 * (3 - 2 * s) * after
                + s**2 * (s - 1) * h * f1
            )
            return state, interval.control(s)

        return IntervalStep(after, h / 6 * (l0 + 4 * lm + l1), ((0.5, defect),), at)
