"""Figures of motions, simulations, trackings and comparisons over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.limits import AT_LIMIT, limit_history
from microbot_ocp.motion import Motion
from microbot_ocp.robot import JointLimits, Limits, Robot
from microbot_ocp.simulation import Simulation, Tracking
from microbot_ocp.tasks import Cell, Comparison, Entry
from microbot_ocp.views import _palette as palette, _scene as scene
from microbot_ocp.views._style import BEYOND_LIMIT, SMALL_FONT, entry_styles, entry_title, failures
from microbot_ocp.views.plots._curves import PASSED, Curve, curves
from microbot_ocp.views.plots._page import AxesGrid, halo

LOAD_HEIGHT = 0.04  # height of the bar of a load, relative to the panel


def motion(
    robot: Robot,
    motion: Motion | Simulation | Sequence[Motion],
    axes: GivenAxes | None = None,
    *,
    quantities: Sequence[str] = ("q", "qd", "tau"),
    joints: Sequence[int] | None = None,
    limits: Limits | JointLimits | None = None,
) -> AxesGrid:
    """Draw position, velocity and torque of one or several motions over time.

    Parameters
    ----------
    robot : Robot
    motion : Motion, Simulation or sequence of Motion
    axes : array of Axes [quantities, joints], optional
        Default a new figure.
    quantities : sequence of str
        Rows of panels: "q", "qd", "qdd", "tau", or the key of another limit, such as "taud" or
        "tool_speed".
    joints : sequence of int, optional
        Indices from 0; default all.
    limits : Limits, optional
        Default the robot's limits.

    Returns
    -------
    AxesGrid [quantities, joints]
        Dots mark the times of marks; a red text names a motion that was not solved.

    Raises
    ------
    InputError
        A motion of another number of joints, an unknown quantity or joint, axes of another shape.
    """
    runs = [motion] if isinstance(motion, Motion | Simulation) else list(motion)
    for each in runs:
        name = "motion" if isinstance(each, Motion) else "simulation"
        checks.joints(name, each.q.shape[1], robot)
    robot = robot if limits is None else robot.with_limits(limits)
    every = [Curve.of(each, robot=robot, quantities=quantities) for each in runs]
    return curves(
        robot,
        every,
        quantities,
        axes,
        joints=joints,
        limits=robot.limits,
        title=f"{robot.name}: {every[0].label}" if len(every) == 1 else robot.name,
    )


def cell(cell: Cell) -> AxesGrid:
    """Draw a motion through stops with rests, payloads, and every quantity that meets its limit.

    Parameters
    ----------
    cell : Cell

    Returns
    -------
    AxesGrid [quantities, joints]
        Rows of position, velocity and torque, and of every other quantity that reaches its limit,
        such as acceleration or torque rate. Rests are shaded grey. A stripe at the bottom shows a
        payload; the first panel has its mass.
    """
    robot, motion_, task = cell.robot, cell.motion, cell.task
    use = limit_history(robot, motion_).use
    plain = ("q", "qd", "qdd", "tau", "taud", "qddd")
    busy = [key for key in use if use[key].max(initial=0.0) >= AT_LIMIT and use[key].shape[1] > 0]
    keys = [key for key in plain if key in ("q", "qd", "tau") or key in busy]
    keys += [key for key in busy if key not in plain and use[key].shape[1] == 1]
    page = motion(robot, motion_, quantities=keys)
    arrives = np.array([mark.time for mark in motion_.marks])
    leaves = arrives + task.dwells
    for panel in page.flat:
        for start, end in zip(arrives, leaves, strict=True):
            panel.axvspan(start, end, label="_rest", **BEYOND_LIMIT)
        for start, end, load in zip(leaves, arrives[1:], task.payloads, strict=False):
            if load.mass:
                color = np.array(palette.PART[:3]) / 255
                panel.axvspan(start, end, 0.0, LOAD_HEIGHT, color=color, linewidth=0, label="_load")
                if panel is page.flat[0]:
                    note = {"fontsize": SMALL_FONT, "ha": "center", "va": "bottom"}
                    note |= {"transform": panel.get_xaxis_transform(), "path_effects": halo()}
                    panel.text((start + end) / 2, LOAD_HEIGHT, f"{load.mass:g} kg", **note)
    (legend,) = page.figure.legends
    for text in legend.get_texts():
        if text.get_text() == PASSED:
            text.set_text("stop")
    return page


def tracking(
    robot: Robot,
    trackings: Tracking | Sequence[Tracking] | Mapping[str, Tracking],
    axes: GivenAxes | None = None,
    *,
    quantities: Sequence[str] = ("error", "tau"),
    joints: Sequence[int] | None = None,
    title: str = "",
) -> AxesGrid:
    """Draw errors and torques of one or several controllers over time.

    Parameters
    ----------
    robot : Robot
    trackings : Tracking, sequence of Tracking or mapping from a label to Tracking
        Simulated trackings; the default label is their ``label``.
    axes : array of Axes [quantities, joints], optional
        Default a new figure.
    quantities : sequence of str
        Rows of panels: "error" (reference minus position, deg, prismatic: mm), "tau", "q", "qd",
        "qdd", or the key of another limit, such as "tool_speed".
    joints : sequence of int, optional
        Indices from 0; default all.
    title : str
        Title of a new figure; default the robot and its controller.

    Returns
    -------
    AxesGrid [quantities, joints]
        Torque limits are the limits of the drives; if they differ between the curves, each is
        dotted in the colour of its curve. A shade in the colour of the curve covers the times at
        which a torque is at its limit; several curves share the height.

    Raises
    ------
    InputError
        No tracking, a tracking of another number of joints, an unknown quantity or joint, axes of
        another shape.
    """
    if isinstance(trackings, Mapping):
        runs = list(trackings.items())
    else:
        several = [trackings] if isinstance(trackings, Tracking) else trackings
        runs = [(run.label, run) for run in several]
    if not runs:
        raise InputError("trackings must hold at least one tracking")
    for label, run in runs:
        checks.joints(f"tracking {label!r}", run.q.shape[1], robot)
    return curves(
        robot,
        [Curve.of(run, label, robot=robot, quantities=quantities) for label, run in runs],
        quantities,
        axes,
        joints=joints,
        limits=_common_limits(robot, [run for _, run in runs]),
        title=title or f"{robot.name}: tracking" + (f", {runs[0][0]}" if len(runs) == 1 else ""),
    )


def _common_limits(robot: Robot, runs: Sequence[Tracking]) -> JointLimits:
    """Return the robot's limits with the torque limits of the drives, if all drives agree."""
    lower, upper = runs[0].torque_limits
    if any(not np.array_equal(run.torque_limits, (lower, upper)) for run in runs):
        lower, upper = np.full_like(lower, -np.inf), np.full_like(upper, np.inf)
    return replace(robot.limits, tau_min=lower, tau_max=upper)


