"""Recording of a solution of any optimal-control problem: variables, bounds and phases."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from microbot_ocp._base.table import Table
from microbot_ocp.ocp.solution import Solution
from microbot_ocp.views import _palette as palette
from microbot_ocp.views._variables import BoundedCurve, dense_times, variable_curves
from microbot_ocp.views.recording._blueprint import playing, plot_view, text_view
from microbot_ocp.views.recording._writer import APPLICATION, TIME, Writer, file_writer, plot_path


@dataclass(frozen=True, eq=False)
class SolutionRecording:
    """Recording of the curves of a solution, with its phases on one time axis.

    Attributes
    ----------
    title : str
    variables : mapping from (name, unit) to the curves of its phases
    phases : tuple of (begin in s, name)
    end : float, s
    summary : Table
    """

    title: str
    variables: dict[tuple[str, str], list[BoundedCurve]]
    phases: tuple[tuple[float, str], ...]
    end: float
    summary: Table

    def blueprint(self) -> rrb.Blueprint:
        """Return the layout: summary at the left, plots of all variables above lanes of phases."""
        plots = [
            plot_view(f"{name} [{unit}]" if unit else name, origin=plot_path(name))
            for name, unit in self.variables
        ]
        grid = rrb.Grid(*plots, grid_columns=min(3, len(plots)))
        lanes = rrb.StateTimelineView(origin="phases", name="phases")
        right = rrb.Vertical(grid, lanes, row_shares=[6.0, 1.0])
        whole = rrb.Horizontal(text_view(), right, column_shares=[1, 2])
        return playing(whole, TIME, self.end)

    def write(self, writer: Writer) -> None:
        """Write all entities; the layout is separate."""
        writer.summary(self.summary)
        for (name, _), curves in self.variables.items():
            path, times = plot_path(name), {TIME: np.concatenate([c.t for c in curves])}
            values = np.concatenate([curve.values for curve in curves])
            writer.curve(f"{path}/solution", times, values, name, palette.VARIABLE, 2.0)
            for side in ("lower", "upper"):
                bounds = [({TIME: curve.t[[0, -1]]}, getattr(curve, side)) for curve in curves]
                finite = [span for span in bounds if np.isfinite(span[1])]
                writer.dashes(f"{path}/limit_{side}", finite)
        begins, names = zip(*self.phases, strict=True)
        columns = rr.StateChange.columns(state=names)
        writer.columns("phases", {TIME: np.array(begins)}, columns)

    def save(self, path: str | Path) -> Path:
        """Write an ``.rrd`` with its layout, completely or not at all."""
        with file_writer(path, self.blueprint(), f"{APPLICATION} {self.title}") as writer:
            self.write(writer)
        return Path(path)


def of_solution(solution: Solution, name: str = "solution") -> SolutionRecording:
    """Return a recording of the states, controls and algebraic variables of a solution.

    ``name`` is the name of the problem. The solution need not have converged.

    Raises
    ------
    InputError
        A solution that no solver computed, which has no interpolation between its mesh points.
    """
    begins = list(accumulate((phase.duration for phase in solution.phases), initial=0.0))
    curves = variable_curves(solution.phases, dense_times)
    variables = {
        (key if k is None else f"{key}[{k}]", unit): parts
        for (key, k, unit), parts in curves.items()
    }
    rows = [[phase.name, f"{phase.duration:.6g}"] for phase in solution.phases]
    attempts = [
        f"{a.solver}: {a.status} after {a.iterations} iterations." for a in solution.attempts
    ]
    return SolutionRecording(
        title=name,
        variables=variables,
        phases=tuple(zip(begins, (phase.name for phase in solution.phases), strict=False)),
        end=begins[-1],
        summary=replace(
            Table.of_text(["phase", "duration [s]"], rows),
            title=f"{name}: {solution.status}, cost {solution.cost:.8g}",
            notes=[solution.advice, *attempts],
        ),
    )
