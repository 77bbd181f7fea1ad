"""Figures of a sweep: time saved over the workspace, deciding limits, trends, failures."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.showing import DrawnAxes, GivenAxes
from microbot_ocp._base.status import Status
from microbot_ocp.sweeps import Quartiles, Sweep
from microbot_ocp.views import _style as style
from microbot_ocp.views._scene import limit_title
from microbot_ocp.views.plots._page import axes_page, styled

KINDS = ("atlas", "limits", "quantities", "failures")
POSES = ("start_", "goal_", "via")


@styled()
def sweep(
    results: Sweep, axes: GivenAxes | None = None, *, kind: str = "atlas", method: str | None = None
) -> DrawnAxes:
    """Draw one figure of a sweep.

    Parameters
    ----------
    results : Sweep
    axes : Axes, array or nested sequence of Axes, optional
        Default a new figure.
    kind : str
        Name of the figure. "atlas": share of the time that the best method saves, over the tool
        position at the goal, from above and from the side. "limits": the limit that is active
        longest in most cases of a hexagon, on these maps. "quantities": median and quartiles of the
        saving over the varied quantities. "failures": number of cases per kind of failure.
    method : str, optional
        Method to compare the best method with; default the fastest baseline, ``results.reference``.

    Returns
    -------
    array of Axes

    Raises
    ------
    InputError
        An unknown kind or method, no case yet.
    """
    checks.one_of("kind", kind, KINDS)
    if not results.done:
        raise checks.InputError(f"{results.folder} has no finished case yet")
    others = [name for name in results.methods if name != results.best]
    if kind in ("atlas", "quantities"):
        if not others:
            raise checks.InputError("kind needs two methods to compare, but the sweep has only one")
        method = checks.one_of("method", method or results.reference, others)
    draw: Any = {"atlas": _atlas, "limits": _limits, "quantities": _trends, "failures": _failures}
    return draw[kind](results, axes, method)


def _maps(results: Sweep, axes: GivenAxes | None, title: str) -> Any:
    """Return a page with two maps of the goals (from above, from the side) and the positions."""
    x, y, z = results.read(["goal_x", "goal_y", "goal_z"]).values()
    away = np.hypot(x, y)
    spans = [np.ptp(v[np.isfinite(v)]) or 1.0 for v in (x, y, away, z)]
    ratios = {"width_ratios": [spans[0] / spans[1], spans[2] / spans[3]]}
    size = (style.FIGURE_WIDTH, 2 * style.ROW_HEIGHT)
    page = axes_page(axes, 1, 2, size=size, title=title, gridspec_kw=ratios)
    above, side = page.axes[0]
    above.set(xlabel="x of the goal [m]", ylabel="y of the goal [m]", aspect="equal")
    side.set(xlabel="distance from the base's axis [m]", ylabel="z of the goal [m]", aspect="equal")
    return page, ((above, x, y), (side, away, z))


def _atlas(results: Sweep, axes: GivenAxes | None, method: str) -> Any:
    """Draw the median of the time saved per hexagon."""
    saved = 100 * results.savings(method)
    page, panels = _maps(results, axes, f"Time saved against: {style.method_title(method)}")
    finite = np.isfinite(saved)
    ends = np.quantile(saved[finite], [0.02, 0.98]) if finite.any() else (0.0, 1.0)
    low, top = min(0.0, ends[0]), max(0.0, ends[1])  # the saving may be negative
    drawn = _hexagons(panels, saved, np.median, cmap="viridis", vmin=low, vmax=top)
    if drawn is not None:
        bar = page.axes.figure.colorbar(drawn, ax=list(page.axes[0]))
        bar.set_label("median of the time saved [%]")
    return page.axes


def _hexagons(panels: Any, values: FloatArray, reduced: Any, **colors: Any) -> Any:
    """Draw finite values in hexagons, at most 24 across and fewer for few cases."""
    finite, drawn = np.isfinite(values), None
    cells = int(np.clip(np.sqrt(finite.sum()) / 1.5, 6, 24))
    for panel, across, up in panels:
        panel.plot(across[~finite], up[~finite], ".", color="0.8", markersize=2, zorder=0)
        if finite.any():
            # Regular hexagons need sqrt(3) times fewer rows than columns for a square map.
            shape = np.ptp(up[finite]) / (np.ptp(across[finite]) or 1.0)
            drawn = panel.hexbin(
                across[finite], up[finite], values[finite], reduce_C_function=reduced,
                gridsize=(cells, max(4, round(cells * shape / np.sqrt(3)))), linewidths=0,
                **colors,
            )  # fmt: skip
    return drawn


def _limits(results: Sweep, axes: GivenAxes | None, _: str | None) -> Any:
    """Draw in every hexagon the limit that is active longest in most of its cases."""
    limit, status = results.read([f"{results.best}_limit", f"{results.best}_status"]).values()
    solved, names = status == Status.SOLVED, results.about["limits"]
    page, panels = _maps(results, axes, "Quantity that is at its limit longest")
    places = np.full(len(limit), np.nan)
    handles, colors = [], [style.look(place, joints=True)["color"] for place in range(len(names))]
    for place, name in enumerate(names):
        decided = solved & (limit == name)
        places[decided] = place
        if decided.any():
            title = limit_title(name, results.about["joints"])
            label = f"{title}: {100 * decided.sum() / solved.sum():.0f} %"
            handles.append(Patch(color=colors[place], label=label))
    ends = {"vmin": -0.5, "vmax": len(names) - 0.5}

    def most_frequent(places: FloatArray) -> int:
        return int(np.bincount(np.asarray(places, dtype=int)).argmax())

    _hexagons(panels, places, most_frequent, cmap=ListedColormap(colors), **ends)
    page.legend(handles, 4)
    return page.axes


def _trends(results: Sweep, axes: GivenAxes | None, method: str) -> Any:
    names, count = _scalars(results), len(results.about["joints"])
    values: dict[str, FloatArray] = results.read(names) if names else {}
    start, goal = (
        np.array(list(results.read([f"{end}_q_{k + 1}" for k in range(count)]).values()))
        for end in ("start", "goal")
    )
    values["largest joint step [rad]"] = np.abs(goal - start).max(axis=0)
    size, title = (1 + 3 * len(values), 4), "Time saved: median and quartiles"
    page = axes_page(axes, 1, len(values), size=size, title=title, sharey=True)
    others = [method, *(m for m in results.methods if m not in (method, results.best))]
    for panel, (name, across) in zip(page.axes[0], values.items(), strict=True):
        panel.set_xlabel("payload [kg]" if name == "payload" else name)
        for place, other in enumerate(others):
            line, label = style.look(place), f"against: {style.method_title(other)}"
            middle, low, half, high = _binned(across, 100 * results.savings(other))
            shade = style.BEYOND_LIMIT | {"facecolor": line["color"]}
            panel.fill_between(middle, low, high, **shade)
            panel.plot(middle, half, marker="o", markersize=3, label=label, **line)
    page.axes[0, 0].set_ylabel("time saved [%]")
    page.legend(page.axes[0, 0].get_lines(), 3)
    return page.axes


def _failures(results: Sweep, axes: GivenAxes | None, _: str | None) -> Any:
    """Draw a bar for each of the ten most frequent failures."""
    failures = results.summary().failures[:10]
    size = (style.FIGURE_WIDTH, 2 + len(failures) / 2)
    page = axes_page(axes, 1, 1, size=size, title="Not solved")
    panel, places = page.axes[0, 0], np.arange(len(failures))[::-1]
    counts = [failure.count for failure in failures]
    bars = panel.barh(places, counts, color=style.WARNING_COLOR)
    panel.bar_label(bars, [f" {count:,}" for count in counts])
    labels = [f"{f.status}: {checks.shortened(f.reason, 80)}\n(case {f.case})" for f in failures]
    panel.set_yticks(places, labels, fontsize=style.SMALL_FONT)
    panel.set_xlabel("cases")
    panel.grid(axis="y", visible=False)
    panel.margins(x=0.1)
    if not failures:
        panel.text(0.5, 0.5, "every case is solved", transform=panel.transAxes, ha="center")
    return page.axes


def _binned(across: FloatArray, values: FloatArray) -> FloatArray:
    """Return middles, lower quartiles, medians and upper quartiles [4,K] of up to eight bins.

    Bins have equal numbers of cases, or one value each if there are at most eight values. Bins with
    fewer than five cases are left out.
    """
    finite = np.isfinite(values) & np.isfinite(across)
    across, values = across[finite], values[finite]
    groups = [np.flatnonzero(across == x) for x in np.unique(across)]
    if len(groups) > 8:
        groups = np.array_split(np.argsort(across, kind="stable"), 8)
    rows = [(np.median(across[k]), *Quartiles.of(values[k])[1:]) for k in groups if k.size >= 5]
    return np.array(rows).reshape(-1, 4).T


def _scalars(results: Sweep) -> list[str]:
    """Return up to six columns of the varied quantities, poses excluded."""
    columns = [name for name, kind in results.about["columns"] if kind == "float"]
    names = [name for name in results.about["varying"] if not name.startswith(POSES)]
    return [c for c in columns for n in names if c == n or c.rsplit("_", 1)[0] == n][:6]
