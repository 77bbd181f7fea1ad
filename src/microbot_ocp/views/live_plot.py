"""Velocity and torque of a motion under limits, drawn anew many times a second.

Axes, labels and the motion to compare with are drawn once and kept as pixels; a frame adds the
curves and limits that moved (12 ms for three joints, where the whole figure takes 110 ms).
"""

from __future__ import annotations

from io import BytesIO
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from microbot_ocp.motion import Motion
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views.plots import LIMIT_COLOR, SETTINGS, WARNING_COLOR
from microbot_ocp.views.style import FIXED

QUANTITIES = ("qd", "tau")
NAMES = {"qd": "velocity", "tau": "torque"}
COLUMN, ROW = 3.1, 2.1  # inches
DPI = 96
REFERENCE_COLOR = "0.72"
ROOM = 1.08  # of an axis beyond the largest limit


class LivePlot:
    """A row of velocities and one of torques, a column for each joint.

    Parameters
    ----------
    robot : Robot
    reference : Motion
        Drawn in grey behind.
    largest : JointLimits
        The widest limits that will be drawn.
    duration : float
        Length of the time axis, s; longer motions make it longer.
    """

    def __init__(
        self, robot: Robot, reference: Motion, largest: JointLimits, duration: float
    ) -> None:
        self.robot, self.reference, self.largest = robot, reference, largest
        self.end = duration
        self._prepare()

    def _prepare(self) -> None:
        count = self.robot.joint_count
        color, dashes = FIXED["time_optimal"]
        with matplotlib.rc_context(SETTINGS):
            self.figure = Figure(
                figsize=(COLUMN * count + 0.4, ROW * len(QUANTITIES) + 0.5), dpi=DPI
            )
            self.canvas = FigureCanvasAgg(self.figure)
            grid = self.figure.subplots(len(QUANTITIES), count, sharex=True, squeeze=False)
            self.figure.subplots_adjust(
                left=0.075, right=0.99, bottom=0.11, top=0.93, wspace=0.22, hspace=0.12
            )
            self.curves, self.limits = {}, {}
            for row, quantity in zip(grid, QUANTITIES, strict=True):
                for joint, axes in enumerate(row):
                    self._frame(axes, quantity, joint)
                    axes.plot(
                        self.reference.t,
                        getattr(self.reference, quantity)[:, joint],
                        color=REFERENCE_COLOR,
                        linewidth=1.6,
                    )
                    look: dict[str, Any] = {"animated": True}
                    (self.curves[quantity, joint],) = axes.plot(
                        [], [], color=color, linestyle=dashes, linewidth=2.0, **look
                    )
                    self.limits[quantity, joint] = [
                        axes.axhline(0.0, color=LIMIT_COLOR, linestyle="--", linewidth=1.0, **look)
                        for _ in range(2)
                    ]
            self.told = self.figure.text(
                0.5, 0.52, "", ha="center", va="center", fontsize=11, color=WARNING_COLOR,
                animated=True, wrap=True,
                bbox={"facecolor": "white", "edgecolor": WARNING_COLOR, "pad": 8},
            )  # fmt: skip
            self.canvas.draw()
        self.background = self.canvas.copy_from_bbox(self.figure.bbox)

    def _frame(self, axes: Any, quantity: str, joint: int) -> None:
        low, high = (bound[joint] for bound in self.largest.bounds(quantity))
        curve = getattr(self.reference, quantity)[:, joint]
        low = low if np.isfinite(low) else 1.5 * curve.min()
        high = high if np.isfinite(high) else 1.5 * curve.max()
        axes.set_ylim(ROOM * low, ROOM * high)
        axes.set_xlim(0.0, self.end)
        if quantity == QUANTITIES[0]:
            axes.set_title(self.robot.joint_names[joint], fontweight="bold")
        if quantity == QUANTITIES[-1]:
            axes.set_xlabel("t [s]")
        if joint == 0:
            axes.set_ylabel(f"{NAMES[quantity]} [{self.robot.unit(quantity, joint)}]")

    def png(self, motion: Motion | None, limits: JointLimits, told: str = "") -> bytes:
        """Picture of a motion with its limits; without one, of the sentence that says why."""
        if motion is not None and motion.duration > self.end:
            self.end = 1.25 * motion.duration
            self._prepare()
        with matplotlib.rc_context(SETTINGS):
            self.canvas.restore_region(self.background)
            for (quantity, joint), curve in self.curves.items():
                for line, bound in zip(
                    self.limits[quantity, joint], limits.bounds(quantity), strict=True
                ):
                    line.set_ydata([bound[joint]] * 2)
                    line.axes.draw_artist(line)
                if motion is not None:
                    curve.set_data(motion.t, getattr(motion, quantity)[:, joint])
                    curve.axes.draw_artist(curve)
            if told:
                self.told.set_text(told)
                self.figure.draw_artist(self.told)
        stream = BytesIO()
        image = Image.fromarray(np.asarray(self.canvas.buffer_rgba()))
        image.convert("RGB").save(stream, "png", compress_level=1)
        return stream.getvalue()
