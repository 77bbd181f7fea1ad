"""What does not move: which way is up, the base, the via points, the words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import Robot
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.recording import _camera as camera, _paths as entities
from microbot_ocp.views.recording._palette import BASE_COLOR, VIA_COLOR
from microbot_ocp.views.recording._rotations import quaternions
from microbot_ocp.views.recording._writer import Writer


def draw(
    writer: Writer,
    robot: Robot,
    places: FloatArray,
    names: Sequence[str],
    target: FloatArray | None,
) -> None:
    """Base plate, a post from the base frame to it where they differ, marked places [m,3], target.

    Of the target [4,4] the axes are drawn.
    """
    size = scene.reach(robot)
    axis, up = camera.up_axis(robot), camera.upward(robot)
    direction = "UP" if up[axis] > 0 else "DOWN"
    view = getattr(rr.ViewCoordinates, f"RIGHT_HAND_{camera.AXES[axis]}_{direction}")
    writer.static(entities.WORLD, view)
    place = robot.base[:3, 3]
    plate = rr.Boxes3D(
        half_sizes=[[0.07 * size, 0.07 * size, 0.008 * size]],
        centers=[place],
        quaternions=quaternions(robot.base[None, :3, :3]),
        colors=[BASE_COLOR],
        fill_mode="solid",
    )
    writer.static(entities.BASE, plate)
    if np.linalg.norm(place) > 1e-9:
        post = rr.LineStrips3D([[np.zeros(3), place]], radii=0.006 * size, colors=[BASE_COLOR])
        writer.static(f"{entities.BASE}/post", post)
    if target is not None:
        pose = rr.Transform3D(translation=target[:3, 3], mat3x3=target[:3, :3])
        writer.static(entities.TARGET, pose, rr.TransformAxes3D(0.12 * size))
    if not len(places):
        return
    labels = [_label(place, places, names) for place in places]
    spheres = rr.Points3D(
        places, radii=0.022 * size, colors=[VIA_COLOR], labels=labels, show_labels=True
    )
    writer.static(entities.PLACES, spheres)


def _label(place: FloatArray, places: FloatArray, names: Sequence[str]) -> str:
    """Names of all that are at one place, lest their labels hide each other."""
    here = np.linalg.norm(places - place, axis=1) < 1e-6
    return ", ".join(name for name, same in zip(names, here, strict=True) if same)


def write_words(writer: Writer, markdown: str) -> None:
    """The summary as text."""
    writer.static(entities.SUMMARY, rr.TextDocument(markdown, media_type="text/markdown"))
