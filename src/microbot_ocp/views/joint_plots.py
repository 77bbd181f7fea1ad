"""Figures of single motions, simulations and controllers: joint curves against time.

A page holds one joint (its quantities under each other) or all of them (a column each).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from microbot_ocp.checks import FloatArray
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Robot
from microbot_ocp.simulation import Simulation, Tracking
from microbot_ocp.views import scene
from microbot_ocp.views.plots import HALO, LIMIT_COLOR, SETTINGS, page, save_figure
from microbot_ocp.views.style import FIXED, SPARE

A4_PORTRAIT = (8.27, 9.6)  # inches; shorter than the page, so that a caption fits below
PAGE_WIDTH = 11.69  # inches
ROW_HEIGHT = 2.4  # inches
NAMES = {
    "q": "position",
    "qd": "velocity",
    "qdd": "acceleration",
    "tau": "torque",
    "error": "error",
}
# Colours and dashes that the comparison of methods uses, the strongest first.
LOOKS = (
    FIXED["time_optimal"],
    FIXED["cubic_report"],
    FIXED["lspb"],
    FIXED["straight_path"],
    FIXED["cubic_path"],
    FIXED["cubic"],
    *SPARE,
)


@dataclass(frozen=True, eq=False)
class Curve:
    """One line in every axes: times [N], s, and values [N,n] by quantity.

    ``values`` may hold "q", "qd", "qdd", "tau" and "error" (of the position).
    """

    label: str
    t: FloatArray
    values: Mapping[str, FloatArray] = field(default_factory=dict)

    @classmethod
    def of(cls, source: Motion | Simulation, label: str | None = None) -> Curve:
        """Curve of a motion, a simulation or a tracking; its own label where none is given."""
        values = {name: getattr(source, name) for name in ("q", "qd", "qdd", "tau")}
        if isinstance(source, Tracking):
            values["error"] = source.error
        return cls(label or str(getattr(source, "label", "simulation")), source.t, values)


def joint_figure(
    robot: Robot,
    curves: Sequence[Curve],
    joint: int,
    *,
    title: str,
    quantities: Sequence[str] = ("q", "qd", "qdd"),
    marks: Sequence[tuple[float, float]] = (),
    base: bool = False,
) -> Figure:
    """Quantities of one joint under each other.

    Parameters
    ----------
    robot : Robot
        For names and units.
    curves : sequence of Curve
    joint : int
        Index from 0.
    title : str
    quantities : sequence of str
        Keys of the curves' values, one axes each.
    marks : sequence of (time, position)
        Via points, s and rad (m), drawn with the position.
    base : bool
        Whether the first curve lies wide below the others, so that they show where they meet it.

    Returns
    -------
    matplotlib.figure.Figure
    """
    with matplotlib.rc_context(SETTINGS):
        figure = _page(f"{title}: {robot.joint_names[joint]} (joint {joint + 1})", A4_PORTRAIT)
        grid = figure.subplots(len(quantities), 1, sharex=True, squeeze=False)[:, 0]
        for axes, quantity in zip(grid, quantities, strict=True):
            _draw(axes, robot, curves, quantity, joint, base)
            axes.set_ylabel(_label(robot, quantity, joint))
            if quantity == "q" and len(marks):
                _draw_marks(axes, robot, marks, joint)
        grid[-1].set_xlabel("t [s]")
        figure.align_ylabels(grid)
        _legend(figure, grid[0], 3)
    return figure


def joints_figure(
    robot: Robot,
    curves: Sequence[Curve],
    quantities: Sequence[str] = ("tau",),
    *,
    title: str,
    limits: tuple[FloatArray, FloatArray] | None = None,
    bounds: Mapping[str, float] | None = None,
    base: bool = False,
) -> Figure:
    """Quantities of all joints: a row each, a column for each joint.

    Parameters
    ----------
    robot : Robot
        For names and units.
    curves : sequence of Curve
        Those without a quantity are left out of its row.
    quantities : sequence of str
        Keys of the curves' values.
    title : str
    limits : (lower, upper), optional
        Torque limits [n], drawn with the torques.
    bounds : mapping, optional
        Largest value shown of a quantity, in its drawn unit; curves beyond are cut, and it is said
        so.
    base : bool
        As in :func:`joint_figure`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    size = (PAGE_WIDTH, ROW_HEIGHT * len(quantities) + 1.5)
    with matplotlib.rc_context(SETTINGS):
        figure = _page(title, size)
        grid = figure.subplots(len(quantities), robot.joint_count, sharex=True, squeeze=False)
        for row, quantity in zip(grid, quantities, strict=True):
            for joint, axes in enumerate(row):
                _draw(axes, robot, curves, quantity, joint, base)
                if quantity == "tau" and limits is not None:
                    for bound in (limits[0][joint], limits[1][joint]):
                        if np.isfinite(bound):
                            axes.axhline(bound, color=LIMIT_COLOR, linestyle="--", linewidth=1.0)
                if bounds and quantity in bounds:
                    _cut(axes, bounds[quantity])
            for joint, axes in enumerate(row):
                unit = _label(robot, quantity, joint)
                alike = unit == _label(robot, quantity, 0)
                axes.set_ylabel(unit if joint == 0 or not alike else "")
        for joint, axes in enumerate(grid[0]):
            axes.set_title(robot.joint_names[joint], fontweight="bold")
        for axes in grid[-1]:
            axes.set_xlabel("t [s]")
        figure.align_ylabels(grid[:, 0])
        _legend(figure, grid[0, 0], 4)
    return figure


