"""Discretisation error of the cost: one solve more, with finer controls or a higher degree.

The error of the dynamics says nothing of how near a control is to the optimal one: what is constant
over an interval may follow its dynamics to twelve digits and cost a per cent too much. What a solve
with more freedom gains is the error; where its controls differ most it arose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.solution import PhaseSolution, Solution, cost_size
from microbot_ocp.ocp.transcription import Mesh, PhaseLayout
from microbot_ocp.ocp.transcription.schemes import Collocation
from microbot_ocp.ocp.verification import phase_layout, state_weights


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

PLACES = np.array([0.1, 0.3, 0.5, 0.7, 0.9])  # of an interval at which controls are compared


def with_more_freedom(solution: Solution) -> list[Mesh]:
    """Meshes with a degree more where all is polynomial, else with halved intervals."""
    return [_freer(phase_layout(phase)) for phase in solution.phases]


def _freer(layout: PhaseLayout) -> Mesh:
    fractions, degrees = layout.mesh, layout.degrees
    if _raises(layout):
        own = [kind.scheme.degree for kind in layout.kinds if isinstance(kind.scheme, Collocation)]
        return Mesh(fractions, np.array(own)[layout.kind_of] + 1)
    halves = np.sort(np.append(fractions, (fractions[:-1] + fractions[1:]) / 2))
    return Mesh(halves, None if degrees is None else np.repeat(degrees, 2))


def _raises(layout: PhaseLayout) -> bool:
    """Whether a degree more frees the controls of a phase, too."""
    return all(c.shape == "polynomial" for c in layout.phase.controls) and all(
        isinstance(kind.scheme, Collocation) and kind.scheme.degree < SETTINGS.highest
        for kind in layout.kinds
    )


def cost_error(solution: Solution, freer: Solution) -> float:
    """Error of the cost, relative, from a solve with more freedom."""
    raised = all(_raises(phase_layout(phase)) for phase in solution.phases)
    gained = abs(solution.cost - freer.cost) * (1.0 if raised else SETTINGS.halved)
    return gained / cost_size(solution.cost, solution.cost_scale)


def control_orders(phase: PhaseSolution) -> FloatArray:
    """Order [N] with which the cost converges where the controls of a phase are smooth."""
    layout = phase_layout(phase)
    own = [
        2 * kind.scheme.degree if _raises(layout) and isinstance(kind.scheme, Collocation) else 2
        for kind in layout.kinds
    ]
    return np.array(own)[layout.kind_of]


def shares(solution: Solution, freer: Solution) -> list[FloatArray]:
    """Shares of the intervals in the error of the cost: one array [N] a phase, one in sum.

    In proportion to the integral of the squared difference of the controls, each relative to its
    own range; of the states where there are no controls.
    """
    parts = [
        _differences(one, other) for one, other in zip(solution.phases, freer.phases, strict=True)
    ]
    whole = sum(float(part.sum()) for part in parts)
    if not whole > 0:
        count = sum(part.size for part in parts)
        return [np.full(part.size, 1.0 / count) for part in parts]
    return [part / whole for part in parts]


def _differences(phase: PhaseSolution, freer: PhaseSolution) -> FloatArray:
    declared = phase_layout(phase).phase
    names = [c.name for c in declared.controls] or [s.name for s in declared.states]
    steps = np.diff(phase.mesh)
    places = (phase.mesh[:-1, None] + PLACES * steps[:, None]).ravel()
    tables = [part.sample(places * part.duration) for part in (phase, freer)]
    one, other = (np.hstack([table[name] for name in names]) for table in tables)
    size = np.maximum(np.ptp(one, axis=0), 1e-6 * np.maximum(np.abs(one).max(axis=0), 1e-300))
    if not declared.controls:
        size = state_weights(phase)
    squares = np.sum(((one - other) / size) ** 2, axis=1).reshape(steps.size, PLACES.size)
    return squares.mean(axis=1) * steps * phase.duration
