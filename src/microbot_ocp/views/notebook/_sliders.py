"""Sliders for limits and payload that solve and draw the time-optimal task again."""

from __future__ import annotations

import html
import textwrap
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike
from PIL import Image

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.needed import needed
from microbot_ocp.limits import quantity_name
from microbot_ocp.motion import Motion
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views._scene import AXIS_MARGIN, data_range
from microbot_ocp.views._style import LIMIT_LINE, LINE_WIDTH, ROW_HEIGHT, WARNING_COLOR, look
from microbot_ocp.views.live import InteractiveTask, Setting
from microbot_ocp.views.plots import SCREEN_DPI, styled

QUANTITIES = ("qd", "tau")
BEYOND = 1.5  # range of an axis without a limit, relative to the values
SHARES = (0.5, 1.5)  # usual ends of a slider, shares of the limits
GRAY: dict[str, Any] = {"color": "0.72", "linewidth": LINE_WIDTH}


class LivePlot:
    """Figure with a row of velocities and a row of torques, one column per joint.

    Parameters
    ----------
    robot : Robot
    reference : Motion
        Motion in grey in the background.
    largest : JointLimits
        Widest limits to be drawn.
    duration : float
        Length of the time axis, s; a longer motion extends the axis.
    """

    def __init__(
        self, robot: Robot, reference: Motion, largest: JointLimits, duration: float
    ) -> None:
        solid: dict[str, Any] = {**look(0), "linewidth": 2.0}
        moving: dict[str, Any] = {"animated": True}
        count = robot.joint_count
        self._panels: dict[tuple[str, int], tuple[Axes, Line2D, list[Line2D]]] = {}
        with styled():
            size = (3 * count, ROW_HEIGHT * len(QUANTITIES) + 1)
            self.figure = Figure(figsize=size, dpi=SCREEN_DPI, layout="constrained")
            self._canvas = FigureCanvasAgg(self.figure)
            grid = self.figure.subplots(len(QUANTITIES), count, sharex=True, squeeze=False)
            for row, quantity in zip(grid, QUANTITIES, strict=True):
                for joint, axes in enumerate(row):
                    values = getattr(reference, quantity)[:, joint]
                    unit = robot.unit(quantity, joint)
                    if joint == 0 or unit != robot.unit(quantity, 0):
                        axes.set_ylabel(f"{quantity_name(quantity)} [{unit}]")
                    axes.set_ylim(*_range(values, *(b[joint] for b in largest.bounds(quantity))))
                    axes.plot(reference.t, values, **GRAY)
                    (curve,) = axes.plot([], [], **solid, **moving)
                    limits = [axes.axhline(0.0, **LIMIT_LINE, **moving) for _ in range(2)]
                    self._panels[quantity, joint] = axes, curve, limits
            for name, top, bottom in zip(robot.joint_names, *grid, strict=True):
                top.set_title(name, fontweight="bold")
                bottom.set_xlabel("t [s]")
            edge = {"facecolor": "white", "edgecolor": WARNING_COLOR, "pad": 8}
            words: dict[str, Any] = {"ha": "center", "va": "center", "color": WARNING_COLOR}
            words |= {"fontsize": 11, "bbox": edge}
            self._message = self.figure.text(0.5, 0.5, "", **words, **moving)
            handles = [
                Line2D([], [], **solid, label="as the sliders say"),
                Line2D([], [], **GRAY, label="under the robot's own limits"),
                Line2D([], [], **{**LIMIT_LINE, "label": "limit"}),
            ]
            self.figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
            self._axes: Axes = grid[0, 0]
            self._keep(duration)

    def _keep(self, duration: float) -> None:
        """Draw the fixed artists and keep their pixels."""
        self._axes.set_xlim(0.0, duration)
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(self.figure.bbox)

    def png(self, motion: Motion | None, limits: JointLimits, message: str = "") -> bytes:
        """Return the picture of a motion and its limits, or of a message without a motion."""
        if motion is not None and motion.duration > self._axes.get_xlim()[1]:
            self._keep(BEYOND * motion.duration)
        self._canvas.restore_region(self._background)
        for (quantity, joint), (axes, curve, lines) in self._panels.items():
            for line, bound in zip(lines, limits.bounds(quantity), strict=True):
                line.set_ydata([bound[joint]] * 2)
                axes.draw_artist(line)
            if motion is not None:
                curve.set_data(motion.t, getattr(motion, quantity)[:, joint])
                axes.draw_artist(curve)
        if message:
            self._message.set_text(textwrap.fill(message, 75))
            self.figure.draw_artist(self._message)
        stream = BytesIO()
        image = Image.fromarray(np.asarray(self._canvas.buffer_rgba()))
        image.convert("RGB").save(stream, "png", compress_level=1)
        return stream.getvalue()


