"""A phase integrated again with the solution's own control."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.status import Status
from microbot_ocp.ocp.solution import PhaseSolution
from microbot_ocp.ocp.verification._certificate import ResimulationCheck
from microbot_ocp.ocp.verification._reintegration import (
    Integrated,
    mesh_states,
    open_loop,
    phase_layout,
    state_weights,
)


def resimulate(phase: PhaseSolution, intervals: Integrated) -> ResimulationCheck:
    """Integrate a phase again from its first state; its intervals are integrated already."""
    states = phase_layout(phase).phase.states
    wanted, weights = mesh_states(phase)[1:], state_weights(phase)
    again = open_loop(phase)
    error = np.nan_to_num(np.abs(again.states - wanted) / weights, nan=np.inf)
    local = np.nan_to_num(np.abs(intervals.states - wanted) / weights, nan=np.inf)
    k, column = np.unravel_index(int(error.argmax()), error.shape)
    owners = [(state, i) for state in states for i in range(state.size)]
    state, component = owners[int(column)]
    return ResimulationCheck(
        phase=phase.name,
        status=Status.FAILED if again.failure else Status.SOLVED,
        failure=again.failure,
        error=float(error.max()),
        local_error=float(local.max()),
        state=state.name,
        component=component,
        time=float(phase.t[int(k) + 1]),
        value=float(again.states[k, column]),
        wanted=float(wanted[k, column]),
        unit=state.unit,
    )
