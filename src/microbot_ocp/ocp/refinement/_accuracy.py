"""Accuracy requirements of a solution, and the history of the meshes of a solve."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp._base.table import Column, Table
from microbot_ocp.ocp.arcs import Switch, find_switches, move_to_switches
from microbot_ocp.ocp.mesh import divide, divide_phase
from microbot_ocp.ocp.solution import Solution
from microbot_ocp.ocp.verification import Judgement, OCPLimitUse, relative_excess, worst_along

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
    """Results of a solve on one mesh.

    Attributes
    ----------
    meshes : mesh of every phase, fractions [N+1]
    variables : number of variables of the program
    state_error : largest relative state error of any interval; infinite if it was not accepted
    switch_offset : largest distance of a switch from the mesh, as a fraction of its phase
    limit_excess : largest excess of a state, algebraic variable or path constraint between mesh
        points, relative to half the range of its limits, or to the limit if there is only one;
        infinite if the solution was not accepted
    worst_limit : limit with that excess; None if all limits are kept
    cost_error : relative error estimated from the changes of the cost from mesh to mesh; infinite
        on the first mesh
    switches : switches of every phase
    cost, duration, status, accepted, iterations : results of the solve
    wall_time : wall time of solve and error estimate, s
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
        """Return one line of text."""
        return (
            f"mesh {' + '.join(map(str, self.intervals))}: state error {self.state_error:.2g}, "
            f"limits exceeded by {self.limit_excess:.2g}, cost {self.cost:.8g}"
        )

    @property
    def intervals(self) -> tuple[int, ...]:
        """Number of intervals of every phase."""
        return tuple(mesh.size - 1 for mesh in self.meshes)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            **vars(self),
            "meshes": [mesh.tolist() for mesh in self.meshes],
            "intervals": list(self.intervals),
            "worst_limit": None if self.worst_limit is None else vars(self.worst_limit),
            "switches": [[vars(switch) for switch in phase] for phase in self.switches],
        }


class History(tuple[RefinementStep, ...]):
    """Meshes of a solve in order; printed as a table."""

    __slots__ = ()

    def table(self) -> Table:
        """Return a table with one row per mesh."""
        return Table(COLUMNS, [(number, *_cells(step)) for number, step in enumerate(self)])

    def rises(self, least: float) -> Iterator[str]:
        """Yield a sentence for each mesh with a cost that is higher by the fraction ``least``."""
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
    """Return the results on a mesh from its judgement; None marks a solution not accepted."""
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


@dataclass(frozen=True)
class Accuracy:
    """Accuracy of a solution, and limits of the effort for it.

    The requirements add to the thresholds of :func:`~microbot_ocp.ocp.verify`; an infinite value
    adds none.

    Attributes
    ----------
    states : relative state error of any interval; see :func:`~microbot_ocp.ocp.mesh.state_errors`
    cost : relative error of the cost, estimated from its changes from mesh to mesh
    switches : distance of a switch from the mesh, as a fraction of its phase; mesh points move to
        the switches
    limits : excess of a state, an algebraic variable or a path constraint between the mesh points,
        relative to half the range of its limits, or to the limit if there is only one. Bounds of
        controls are left to :func:`~microbot_ocp.ocp.verify`: only polynomials exceed them, mostly
        at jumps. A path constraint of a polynomial control may stay exceeded at a jump for any
        interval length; ``advice`` reports this.
    rounds : largest number of finer meshes
    most_intervals : largest number of intervals of all phases together
    """

    states: float = 1e-6
    cost: float = 1e-5
    switches: float = 1e-3
    limits: float = 1e-5
    rounds: int = 14
    most_intervals: int = 2000

    def __post_init__(self) -> None:
        for name in ("states", "cost", "switches", "limits"):
            value = getattr(self, name)
            if not (isinstance(value, float) and value == np.inf):
                checks.number(f"accuracy of {name}", value, above=0.0)

    def met(self, step: RefinementStep) -> bool:
        """Return True if a mesh meets the accuracy."""
        return not any(self.missing(step))

    def missing(self, step: RefinementStep) -> Iterator[str]:
        """Yield the requirements that a mesh does not meet, in words."""
        use = step.worst_limit
        for name, value, wanted, unit in (
            ("state error", step.state_error, self.states, ""),
            ("offset of a switch", step.switch_offset, self.switches, " of a phase"),
            ("excess of a limit", step.limit_excess, self.limits, f" relative to it{_where(use)}"),
            ("error of the cost", step.cost_error, self.cost, " relative to it"),
        ):
            if value > wanted:
                amount = f"{value:.1e}" if value < np.inf else "unknown"
                yield f"{name} {amount} instead of {wanted:.1e}{unit}"

    def finer(
        self, solution: Solution, judgement: Judgement, step: RefinementStep, *, whole: bool
    ) -> list[FloatArray]:
        """Return finer meshes: intervals divided by their errors, and points moved to switches.

        With ``whole``, every interval is halved if that suffices. Intervals that exceed limits
        between their points are divided as for a scheme of order zero: at a jump of the control, a
        state exceeds its limit by step times jump for any order of the scheme.
        """
        with np.errstate(invalid="ignore"):  # an infinite error by an infinite accuracy
            pairs = zip(judgement.errors, judgement.state_errors, strict=True)
            errors = [np.fmax(share, error / self.states) for share, error in pairs]
            beyond = [relative_excess(dense).max(axis=1) / self.limits for dense in judgement.dense]
            excess = list(map(np.fmax, judgement.excess, beyond))
        phases = solution.phases
        divided = [divide_phase(p, e, 1.0) for p, e in zip(phases, errors, strict=True)]
        both = zip(divided, phases, strict=True)
        most = max(int(np.histogram(mesh[:-1], phase.mesh)[0].max()) for mesh, phase in both)
        if whole and most <= 2:
            divided = [np.union1d(p.mesh, (p.mesh[:-1] + p.mesh[1:]) / 2) for p in phases]
        finer = []
        parts = zip(phases, divided, excess, step.switches, strict=True)
        for phase, mesh, each, switches in parts:
            points = np.union1d(mesh, divide(phase.mesh, each, 1.0, 0))
            finer.append(move_to_switches(points, switches, self.switches))
        return finer


def _where(use: OCPLimitUse | None) -> str:
    if use is None:
        return ""
    name = f"{use.name}[{use.component}]" if use.component else use.name
    return (
        f": {use.kind} {name} of phase {use.phase!r} is still {use.excess:.2g} {use.unit} beyond "
        f"its limit of {use.limit:.6g} at {use.time:.4g} s"
    )


# Requirements of every solution: it passes the judgement, and its cost has settled.
PASSING = Accuracy(np.inf, 1e-4, np.inf, np.inf)
