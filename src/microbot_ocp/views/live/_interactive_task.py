"""A time-optimal task that somebody changes by hand: solved again for the newest setting."""

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
    """Does a job in the background for the newest request; older ones that wait are dropped.

    Parameters
    ----------
    job : callable
        Takes a request. It runs in one thread, never twice at once; what it raises is logged.
    """

    def __init__(self, job: Callable[[Request], None]) -> None:
        self._job = job
        self._thread = ThreadPoolExecutor(1)
        self._newest: Future[None] | None = None

    def ask(self, request: Request) -> None:
        """Do the job for this request as soon as the one under way is done."""
        if self._newest is not None:
            self._newest.cancel()  # nothing happens to the one under way
        self._newest = self._thread.submit(self._job, request)
        self._newest.add_done_callback(lambda job: job.cancelled() or job.result())

    @property
    def newer(self) -> bool:
        """Whether a newer request waits for the job under way to end."""
        return self._newest is not None and not (self._newest.running() or self._newest.done())

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until nothing is left to do; False where ``timeout`` seconds were not enough."""
        return self._newest is None or not wait([self._newest], timeout).not_done


@dataclass(frozen=True, eq=False)
class Setting:
    """What somebody asks for.

    Attributes
    ----------
    torque, speed : float
        Shares of the robot's own limits.
    payload : float
        At the tool, kg.
    via_q : array [m,n], optional
        Other via points, rad (prismatic: m).
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
    """The fastest motion through via points for one :class:`Setting` after another.

    A setting is solved in the background by :class:`microbot_ocp.TimeOptimalSolver`; while a solve
    is under way only the newest one waits for its turn. Who shows the answer overrides ``_show``.

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
        """Wait until the last position of the sliders is solved; False where that took longer."""
        return self._work.wait(timeout)

    def _solve(self, setting: Setting) -> None:
        begin = time.perf_counter()
        limits = setting.limits(self._bare)
        try:
            motion = self._solver(limits, setting.payload, via_q=setting.via_q)
            self.message = motion.note
            self.motion = motion if motion.solved else None
        except Exception as problem:  # a slider must not go on showing the old motion
            kind = "" if isinstance(problem, InputError) else f"{type(problem).__name__}: "
            self.motion, self.message = None, f"not solved: {kind}{problem}"
        self.robot = self._bare.with_payload(setting.payload).with_limits(limits)
        self.solve_time = time.perf_counter() - begin
        self.solves += 1
        self._answer(setting)

    def _answer(self, setting: Setting) -> None:
        """Say what came of a setting, and show it."""
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
    """Say which joints reach their torque limit, and for what share of the time."""
    shares = np.zeros(robot.joint_count)
    for spell in limit_history(robot, motion).spells("tau"):
        shares[spell.joint] += (spell.end - spell.start) / motion.duration
    named = [
        f"{name} {100 * share:.0f} %"
        for name, share in zip(robot.joint_names, shares, strict=True)
        if share >= 0.005
    ]
    return "at the torque limit: " + ", ".join(named) if named else "no torque limit is reached"