def _range(values: Any, lower: float, upper: float) -> tuple[float, float]:
    """Return the range of an axis: the limits, or more than the values without a limit."""
    low, high = data_range(values)
    low = lower if np.isfinite(lower) else BEYOND * min(low, 0.0)
    high = upper if np.isfinite(upper) else BEYOND * max(high, 0.0)
    return (1 + AXIS_MARGIN) * low, (1 + AXIS_MARGIN) * high


class TimeOptimalSliders(InteractiveTask):
    """Fastest motion through via points with sliders, displayed in a notebook.

    The first two sliders scale all torque limits and all velocity limits of the robot, the third
    slider sets a payload at the tool. Every change solves the task again in the background; only
    the newest setting waits for a running solve.

    Parameters
    ----------
    robot : Robot
    via_q : array_like [m,n]
        Via points, rad (prismatic: m).
    torque, speed : (lowest, highest)
        Range of the scale of the robot's limits, around 1.
    payload : float
        Largest payload, kg.
    **settings
        Settings of :class:`microbot_ocp.TimeOptimalSolver`.

    Attributes
    ----------
    torque, speed, payload : ipywidgets sliders
        Sliders in percent, percent and kg; a program may set their ``value``.
    motion : Motion or None
        Motion for the last setting; None if the task was not solved.
    robot : Robot
        Robot with the limits and the payload of the last setting.
    message : str
        Duration, saturated joints and solve time, or the reason why there is no motion.
    solve_time : float
        Wall time of the last solve, s.
    solves : int
        Number of solves.

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
        torque: tuple[float, float] = SHARES,
        speed: tuple[float, float] = SHARES,
        payload: float = 2.0,
        **settings: Any,
    ) -> None:
        widgets = needed("ipywidgets", "sliders need", "notebook")
        for name, shares in (("torque", torque), ("speed", speed)):
            if not isinstance(shares, tuple) or len(shares) != 2:
                raise InputError(
                    f"{name} must be a pair (lowest, highest) of shares, not {shares!r}"
                )
            low = checks.number(f"lowest {name}", shares[0], above=0.0, at_most=1.0)
            checks.number(f"highest {name}", shares[1], at_least=max(1.0, low))
        most = checks.number("payload", payload, "kg", above=0.0)
        super().__init__(robot, via_q, **settings)
        widest = Setting(torque[1], speed[1]).limits(robot)
        self._draw = LivePlot(robot, self._reference, widest, 2.0 * self._reference.duration)

        def slider(kind: str, name: str, low: float, high: float, **options: Any) -> Any:
            style, layout = {"description_width": "13em"}, {"width": "40em"}
            options |= {"min": low, "max": high, "style": style, "layout": layout}
            return getattr(widgets, kind)(description=name, **options)

        percent: Any = {"value": 100, "readout_format": "d"}
        torques, speeds = (tuple(round(100 * share) for share in ends) for ends in (torque, speed))
        self.torque = slider("IntSlider", "torque limits [%]", *torques, **percent)
        self.speed = slider("IntSlider", "speed limits [%]", *speeds, **percent)
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
        """Setting of the sliders."""
        return Setting(self.torque.value / 100, self.speed.value / 100, self.payload.value)

    def _show(self, setting: Setting) -> None:
        message = "" if self.motion else self.message
        self._picture.value = self._draw.png(self.motion, setting.limits(self._bare), message)
        color = "" if self.motion else f' style="color:{WARNING_COLOR}"'
        self._status.value = f"<b{color}>{html.escape(self.message)}</b>"

    def _repr_mimebundle_(self, **options: Any) -> dict[str, Any]:
        bundle = self._box._repr_mimebundle_(**options)
        # The picture replaces the widget in saved files and mails.
        return {**bundle, "image/png": bytes(self._picture.value), "text/plain": self.message}
