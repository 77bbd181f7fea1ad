"""A solution of any optimal-control problem: every variable over the time, bounds, phases."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.ocp.problem import Phase
from microbot_ocp.ocp.solution import PhaseSolution, Solution
from microbot_ocp.views.recording import (
    _blueprint as blueprint,
    _curves as curves,
    _messages as words,
    _paths as entities,
    _surroundings as surroundings,
)
from microbot_ocp.views.recording._palette import VARIABLE_COLOR
from microbot_ocp.views.recording._writer import APPLICATION, Writer, file_writer

POINTS = 400  # samples of a phase
COLUMNS = 3  # of plots


@dataclass(frozen=True, eq=False)
class Stretch:
    """One variable's component in one phase: times [N], s, values [N] and bounds."""

    t: FloatArray
    values: FloatArray
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class SolutionRecording:
    """Curves of a solution, phase after phase on one time, ready to be saved.

    Attributes
    ----------
    title : str
    variables : mapping from (name, unit) to the stretches of its phases
    phases : tuple of (begin in s, name)
    end : float, s
    summary : str
        Markdown.
    """

    title: str
    variables: dict[tuple[str, str], tuple[Stretch, ...]]
    phases: tuple[tuple[float, str], ...]
    end: float
    summary: str

    def blueprint(self) -> rrb.Blueprint:
        """Plots of every variable over lanes of the phases; words to the left."""
        plots = [
            rrb.TimeSeriesView(
                origin=entities.variable(name),
                name=f"{name} [{unit}]" if unit else name,
                plot_legend=rrb.PlotLegend(visible=False),
            )
            for name, unit in self.variables
        ]
        grid = rrb.Grid(*plots, grid_columns=min(COLUMNS, len(plots)))
        lanes = rrb.StateTimelineView(origin=entities.PHASES, name="phases")
        left = rrb.TextDocumentView(origin=entities.SUMMARY, name="summary")
        right = rrb.Vertical(grid, lanes, row_shares=[6.0, 1.0])
        whole = rrb.Horizontal(left, right, column_shares=[1.0, 2.2])
        return blueprint.playing(whole, entities.TIME, self.end)

    def write(self, writer: Writer) -> None:
        """Send everything but the layout."""
        surroundings.write_words(writer, self.summary)
        for (name, _), stretches in self.variables.items():
            path = entities.variable(name)
            look = rr.SeriesLines.from_fields(names=[name], colors=[VARIABLE_COLOR], widths=[2.0])
            writer.static(f"{path}/solution", look)
            times = {entities.TIME: np.concatenate([s.t for s in stretches])}
            values = np.concatenate([s.values for s in stretches])
            writer.columns(f"{path}/solution", times, rr.Scalars.columns(scalars=values))
            for side in ("lower", "upper"):
                spans = [
                    ({entities.TIME: (s.t[0], s.t[-1])}, getattr(s, side))
                    for s in stretches
                    if np.isfinite(getattr(s, side))
                ]
                curves.dashed(writer, f"{path}/limit_{side}", spans)
        begins = {entities.TIME: np.array([begin for begin, _ in self.phases])}
        names = [name for _, name in self.phases]
        writer.columns(entities.PHASES, begins, rr.StateChange.columns(state=names))

    def save(self, path: str | Path) -> Path:
        """Write an ``.rrd`` with its layout, whole or not at all."""
        application = f"{APPLICATION} {self.title}"
        with file_writer(path, self.blueprint(), application) as writer:
            self.write(writer)
        return Path(path)


def of_solution(solution: Solution, name: str = "solution") -> SolutionRecording:
    """States, controls and algebraic variables of a solve, converged or not, with their bounds.

    ``name`` is that of the problem.

    Raises
    ------
    InputError
        A solution that no solve made: it has no interpolation between its mesh points.
    """
    begins = list(accumulate((phase.duration for phase in solution.phases), initial=0.0))
    found: dict[tuple[str, str], list[Stretch]] = {}
    for begin, phase in zip(begins, solution.phases, strict=False):
        for key, stretch in _stretches(begin, phase):
            found.setdefault(key, []).append(stretch)
    rows = [[phase.name, f"{phase.duration:.6g}"] for phase in solution.phases]
    return SolutionRecording(
        title=name,
        variables={key: tuple(stretches) for key, stretches in found.items()},
        phases=tuple(zip(begins, (phase.name for phase in solution.phases), strict=False)),
        end=begins[-1],
        summary=words.document(
            f"{name}: {solution.status}, cost {solution.cost:.8g}",
            words.table(["phase", "duration [s]"], rows),
            [
                solution.advice,
                *(
                    f"{a.solver}: {a.status} after {a.iterations} iterations."
                    for a in solution.attempts
                ),
            ],
        ),
    )


def _stretches(begin: float, solved: PhaseSolution) -> Iterator[tuple[tuple[str, str], Stretch]]:
    if solved.layout is None:
        raise InputError(f"phase {solved.name!r} was not made by a solve: it has mesh values only")
    phase: Phase = solved.layout.phase
    t = np.union1d(np.linspace(0.0, solved.duration, POINTS), solved.t)
    table = solved.sample(t)
    for variable in (*phase.states, *phase.controls, *phase.algebraics):
        for k in range(variable.size):
            label = variable.name if variable.size == 1 else f"{variable.name}[{k}]"
            bounds = float(variable.lower[k]), float(variable.upper[k])
            yield (label, variable.unit), Stretch(begin + t, table[variable.name][:, k], *bounds)
