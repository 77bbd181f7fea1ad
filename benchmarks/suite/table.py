"""All problems of the suite."""

from __future__ import annotations

from benchmarks.suite import (
    algebraic,
    biology,
    blind,
    constrained,
    fifth,
    flight,
    fourth,
    mechanisms,
    reactors,
    second,
    singular,
    textbook,
    third,
)
from benchmarks.suite.problem import SuiteProblem

PROBLEMS: tuple[SuiteProblem, ...] = (
    *textbook.PROBLEMS,
    *singular.PROBLEMS,
    *constrained.PROBLEMS,
    *reactors.PROBLEMS,
    *biology.PROBLEMS,
    *mechanisms.PROBLEMS,
    *flight.PROBLEMS,
    *algebraic.PROBLEMS,
    *blind.PROBLEMS,
    *second.PROBLEMS,
    *third.PROBLEMS,
    *fourth.PROBLEMS,
    *fifth.PROBLEMS,
)
BY_NAME = {problem.name: problem for problem in PROBLEMS}
