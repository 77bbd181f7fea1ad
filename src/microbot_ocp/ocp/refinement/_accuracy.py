"""What an accuracy asks of a mesh, and the finer mesh that comes nearer to it.

Intervals are divided, raised in degree, and moved to where controls switch or arcs meet.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.arcs import Switch, move_to_switches
from microbot_ocp.ocp.mesh import divide_phase
from microbot_ocp.ocp.refinement._degrees import Degrees, decay_rates, degrees_on, refine_hp
from microbot_ocp.ocp.refinement._history import RefinementStep
from microbot_ocp.ocp.refinement._refiner import split
from microbot_ocp.ocp.solution import PhaseSolution
from microbot_ocp.ocp.transcription import Mesh, Meshes, Transcription
from microbot_ocp.ocp.verification import Failure, OCPLimitUse, phase_layout


@dataclass(frozen=True)
class Accuracy:
    """How accurate a solution is to be, and how much may be tried for it.

    Attributes
    ----------
    states : relative state error of any interval; see :func:`~microbot_ocp.ocp.mesh.state_errors`
    cost : relative error of the cost: what a solve with finer controls or a higher degree gains,
        once the rest is good enough; infinite to ask for none
    switches : distance of a switch from the mesh, as a fraction of its phase
    limits : excess of a state, an algebraic variable or a path constraint between the mesh points,
        relative to half the range of its limits, or to the limit where there is only one. Bounds
        of the controls are left to :func:`~microbot_ocp.ocp.verify`: only polynomials leave them,
        and most of all where they jump. A path constraint of a polynomial control may stay
        exceeded at such a jump, on however short an interval, which ``advice`` then says.
    degrees : (least, most) of collocation: the degree is raised where the solution is smooth,
        intervals are divided where it is not (hp); None to divide intervals only
    rounds : most finer meshes
    most_intervals : of all phases together
    progress : share of the former errors that two meshes have to come below together
    moves : share of the cost: while a mesh changes it by more its errors mean little
    rise : share of the cost by which a finer mesh costs more without that being explained
    """

    states: float = 1e-6
    cost: float = 1e-5
    switches: float = 1e-3
    limits: float = 1e-5
    degrees: tuple[int, int] | None = None
    rounds: int = 10
    most_intervals: int = 2000
    progress: float = 0.9
    moves: float = 1e-2
    rise: float = 1e-6

    def __post_init__(self) -> None:
        for name in ("states", "switches", "limits"):
            checks.number(f"accuracy of {name}", getattr(self, name), above=0.0)
        if not self.cost > 0:
            raise InputError(f"accuracy of cost must be above 0, not {self.cost}")
        self.hp  # noqa: B018  its own check

    @property
    def hp(self) -> Degrees | None:
        """Least and most degree, where degrees are raised."""
        return None if self.degrees is None else Degrees(*self.degrees)

    def first_mesh(self, transcription: Transcription, mesh: Meshes) -> Meshes:
        """Give a mesh with the degree of the scheme in every interval, where degrees are raised."""
        hp = self.hp
        if hp is None:
            return mesh
        degree = getattr(transcription.scheme, "degree", hp.least)
        start = int(np.clip(degree, hp.least, hp.most))
        return [
            layout.chosen if layout.degrees is not None else Mesh(layout.mesh, start)
            for layout in transcription.layouts(mesh)
        ]

    def met(self, step: RefinementStep) -> bool:
        """Return whether a mesh is good enough, but for its cost."""
        return (
            step.state_error <= self.states
            and step.switch_offset <= self.switches
            and step.limit_excess <= self.limits
        )

    def missing(self, step: RefinementStep) -> list[Failure]:
        """Return what a mesh misses."""
        use = step.worst_limit
        parts = (
            ("state error", step.state_error, self.states, ""),
            ("offset of a switch", step.switch_offset, self.switches, " of a phase"),
            ("excess of a limit", step.limit_excess, self.limits, f" of it{_where(use)}"),
            ("error of the cost", step.cost_error, self.cost, " of it"),
        )
        return [
            Failure(Status.NO_PROGRESS, f"{name} {value:.1e} instead of {wanted:.1e}{unit}")
            for name, value, wanted, unit in parts
            if wanted < value < np.inf
        ]

    def stalled(self, history: Sequence[RefinementStep]) -> bool:
        """Return whether the last two meshes improved no error, switch nor limit."""
        if len(history) < 3:
            return False
        before, *later = history[-3:]
        if abs(later[0].cost - later[1].cost) > self.moves * abs(later[1].cost):
            return False
        return all(
            step.state_error > self.progress * before.state_error
            and step.switch_offset >= self.progress * before.switch_offset
            and step.limit_excess >= self.progress * before.limit_excess
            and not step.cost_error < self.progress * before.cost_error
            for step in later
        )

    def rises(self, history: Sequence[RefinementStep]) -> Iterator[str]:
        """Yield why a finer mesh costs more than a coarser one; nothing where none does."""
        pairs = itertools.pairwise((k, step) for k, step in enumerate(history) if step.accepted)
        for (one, coarse), (other, fine) in pairs:
            if fine.cost - coarse.cost > self.rise * abs(coarse.cost):
                yield (
                    f"The cost rises from {coarse.cost:.8g} on mesh {one} to {fine.cost:.8g} on "
                    f"mesh {other}: mesh {one} has a state error of {coarse.state_error:.1e} and "
                    f"exceeds limits by {coarse.limit_excess:.1e} between its points."
                )

    def finer(
        self,
        phase: PhaseSolution,
        errors: FloatArray,
        excess: FloatArray,
        switches: Sequence[Switch],
    ) -> Mesh:
        """Return a mesh for a phase that comes nearer."""
        layout, hp = phase_layout(phase), self.hp
        if hp is None:
            finer = Mesh(divide_phase(phase, errors, self.states))
        else:
            finer = refine_hp(layout.chosen, errors, decay_rates(phase), self.states, hp)
        finer = self._divided_at_limits(layout.mesh, finer, excess)
        moved = move_to_switches(finer.fractions, switches, self.switches)
        if hp is not None:
            return Mesh(moved, degrees_on(moved, finer))
        return Mesh(moved, None if layout.degrees is None else degrees_on(moved, layout.chosen))

    def _divided_at_limits(self, mesh: FloatArray, finer: Mesh, excess: FloatArray) -> Mesh:
        """Divide where a limit is exceeded, but for intervals that are divided already."""
        bad = excess > self.limits
        if not bad.any():
            return finer
        cuts = split(mesh, bad)
        owner = np.searchsorted(mesh, cuts, side="right") - 1
        pieces = np.histogram(finer.fractions, mesh)[0]
        whole = np.append(pieces[:-1] == 1, pieces[-1] == 2)  # the last bin has both its ends
        fresh = cuts[~np.isin(cuts, mesh) & whole[np.minimum(owner, whole.size - 1)]]
        fractions = np.union1d(finer.fractions, fresh)
        degrees = None if finer.degrees is None else degrees_on(fractions, finer)
        return Mesh(fractions, degrees)


def _where(use: OCPLimitUse | None) -> str:
    if use is None:
        return ""
    name = f"{use.name}[{use.component}]" if use.component else use.name
    return (
        f": {use.kind} {name} of phase {use.phase!r} is still {use.excess:.2g} {use.unit} beyond "
        f"its limit of {use.limit:.6g} at {use.time:.4g} s"
    )
