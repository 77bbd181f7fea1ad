"""The meshes of a solve, printed as a table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp._base.table import Column, Table
from microbot_ocp.ocp.arcs import Switch, find_switches
from microbot_ocp.ocp.solution import Solution
from microbot_ocp.ocp.verification import (
    Judgement,
    OCPLimitUse,
    relative_excess,
    worst_along,
)

COLUMNS = (
    Column("round"),
    Column("intervals"),
    Column("variables"),
    Column("state error", show=".1e"),
    Column("switch offset", show=".1e"),
    Column("limit excess", show=".1e"),
    Column("cost", show=".9g"),
    Column("cost error", show=".1e"),
    Column("iterations"),
    Column("time", "s", ".2f"),
    Column("", left=True),
)


@dataclass(frozen=True, eq=False)
class RefinementStep:
    """One mesh of a solve.

    Attributes
    ----------
    meshes : of every phase, fractions [N+1]
    variables : of the program
    state_error : largest relative state error of any interval; infinite where it was not accepted
    switch_offset : largest distance of a switch from the mesh, as a fraction of its phase
    limit_excess : largest excess of a state, algebraic variable or path constraint between mesh
        points, relative to half the range of its limits, or to the limit where there is only one;
        infinite where it was not accepted
    worst_limit : where that is; None where all limits are kept
    cost_error : relative, seen from what the cost changed by from mesh to mesh; infinite on the
        first
    switches : of every phase
    cost, duration, status, accepted, iterations : of the solve
    wall_time : of solve and error estimate, s
    """

    meshes: tuple[FloatArray, ...]
    variables: int
    state_error: float
    switch_offset: float
    limit_excess: float
    worst_limit: OCPLimitUse | None
    switches: tuple[tuple[Switch, ...], ...]
    cost: float
    duration: float
    status: Status
    accepted: bool
    iterations: int
    wall_time: float
    cost_error: float = np.inf

    def __str__(self) -> str:
        """One line of text."""
        return (
            f"mesh {' + '.join(map(str, self.intervals))}: state error {self.state_error:.2g}, "
            f"limits exceeded by {self.limit_excess:.2g}, cost {self.cost:.8g}"
        )

    @property
    def intervals(self) -> tuple[int, ...]:
        """Number of intervals of every phase."""
        return tuple(mesh.size - 1 for mesh in self.meshes)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            **vars(self),
            "meshes": [mesh.tolist() for mesh in self.meshes],
            "intervals": list(self.intervals),
            "worst_limit": None if self.worst_limit is None else vars(self.worst_limit),
            "switches": [[vars(switch) for switch in phase] for phase in self.switches],
        }


class History(tuple[RefinementStep, ...]):
    """Meshes of a solve one after the other; printed as a table."""

    __slots__ = ()

    def table(self) -> Table:
        """Return one row a mesh."""
        return Table(COLUMNS, [(number, *_cells(step)) for number, step in enumerate(self)])

    def rises(self, least: float) -> Iterator[str]:
        """Yield why a finer mesh costs more than a coarser one by a share; nothing where none
        does.
        """
        for (one, coarse), (other, fine) in pairwise(enumerate(self)):
            if fine.accepted and fine.cost - coarse.cost > least * abs(coarse.cost):
                yield (
                    f"The cost rises from {coarse.cost:.8g} on mesh {one} to {fine.cost:.8g} on "
                    f"mesh {other}: mesh {one} has a state error of {coarse.state_error:.1e} and "
                    f"exceeds limits by {coarse.limit_excess:.1e} between its points."
                )

    def __str__(self) -> str:
        return str(self.table())

    def _repr_html_(self) -> str:
        return self.table()._repr_html_()


def _cells(step: RefinementStep) -> tuple[Any, ...]:
    return (
        " + ".join(map(str, step.intervals)),
        step.variables,
        step.state_error,
        step.switch_offset,
        step.limit_excess,
        step.cost,
        step.cost_error if np.isfinite(step.cost_error) else "",
        step.iterations,
        step.wall_time,
        "" if step.accepted else f"{step.status}, not accepted",
    )


def step_of(solution: Solution, judgement: Judgement | None, wall_time: float) -> RefinementStep:
    """Return what a mesh led to, as its judgement says; without one it was not accepted."""
    layouts = [phase.laid_out for phase in solution.phases]
    switches = tuple(find_switches(phase) for phase in solution.phases)
    errors, excess, worst = [np.inf], [np.inf], None
    if judgement is not None:
        errors = [float(each.max()) for each in judgement.state_errors]
        excess = [float(relative_excess(dense).max()) for dense in judgement.dense]
        worst = worst_along(judgement.limits)
    return RefinementStep(
        meshes=tuple(phase.mesh for phase in solution.phases),
        variables=sum(layout.variable_count for layout in layouts),
        state_error=max(errors),
        switch_offset=max((s.offset for each in switches for s in each), default=0.0),
        limit_excess=max(excess),
        worst_limit=worst,
        switches=switches,
        cost=solution.cost,
        duration=solution.duration,
        status=solution.status,
        accepted=judgement is not None,
        iterations=sum(max(attempt.iterations, 0) for attempt in solution.attempts),
        wall_time=wall_time,
    )
