"""A whole curve of one iterate as a line in a box, with its limits and the ends of its axes.

Rerun's plots show one value an instant.
"""

from __future__ import annotations

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.views._scene import is_near
from microbot_ocp.views._style import STYLE
from microbot_ocp.views._variables import BoundedCurve
from microbot_ocp.views.recording._writer import Times, Writer


def prepare_panel(writer: Writer, path: str) -> None:
    """Log what does not change: the box, and how lines look. Negative radii are screen points."""
    width, height = STYLE.panel
    corners = [[0, 0], [0, -height], [width, -height], [width, 0], [0, 0]]
    box = rr.LineStrips2D([corners], radii=-0.5, colors=[STYLE.neutral])
    writer.static(f"{path}/box", box)
    for leaf, color, radius in (("curve", STYLE.speed, -1.2), ("limits", STYLE.dull, -0.6)):
        look = rr.LineStrips2D.from_fields(radii=[radius], colors=[color])
        writer.static(f"{path}/{leaf}", look)
    invisible = rr.Points2D.from_fields(radii=[-0.0], colors=[STYLE.dull], show_labels=True)
    writer.static(f"{path}/axes", invisible)


def draw_panel(writer: Writer, path: str, times: Times, curve: BoundedCurve) -> None:
    """Draw one curve with its limits and the ends of its axes, at times [1]."""
    finite = curve.values[np.isfinite(curve.values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    size, (width, height) = _size(low, high), STYLE.panel
    near = [limit for limit in (curve.lower, curve.upper) if is_near(limit, low, low + size)]
    bottom, top = rounded(min(low, *near, high), max(high, *near, low))
    end = rounded(0.0, float(curve.t[-1]))[1]

    def place(t: FloatArray, values: FloatArray) -> FloatArray:
        return np.column_stack([width * t / end, -height * (values - bottom) / (top - bottom)])

    def draw_lines(leaf: str, lines: list[FloatArray]) -> None:
        strips = rr.LineStrips2D.columns(strips=[line.astype(np.float32) for line in lines])
        writer.columns(f"{path}/{leaf}", times, strips.partition([len(lines)]))

    shown = np.nan_to_num(curve.values, nan=bottom, posinf=top, neginf=bottom)
    draw_lines("curve", [place(curve.t, shown)])
    edges = np.linspace(0.0, end, 2 * STYLE.dashes).reshape(-1, 2)
    draw_lines("limits", [place(edge, np.full(2, limit)) for limit in near for edge in edges])
    labels = [f"{top:g}", f"{bottom:g}", "0", f"{end:g} s"]
    places = [[-0.2, -height - 0.08], [-0.2, -0.08], [0.0, 0.04], [width, 0.04]]
    rows = rr.Points2D.columns(positions=places, labels=labels).partition([len(labels)])
    writer.columns(f"{path}/axes", times, rows)


def rounded(low: float, high: float) -> tuple[float, float]:
    """Return a range with round ends that holds another one."""
    size = _size(low, high)
    decade = 10.0 ** np.floor(np.log10(size / 4))
    step = next(decade * m for m in (1, 2, 5, 10) if size / (decade * m) <= 5)
    bottom, top = step * np.floor(low / step + 1e-9), step * np.ceil(high / step - 1e-9)
    if top - bottom < step / 2:
        top = bottom + step
    return float(f"{bottom:.9g}") + 0.0, float(f"{top:.9g}") + 0.0  # no -0.0


def _size(low: float, high: float) -> float:
    """Return the length of a range; that of a point is not zero."""
    return max(high - low, 1e-3 * max(abs(low), abs(high)), 1e-9)
