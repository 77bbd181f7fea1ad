"""A comparison as curves: every method in one look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.motion import Motion
from microbot_ocp.tasks import Comparison, Entry
from microbot_ocp.views import _scene as scene
from microbot_ocp.views._style import entry_styles, entry_title, failures
from microbot_ocp.views.plots._curves import Curve, curves
from microbot_ocp.views.plots._page import AxesGrid


def comparison(
    comparison: Comparison,
    axes: GivenAxes | None = None,
    *,
    quantities: Sequence[str] = ("q", "qd", "tau"),
    joints: Sequence[int] | None = None,
    methods: Sequence[str] | None = None,
) -> AxesGrid:
    """Draw position, velocity and torque of every method against time, with the limits.

    Parameters
    ----------
    comparison : Comparison
    axes : array of Axes [quantities, joints], optional
        Default a new figure, a column for each joint (a row each for more than four).
    quantities : sequence of str
        Of "q", "qd", "qdd", "tau", or the key of another limit, such as "taud" or "tool_speed".
    joints : sequence of int, optional
        Indices from 0; default all.
    methods : sequence of str, optional
        Names of entries; default all.

    Returns
    -------
    AxesGrid [quantities, joints]
        Markers show when via points are passed. A method without a motion is named above the
        legend, with the reason.

    Raises
    ------
    InputError
        A quantity or joint that is not there, axes of another shape.
    KeyError
        A method that is not there.
    """
    names = [entry.name for entry in comparison.entries]
    if methods is not None:
        names = [comparison[name].name for name in methods]
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
    """Return curves of the named entries that have a motion."""
    styles = entry_styles(comparison)
    robot = comparison.robot.with_limits(comparison.limits)
    return [
        replace(
            Curve.of(motion, legend_title(entry, motion), robot=robot, quantities=quantities),
            color=styles[entry.name].color,
            linestyle=styles[entry.name].linestyle,
            passages=scene.via_passages(comparison, motion),
            prominent=styles[entry.name].highlighted,
            warning="",  # the label says so
        )
        for entry, motion in scene.solved_entries(comparison)
        if entry.name in names
    ]


def legend_title(entry: Entry, motion: Motion) -> str:
    """Return the title of an entry with its duration, and whether it may be trusted."""
    title = f"{entry_title(entry)}, {motion.duration:.3f} s"
    if not motion.solved:
        return f"{title} (NOT SOLVED: {entry.status})"
    if entry.certificate is not None and not entry.certificate.ok:
        return f"{title} (NOT CERTIFIED)"
    return title
