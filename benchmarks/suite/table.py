"""All problems of the suite."""

from __future__ import annotations

from benchmarks.suite import (
    algebraic,
    biology,
    constrained,
    economics,
    estimation,
    flight,
    mechanisms,
    reactors,
    singular,
    space,
    textbook,
    vehicles,
)
from benchmarks.suite.problem import SuiteProblem

PROBLEMS: tuple[SuiteProblem, ...] = (
    *textbook.PROBLEMS,
    *singular.PROBLEMS,
    *constrained.PROBLEMS,
    *algebraic.PROBLEMS,
    *reactors.PROBLEMS,
    *estimation.PROBLEMS,
    *biology.PROBLEMS,
    *economics.PROBLEMS,
    *mechanisms.PROBLEMS,
    *vehicles.PROBLEMS,
    *flight.PROBLEMS,
    *space.PROBLEMS,
)
BY_NAME = {problem.name: problem for problem in PROBLEMS}
