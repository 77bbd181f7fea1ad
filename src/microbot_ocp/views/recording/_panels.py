"""Curves that change as a whole: one panel a curve, drawn in two dimensions.

Rerun's plots show one value an instant. Here a whole curve belongs to one iteration, so it is drawn
as a line in a box of its own, with its limits and the ends of its axes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.views.recording._palette import LIMIT_COLOR, NEUTRAL_COLOR, Color
from microbot_ocp.views.recording._writer import Times, Writer

WIDTH, HEIGHT = 1.7, 1.0  # of the box; Rerun's second axis points down
CURVE_COLOR: Color = (86, 180, 233, 255)
DASHES = 24
STRETCH = 2.0  # a limit that would stretch the axis by more is not drawn
BOUNDS = ((-0.42, WIDTH + 0.12), (-HEIGHT - 0.1, 0.24))


@dataclass(frozen=True, eq=False)
class Curve:
    """Values [M] over times t [M], s, in the unit in which they are drawn, and their limits."""

    t: FloatArray
    values: FloatArray
    lower: float = -np.inf
    upper: float = np.inf


def _points(size: float) -> float:
    """A radius in points of the screen: Rerun takes negative ones so."""
    return -size


def view(path: str, name: str) -> rrb.Spatial2DView:
    """Shows the panel at a path."""
    return rrb.Spatial2DView(
        origin=path,
        name=name,
        visual_bounds=rrb.VisualBounds2D(x_range=BOUNDS[0], y_range=BOUNDS[1]),
    )


def prepare(writer: Writer, path: str) -> None:
    """What does not change: the box, and how lines look."""
    corners = [[0, 0], [0, -HEIGHT], [WIDTH, -HEIGHT], [WIDTH, 0], [0, 0]]
    box = rr.LineStrips2D([corners], radii=_points(0.5), colors=[NEUTRAL_COLOR])
    writer.static(f"{path}/box", box)
    for leaf, color, width in (("curve", CURVE_COLOR, 1.2), ("limits", LIMIT_COLOR, 0.6)):
        look = rr.LineStrips2D.from_fields(radii=[_points(width)], colors=[color])
        writer.static(f"{path}/{leaf}", look)
    invisible = rr.Points2D.from_fields(
        radii=[_points(0.0)], colors=[LIMIT_COLOR], show_labels=True
    )
    writer.static(f"{path}/axes", invisible)


def draw(writer: Writer, path: str, times: Times, curve: Curve) -> None:
    """One curve with its limits and the ends of its axes, at times [1]."""
    finite = curve.values[np.isfinite(curve.values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    size = max(high - low, 1e-3 * max(abs(low), abs(high)), 1e-9)
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
    _lines(writer, f"{path}/curve", times, [place(curve.t, shown)])
    edges = np.linspace(0.0, end, 2 * DASHES).reshape(DASHES, 2)
    dashes = [place(edge, np.full(2, limit)) for limit in near for edge in edges]
    _lines(writer, f"{path}/limits", times, dashes)
    labels = [f"{top:g}", f"{bottom:g}", "0", f"{end:g} s"]
    places = [[-0.2, -HEIGHT - 0.08], [-0.2, -0.08], [0.0, 0.04], [WIDTH, 0.04]]
    rows = rr.Points2D.columns(positions=places, labels=labels).partition([len(labels)])
    writer.columns(f"{path}/axes", times, rows)


def rounded(low: float, high: float) -> tuple[float, float]:
    """A range with round ends that holds another one."""
    size = max(high - low, 1e-3 * max(abs(low), abs(high)), 1e-9)
    decade = 10.0 ** np.floor(np.log10(size / 4))
    step = next(decade * m for m in (1, 2, 5, 10) if size / (decade * m) <= 5)
    bottom, top = step * np.floor(low / step + 1e-9), step * np.ceil(high / step - 1e-9)
    if top - bottom < step / 2:
        top = bottom + step
    return float(f"{bottom:.9g}") + 0.0, float(f"{top:.9g}") + 0.0  # no -0.0


def _lines(writer: Writer, path: str, times: Times, strips: Iterable[FloatArray]) -> None:
    lines = [np.asarray(strip, dtype=np.float32) for strip in strips]
    writer.columns(path, times, rr.LineStrips2D.columns(strips=lines).partition([len(lines)]))
