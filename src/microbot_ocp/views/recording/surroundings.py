"""What does not move: axes, base, via points, the words."""

from __future__ import annotations

import rerun as rr

from microbot_ocp.checks import FloatArray
from microbot_ocp.robot import Robot
from microbot_ocp.views import scene
from microbot_ocp.views.recording import entities
from microbot_ocp.views.recording.writer import Writer

BASE_COLOR = (120, 120, 125, 255)
VIA_COLOR = (245, 245, 245, 255)


def draw(writer: Writer, robot: Robot, via_q: FloatArray) -> None:
    """Axes, base plate and via points."""
    size = scene.reach(robot)
    writer.static(entities.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    half = [[0.07 * size, 0.07 * size, 0.008 * size]]
    writer.static(
        entities.BASE, rr.Boxes3D(half_sizes=half, colors=[BASE_COLOR], fill_mode="solid")
    )
    places = scene.link_origins(robot, via_q)[:, -1]
    spheres = rr.Points3D(
        places,
        radii=0.022 * size,
        colors=[VIA_COLOR],
        labels=[f"via {k}" for k in range(1, len(places) + 1)],
        show_labels=True,
    )
    writer.static(entities.VIA_POINTS, spheres)


def write_words(writer: Writer, markdown: str) -> None:
    """The summary as text."""
    writer.static(entities.SUMMARY, rr.TextDocument(markdown, media_type="text/markdown"))
