"""The result of a refinement: its meshes, printed as a table, and its status."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.showing import view_for
from microbot_ocp._base.status import Status
from microbot_ocp._base.table import Column, Table
from microbot_ocp.ocp.arcs import Switch, find_switches
from microbot_ocp.ocp.solution import Solution
from microbot_ocp.ocp.transcription import Mesh
from microbot_ocp.ocp.transcription.schemes import Collocation
from microbot_ocp.ocp.verification import OCPLimitUse, phase_layout

DEARER = 1e-6  # share of the cost: by more a finer mesh may not cost more without a reason
COLUMNS = (
    Column("round"),
    Column("intervals"),
    Column("degree"),
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
    """One mesh of a refinement.

    Attributes
    ----------
    meshes : of every phase
    degrees : least and most degree of collocation, None for other schemes
    variables : of the program
    state_error : largest relative state error of any interval; infinite where nothing was solved
    switch_offset : largest distance of a switch from the mesh, as a fraction of its phase
    limit_excess : largest excess of a state, algebraic variable or path constraint between mesh
        points, relative to half the range of its limits, or to the limit where there is only one;
        infinite where nothing was solved
    worst_limit : where that is; None where all limits are kept
    cost_error : relative, found by a solve with finer controls or a higher degree once all else is
        good enough; infinite where it was not looked for
    switches : of every phase
    cost, duration, status, accepted, iterations : of the solve
    wall_time : of solve and error estimate, s
    """

    meshes: tuple[Mesh, ...]
    degrees: tuple[int, int] | None
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

    @property
    def intervals(self) -> tuple[int, ...]:
        """Number of intervals of every phase."""
        return tuple(mesh.intervals for mesh in self.meshes)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            **vars(self),
            "meshes": [mesh.as_dict() for mesh in self.meshes],
            "intervals": list(self.intervals),
            "worst_limit": None if self.worst_limit is None else vars(self.worst_limit),
            "switches": [[vars(switch) for switch in phase] for phase in self.switches],
        }


class History(tuple[RefinementStep, ...]):
    """Meshes of a refinement one after the other; printed as a table."""

    __slots__ = ()

    def table(self) -> Table:
        """One row a mesh."""
        return Table(COLUMNS, [(number, *_cells(step)) for number, step in enumerate(self)])

    def __str__(self) -> str:
        return str(self.table())


def _cells(step: RefinementStep) -> tuple[Any, ...]:
    low, high = step.degrees or ("", "")
    return (
        " + ".join(map(str, step.intervals)),
        f"{low}" if low == high else f"{low} to {high}",
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


@dataclass(frozen=True, eq=False)
class Refined:
    """A solution, the meshes that led to it, and whether its accuracy is the one asked for.

    Attributes
    ----------
    solution : the last accepted one
    history : of every mesh
    status : Status
        Why it ended. Where the first mesh was not solved it is the status of that solve.
    exceeded : the limit that the solution exceeds most between mesh points, if by more than asked
        for
    missed : what was asked for and is not reached, in words
    way : in which other way it was found, where the declared one led to nothing
    """

    solution: Solution
    history: History
    status: Status
    exceeded: OCPLimitUse | None = None
    missed: tuple[str, ...] = ()
    way: str = ""

    @property
    def advice(self) -> str:
        """What the status means, what is missed, and why a finer mesh costs more where it does.

        Where the first mesh was not solved it is the advice of that solve.
        """
        if not self.solution.status.solved:
            return self.solution.advice
        said = [self.status.sentence]
        if self.missed and self.status.solved:
            said = [f"Good enough: finer meshes come no nearer to {'; '.join(self.missed)}."]
        elif self.missed:
            said.append(f"Missed: {'; '.join(self.missed)}.")
        if self.way:
            said.append(f"With other values at every point no finer mesh was accepted: {self.way}.")
        use = self.exceeded
        if use is not None:
            name = f"{use.name}[{use.component}]" if use.component else use.name
            said.append(
                f"Between mesh points {use.kind} {name} of phase {use.phase!r} is still "
                f"{use.excess:.2g} {use.unit} beyond its limit of {use.limit:.6g} at "
                f"{use.time:.4g} s."
            )
        several = self.solution.several
        return " ".join([*said, *([several] if several else ()), *self._rises()])

    def _rises(self) -> Iterator[str]:
        """Why a finer mesh costs more than a coarser one; nothing where none does."""
        kept = [(number, step) for number, step in enumerate(self.history) if step.accepted]
        for (one, coarse), (other, fine) in itertools.pairwise(kept):
            if fine.cost - coarse.cost > DEARER * abs(coarse.cost):
                yield (
                    f"The cost rises from {coarse.cost:.8g} on mesh {one} to {fine.cost:.8g} on "
                    f"mesh {other}: mesh {one} has a state error of {coarse.state_error:.1e} and "
                    f"exceeds limits by {coarse.limit_excess:.1e} between its points."
                )

    def __str__(self) -> str:
        return f"{self.history}\n{self.advice}"

    def __repr__(self) -> str:
        return (
            f"<Refined: {self.status} in {len(self.history)} meshes, cost {self.solution.cost:.8g}>"
        )

    def _repr_html_(self) -> str:
        return view_for(self, "table")(self)._repr_html_()


def step_of(
    solution: Solution,
    errors: Sequence[FloatArray],
    excess: Sequence[FloatArray],
    worst_limit: OCPLimitUse | None,
    accepted: bool,
    wall_time: float,
) -> RefinementStep:
    layouts = [phase_layout(phase) for phase in solution.phases]
    switches = tuple(find_switches(phase) for phase in solution.phases)
    used = [
        kind.scheme.degree
        for layout in layouts
        for kind in layout.kinds
        if isinstance(kind.scheme, Collocation)
    ]
    return RefinementStep(
        meshes=tuple(layout.chosen for layout in layouts),
        degrees=(min(used), max(used)) if used else None,
        variables=sum(layout.variable_count for layout in layouts),
        state_error=max(float(own.max()) for own in errors),
        switch_offset=max((s.offset for own in switches for s in own), default=0.0),
        limit_excess=max(float(own.max()) for own in excess),
        worst_limit=worst_limit,
        switches=switches,
        cost=solution.cost,
        duration=solution.duration,
        status=solution.status,
        accepted=accepted,
        iterations=sum(attempt.iterations for attempt in solution.attempts),
        wall_time=wall_time,
    )
