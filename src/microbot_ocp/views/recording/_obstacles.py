"""What stands around an arm, its capsules, and where it is nearest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import Capsule, Robot
from microbot_ocp.scene import (
    Box,
    ConvexMesh,
    Cylinder,
    HalfSpace,
    Nearest,
    Scene,
    Sphere,
    contact_model,
    has_coal,
    with_arm_capsules,
)
from microbot_ocp.views._scene import reach
from microbot_ocp.views.recording._animated_arm import AnimatedArm
from microbot_ocp.views.recording._curves import draw_curve, draw_dashed
from microbot_ocp.views.recording._limits import LimitPlot
from microbot_ocp.views.recording._writer import TIME, WORLD, Times, Writer, link_path, plot_path

OBSTACLE_COLOR = (205, 160, 105, 255)
CAPSULE_COLOR = (150, 190, 230, 60)
NEAREST_COLOR = (255, 220, 90, 255)
PLANE = 1.6  # reaches from the middle to the edge of what is drawn of a half space
RADIUS = 0.004  # of the line between nearest points, in reaches
CLEARANCE = LimitPlot("clearance", "nearest", "clearance [mm]")


def draw_scene(
    writer: Writer,
    robot: Robot,
    scene: Scene,
    arm: AnimatedArm,
    end: Times,
    around: Sequence[tuple[float, float, Robot, Scene]],
) -> None:
    """Obstacles, the capsules of the arm, the line between the nearest points with its length, and
    that length as a curve with what the scene asks for.

    ``around`` are start and end of stretches, s, the arm with what it carries there, and what is
    around it. Without coal there are no nearest points.
    """
    size = reach(robot)
    for obstacle in scene.obstacles:
        path = rr.new_entity_path([WORLD, "scene", obstacle.name])
        pose, drawn = _drawn(obstacle, size)
        writer.static(path, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        writer.static(path, drawn)
    padded = with_arm_capsules(robot)
    for number, (frame, capsule) in enumerate(padded.capsules, start=1):
        pose, drawn = drawn_capsule(capsule, CAPSULE_COLOR)
        path = link_path(arm.name, frame, f"capsule_{number}")
        writer.static(path, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        writer.static(path, drawn)
    if has_coal() and arm.moves:
        _draw_nearest(writer, around, arm, RADIUS * size)
        whole = {key: (0.0, float(value[0])) for key, value in end.items()}
        bound = f"{plot_path(CLEARANCE.key, CLEARANCE.label)}/limit_lower"
        draw_dashed(writer, bound, [(whole, 1e3 * scene.clearance)])


def _draw_nearest(
    writer: Writer,
    around: Sequence[tuple[float, float, Robot, Scene]],
    arm: AnimatedArm,
    radius: float,
) -> None:
    found = nearest_along(around, arm)
    ends = np.array([(near.on_arm, near.on_other) for near in found])
    words = [f"{near.pair.label}: {1e3 * near.distance:.1f} mm" for near in found]
    path = f"{WORLD}/scene/nearest"
    writer.static(path, rr.LineStrips3D.from_fields(colors=[NEAREST_COLOR], radii=[radius]))
    writer.columns(path, arm.times, rr.LineStrips3D.columns(strips=list(ends)))
    middle = f"{path}/distance"  # at the obstacle, where no label of the arm stands
    writer.static(middle, rr.Points3D.from_fields(colors=[NEAREST_COLOR], radii=[radius]))
    points = rr.Points3D.columns(positions=ends[:, 1], labels=words)
    writer.columns(middle, arm.times, points)
    curve = f"{plot_path(CLEARANCE.key, CLEARANCE.label)}/{arm.name}"
    draw_curve(writer, arm, curve, arm.times, 1e3 * np.array([near.distance for near in found]))


def nearest_along(
    around: Sequence[tuple[float, float, Robot, Scene]], arm: AnimatedArm
) -> list[Nearest]:
    """Where an arm is nearest to what is around it, at every sample."""
    models = [contact_model(robot, scene.without_parts_of(robot)) for _, _, robot, scene in around]
    ends_of = [end for _, end, _, _ in around][:-1]
    places = np.searchsorted(ends_of, arm.times[TIME], side="right")
    return [models[k].nearest(q) for k, q in zip(places, arm.q, strict=True)]


def _drawn(obstacle: Any, size: float) -> tuple[FloatArray, Any]:
    """Frame [4,4] of an obstacle, and what is drawn in it."""
    style: dict[str, Any] = {"colors": [OBSTACLE_COLOR], "fill_mode": "solid"}
    pose = np.eye(4)
    if isinstance(obstacle, Capsule):
        return drawn_capsule(obstacle, OBSTACLE_COLOR)
    if isinstance(obstacle, Sphere):
        pose[:3, 3] = obstacle.center
        return pose, rr.Ellipsoids3D(radii=[obstacle.radius], **style)
    if isinstance(obstacle, HalfSpace):
        thick = 0.01 * size
        pose = _along(obstacle.normal)
        pose[:3, 3] = (obstacle.offset - thick) * obstacle.normal
        half = [PLANE * size, PLANE * size, thick]
        style["colors"] = [(*OBSTACLE_COLOR[:3], 90)]
        return pose, rr.Boxes3D(half_sizes=[half], **style)
    if isinstance(obstacle, Box):
        return obstacle.pose, rr.Boxes3D(half_sizes=[obstacle.size / 2], **style)
    if isinstance(obstacle, Cylinder):
        drawn = rr.Cylinders3D(radii=[obstacle.radius], lengths=[obstacle.length], **style)
        return obstacle.pose, drawn
    assert isinstance(obstacle, ConvexMesh)
    return obstacle.pose, rr.Mesh3D(
        vertex_positions=obstacle.vertices.astype(np.float32),
        triangle_indices=obstacle.triangles,
        albedo_factor=OBSTACLE_COLOR,
    )


def drawn_capsule(capsule: Capsule, color: tuple[int, ...]) -> tuple[FloatArray, Any]:
    """Frame [4,4] of a capsule in the frame that it is given in, and what is drawn in it."""
    along = capsule.end - capsule.start
    length = float(np.linalg.norm(along))
    pose = _along(along / length if length else np.array([0.0, 0.0, 1.0]))
    pose[:3, 3] = capsule.start
    return pose, rr.Capsules3D(
        radii=[capsule.radius], lengths=[length], colors=[color], fill_mode="solid"
    )


def _along(direction: FloatArray) -> FloatArray:
    """A frame [4,4] at the origin whose Z axis is a unit vector."""
    side = np.cross(np.eye(3)[np.argmin(np.abs(direction))], direction)
    side /= np.linalg.norm(side)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([side, np.cross(direction, side), direction])
    return pose
