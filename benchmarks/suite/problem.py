"""Problem of the suite as data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from microbot_ocp.ocp import Guess, OptimalControlProblem

Array = np.ndarray

# Sources, and confirmations of their figures.
PROPT, ICLOCS, PSOPT_EXAMPLE = "PROPT", "ICLOCS2", "PSOPT"
LUUS_PROPT = "Luus, Iterative Dynamic Programming; PROPT"
OPTI, SOURCELESS = "Opti on 300 intervals", "no figure"


@dataclass(frozen=True)
class SuiteProblem:
    """Problem of the suite with the optimum of its source.

    Attributes
    ----------
    build : callable
        Function that declares the problem; its docstring is the statement.
    kind : str
        Difficulty of the problem, by which the page groups it.
    source : str
        Publication of the figure.
    published : float
        Figure of the source, or the closed form.
    tolerance : float
        Relative tolerance, from the digits of the figure and the mesh behind it.
    confirmed : str
        Method that confirmed the figure without the package.
    reference : float, optional
        Optimum by closed form or recomputation, if the figure is coarser than 1e-5 or wrong.
    sign : float
        -1 if the source maximises, else 1.
    guess : callable, optional
        Guess of the source, by phase; without it the package's own guess is used.
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
        """Return the optimum that errors are relative to."""
        return self.published if self.reference is None else self.reference

    def error(self, cost: float) -> float:
        """Return the relative difference of a minimised cost to the optimum."""
        return abs(self.sign * cost - self.optimum) / abs(self.optimum)


def line(start: float, end: float) -> Callable[[Array], Array]:
    """Return a linear guess from one value to another."""
    return lambda s: (start + (end - start) * s)[:, None]


def along(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Return a guess of one component as a function of the fraction of the phase."""
    return lambda s: function(s)[:, None]
