"""Recording of a sweep: every goal as a point in space, coloured by the time saved."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from microbot_ocp._base.needed import needed
from microbot_ocp._base.status import Status
from microbot_ocp.sweeps import Sweep
from microbot_ocp.views import _palette as palette
from microbot_ocp.views._eye import fitted
from microbot_ocp.views._style import look, rgb
from microbot_ocp.views.recording._blueprint import eye_controls, folded, text_view
from microbot_ocp.views.recording._writer import WORLD, file_writer

MOST_POINTS = 200_000  # number of points that a viewer rotates smoothly


def of_sweep(results: Sweep, path: str | Path) -> Path:
    """Write a recording of the time saved against every other method, and of the deciding limit.

    It shows at most the first 200,000 cases.
    """
    viridis = needed("matplotlib", "atlases need").colormaps["viridis"]  # dark to bright
    best, first = results.best, slice(MOST_POINTS)
    names = ["goal_x", "goal_y", "goal_z", f"{best}_limit", f"{best}_status"]
    *goals, limit, status = (column[first] for column in results.read(names).values())
    places = np.column_stack(goals)
    placed = np.isfinite(places).all(axis=1)
    seen = places[placed] if placed.any() else np.eye(3)
    radius = 0.012 * (float(np.ptp(seen, axis=0).max()) or 1.0)
    aside = np.array([2, -2, 1]) / 3  # seen from a corner, a little from above
    eye = fitted(seen, aside, np.eye(3)[2], radius)
    titles = {
        f"saved_{method}": f"time saved against {method}: 0 % dark, 60 % and more bright"
        for method in results.methods
        if method != best
    }
    views = [
        rrb.Spatial3DView(origin=f"{WORLD}/{name}", name=title, eye_controls=eye_controls(eye))
        for name, title in {**titles, "limits": "quantity that is at its limit longest"}.items()
    ]
    shares = [3, 1]
    layout = folded(rrb.Vertical(rrb.Tabs(*views), text_view(), row_shares=shares))
    with file_writer(path, layout) as writer:
        writer.static(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        writer.summary(results.table())
        for name in titles:
            saved = results.savings(name.removeprefix("saved_"))[first]
            shown = placed & np.isfinite(saved)
            labels = [f"case {k}: {100 * saved[k]:.1f} %" for k in np.flatnonzero(shown)]
            colors = (255 * viridis(np.clip(saved[shown] / 0.6, 0, 1))).astype(np.uint8)
            points = rr.Points3D(
                places[shown], colors=colors, radii=radius, labels=labels, show_labels=False
            )
            writer.static(f"{WORLD}/{name}/goals", points)
            rest = rr.Points3D(places[placed & ~shown], colors=[palette.DULL], radii=0.4 * radius)
            writer.static(f"{WORLD}/{name}/not_solved", rest)
        for place, name in enumerate(results.about["limits"]):
            decided = placed & (status == Status.SOLVED) & (limit == name)
            color = rgb(look(place, joints=True)["color"])
            points = rr.Points3D(places[decided], colors=[color], radii=radius)
            writer.static(f"{WORLD}/limits/{name}", points)
    return Path(path)
