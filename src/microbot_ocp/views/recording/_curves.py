"""Curves with their limits: over a timeline as Rerun's plots, and whole in panels.

Rerun's plots show one value an instant. Where a whole curve belongs to one iteration, a panel draws
it as a line in a box of its own, with its limits and the ends of its axes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.problem import Variable
from microbot_ocp.ocp.solution import PhaseSolution
from microbot_ocp.robot import Robot
from microbot_ocp.views._scene import AxisLimits, display_factor
from microbot_ocp.views.recording._animated_arm import (
    LIMIT_COLOR,
    NEUTRAL_COLOR,
    SPEED_COLOR,
    AnimatedArm,
)
from microbot_ocp.views.recording._writer import PROGRESS, TIME, WHOLE, Times, Writer, plot_path

DASHES = 40  # of a limit's line, over the whole timeline

WIDTH, HEIGHT = 1.7, 1.0  # of a panel's box; Rerun's second axis points down
PANEL_BOUNDS = ((-0.42, WIDTH + 0.12), (-HEIGHT - 0.1, 0.24))
PANEL_DASHES = 24
STRETCH = 2.0  # a limit that would stretch a panel's axis by more is not drawn


def draw_curves(writer: Writer, robot: Robot, arm: AnimatedArm) -> None:
    """Every quantity of every joint of an arm."""
    for quantity, values in arm.curves.items():
        for joint, name in enumerate(robot.joint_names):
            shown = values[:, joint] * display_factor(robot, quantity, joint)
            draw_curve(writer, arm, plot_path(quantity, name, arm.name), arm.times, shown)


def draw_progress(writer: Writer, arm: AnimatedArm) -> None:
    """How far the arm is over the time, %, and the time over how far it is, s."""
    t, progress = arm.times[TIME], arm.times[PROGRESS]
    percent = 100.0 / WHOLE * progress
    draw_curve(writer, arm, plot_path("progress", arm.name), {TIME: t}, percent)
    draw_curve(writer, arm, plot_path("elapsed", arm.name), {PROGRESS: progress}, t)


def draw_curve(
    writer: Writer, arm: AnimatedArm, path: str, times: Times, values: FloatArray
) -> None:
    """Values [N] in the arm's colour."""
    look = rr.SeriesLines.from_fields(
        names=[arm.title or arm.name],
        colors=[arm.look.line_color],
        widths=[2.5 if arm.look.solid else 1.6],
    )
    writer.static(path, look)
    writer.columns(path, times, rr.Scalars.columns(scalars=values))


def draw_bound(writer: Writer, path: str, times: Times, values: FloatArray) -> None:
    """A bound [N] that varies along the motion."""
    look = rr.SeriesLines.from_fields(names=["limit"], colors=[LIMIT_COLOR], widths=[1.2])
    writer.static(path, look)
    writer.columns(path, times, rr.Scalars.columns(scalars=values))


def draw_limits(writer: Writer, path: str, limits: AxisLimits, end: Times) -> None:
    """Dashed lines over all timelines, beside the curves at a path."""
    whole = {key: (0.0, float(value[0])) for key, value in end.items()}
    for side, value in (("lower", limits.lower), ("upper", limits.upper)):
        if value is not None:
            draw_dashed(writer, f"{path}/limit_{side}", [(whole, value)])


def draw_dashed(
    writer: Writer, path: str, spans: Sequence[tuple[Mapping[str, tuple[float, float]], float]]
) -> None:
    """Dashes at a value from begin to end on every timeline, for each span.

    Rows without a value interrupt the line.
    """
    spans = [span for span in spans if all(begin < end for begin, end in span[0].values())]
    if not spans:
        return
    gap = 1e-6  # share of the span after a dash, where the row without a value is
    edges = np.linspace(0.0, 1.0 - gap, 2 * DASHES)
    share = np.column_stack([edges[::2], edges[1::2], edges[1::2] + gap]).ravel()
    times = {
        key: np.concatenate([span[key][0] + np.diff(span[key]) * share for span, _ in spans])
        for key in spans[0][0]
    }
    look = rr.SeriesLines.from_fields(names=["limit"], colors=[LIMIT_COLOR], widths=[1.2])
    writer.static(path, look)
    values = np.repeat([value for _, value in spans], 2 * DASHES)
    lengths = np.tile([1, 1, 0], DASHES * len(spans))
    writer.columns(path, times, rr.Scalars.columns(scalars=values).partition(lengths=lengths))


