"""Iterations of the solvers as motions of the robot, for progress displays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.motion import State, torque_along
from microbot_ocp.ocp.solution import Iteration, StepProgress, quiet
from microbot_ocp.robot import Robot

Samples = tuple[FloatArray, State]  # mesh points: times [M], s, and states


@dataclass(frozen=True, eq=False)
class MotionIteration(Iteration):
    """An iteration whose phases are a motion of a robot.

    Attributes
    ----------
    robot : Robot
        Robot with the limits of the task.
    via_q : array [m,n]
        Via points, rad (m).
    """

    robot: Robot = field(repr=False)
    via_q: FloatArray = field(repr=False)

    def motion(self) -> Samples:
        """Return times [M], s, and the states [M,n] at the mesh points, also of infeasible ones."""
        starts = np.cumsum([0.0, *(phase.duration for phase in self.phases)])
        # The last point of a phase is the first one of the next.
        last = len(self.phases) - 1
        rows = [slice(None) if k == last else slice(-1) for k in range(len(self.phases))]
        parts = list(zip(self.phases, rows, strict=True))
        t = [start + phase.t[part] for start, (phase, part) in zip(starts, parts, strict=False)]
        states = (
            np.concatenate([phase[name][part] for phase, part in parts]) for name in State._fields
        )
        return np.concatenate(t), State(*states)

    def torque(self) -> FloatArray:
        """Return the torque [M,n] at the mesh points, N m (N)."""
        return torque_along(self.robot, self.motion()[1])


def with_motion(progress: StepProgress, robot: Robot, via_q: FloatArray) -> StepProgress:
    """Return a progress function for solvers that passes each iteration on with its motion."""
    if progress is quiet:
        return quiet

    def tell(event: Iteration | str) -> None:
        if isinstance(event, Iteration):
            event = MotionIteration(**vars(event), robot=robot, via_q=via_q)
        progress(event)

    return tell
