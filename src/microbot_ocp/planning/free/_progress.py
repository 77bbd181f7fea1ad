"""Iterations of the solvers as motions of the robot, for whoever watches them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.motion import State, torque_along
from microbot_ocp.ocp.solution import Iteration, PhaseSolution, StepProgress, quiet
from microbot_ocp.robot import Robot

Samples = tuple[FloatArray, State]  # times [M] of the mesh points, s, and the state there
MotionOf = Callable[[Sequence[PhaseSolution]], Samples]


@dataclass(frozen=True, eq=False)
class MotionIteration(Iteration):
    """An iteration whose phases are a motion of a robot.

    Attributes
    ----------
    robot : Robot
        With the limits of the task.
    via_q : array [m,n]
        Via points, rad (m).
    """

    robot: Robot = field(repr=False)
    via_q: FloatArray = field(repr=False)
    motion_of: MotionOf = field(repr=False)

    def motion(self) -> Samples:
        """Return times [M], s, and the state [M,n] at the mesh points, constraints met or not."""
        return self.motion_of(self.phases)

    def torque(self) -> FloatArray:
        """Return the torque [M,n] at the mesh points, N m (N)."""
        return torque_along(self.robot, self.motion()[1])


def with_motion(
    progress: StepProgress, robot: Robot, via_q: FloatArray, motion_of: MotionOf
) -> StepProgress:
    """Return a progress function for solvers that gives ``progress`` every iteration with its
    motion.
    """
    if progress is quiet:
        return quiet

    def tell(event: Iteration | str) -> None:
        if isinstance(event, Iteration):
            event = MotionIteration(**vars(event), robot=robot, via_q=via_q, motion_of=motion_of)
        progress(event)

    return tell
