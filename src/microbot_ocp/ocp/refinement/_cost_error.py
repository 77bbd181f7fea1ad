"""Discretisation error of the cost: one solve more, with finer controls or a higher degree.

The error of the dynamics says nothing of how near a control is to the optimal one: what is constant
over an interval may follow its dynamics to twelve digits and cost a per cent too much. What a solve
with more freedom gains is the error, and that solve is the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ocp.ocp.solution import Solution, cost_size
from microbot_ocp.ocp.transcription import Mesh, PhaseLayout
from microbot_ocp.ocp.transcription.schemes import Collocation
from microbot_ocp.ocp.verification import phase_layout


@dataclass(frozen=True)
class CostErrorSettings:
    """How the error of a cost is estimated.

    Attributes
    ----------
    highest : degree of collocation
    halved : times what halving gains of a second-order error is the whole
    """

    highest: int = 9
    halved: float = 4 / 3


SETTINGS = CostErrorSettings()


def with_more_freedom(solution: Solution) -> list[Mesh]:
    """Return meshes with a degree more where all is polynomial, else with halved intervals."""
    return [_freer(phase_layout(phase)) for phase in solution.phases]


def _freer(layout: PhaseLayout) -> Mesh:
    fractions, degrees = layout.mesh, layout.degrees
    if _raises(layout):
        of_kind = [
            kind.scheme.degree for kind in layout.kinds if isinstance(kind.scheme, Collocation)
        ]
        return Mesh(fractions, np.array(of_kind)[layout.kind_of] + 1)
    halves = np.sort(np.append(fractions, (fractions[:-1] + fractions[1:]) / 2))
    return Mesh(halves, None if degrees is None else np.repeat(degrees, 2))


def _raises(layout: PhaseLayout) -> bool:
    """Return whether a degree more frees the controls of a phase, too."""
    return all(c.shape == "polynomial" for c in layout.phase.controls) and all(
        isinstance(kind.scheme, Collocation) and kind.scheme.degree < SETTINGS.highest
        for kind in layout.kinds
    )


def cost_error(solution: Solution, freer: Solution) -> float:
    """Return the error of the cost, relative, from a solve with more freedom."""
    raised = all(_raises(phase_layout(phase)) for phase in solution.phases)
    gained = abs(solution.cost - freer.cost) * (1.0 if raised else SETTINGS.halved)
    return gained / cost_size(solution.cost, solution.cost_scale)
