"""A problem of the suite as data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from microbot_ocp.ocp import Guess, OptimalControlProblem

Array = np.ndarray

# sources, and how figures were confirmed
PROPT, ICLOCS, PSOPT_EXAMPLE = "PROPT", "ICLOCS2", "PSOPT"
LUUS_PROPT = "Luus, Iterative Dynamic Programming; PROPT"
OPTI, SOURCELESS = "Opti on 300 intervals", "no figure"


@dataclass(frozen=True)
class SuiteProblem:
    """A problem and what its source says of the optimum.

    Attributes
    ----------
    build : callable
        Makes the problem; its name is the name, its docstring the statement.
    kind : str
        What is hard about it, by the word under which the page groups it.
    source : str
    published : float
        The figure of the source, or the closed form.
    tolerance : float
        Relative; what the digits of the figure and the mesh it was computed on allow.
    confirmed : str
        How the figure was confirmed without the package.
    reference : float, optional
        The optimum where the figure is coarser than 1e-5 or off: closed form, or recomputed.
    sign : float
        -1 where the source maximises.
    guess : callable, optional
        The guess of the source, by phase; without one the package's own is used.
    """

    build: Callable[[], OptimalControlProblem]
    kind: str
    source: str
    published: float
    tolerance: float
    confirmed: str
    reference: float | None = None
    sign: float = 1.0
    guess: Callable[[], Mapping[str, Guess]] | None = None

    @property
    def name(self) -> str:
        return self.build.__name__

    @property
    def optimum(self) -> float:
        """What errors are relative to."""
        return self.published if self.reference is None else self.reference

    def error(self, cost: float) -> float:
        """Relative difference of a cost, as it is minimised, to the optimum."""
        return abs(self.sign * cost - self.optimum) / abs(self.optimum)


def line(start: float, end: float) -> Callable[[Array], Array]:
    """A guess that goes evenly from one value to another."""
    return lambda s: (start + (end - start) * s)[:, None]


def along(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """A guess of one component from a function of the fraction of the phase."""
    return lambda s: function(s)[:, None]
