"""The limits that make a task infeasible, by their least violation.

The relaxed problem keeps via points and dynamics. Every limit may be violated by a constant amount
on each segment, and the sum of the amounts, relative to the limits, is minimised. If the minimum is
zero, its motion is feasible, and the search continues from it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from microbot_ocp._base.outcome import Advice, Outcome
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LimitFamily
from microbot_ocp.ocp import Explanation, PhaseSolution, Relaxation, explain
from microbot_ocp.ocp.transcription import Guess, Meshes, Transcription
from microbot_ocp.planning.task import place_in_task

MOST_ITERATIONS = 200  # iteration limit of each relaxed solve
UNCONFIRMED = (
    "Not confirmed: the relaxed problem, in which limits may give, did not converge either, so "
    "there may be a motion: try more starts, or another seed."
)

CONFIRMED = (
    "No motion within the limits was found. The relaxed problem, in which limits may give, confirms"
    " it: of the motions near those tried the one that breaks the limits least exceeds"
)


def least_violation(
    kernels: Transcription, starts: Sequence[Mapping[str, Guess]], mesh: Meshes
) -> Explanation:
    """Return the least violation of the limits over several starts."""
    best: Explanation | None = None
    for start in starts:
        explanation = explain(
            kernels, mesh, start, limits_only=True, max_iterations=MOST_ITERATIONS
        )
        if explanation.conclusive and explanation.feasible:
            return explanation
        if best is None or _total(explanation) < _total(best):
            best = explanation
    assert best is not None
    return best


def _total(explanation: Explanation) -> float:
    """Return the sum of relative violations; infinite if the solve was not conclusive."""
    if not explanation.conclusive:
        return float("inf")
    return sum(map(_violation, explanation.gives))


def _violation(gives: Relaxation) -> float:
    """Return a violation relative to its limit."""
    return (gives.amount or 0.0) / abs(gives.limit or 1.0)


def guesses_from(explanation: Explanation) -> dict[str, Guess]:
    """Return the motion of a relaxed problem as initial guesses."""
    names = ("q", "qd", "qdd")
    return {
        phase.name: Guess(phase.duration, {name: phase[name] for name in names})
        for phase in explanation.phases
    }


def judged(
    explanation: Explanation, family: LimitFamily, outcome: Outcome
) -> tuple[Outcome, dict[str, Any]]:
    """Return the outcome with the violated limits, and the provenance entry with all numbers."""
    if not explanation.conclusive:
        return outcome.and_(Advice("remark", UNCONFIRMED)), {}
    if explanation.feasible:
        return outcome, {}
    rows, entries = list[Advice](), []
    for gives in sorted(explanation.gives, key=_violation, reverse=True):
        title, pose = _limit_name(gives, explanation, family), _pose(gives, explanation)
        joints = enumerate(pose)
        at = ", ".join(family.robot.position_text(j, float(f"{value:.4g}")) for j, value in joints)
        unit = f" {gives.unit}".rstrip()
        sentence = (
            f"  {title} by {gives.amount:.4g}{unit}, the limit being {gives.limit:.6g}{unit}, most "
            f"at q = ({at})"
        )
        rows.append(Advice("limit", sentence, title, gives.amount, gives.unit))
        about = {"limit": title, "value": gives.limit, "exceeded_by": gives.amount}
        entries.append(about | {"unit": gives.unit, "q": pose})
    return Outcome.of(Status.INFEASIBLE, CONFIRMED, *rows), {"least_violation": entries}


def _limit_name(gives: Relaxation, explanation: Explanation, family: LimitFamily) -> str:
    """Return the names of the limit and its segment; the reported pose gives the place."""
    name = gives.name.removesuffix(f"[{gives.component}]")
    phases = [phase.name for phase in explanation.phases]
    return place_in_task(family, gives.kind, name, gives.component, gives.phase, None, phases)


def _pose(gives: Relaxation, explanation: Explanation) -> list[float]:
    phase: PhaseSolution = next(p for p in explanation.phases if p.name == gives.phase)
    return [float(np.interp(gives.time, phase.t, column)) for column in phase["q"].T]
