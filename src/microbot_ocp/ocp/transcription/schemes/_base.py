"""Protocol of a scheme: symbols of one interval as input, and the step over it as output."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca

from microbot_ocp._base.checks import InputError
from microbot_ocp.ocp.problem import Phase, Variable

Fraction = float | ca.MX


@dataclass(frozen=True, eq=False)
class StageVariable:
    """A variable and a fraction of the interval at which a scheme needs its value."""

    source: Variable
    fraction: float


@dataclass(frozen=True, eq=False)
class Interval:
    """Unscaled symbols of one interval.

    Attributes
    ----------
    x : state at the start
    begin, end : linear controls at the start and at the end, and free parameters
    constant : constant controls
    rate : time derivative of the linear controls
    start, length, duration : start and length of the interval and duration of the phase, s
    constants : parameters of the phase
    dynamics : ``(x, u, rate, time, duration, constants) -> slope, running cost``; u stacks
        constant and linear controls, free parameters, polynomial controls and algebraic variables
    """

    x: ca.MX
    begin: ca.MX
    end: ca.MX
    constant: ca.MX
    rate: ca.MX
    start: ca.MX
    length: ca.MX
    duration: ca.MX
    constants: ca.MX
    dynamics: ca.Function

    def f(self, x: ca.MX, u: ca.MX, fraction: Fraction) -> tuple[ca.MX, ca.MX]:
        """Return derivative of the state and running cost at a fraction of the interval."""
        time = self.start + fraction * self.length
        slope, cost = self.dynamics(x, u, self.rate, time, self.duration, self.constants)
        return slope, cost

    def control(self, fraction: Fraction) -> ca.MX:
        """Return constant and linear controls and free parameters at a fraction of the interval."""
        return ca.vertcat(self.constant, self.begin + fraction * (self.end - self.begin))


@dataclass(frozen=True, eq=False)
class IntervalStep:
    """The step of a scheme over one interval.

    Attributes
    ----------
    arrived : state at the end
    running : integral of the running cost
    defects : pairs of a fraction of the interval and the residual of the dynamics there [n], in the
        units of the state
    at : function of a fraction of the interval that returns state and control there
    """

    arrived: ca.MX
    running: ca.MX
    defects: tuple[tuple[float, ca.MX], ...]
    at: Callable[[Fraction], tuple[ca.MX, ca.MX]]


class Scheme(Protocol):
    """A transcription method: frozen settings and pure functions."""

    @property
    def points(self) -> tuple[float, ...]:
        """Fractions in (0, 1] at which path constraints hold besides the mesh points."""
        ...

    @property
    def order(self) -> int:
        """Power of the step in the state error at mesh points, for smooth problems."""
        ...

    def variables(self, phase: Phase) -> tuple[StageVariable, ...]:
        """Return the inner variables of an interval."""
        ...

    def step(self, phase: Phase, interval: Interval, values: Sequence[ca.MX]) -> IntervalStep:
        """Return the step over the interval, given the values of :meth:`variables`."""
        ...


def lagrange(points: Sequence[float], s: Any) -> list[Any]:
    """Return the Lagrange polynomials through some points at s, a number or an expression."""
    weights = []
    for point in points:
        weight: Any = 1.0
        for other in points:
            if other != point:
                weight = weight * (s - other) / (point - other)
        weights.append(weight)
    return weights


def pointwise(phase: Phase) -> list[Variable]:
    """Return the variables that have values only at the points of a scheme."""
    return [*phase.shaped("polynomial"), *phase.algebraics]


def refuse_pointwise(phase: Phase, scheme: str) -> None:
    """Raise InputError if a phase has variables at inner points, which a scheme lacks."""
    for variable in pointwise(phase):
        kind = "polynomial control" if variable.shape == "polynomial" else "algebraic variable"
        raise InputError(
            f"{kind} {variable.name!r} of phase {phase.name!r} needs collocation (scheme 'radau' "
            f"or 'gauss'), not {scheme}"
        )
