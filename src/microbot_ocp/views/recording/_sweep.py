"""The atlas of a sweep: every goal as a point in space, coloured by the time saved."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from matplotlib import colormaps

from microbot_ocp._base.status import Status
from microbot_ocp.sweeps import Sweep
from microbot_ocp.views.plots._style import JOINT_COLORS
from microbot_ocp.views.recording._blueprint import folded
from microbot_ocp.views.recording._writer import SUMMARY, WORLD, file_writer
from microbot_ocp.views.tables._sweep import sweep as sweep_table

MOST_POINTS = 200_000
SIZE = 0.012  # radius of a point, of the workspace
TILT = np.array([0.75, -1.0, 0.55])


def of_sweep(results: Sweep, path: str | Path) -> Path:
    """Write a recording: the time saved against every other method, and the limit that decides.

    Where more than 200,000 cases are done it shows the first so many.
    """
    read = results.read(["goal_x", "goal_y", "goal_z", f"{results.best}_limit",
                         f"{results.best}_status"])  # fmt: skip
    kept = slice(0, MOST_POINTS)
    places = np.column_stack([read[f"goal_{axis}"] for axis in "xyz"])[kept]
    known = np.isfinite(places).all(axis=1)
    solved = (read[f"{results.best}_status"] == Status.SOLVED)[kept]
    middle, width = np.zeros(3), 1.0
    if known.any():
        middle = (places[known].min(axis=0) + places[known].max(axis=0)) / 2
        width = float(np.ptp(places[known], axis=0).max()) or 1.0
    views = []
    table = sweep_table(results)

    def view(name: str, title: str) -> None:
        eye = rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=middle + 1.25 * width * TILT, look_target=middle,
            eye_up=[0, 0, 1],
        )  # fmt: skip
        views.append(rrb.Spatial3DView(origin=f"{WORLD}/{name}", name=title, eye_controls=eye))

    others = [method for method in results.methods if method != results.best]
    for method in others:
        view(f"saved_{method}", f"time saved against {method}: 0 % dark, 60 % and more bright")
    view("limits", "limit that is at work longest")
    text = rrb.TextDocumentView(origin=SUMMARY, name="summary")
    layout = folded(rrb.Vertical(rrb.Tabs(*views), text, row_shares=[2.6, 1.0]))
    with file_writer(path, layout) as writer:
        writer.static(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        writer.summary(table)
        for method in others:
            saved = results.savings(method)[kept]
            shown = known & np.isfinite(saved)
            colors = (255 * colormaps["viridis"](np.clip(saved[shown] / 0.6, 0, 1))).astype(
                np.uint8
            )
            labels = [f"case {k}: {100 * s:.1f} %" for k, s in
                      zip(np.flatnonzero(shown), saved[shown], strict=True)]  # fmt: skip
            points = rr.Points3D(
                places[shown], colors=colors, radii=SIZE * width, labels=labels, show_labels=False
            )
            writer.static(f"{WORLD}/saved_{method}/goals", points)
            failed = known & ~shown
            rest = rr.Points3D(places[failed], colors=[(150, 150, 150)], radii=0.4 * SIZE * width)
            writer.static(f"{WORLD}/saved_{method}/not_solved", rest)
        for place, name in enumerate(results.about["limits"]):
            mine = known & solved & (read[f"{results.best}_limit"][kept] == name)
            color = JOINT_COLORS[place % len(JOINT_COLORS)]
            rgb = tuple(int(color[k : k + 2], 16) for k in (1, 3, 5))
            points = rr.Points3D(places[mine], colors=[rgb], radii=SIZE * width)
            writer.static(f"{WORLD}/limits/{name}", points)
    return Path(path)
