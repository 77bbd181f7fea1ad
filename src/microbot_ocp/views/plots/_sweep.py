"""Pictures of a sweep: time saved over the workspace, what decides, trends, what failed."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.showing import DrawnAxes, GivenAxes
from microbot_ocp._base.status import Status
from microbot_ocp.comparison import METHODS
from microbot_ocp.sweeps import Sweep
from microbot_ocp.views.plots._page import axes_page, styled
from microbot_ocp.views.plots._style import JOINT_COLORS, look

KINDS = ("atlas", "limits", "quantities", "failures")
CELLS = 24  # hexagons across a map
BINS = 8  # of a trend
FEWEST = 5  # cases of a bin
MOST_BARS = 10
MOST_PANELS = 6
POSES = ("start_", "goal_", "via")


@styled()
def sweep(
    results: Sweep, axes: GivenAxes | None = None, *, kind: str = "atlas", method: str | None = None
) -> DrawnAxes:
    """One picture of a sweep.

    Parameters
    ----------
    results : Sweep
    axes : Axes, array or nested sequence of Axes, optional
        Default a new figure.
    kind : str
        "atlas": share of the time that the best method saves, over the places of the tool at the
        goal, seen from above and from the side. "limits": which limit is at work longest, on the
        same maps. "quantities": the saving against what varies, median and quartiles. "failures":
        how many cases ended in which way.
    method : str, optional
        The one that the best is compared with; default the first.

    Returns
    -------
    array of Axes

    Raises
    ------
    InputError
        A kind or method that is not there, no case yet.
    """
    checks.one_of("kind", kind, KINDS)
    if not results.done:
        raise checks.InputError(f"{results.folder} has no case yet")
    others = [name for name in results.methods if name != results.best]
    if kind in ("atlas", "quantities"):
        if not others:
            raise checks.InputError("one method alone saves nothing: the sweep has no other")
        method = checks.one_of("method", method or others[0], others)
    draw: Any = {"atlas": _atlas, "limits": _limits, "quantities": _trends, "failures": _failures}
    return draw[kind](results, axes, method)


def _maps(results: Sweep, axes: GivenAxes | None, title: str) -> Any:
    """Two panels of the goals: from above, and from the side."""
    place = results.read(["goal_x", "goal_y", "goal_z"])
    x, y, z = place.values()
    away = np.hypot(x, y)
    shapes = [np.ptp(v[np.isfinite(v)]) or 1.0 for v in (x, y, away, z)]
    wide = [shapes[0] / shapes[1], shapes[2] / shapes[3]]
    ratios = {"width_ratios": wide}
    page = axes_page(axes, 1, 2, size=(9.6, 4.6), title=title, gridspec_kw=ratios)
    above, side = page.axes[0]
    above.set(xlabel="x of the goal [m]", ylabel="y of the goal [m]", aspect="equal")
    side.set(xlabel="distance from the base's axis [m]", ylabel="z of the goal [m]")
    side.set_aspect("equal")
    return page, ((above, x, y), (side, away, z))


def _atlas(results: Sweep, axes: GivenAxes | None, method: str) -> Any:
    saved = 100 * results.savings(method)
    title = f"Time saved against: {_title(method)}"
    page, panels = _maps(results, axes, title)
    known = np.isfinite(saved)
    ends = np.quantile(saved[known], [0.02, 0.98]) if known.any() else (0.0, 1.0)
    low, top = min(0.0, ends[0]), max(0.0, ends[1])  # the other method may be the faster one
    cells = int(np.clip(np.sqrt(known.sum()) / 1.5, 6, CELLS))
    drawn = None
    for panel, across, up in panels:
        size = np.ptp(across[known]) if known.any() else 1.0
        tall = max(4, round(cells * np.ptp(up[known]) / (size or 1.0) / np.sqrt(3))) if size else 4
        panel.plot(across[~known], up[~known], ".", color="0.8", markersize=2, zorder=0)
        if known.any():
            drawn = panel.hexbin(
                across[known], up[known], saved[known], reduce_C_function=np.median,
                gridsize=(cells, tall), cmap="viridis", vmin=low, vmax=top, linewidths=0.2,
            )  # fmt: skip
    if drawn is not None:
        bar = page.figure.colorbar(drawn, ax=list(page.axes[0]), shrink=0.85)
        bar.set_label("median of the time saved [%]")
    return page.axes


def _limits(results: Sweep, axes: GivenAxes | None, _: str | None) -> Any:
    best = results.best
    read = results.read([f"{best}_limit", f"{best}_status"])
    solved = read[f"{best}_status"] == Status.SOLVED
    page, panels = _maps(results, axes, "Limit that is at work longest")
    handles = []
    size = min(3.0, 100.0 / np.sqrt(solved.sum() + 1.0))  # many points lie over each other
    for place, name in enumerate(results.about["limits"]):
        mine = solved & (read[f"{best}_limit"] == name)
        if not mine.any():
            continue
        style: dict[str, Any] = {
            "color": JOINT_COLORS[place % len(JOINT_COLORS)],
            "marker": "os^Dv<>p"[place % 8],
        }
        label = f"{name.replace('_', ' ')}: {100 * mine.sum() / solved.sum():.0f} %"
        handles.append(Line2D([], [], linestyle="", label=label, **style))
        for panel, across, up in panels:
            panel.plot(
                across[mine], up[mine], linestyle="", markersize=size, alpha=0.75,
                zorder=3.0 - mine.mean(), **style,
            )  # fmt: skip
    page.legend(handles, 4)
    return page.axes


def _trends(results: Sweep, axes: GivenAxes | None, method: str) -> Any:
    names = _scalars(results)
    values: dict[str, FloatArray] = results.read(names) if names else {}
    count = len(results.about["joints"])
    ends = results.read([f"{end}_q_{k + 1}" for end in ("start", "goal") for k in range(count)])
    moved = [abs(ends[f"goal_q_{k + 1}"] - ends[f"start_q_{k + 1}"]) for k in range(count)]
    values["largest joint step [rad]"] = np.max(moved, axis=0)
    page = axes_page(
        axes, 1, len(values), size=(1.2 + 3.4 * len(values), 3.8),
        title="Time saved: median and quartiles", sharey=True,
    )  # fmt: skip
    others = [method, *(m for m in results.methods if m not in (method, results.best))]
    handles = []
    for panel, (name, across) in zip(page.axes[0], values.items(), strict=True):
        panel.set_xlabel(_unit(name))
        for place, other in enumerate(others):
            color, dashes = look(place)
            middle, low, half, high = _binned(across, 100 * results.savings(other))
            panel.fill_between(middle, low, high, color=color, alpha=0.15, linewidth=0)
            line = panel.plot(
                middle, half, color=color, linestyle=dashes, marker="o", markersize=3,
                label=f"against: {_title(other)}",
            )  # fmt: skip
            if panel is page.axes[0, 0]:
                handles += line
    page.axes[0, 0].set_ylabel("time saved [%]")
    page.legend(handles, 3)
    return page.axes


def _failures(results: Sweep, axes: GivenAxes | None, _: str | None) -> Any:
    found = results.summary().failures[:MOST_BARS]
    page = axes_page(axes, 1, 1, size=(9.6, 1.4 + 0.42 * max(len(found), 1)), title="Not solved")
    panel = page.axes[0, 0]
    places = np.arange(len(found))[::-1]
    panel.barh(places, [f.count for f in found], color="#B00020", alpha=0.7, height=0.6)
    labels = [f"{f.status}: {checks.shortened(f.reason, 80)}\n(case {f.case})" for f in found]
    panel.set_yticks(places, labels, fontsize=7.5)
    for place, failure in zip(places, found, strict=True):
        panel.text(failure.count, place, f" {failure.count:,}", va="center")
    panel.set_xlabel("cases")
    panel.grid(axis="y", visible=False)
    panel.margins(x=0.12)
    if not found:
        panel.text(0.5, 0.5, "every case is solved", transform=panel.transAxes, ha="center")
    return page.axes


def _binned(across: FloatArray, values: FloatArray) -> FloatArray:
    """Middles, lower quartiles, medians and upper quartiles [4,K] of bins of as many cases."""
    known = np.isfinite(values) & np.isfinite(across)
    across, values = across[known], values[known]
    several = np.unique(across)
    if several.size <= BINS:
        groups = [(float(x), values[across == x]) for x in several]
    else:
        order = np.array_split(np.argsort(across, kind="stable"), BINS)
        groups = [(float(np.median(across[k])), values[k]) for k in order if k.size]
    rows = [(x, *np.quantile(v, (0.25, 0.5, 0.75))) for x, v in groups if v.size >= FEWEST]
    return np.array(rows).reshape(-1, 4).T


def _scalars(results: Sweep) -> list[str]:
    """Columns of what varies and is no pose."""
    columns = [name for name, kind in results.about["columns"] if kind == "float"]
    names = [name for name in results.about["varying"] if not name.startswith(POSES)]
    return [c for c in columns for n in names if c == n or c.rsplit("_", 1)[0] == n][:MOST_PANELS]


def _title(method: str) -> str:
    return METHODS[method].title if method in METHODS else method


def _unit(name: str) -> str:
    return "payload [kg]" if name == "payload" else name
