"""Small charts: fronts, sensitivities of the duration, torque reserve, sparsity."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.acceleration import AccelerationMap
from microbot_ocp.execution import Reserve
from microbot_ocp.motion import DurationLine, Sensitivities
from microbot_ocp.ocp import ParametricSolver
from microbot_ocp.tasks import Front
from microbot_ocp.views._scene import AXIS_MARGIN
from microbot_ocp.views._style import PAGE
from microbot_ocp.views.plots._page import AxesGrid, axes_page, styled


def row(
    axes: GivenAxes | None, count: int, title: str = "", height: float = 0.5 * PAGE[0]
) -> AxesGrid:
    """Return axes [count]; new axes have the given height, inches."""
    return axes_page(axes, 1, count, size=(PAGE[0], height), title=title).axes[0]


@styled()
def front(front: Front, axes: GivenAxes | None = None) -> AxesGrid:
    """Draw effort and peak torque of the motions of a front over their durations.

    Parameters
    ----------
    front : Front
        Front of :func:`microbot_ocp.tasks.time_effort_front` or ``time_torque_front``.
    axes : array of Axes [2], optional
        Default a new figure.

    Returns
    -------
    AxesGrid [2]
        Open circles are motions that are not certified.
    """
    panels = row(axes, 2, "time against effort and peak torque")
    time = [point.duration for point in front.points]
    good = [point.motion.solved and point.certificate.ok for point in front.points]
    columns = {"effort": "effort [s]", "peak_torque": "peak torque [share of its limit]"}
    for panel, (key, label) in zip(panels, columns.items(), strict=True):
        values = [getattr(point, key) for point in front.points]
        (line,) = panel.plot(time, values)
        faces = [line.get_color() if certified else "none" for certified in good]
        panel.scatter(time, values, facecolors=faces, edgecolors=line.get_color())
        panel.locator_params(axis="x", nbins=5)
        panel.set(xlabel="duration [s]", ylabel=label, ylim=(0.0, (1 + AXIS_MARGIN) * max(values)))
    return panels


@styled()
def acceleration_map(
    found: AccelerationMap, guess: float | None = None, axes: GivenAxes | None = None
) -> AxesGrid:
    """Draw accelerations that torque allows over the speed, a line for each payload.

    Parameters
    ----------
    found : AccelerationMap
    guess : float, optional
        Acceleration that a driver or planner takes, rad/s^2 (m/s^2): a dashed line.
    axes : Axes, optional
        Default a new figure.

    Returns
    -------
    AxesGrid [1]
        Open circles are accelerations that a known state breaks; zero is where gravity or speed
        alone need more than the torques.
    """
    panels = row(axes, 1, "accelerations that torque allows")
    share = 100.0 * found.speeds
    for load, proved, broken in zip(found.payloads, found.qdd_max, found.broken, strict=True):
        (line,) = panels[0].plot(share, proved, marker=".", label=f"{load:g} kg")
        panels[0].scatter(share, broken, facecolors="none", edgecolors=line.get_color())
    if guess is not None:
        panels[0].axhline(guess, color="0.4", linestyle="--", label=f"guess, {guess:g}")
    panels[0].set(xlabel="speed [% of its limit]", ylabel="acceleration [rad/s²]")
    panels[0].set_ylim(bottom=0.0)
    panels[0].legend(title="payload up to", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return panels


@styled()
def prices(sensitivities: Sensitivities, axes: GivenAxes | None = None) -> AxesGrid:
    """Draw the time saved by one percent more of each limit, the largest first.

    Parameters
    ----------
    sensitivities : Sensitivities
    axes : Axes, optional
        Default a new figure.

    Returns
    -------
    AxesGrid [1]
    """
    table = sensitivities.table()
    names, saved = [row[0] for row in table.rows], [row[-1] for row in table.rows]
    title, height = "time saved by one percent more of a limit", 2 + len(names) / 4
    panels = row(axes, 1, title, height)
    # A hollow bar marks a limit that barely binds: one percent more may make it inactive.
    filled = [row[4] == "yes" for row in table.rows]
    for bar, sure in zip(panels[0].barh(names, saved, edgecolor="C0"), filled, strict=True):
        bar.set_fill(sure)
    panels[0].invert_yaxis()
    panels[0].set(xlabel="time saved [ms]")
    return panels


@styled()
def duration_line(line: DurationLine, axes: GivenAxes | None = None) -> AxesGrid:
    """Draw the shortest duration over one datum of a task, with its slopes.

    Parameters
    ----------
    line : DurationLine
        Result of :meth:`microbot_ocp.TimeOptimalSolver.along`.
    axes : Axes, optional
        Default a new figure.

    Returns
    -------
    AxesGrid [1]
        Slopes are short lines; a hollow mark shows that other limits bind than at the value before.
    """
    panels = row(axes, 1)
    half = 0.5 * np.gradient(line.values) if line.values.size > 1 else np.zeros(1)
    ends = np.stack([-half, half])
    panels[0].plot(line.values + ends, line.duration + line.slope * ends, color="C0")
    for changed, fill in ((False, "full"), (True, "none")):
        at = line.changes == changed
        panels[0].plot(line.values[at], line.duration[at], "o", color="C0", fillstyle=fill)
    unit = f" [{line.unit}]" if line.unit else ""
    panels[0].set(xlabel=f"{line.name}{unit}", ylabel="duration [s]")
    return panels


@styled()
def reserve(reserve: Reserve, axes: GivenAxes | None = None) -> AxesGrid:
    """Draw the error of the tool and the duration over the reserve of torque.

    Parameters
    ----------
    reserve : Reserve
        Result of :func:`microbot_ocp.smallest_reserve`.
    axes : array of Axes [2], optional
        Default a new figure.

    Returns
    -------
    AxesGrid [2]
        The bound is dashed, the least reserve that keeps it dotted.
    """
    panels = row(axes, 2, "effect of a torque reserve")
    share = [100.0 * trial.reserve for trial in reserve.trials]
    error = np.array([trial.error for trial in reserve.trials])
    panels[0].semilogy(share, np.where(np.isfinite(error), 1e3 * error, np.nan), marker="o")
    panels[0].axhline(1e3 * reserve.bound, linestyle="--", color="0.4")
    panels[1].plot(share, [trial.duration for trial in reserve.trials], marker="o")
    for panel, label in zip(panels, ("error of the tool [mm]", "duration [s]"), strict=True):
        panel.set(xlabel="reserve [%]", ylabel=label)
        if reserve.solved:
            panel.axvline(100.0 * reserve.reserve, linestyle=":", color="0.4")
    return panels


@styled()
def sparsity(solver: ParametricSolver, axes: GivenAxes | None = None) -> AxesGrid:
    """Draw the nonzeros of the Jacobian of the constraints and of the Hessian of the Lagrangian.

    Parameters
    ----------
    solver : ParametricSolver
    axes : array of Axes [2], optional
        Default a new figure.

    Returns
    -------
    AxesGrid [2]
        Lines separate the phases.
    """
    program = solver.program
    panels = row(axes, 2, solver.transcription.problem.name)
    edges = [
        np.cumsum([getattr(layout, count) for layout in program.layouts])[:-1]
        for count in ("variable_count", "row_count")
    ]
    matrices = {"Jacobian": ("jacobian", edges[1], "row"), "Hessian": ("hessian", edges[0], "")}
    for panel, (name, (key, borders, label)) in zip(panels, matrices.items(), strict=True):
        pattern = program.functions[key].sparsity_out(1)
        rows, columns = pattern.get_triplet()
        panel.plot(columns, rows, ".", markersize=max(0.5, 200.0 / max(pattern.shape)))
        for border in edges[0]:
            panel.axvline(border - 0.5, color="0.6", linewidth=0.5)
        for border in borders:
            panel.axhline(border - 0.5, color="0.6", linewidth=0.5)
        height, width = pattern.shape
        title = f"{name}: {height} x {width}, {pattern.nnz()} nonzeros"
        panel.set(xlim=(-1, width), ylim=(height, -1), title=title)
        panel.set(xlabel="variable", ylabel=label or "variable")
    return panels
