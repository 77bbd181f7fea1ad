"""Multiple shooting by explicit Runge-Kutta steps, or by one of CasADi's integrators."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.quiet import quiet
from microbot_ocp.ocp.problem import Phase
from microbot_ocp.ocp.transcription.schemes._base import (
    Fraction,
    Interval,
    IntervalStep,
    StageVariable,
    refuse_pointwise,
)


@dataclass(frozen=True)
class Shooting:
    """Classical Runge-Kutta steps of order four; exact for chains of up to four integrators.

    Attributes
    ----------
    steps : number of Runge-Kutta steps over each interval
    """

    steps: int = 1
    points: tuple[float, ...] = (0.5,)
    order: int = 4

    def variables(self, phase: Phase) -> tuple[StageVariable, ...]:
        """Return an empty tuple: the states inside follow from the start."""
        refuse_pointwise(phase, "shooting")
        return ()

    def step(self, phase: Phase, interval: Interval, values: Sequence[ca.MX]) -> IntervalStep:
        """Return the Runge-Kutta step from the start of the interval."""

        def after(fraction: Fraction) -> tuple[ca.MX, ca.MX]:
            x, cost, share = interval.x, ca.MX(0), fraction / self.steps
            for i in range(self.steps):
                x, added = _runge_kutta(interval, x, i * share, share)
                cost = cost + added
            return x, cost

        return _shot(interval, after)


def _shot(interval: Interval, after: Callable[[Fraction], tuple[ca.MX, ca.MX]]) -> IntervalStep:
    """Return the step given by a function of state and running cost after any fraction of it."""
    arrived, running = after(1.0)
    return IntervalStep(arrived, running, (), lambda s: (after(s)[0], interval.control(s)))


def _runge_kutta(
    interval: Interval, x: ca.MX, start: Fraction, share: Fraction
) -> tuple[ca.MX, ca.MX]:
    h = share * interval.length
    middle, end = start + share / 2, start + share
    k1, l1 = interval.f(x, interval.control(start), start)
    k2, l2 = interval.f(x + h / 2 * k1, interval.control(middle), middle)
    k3, l3 = interval.f(x + h / 2 * k2, interval.control(middle), middle)
    k4, l4 = interval.f(x + h * k3, interval.control(end), end)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), h / 6 * (l1 + 2 * l2 + 2 * l3 + l4)


_ADAPTIVE = ("cvodes", "idas")
INTEGRATORS = (*_ADAPTIVE, "collocation", "rk")


@dataclass(frozen=True)
class IntegratorShooting:
    """Multiple shooting by a CasADi integrator: "cvodes", "idas", "collocation" or "rk".

    Intended for stiff dynamics, for which fixed steps are unstable; derivatives of adaptive
    integrators are slow.

    Raises
    ------
    InputError
        The integrator is unknown, or rejects an option.
    """

    integrator: str = "cvodes"
    options: Mapping[str, Any] = field(default_factory=dict)
    points: tuple[float, ...] = (0.5,)
    order: int = 4

    def __post_init__(self) -> None:
        checks.one_of("integrator", self.integrator, INTEGRATORS)
        x = ca.MX.sym("x")
        try:
            with quiet():
                ca.integrator("probe", self.integrator, {"x": x, "ode": x}, 0.0, 1.0, self._options)
        except (RuntimeError, NotImplementedError) as refused:
            lines = [re.sub(r"^\S*\.cpp:\d+: ", "", k) for k in str(refused).splitlines()]
            reason = next((k for k in lines if re.match("Unknown|Illegal", k)), lines[-1])
            sentence = f"options of integrator {self.integrator!r} were rejected: {reason}"
            raise InputError(sentence) from None

    @property
    def _options(self) -> dict[str, Any]:
        # The steps control the error of the running cost only with quad_err_con.
        tolerant: dict[str, Any] = dict.fromkeys(("abstol", "reltol"), 1e-10)
        tolerant |= {"quad_err_con": True, "disable_internal_warnings": True}
        tolerant |= {"show_eval_warnings": False}
        return {**(tolerant if self.integrator in _ADAPTIVE else {}), **self.options}

    def variables(self, phase: Phase) -> tuple[StageVariable, ...]:
        """Return an empty tuple: the states inside follow from the start."""
        refuse_pointwise(phase, "shooting on an integrator")
        return ()

    def step(self, phase: Phase, interval: Interval, values: Sequence[ca.MX]) -> IntervalStep:
        """Return the step of the integrator over the fraction of the interval from 0 to 1."""
        names = ("begin", "end", "constant", "start", "length", "duration", "constants")
        inputs = [getattr(interval, name) for name in names]
        symbols = [ca.MX.sym(name, k.shape[0]) for name, k in zip(names, inputs, strict=True)]
        x, s, reach = ca.MX.sym("x", interval.x.shape[0]), ca.MX.sym("s"), ca.MX.sym("reach")
        inner = replace(interval, x=x, **dict(zip(names, symbols, strict=True)))
        rate = ((inner.end - inner.begin) / inner.length)[: interval.rate.shape[0]]
        inner = replace(inner, rate=rate)
        slope, cost = inner.f(x, inner.control(s * reach), s * reach)
        dae = {
            "x": x,
            "t": s,
            "p": ca.vertcat(*symbols, reach),
            "ode": reach * inner.length * slope,
            "quad": reach * inner.length * cost,
        }
        run = ca.integrator("step", self.integrator, dae, 0.0, 1.0, self._options)

        def after(fraction: Fraction) -> tuple[ca.MX, ca.MX]:
            result = run(x0=interval.x, p=ca.vertcat(*inputs, fraction))
            return result["xf"], result["qf"]

        return _shot(interval, after)
