"""Velocity and torque of a motion under limits, drawn anew many times a second.

Axes, labels and the motion to compare with are drawn once and kept as pixels; a frame adds what
moved (12 ms for three joints, where the whole figure takes 190 ms). Frames may be drawn in another
thread: only the first drawing touches matplotlib's settings, which all threads share.
"""

from __future__ import annotations

import textwrap
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from microbot_ocp.motion import Motion
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views._style import STYLE, look
from microbot_ocp.views.plots import styled

QUANTITIES = {"qd": "velocity", "tau": "torque"}
GRAY: dict[str, Any] = {"color": "0.72", "linewidth": STYLE.line}


class LivePlot:
    """A row of velocities and one of torques, one column a joint.

    Parameters
    ----------
    robot : Robot
    reference : Motion
        Drawn in grey behind.
    largest : JointLimits
        The widest limits that will be drawn.
    duration : float
        Length of the time axis, s; a longer motion makes it longer.
    """

    def __init__(
        self, robot: Robot, reference: Motion, largest: JointLimits, duration: float
    ) -> None:
        solid: dict[str, Any] = {**look(0), "linewidth": 2.0}
        moving: dict[str, Any] = {"animated": True}
        count = robot.joint_count
        self._panels: dict[tuple[str, int], tuple[Axes, Line2D, list[Line2D]]] = {}
        with styled():
            size = (3.1 * count + 0.4, 0.9 * STYLE.row * len(QUANTITIES) + 0.8)
            self.figure = Figure(figsize=size, dpi=STYLE.screen_dpi)
            self._canvas = FigureCanvasAgg(self.figure)
            grid = self.figure.subplots(len(QUANTITIES), count, sharex=True, squeeze=False)
            self.figure.subplots_adjust(0.24 / count, 0.16, 0.99, 0.94, 0.22, 0.12)
            for row, quantity in zip(grid, QUANTITIES, strict=True):
                for joint, axes in enumerate(row):
                    values = getattr(reference, quantity)[:, joint]
                    _frame(axes, robot, quantity, joint)
                    axes.set_ylim(*_range(values, *(b[joint] for b in largest.bounds(quantity))))
                    axes.plot(reference.t, values, **GRAY)
                    (curve,) = axes.plot([], [], **solid, **moving)
                    limits = [axes.axhline(0.0, **STYLE.limit_line, **moving) for _ in range(2)]
                    self._panels[quantity, joint] = axes, curve, limits
            edge = {"facecolor": "white", "edgecolor": STYLE.warning, "pad": 8}
            words: dict[str, Any] = {"ha": "center", "va": "center", "color": STYLE.warning}
            self._message = self.figure.text(
                0.5, 0.55, "", fontsize=11, bbox=edge, **words, **moving
            )
            handles = [
                Line2D([], [], **solid, label="as the sliders say"),
                Line2D([], [], **GRAY, label="under the robot's own limits"),
                Line2D([], [], **{**STYLE.limit_line, "label": "limit"}),
            ]
            self.figure.legend(handles=handles, loc="lower center", ncols=3, frameon=False)
            self._axes: Axes = grid[0, 0]
            self._keep(duration)

    def _keep(self, duration: float) -> None:
        """Draw what does not move and keep its pixels."""
        self._axes.set_xlim(0.0, duration)
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(self.figure.bbox)

    def png(self, motion: Motion | None, limits: JointLimits, message: str = "") -> bytes:
        """Return the picture of a motion and limits; without one, of a message why."""
        if motion is not None and motion.duration > self._axes.get_xlim()[1]:
            self._keep(1.25 * motion.duration)
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


def _frame(axes: Axes, robot: Robot, quantity: str, joint: int) -> None:
    if quantity == "qd":
        axes.set_title(robot.joint_names[joint], fontweight="bold")
    else:
        axes.set_xlabel("t [s]")
    unit = robot.unit(quantity, joint)
    if joint == 0 or unit != robot.unit(quantity, 0):
        axes.set_ylabel(f"{QUANTITIES[quantity]} [{unit}]")


def _range(values: Any, lower: float, upper: float) -> tuple[float, float]:
    """Return the range of an axis that holds the limits, or half as much again as the values."""
    low = lower if np.isfinite(lower) else 1.5 * min(float(values.min()), -1e-3)
    high = upper if np.isfinite(upper) else 1.5 * max(float(values.max()), 1e-3)
    return (1 + STYLE.room) * low, (1 + STYLE.room) * high
