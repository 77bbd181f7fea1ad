"""The space around the arms: which way is up, base, via points and target, and the eye's place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import Robot
from microbot_ocp.views._scene import link_origins, reach
from microbot_ocp.views.recording._animated_arm import BASE_COLOR, VIA_COLOR
from microbot_ocp.views.recording._line_of_sight import ENOUGH, TURNS, hidden_share
from microbot_ocp.views.recording._writer import BASE, PLACES, TARGET, WORLD, Writer, quaternions

FIELD_OF_VIEW = np.radians(55.0)  # of Rerun's eye, from bottom to top
ASPECT = 1.25  # width of the view to its height, about
MARGIN = 1.05
THICK = 0.14  # share of the reach that arrows, arcs and masses stand out from the links
TILT = np.radians(20.0)  # of the line of sight, from above
STEEP_TILT = np.radians(60.0)  # the same where all that moves is level
POSES = 30  # of an arm that are to be seen
FLAT = 0.12  # height to width from which on a motion counts as level


def draw_surroundings(
    writer: Writer,
    robot: Robot,
    places: FloatArray,
    names: Sequence[str],
    target: FloatArray | None,
) -> None:
    """Base plate, a post from the base frame to it where they differ, places [m,3] with names.

    Of the target [4,4] the axes are drawn.
    """
    size = reach(robot)
    up = upward(robot)
    axis = int(np.abs(up).argmax())
    view = f"RIGHT_HAND_{'XYZ'[axis]}_{'UP' if up[axis] > 0 else 'DOWN'}"
    writer.static(WORLD, getattr(rr.ViewCoordinates, view))
    base = robot.base[:3, 3]
    plate = rr.Boxes3D(
        half_sizes=[[0.07 * size, 0.07 * size, 0.008 * size]],
        centers=[base],
        quaternions=quaternions(robot.base[None, :3, :3]),
        colors=[BASE_COLOR],
        fill_mode="solid",
    )
    writer.static(BASE, plate)
    if np.linalg.norm(base) > 1e-9:
        post = rr.LineStrips3D([[np.zeros(3), base]], radii=0.006 * size, colors=[BASE_COLOR])
        writer.static(f"{BASE}/post", post)
    if target is not None:
        pose = rr.Transform3D(translation=target[:3, 3], mat3x3=target[:3, :3])
        writer.static(TARGET, pose, rr.TransformAxes3D(0.12 * size))
    if not len(places):
        return
    labels = [_label(place, places, names) for place in places]
    spheres = rr.Points3D(
        places, radii=0.022 * size, colors=[VIA_COLOR], labels=labels, show_labels=True
    )
    writer.static(PLACES, spheres)


def _label(place: FloatArray, places: FloatArray, names: Sequence[str]) -> str:
    """Names of all that are at one place, as one label."""
    here = np.linalg.norm(places - place, axis=1) < 1e-6
    return ", ".join(name for name, same in zip(names, here, strict=True) if same)


class Eye(NamedTuple):
    """Place of the eye and what it looks at [3], m, and what is up for it [3]."""

    position: FloatArray
    target: FloatArray
    up: FloatArray


def upward(robot: Robot) -> FloatArray:
    """Unit vector [3] of the base frame nearest to upward; z without gravity."""
    size = np.abs(robot.gravity)
    axis = int(size.argmax()) if size.any() else 2
    sign = -1.0 if robot.gravity[axis] > 0.0 else 1.0
    return sign * np.eye(3)[axis]


def find_eye(
    robot: Robot,
    q: FloatArray,
    places: FloatArray,
    headroom: float,
    obstacles: Sequence[Any] = (),
) -> Eye:
    """An eye that sees the arm at all positions q [N,n] from its broad side, on the tool's side.

    It sees the places ``places`` [m,3] as well; ``headroom`` (m) is for the labels above the tool.
    Where obstacles hide too much of the arm it looks from another side.
    """
    up = upward(robot)
    at_zero = np.zeros((1, robot.joint_count))
    origins = link_origins(robot, q if len(q) else at_zero)
    points = np.vstack([origins.reshape(-1, 3), places, origins[:, -1] + headroom * up])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    level = points - np.outer(points @ up, up)
    spread, directions = np.linalg.eigh(np.cov((level - level.mean(axis=0)).T) + np.outer(up, up))
    sideways = np.abs(directions.T @ up) < 0.5
    broad = spread[sideways].max() if sideways.any() else 0.0
    towards = directions[:, np.flatnonzero(sideways)[0]]
    side = float((origins[:, -1] - middle).mean(axis=0) @ towards)
    preferred = np.array([1.0, -1.0, 1.0]) @ towards
    if side * np.sign(side) < 1e-3 * np.sqrt(broad):
        side = preferred
    towards = towards * (1.0 if side >= 0.0 else -1.0)
    height, width = np.ptp(points @ up), np.linalg.norm(np.ptp(level, axis=0))
    tilt = STEEP_TILT if height - headroom < FLAT * width else TILT
    eyes, seen = [], origins[:: max(1, len(origins) // POSES), 1:].reshape(-1, 3)
    for turn in TURNS:
        turned = np.cos(turn) * towards + np.sin(turn) * np.cross(up, towards)
        sight = np.cos(tilt) * turned + np.sin(tilt) * up
        eye = _fitted(points, THICK * reach(robot), middle, sight, up)
        hidden = hidden_share(eye.position, seen, obstacles)
        if hidden <= ENOUGH:
            return eye
        eyes.append((hidden, eye))
    return min(eyes, key=lambda entry: entry[0])[1]


def _fitted(
    points: FloatArray, radius: float, middle: FloatArray, towards: FloatArray, up: FloatArray
) -> Eye:
    """The nearest eye in a direction that sees the balls around all points [N,3]."""
    right = np.cross(up, towards)
    right /= np.linalg.norm(right)
    above = np.cross(towards, right)
    across, high = ((points - middle) @ axis for axis in (right, above))
    centre = [(values.min() + values.max()) / 2 for values in (across, high)]
    target = middle + centre[0] * right + centre[1] * above
    depth = (points - target) @ towards
    half_height = np.tan(FIELD_OF_VIEW / 2)
    away = np.maximum(np.abs(high - centre[1]), (np.abs(across - centre[0])) / ASPECT) + radius
    need = away / half_height
    distance = float((depth + MARGIN * need).max())
    return Eye(target + distance * towards, target, up)


def grid_spacing(robot: Robot) -> float:
    """A power of ten or half of one, m, about an eighth of the reach."""
    wanted = reach(robot) / 8
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(decade * (5.0 if wanted / decade >= 5 else 1.0))
