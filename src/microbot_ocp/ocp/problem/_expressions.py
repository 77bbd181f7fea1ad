"""Expressions of a phase as functions of numbers: one order of inputs for all that look at them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.problem._items import Measurement
from microbot_ocp.ocp.problem._phase import Phase


class Expressions:
    """What expressions of a phase may depend on, in one order.

    Parameters
    ----------
    phase : Phase
    data : measurements that they are of, too

    Attributes
    ----------
    inputs : names and symbols: variables, rates of linear controls, data, time, duration and
        parameters
    """

    def __init__(self, phase: Phase, data: Sequence[Measurement] = ()) -> None:
        self.phase, self.data = phase, data
        self.inputs: list[tuple[str, ca.MX]] = [(v.name, v.symbol) for v in phase.variables]
        for control in phase.controls:
            if control.rate is not None:
                self.inputs.append((f"the rate of {control.name}", control.rate))
        self.inputs += [(m.name, m.symbol) for m in data]
        self.inputs += [("time", phase.time), ("duration", phase.duration)]
        self.inputs += [(p.name, p.symbol) for p in phase.parameters]

    @property
    def symbols(self) -> list[ca.MX]:
        """Symbols of the inputs."""
        return [symbol for _, symbol in self.inputs]

    def function(self, expressions: Sequence[ca.MX]) -> ca.Function:
        """Return the expressions, one below the other, as a function of the table of all inputs."""
        stacked = ca.densify(ca.vertcat(*expressions, ca.MX(0, 1)))
        run = ca.Function("declared", [ca.vertcat(*self.symbols)], [stacked])
        with suppress(RuntimeError):  # interpolants have no scalar graph
            run = run.expand()
        return run

    def tables(
        self,
        values: Mapping[str, FloatArray],
        t: FloatArray,
        duration: float | FloatArray,
        rates: Mapping[str, FloatArray] | None = None,
        data: Sequence[FloatArray] = (),
    ) -> list[FloatArray]:
        """Return values [size, M] of the inputs at times t [M] since the start of the phase.

        Rates and variables that have no value there are zero.
        """
        phase, rates = self.phase, rates or {}
        none = {v.name: np.zeros((v.size, t.size)) for v in phase.variables}
        moving = [values.get(v.name, none[v.name]) for v in phase.variables]
        moving += [rates.get(c.name, none[c.name]) for c in phase.controls if c.rate is not None]
        fixed = [np.tile(p.value[:, None], (1, t.size)) for p in phase.parameters]
        return [*moving, *data, t[None], np.full((1, t.size), duration), *fixed]

    def table(self, *values: Any, **more: Any) -> FloatArray:
        """Return the same, one below the other [inputs, M]."""
        return np.vstack(self.tables(*values, **more))
