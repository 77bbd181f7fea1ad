"""Starting points from earlier solutions and complete guesses, and what they cost."""

from typing import Any

import numpy as np
import pytest

from microbot_ocp.ocp.solution import PhaseSolution
from microbot_ocp.ocp.starts import (
    _initial_guess,
    completed,
    default_guess,
    guess_from,
    starting_point,
)
from microbot_ocp.ocp.transcription import Transcription
from ocp.textbook import bryson_denham, solve_once


def test_all_variables_of_a_solution_are_sampled_together(monkeypatch):
    problem = bryson_denham(0.1, shape="polynomial")
    solution = solve_once(problem, 10)
    sample, times = PhaseSolution.sample, []
    monkeypatch.setattr(PhaseSolution, "sample", lambda p, t: times.append(t) or sample(p, t))
    starting_point(Transcription(problem).program(15), problem, solution)
    assert len(times) == 4  # at the mesh points and at three collocation points
    guess: Any = guess_from(problem, solution)["fly"].values
    shares = np.linspace(0.0, 1.0, 7)
    for name in ("x", "v", "u", "x"):  # also at other places in between
        assert guess[name](shares) == pytest.approx(sample(solution["fly"], shares)[name])
        assert guess[name](shares[:2]) == pytest.approx(sample(solution["fly"], shares[:2])[name])


def test_a_complete_guess_needs_no_default(monkeypatch):
    problem = bryson_denham(0.1)
    whole = default_guess(problem)
    monkeypatch.setattr(_initial_guess, "default_guess", lambda _: pytest.fail("not needed"))
    assert completed(problem, whole)["fly"].values.keys() == whole["fly"].values.keys()
