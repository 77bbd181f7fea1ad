"""A phase integrated again with the solution's own control, interval by interval."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.growth import carry
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.solution import PhaseSolution
from microbot_ocp.ocp.verification._certificate import ResimulationCheck
from microbot_ocp.ocp.verification._reintegration import (
    Integrated,
    mesh_states,
    phase_layout,
    state_weights,
    transitions,
)


def resimulate(phase: PhaseSolution, intervals: Integrated) -> ResimulationCheck:
    """Judge the intervals of a phase, which are integrated already."""
    states = phase_layout(phase).phase.states
    wanted, weights = mesh_states(phase)[1:], state_weights(phase)
    defects = np.nan_to_num((intervals.states - wanted) / weights, nan=np.inf)
    k, column = np.unravel_index(int(np.abs(defects).argmax()), defects.shape)
    owners = [(state, i) for state in states for i in range(state.size)]
    state, component = owners[int(column)]
    added = float(np.abs(defects).sum(axis=0).max())
    open_loop, amplification = np.inf, np.inf
    if np.isfinite(added):
        errors, amplification = carry(defects, transitions(phase))
        open_loop = float(np.abs(errors).max())
    return ResimulationCheck(
        phase=phase.name,
        status=Status.FAILED if intervals.failure else Status.SOLVED,
        failure=intervals.failure,
        error=min(added, open_loop),
        local_error=float(np.abs(defects).max()),
        open_loop_error=open_loop,
        amplification=amplification,
        state=state.name,
        component=component,
        time=float(phase.t[int(k) + 1]),
        value=float(intervals.states[k, column]),
        wanted=float(wanted[k, column]),
        unit=state.unit,
    )
