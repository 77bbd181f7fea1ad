"""Interactive time-optimal task that is solved again for the newest setting."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.limits import limit_history
from microbot_ocp.motion import Motion
from microbot_ocp.planning import TimeOptimalSolver
from microbot_ocp.robot import JointLimits, Robot

Request = TypeVar("Request")


class NewestOnly(Generic[Request]):
    """Background worker that handles the newest request and drops older waiting ones.

    Parameters
    ----------
    job : callable
        Function of a request. It runs in one thread, one request at a time; exceptions are logged.
    """

    def __init__(self, job: Callable[[Request], None]) -> None:
        self._job = job
        self._thread = ThreadPoolExecutor(1)
        self._newest: Future[None] | None = None

    def ask(self, request: Request) -> None:
        """Run the job for this request after the running job."""
        if self._newest is not None:
            self._newest.cancel()  # a running job is not affected
        self._newest = self._thread.submit(self._job, request)
        self._newest.add_done_callback(lambda job: job.cancelled() or job.result())

    @property
    def newer(self) -> bool:
        """True if a newer request waits for the running job."""
        return self._newest is not None and not (self._newest.running() or self._newest.done())

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until all jobs are done; return False if ``timeout`` seconds were not enough."""
        return self._newest is None or not wait([self._newest], timeout).not_done


@dataclass(frozen=True, eq=False)
class Setting:
    """Setting of an interactive task.

    Attributes
    ----------
    torque, speed : float
        Scale of the robot's torque and velocity limits.
    payload : float
        Point mass at the tool, kg.
    via_q : array [m,n], optional
        Via points, rad (prismatic: m); default the via points of the task.
    """

    torque: float = 1.0
    speed: float = 1.0
    payload: float = 0.0
    via_q: FloatArray | None = None

    def limits(self, robot: Robot) -> JointLimits:
        """Return the robot's limits with torques and velocities scaled."""
        limits, speed, torque = robot.limits, self.speed, self.torque
        return replace(
            limits,
            **{key: speed * getattr(limits, key) for key in ("qd_min", "qd_max")},
            **{key: torque * getattr(limits, key) for key in ("tau_min", "tau_max")},
        )


class InteractiveTask:
    """Fastest motion through via points for changing values of a :class:`Setting`.

    :class:`microbot_ocp.TimeOptimalSolver` solves in the background; only the newest setting waits
    for a running solve. A subclass shows the answer in ``_show``.

    Raises
    ------
    InputError
        Bad via points or settings, or a task that is not solved under the robot's own limits.
    """

    def __init__(self, robot: Robot, via_q: ArrayLike, **settings: Any) -> None:
        self._bare = robot
        self._solver = TimeOptimalSolver(robot, via_q, **settings)
        self._reference = self._solver()
        if not self._reference.solved:
            raise InputError(
                "sliders need a task that is solved under the robot's own limits; this one is "
                f"{self._reference.note}"
            )
        self.motion: Motion | None = self._reference
        self.robot, self.message, self.solves = robot, "", 1
        self.solve_time = float(self._reference.provenance["wall_time"])
        self._work = NewestOnly(self._solve)

    def wait(self, timeout: float | None = 60.0) -> bool:
        """Wait until the last setting is solved; return False after ``timeout`` seconds."""
        return self._work.wait(timeout)

    def _solve(self, setting: Setting) -> None:
        begin = time.perf_counter()
        limits = setting.limits(self._bare)
        try:
            motion = self._solver(limits, setting.payload, via_q=setting.via_q)
            self.message = motion.note
            self.motion = motion if motion.solved else None
        except Exception as problem:  # any failure must replace the old motion on the screen
            kind = "" if isinstance(problem, InputError) else f"{type(problem).__name__}: "
            self.motion, self.message = None, f"not solved: {kind}{problem}"
        self.robot = self._bare.with_payload(setting.payload).with_limits(limits)
        self.solve_time = time.perf_counter() - begin
        self.solves += 1
        self._answer(setting)

    def _answer(self, setting: Setting) -> None:
        """Write the message on a solved setting and show the answer."""
        if self.motion is not None:
            change = self.motion.duration / self._reference.duration - 1
            self.message = (
                f"{self.motion.duration:.3f} s, {100 * change:+.1f} % against the robot's own "
                f"limits; {_saturated(self.robot, self.motion)}; "
                f"solved in {1e3 * self.solve_time:.0f} ms"
            )
        self._show(setting)

    def _show(self, setting: Setting) -> None:
        raise NotImplementedError


def _saturated(robot: Robot, motion: Motion) -> str:
    """Return a text on the joints at their torque limit, with shares of the duration."""
    shares = np.zeros(robot.joint_count)
    for spell in limit_history(robot, motion).spells("tau"):
        shares[spell.joint] += (spell.end - spell.start) / motion.duration
    named = [
        f"{name} {100 * share:.0f} %"
        for name, share in zip(robot.joint_names, shares, strict=True)
        if round(100 * share)
    ]
    return f"torque at its limit: {', '.join(named)}" if named else "no torque at its limit"
