"""Sliders for limits and payload; each move solves the time-optimal task again."""

from __future__ import annotations

import html
from typing import Any

from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.needed import needed
from microbot_ocp.robot import Robot
from microbot_ocp.views._style import STYLE
from microbot_ocp.views.live import InteractiveTask, LivePlot, Setting


class TimeOptimalSliders(InteractiveTask):
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
        widgets = needed("ipywidgets", "sliders need", "notebook")
        _check_range("torque", torque)
        _check_range("speed", speed)
        most = checks.number("payload", payload, "kg", above=0.0)
        super().__init__(robot, via_q, **settings)
        widest = Setting(torque[1], speed[1]).limits(robot)
        self._draw = LivePlot(robot, self._reference, widest, 2.0 * self._reference.duration)

        def slider(kind: str, name: str, low: float, high: float, **options: Any) -> Any:
            style, layout = {"description_width": "13em"}, {"width": "40em"}
            options |= {"min": low, "max": high, "style": style, "layout": layout}
            return getattr(widgets, kind)(description=name, **options)

        percent: Any = {"kind": "IntSlider", "value": 100, "readout_format": "d"}
        low, high = (round(100 * share) for share in torque)
        self.torque = slider(name="torque limits [%]", low=low, high=high, **percent)
        low, high = (round(100 * share) for share in speed)
        self.speed = slider(name="speed limits [%]", low=low, high=high, **percent)
        options: Any = {"value": 0.0, "step": most / 40, "readout_format": ".2f"}
        self.payload = slider("FloatSlider", "payload at the tool [kg]", 0.0, most, **options)
        sliders = [self.torque, self.speed, self.payload]
        self._status, self._picture = widgets.HTML(), widgets.Image(format="png")
        self._box = widgets.VBox([*sliders, self._status, self._picture])
        self._answer(Setting())
        for each in sliders:
            each.observe(lambda _: self._work.ask(self.setting), names="value")

    @property
    def setting(self) -> Setting:
        """Where the sliders stand."""
        return Setting(self.torque.value / 100, self.speed.value / 100, self.payload.value)

    def _show(self, setting: Setting) -> None:
        message = "" if self.motion else self.message
        self._picture.value = self._draw.png(self.motion, setting.limits(self._bare), message)
        color = "" if self.motion else f' style="color:{STYLE.warning}"'
        self._status.value = f"<b{color}>{html.escape(self.message)}</b>"

    def _repr_mimebundle_(self, **options: Any) -> dict[str, Any]:
        bundle = self._box._repr_mimebundle_(**options)
        # where no widget can live, in a file or a mail, its picture does
        return {**bundle, "image/png": bytes(self._picture.value), "text/plain": self.message}


def _check_range(name: str, pair: tuple[float, float]) -> None:
    if not isinstance(pair, tuple) or len(pair) != 2:
        raise InputError(f"{name} must be a pair (lowest, highest) of shares, not {pair!r}")
    low = checks.number(f"lowest {name}", pair[0], above=0.0, at_most=1.0)
    checks.number(f"highest {name}", pair[1], at_least=max(1.0, low))