def save_figures(figures: Mapping[str, Figure], folder: str | Path) -> list[Path]:
    """Write figures by the stems of their files as PNG and PDF.

    Returns
    -------
    list of Path
    """
    return [path for stem, figure in figures.items() for path in save_figure(figure, folder, stem)]


def _page(title: str, size: tuple[float, float]) -> Figure:
    return page(title, size, ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.06))


def _draw(
    axes: Axes, robot: Robot, curves: Iterable[Curve], quantity: str, joint: int, base: bool
) -> None:
    factor = scene.display_factor(robot, _kind(quantity), joint)
    for place, curve in enumerate(curves):
        if quantity not in curve.values:
            continue
        color, dashes = LOOKS[place % len(LOOKS)]
        axes.plot(
            curve.t,
            curve.values[quantity][:, joint] * factor,
            color=color,
            linestyle=dashes,
            linewidth=3.0 if base and not place else 1.6,
            zorder=3 + 0.01 * place,
            label=curve.label,
        )
    axes.margins(x=0.015, y=0.08)


def _draw_marks(axes: Axes, robot: Robot, marks: Sequence[tuple[float, float]], joint: int) -> None:
    factor = scene.display_factor(robot, "q", joint)
    times, positions = np.array(marks, dtype=float).T
    axes.plot(
        times, positions * factor, linestyle="none", marker="o", markersize=6, color="black",
        markeredgecolor="white", zorder=6, label="via point",
    )  # fmt: skip


def _cut(axes: Axes, bound: float) -> None:
    low, high = axes.get_ylim()
    if low < -bound or high > bound:
        axes.set_ylim(max(low, -bound), min(high, bound))
        axes.annotate(
            "curves go on beyond", (1.0, 1.0), xycoords="axes fraction", xytext=(-3, -3),
            textcoords="offset points", ha="right", va="top", fontsize=7.5, color=LIMIT_COLOR,
            path_effects=HALO,
        )  # fmt: skip


def _legend(figure: Figure, axes: Axes, columns: int) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles=handles,
        labels=labels,
        loc="outside lower center",
        ncols=min(columns, max(1, len(labels))),
        frameon=False,
        handlelength=3.6,
    )


def _kind(quantity: str) -> str:
    return "q" if quantity == "error" else quantity


def _label(robot: Robot, quantity: str, joint: int) -> Any:
    unit = scene.display_unit(robot, _kind(quantity), joint)
    return f"{NAMES[quantity]} [{unit}]"
