"""What is asked of a solution: how accurate it is to be, and how much may be tried for it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.arcs import move_to_switches
from microbot_ocp.ocp.mesh import divide, divide_phase
from microbot_ocp.ocp.refinement._history import RefinementStep
from microbot_ocp.ocp.solution import Solution
from microbot_ocp.ocp.verification import Failure, Judgement, OCPLimitUse, relative_excess


@dataclass(frozen=True)
class Accuracy:
    """How accurate a solution is to be, and how much may be tried for it.

    It is asked for besides what :func:`~microbot_ocp.ocp.verify` lets pass; what is infinite is
    not.

    Attributes
    ----------
    states : relative state error of any interval; see :func:`~microbot_ocp.ocp.mesh.state_errors`
    cost : relative error of the cost: what it would still change by on finer meshes, seen from what
        it changed by from mesh to mesh
    switches : distance of a switch from the mesh, as a fraction of its phase: mesh points move
        there
    limits : excess of a state, an algebraic variable or a path constraint between the mesh points,
        relative to half the range of its limits, or to the limit where there is only one. Bounds
        of the controls are left to :func:`~microbot_ocp.ocp.verify`: only polynomials leave them,
        and most of all where they jump. A path constraint of a polynomial control may stay
        exceeded at such a jump, on however short an interval, which ``advice`` then says.
    rounds : most finer meshes
    most_intervals : of all phases together
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
        """Return whether a mesh is good enough."""
        return not any(self.missing(step))

    def missing(self, step: RefinementStep) -> Iterator[Failure]:
        """Yield what a mesh misses."""
        use = step.worst_limit
        for name, value, wanted, unit in (
            ("state error", step.state_error, self.states, ""),
            ("offset of a switch", step.switch_offset, self.switches, " of a phase"),
            ("excess of a limit", step.limit_excess, self.limits, f" of it{_where(use)}"),
            ("error of the cost", step.cost_error, self.cost, " of it"),
        ):
            if value > wanted:
                amount = f"{value:.1e}" if value < np.inf else "unknown"
                sentence = f"{name} {amount} instead of {wanted:.1e}{unit}"
                yield Failure(Status.NO_PROGRESS, sentence)

    def finer(
        self, solution: Solution, judgement: Judgement, step: RefinementStep, *, whole: bool
    ) -> list[FloatArray]:
        """Return meshes that come nearer: intervals divided as their errors ask for, and points
        where controls switch; with ``whole`` every interval in two, if that will do.

        Where limits are exceeded in between they are divided further: where a control jumps a state
        leaves its limit by the step times the jump, whatever the order of the scheme.
        """
        with np.errstate(invalid="ignore"):  # infinite, where it is not asked for
            errors = [
                np.fmax(share, error / self.states)
                for share, error in zip(judgement.errors, judgement.state_errors, strict=True)
            ]
            excess = [
                np.fmax(share, relative_excess(dense).max(axis=1) / self.limits)
                for share, dense in zip(judgement.excess, judgement.dense, strict=True)
            ]
        phases = solution.phases
        divided = [divide_phase(p, e, 1.0) for p, e in zip(phases, errors, strict=True)]
        most = max(
            int(np.histogram(mesh[:-1], phase.mesh)[0].max())
            for mesh, phase in zip(divided, phases, strict=True)
        )
        if whole and most <= 2:
            divided = [np.union1d(p.mesh, (p.mesh[:-1] + p.mesh[1:]) / 2) for p in phases]
        return [
            move_to_switches(
                np.union1d(mesh, divide(phase.mesh, beyond, 1.0, 0)), switches, self.switches
            )
            for mesh, phase, beyond, switches in zip(
                divided, phases, excess, step.switches, strict=True
            )
        ]


def _where(use: OCPLimitUse | None) -> str:
    if use is None:
        return ""
    name = f"{use.name}[{use.component}]" if use.component else use.name
    return (
        f": {use.kind} {name} of phase {use.phase!r} is still {use.excess:.2g} {use.unit} beyond "
        f"its limit of {use.limit:.6g} at {use.time:.4g} s"
    )


# What is asked of every solution: that it passes, and that its cost is settled.
PASSING = Accuracy(np.inf, 1e-4, np.inf, np.inf, rounds=14, most_intervals=1000)
