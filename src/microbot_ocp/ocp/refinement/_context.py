"""What the solves of one problem share."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from microbot_ocp.ocp.solution import Progress, Solution
from microbot_ocp.ocp.solvers import SolverSettings, solve_on
from microbot_ocp.ocp.transcription import Guess, Meshes, Transcription


@dataclass(frozen=True, eq=False)
class SolveContext:
    """How a transcription is solved, and until when.

    Attributes
    ----------
    transcription, settings : of every solve
    until : when the time of all is over, by ``time.perf_counter``
    progress : called at every iteration
    """

    transcription: Transcription
    settings: SolverSettings
    until: float
    progress: Progress | None = None

    @property
    def over(self) -> bool:
        """Whether the time is over."""
        return time.perf_counter() >= self.until

    def solve(
        self,
        mesh: Meshes,
        guess: Mapping[str, Guess] | Solution | str | None,
        *,
        uneven: bool = False,
        **settings: Any,
    ) -> Solution:
        """Return one solve, with other settings where these are given."""
        changed = replace(self.settings, **settings)
        how = self.until, self.progress
        return solve_on(self.transcription, mesh, guess, changed, *how, uneven=uneven)