@dataclass(frozen=True, eq=False)
class Curve:
    """Values [M] over times t [M], s, in the unit in which they are drawn, and their limits."""

    t: FloatArray
    values: FloatArray
    lower: float = -np.inf
    upper: float = np.inf


def variable_curves(
    phase: PhaseSolution, t: FloatArray, start: float
) -> Iterator[tuple[Variable, int, Curve]]:
    """Every component (0-based) of every variable of a solved phase at its times t [M].

    The phase begins ``start`` seconds after the first one.
    """
    assert phase.layout is not None
    table, declared = phase.sample(t), phase.layout.phase
    for variable in (*declared.states, *declared.controls, *declared.algebraics):
        for k in range(variable.size):
            bounds = float(variable.lower[k]), float(variable.upper[k])
            yield variable, k, Curve(start + t, table[variable.name][:, k], *bounds)


def prepare_panel(writer: Writer, path: str) -> None:
    """What does not change: the box, and how lines look."""
    corners = [[0, 0], [0, -HEIGHT], [WIDTH, -HEIGHT], [WIDTH, 0], [0, 0]]
    box = rr.LineStrips2D([corners], radii=_points(0.5), colors=[NEUTRAL_COLOR])
    writer.static(f"{path}/box", box)
    for leaf, color, width in (("curve", SPEED_COLOR, 1.2), ("limits", LIMIT_COLOR, 0.6)):
        look = rr.LineStrips2D.from_fields(radii=[_points(width)], colors=[color])
        writer.static(f"{path}/{leaf}", look)
    invisible = rr.Points2D.from_fields(
        radii=[_points(0.0)], colors=[LIMIT_COLOR], show_labels=True
    )
    writer.static(f"{path}/axes", invisible)


def _points(size: float) -> float:
    """A radius in points of the screen: Rerun takes negative ones so."""
    return -size


def draw_panel(writer: Writer, path: str, times: Times, curve: Curve) -> None:
    """One curve with its limits and the ends of its axes, at times [1]."""
    finite = curve.values[np.isfinite(curve.values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    size = _size(low, high)
    near = [
        limit
        for limit in (curve.lower, curve.upper)
        if np.isfinite(limit) and max(high, limit) - min(low, limit) <= STRETCH * size
    ]
    bottom, top = rounded(min(low, *near, high), max(high, *near, low))
    end = rounded(0.0, float(curve.t[-1]))[1]

    def place(t: FloatArray, values: FloatArray) -> FloatArray:
        across = WIDTH * np.asarray(t) / end
        return np.column_stack([across, -HEIGHT * (values - bottom) / (top - bottom)])

    shown = np.nan_to_num(curve.values, nan=bottom, posinf=top, neginf=bottom)
    _draw_lines(writer, f"{path}/curve", times, [place(curve.t, shown)])
    edges = np.linspace(0.0, end, 2 * PANEL_DASHES).reshape(PANEL_DASHES, 2)
    dashes = [place(edge, np.full(2, limit)) for limit in near for edge in edges]
    _draw_lines(writer, f"{path}/limits", times, dashes)
    labels = [f"{top:g}", f"{bottom:g}", "0", f"{end:g} s"]
    places = [[-0.2, -HEIGHT - 0.08], [-0.2, -0.08], [0.0, 0.04], [WIDTH, 0.04]]
    rows = rr.Points2D.columns(positions=places, labels=labels).partition([len(labels)])
    writer.columns(f"{path}/axes", times, rows)


def rounded(low: float, high: float) -> tuple[float, float]:
    """A range with round ends that holds another one."""
    size = _size(low, high)
    decade = 10.0 ** np.floor(np.log10(size / 4))
    step = next(decade * m for m in (1, 2, 5, 10) if size / (decade * m) <= 5)
    bottom, top = step * np.floor(low / step + 1e-9), step * np.ceil(high / step - 1e-9)
    if top - bottom < step / 2:
        top = bottom + step
    return float(f"{bottom:.9g}") + 0.0, float(f"{top:.9g}") + 0.0  # no -0.0


def _size(low: float, high: float) -> float:
    """Length of a range; that of a point is not zero."""
    return max(high - low, 1e-3 * max(abs(low), abs(high)), 1e-9)


def _draw_lines(writer: Writer, path: str, times: Times, strips: Iterable[FloatArray]) -> None:
    lines = [np.asarray(strip, dtype=np.float32) for strip in strips]
    writer.columns(path, times, rr.LineStrips2D.columns(strips=lines).partition([len(lines)]))
