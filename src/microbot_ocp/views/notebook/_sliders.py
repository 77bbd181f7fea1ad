"""Sliders for limits and payload; each move solves the time-optimal task again."""

from __future__ import annotations

import html
import time
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp.limits import limit_history
from microbot_ocp.motion import Motion
from microbot_ocp.planning import TimeOptimalSolver
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views.live import NewestOnly

EXTRA = "pip install 'microbot_ocp[notebook]'"


@dataclass(frozen=True)
class Setting:
    """What the sliders say: shares of the robot's own limits, and the payload, kg."""

    torque: float = 1.0
    speed: float = 1.0
    payload: float = 0.0

    def limits(self, robot: Robot) -> JointLimits:
        """The robot's limits with torques and velocities scaled."""
        own = robot.limits
        return replace(
            own,
            qd_min=self.speed * own.qd_min,
            qd_max=self.speed * own.qd_max,
            tau_min=self.torque * own.tau_min,
            tau_max=self.torque * own.tau_max,
        )


class TimeOptimalSliders:
    """The fastest motion through via points under sliders; shows itself in a notebook.

    The first two sliders scale all torque and all velocity limits of the robot, the third one puts
    a payload at the tool. A move of a slider solves the task again in the background; while a
    solve is under way only the newest position of the sliders waits for its turn.

    Parameters
    ----------
    robot : Robot
    via_q : array_like [m,n]
        Via points, rad (prismatic: m).
    torque, speed : (lowest, highest)
        Range of the shares of the robot's limits, around 1.
    payload : float
        Largest payload, kg.
    **settings
        Of :class:`microbot_ocp.TimeOptimalSolver`.

    Attributes
    ----------
    torque, speed, payload : ipywidgets sliders
        In percent, percent and kg; their ``value`` may be set by hand.
    motion : Motion or None
        The last motion; None where there is none for the last setting.
    robot : Robot
        With the limits and the payload of the last setting.
    message : str
        Duration, saturated joints and solve time, or why there is no motion.
    solve_time : float
        Wall time of the last solve, s.
    solves : int
        How many there were.

    Raises
    ------
    InputError
        Bad via points, limits or ranges; ipywidgets is missing.
    """

    def __init__(
        self,
        robot: Robot,
        via_q: ArrayLike,
        *,
        torque: tuple[float, float] = (0.5, 1.5),
        speed: tuple[float, float] = (0.5, 1.5),
        payload: float = 2.0,
        **settings: Any,
    ) -> None:
        widgets = _widgets()
        ranges = {"torque": torque, "speed": speed}
        for name, pair in ranges.items():
            _check_range(name, pair)
        most = checks.number("payload", payload, "kg", above=0.0)
        self._own = robot
        self._solver = TimeOptimalSolver(robot, via_q, **settings)
        self._reference = self._solver()
        if not self._reference.solved:
            raise InputError(
                "sliders need a task that is solved under the robot's own limits; this one is "
                f"{self._reference.note}"
            )
        self._draw = _live_plot(robot, self._reference, Setting(torque[1], speed[1]))
        self.motion: Motion | None = self._reference
        self.robot = robot
        self.message = ""
        self.solve_time = float(self._reference.provenance["wall_time"])
        self.solves = 1
        self.torque, self.speed = (
            widgets.IntSlider(
                value=100,
                min=round(100 * low),
                max=round(100 * high),
                description=name,
                readout_format="d",
                style={"description_width": "13em"},
                layout={"width": "40em"},
            )
            for name, (low, high) in zip(
                ("torque limits [%]", "speed limits [%]"), ranges.values(), strict=True
            )
        )
        self.payload = widgets.FloatSlider(
            value=0.0,
            min=0.0,
            max=most,
            step=most / 40,
            description="payload at the tool [kg]",
            readout_format=".2f",
            style={"description_width": "13em"},
            layout={"width": "40em"},
        )
        self._status, self._picture = widgets.HTML(), widgets.Image(format="png")
        self._box = widgets.VBox(
            [self.torque, self.speed, self.payload, self._status, self._picture]
        )
        self._work = NewestOnly(self._solve)
        self._update(robot.limits)
        for slider in (self.torque, self.speed, self.payload):
            slider.observe(self._moved, names="value")

    @property
    def setting(self) -> Setting:
        """Where the sliders stand."""
        return Setting(self.torque.value / 100, self.speed.value / 100, self.payload.value)

    def wait(self, timeout: float | None = 60.0) -> bool:
        """Wait until the last position of the sliders is solved; False where that took longer."""
        return self._work.wait(timeout)

    def _moved(self, _: Any) -> None:
        self._work.ask(self.setting)

    def _solve(self, setting: Setting) -> None:
        begin = time.perf_counter()
        limits = setting.limits(self._own)
        try:
            motion = self._solver(limits, setting.payload)
            self.message = motion.note
            self.motion = motion if motion.solved else None
        except InputError as problem:  # this setting asks for what cannot be done
            self.motion, self.message = None, f"not solved: {problem}"
        except Exception as problem:  # a slider must not go on showing the old motion
            self.motion, self.message = None, f"not solved: {type(problem).__name__}: {problem}"
        self.robot = self._own.with_payload(setting.payload).with_limits(limits)
        self.solve_time = time.perf_counter() - begin
        self.solves += 1
        self._update(limits)

    def _update(self, limits: JointLimits) -> None:
        self._picture.value = self._draw.png(
            self.motion, limits, "" if self.motion else self.message
        )
        if self.motion is None:
            self._status.value = f'<b style="color:#B00020">{html.escape(self.message)}</b>'
            return
        change = self.motion.duration / self._reference.duration - 1
        self.message = (
            f"{self.motion.duration:.3f} s, {100 * change:+.1f} % against the robot's own limits"
            f"; {_saturated(self.robot, self.motion)}; solved in {1e3 * self.solve_time:.0f} ms"
        )
        self._status.value = f"<b>{html.escape(self.message)}</b>"

    def _repr_mimebundle_(self, **options: Any) -> dict[str, Any]:
        bundle = self._box._repr_mimebundle_(**options)
        # where no widget can live, in a file or a mail, its picture does
        return {**bundle, "image/png": bytes(self._picture.value), "text/plain": self.message}


def _saturated(robot: Robot, motion: Motion) -> str:
    """Which joints reach their torque limit, and for what share of the time."""
    shares = np.zeros(robot.joint_count)
    for spell in limit_history(robot, motion).spells("tau"):
        shares[spell.joint] += (spell.end - spell.start) / motion.duration
    named = [
        f"{name} {100 * share:.0f} %"
        for name, share in zip(robot.joint_names, shares, strict=True)
        if share >= 0.005
    ]
    return "at the torque limit: " + ", ".join(named) if named else "no torque limit is reached"


def _check_range(name: str, pair: tuple[float, float]) -> None:
    if not isinstance(pair, tuple) or len(pair) != 2:
        raise InputError(f"{name} must be a pair (lowest, highest) of shares, not {pair!r}")
    low = checks.number(f"lowest {name}", pair[0], above=0.0, at_most=1.0)
    checks.number(f"highest {name}", pair[1], at_least=max(1.0, low))


def _widgets() -> Any:
    try:
        return import_module("ipywidgets")
    except ModuleNotFoundError:
        raise InputError(f"sliders need ipywidgets, the extra 'notebook': {EXTRA}") from None


def _live_plot(robot: Robot, reference: Motion, widest: Setting) -> Any:
    from microbot_ocp.views.live import LivePlot

    return LivePlot(robot, reference, widest.limits(robot), 2.0 * reference.duration)