def comparison(
    comparison: Comparison,
    axes: GivenAxes | None = None,
    *,
    quantities: Sequence[str] = ("q", "qd", "tau"),
    joints: Sequence[int] | None = None,
    methods: Sequence[str] | None = None,
) -> AxesGrid:
    """Draw position, velocity and torque of every method over time, with the limits.

    Parameters
    ----------
    comparison : Comparison
    axes : array of Axes [quantities, joints], optional
        Default a new figure with one column per joint (one row per joint for more than four).
    quantities : sequence of str
        Rows of panels: "q", "qd", "qdd", "tau", or the key of another limit, such as "taud" or
        "tool_speed".
    joints : sequence of int, optional
        Indices from 0; default all.
    methods : sequence of str, optional
        Names of entries; default all.

    Returns
    -------
    AxesGrid [quantities, joints]
        Markers show the passages of via points. A text above the legend names every method without
        a motion, with the reason.

    Raises
    ------
    InputError
        An unknown quantity or joint, axes of another shape.
    KeyError
        An unknown method.
    """
    every = [entry.name for entry in comparison.entries]
    names = [comparison[name].name for name in (every if methods is None else methods)]
    return curves(
        comparison.robot,
        entry_curves(comparison, names, quantities),
        quantities,
        axes,
        joints=joints,
        limits=comparison.limits,
        title=f"{comparison.robot.name}: the same task, the same limits",
        symbols=True,
        warnings=list(failures(comparison, names)),
    )


def entry_curves(
    comparison: Comparison, names: Sequence[str], quantities: Sequence[str]
) -> list[Curve]:
    """Return the curves of the named entries with a motion."""
    styles = entry_styles(comparison)
    robot = comparison.robot.with_limits(comparison.limits)
    return [
        replace(
            Curve.of(motion, legend_title(entry, motion), robot=robot, quantities=quantities),
            color=styles[entry.name].color,
            linestyle=styles[entry.name].linestyle,
            passages=scene.via_passages(comparison, motion),
            prominent=styles[entry.name].highlighted,
            warning="",  # the legend title has it
        )
        for entry, motion in scene.solved_entries(comparison)
        if entry.name in names
    ]


def legend_title(entry: Entry, motion: Motion) -> str:
    """Return the title of an entry with its duration, and a warning if it failed."""
    title = f"{entry_title(entry)}, {motion.duration:.3f} s"
    if not motion.solved:
        return f"{title} (NOT SOLVED: {entry.status})"
    if entry.certificate is not None and not entry.certificate.ok:
        return f"{title} (NOT CERTIFIED)"
    return title
