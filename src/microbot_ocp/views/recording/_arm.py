"""One arm in space: links, joints, centres of mass, frames, tool, label and trail."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.robot import Mesh, Robot, Shape, read_mesh
from microbot_ocp.views._scene import link_origins, link_poses, reach
from microbot_ocp.views.recording._animated_arm import MASS_COLOR, AnimatedArm, Color, Look
from microbot_ocp.views.recording._surroundings import Eye, upward
from microbot_ocp.views.recording._writer import (
    PROGRESS,
    TIME,
    Times,
    Writer,
    along_z,
    arm_path,
    link_path,
    quaternions,
    tool_path,
)

NOWHERE = 1e-6  # m, below which a link has no length
JOINT = (1.5, 3.6)  # radius and length of a joint in link radii
MASS = (1.3, 2.2)  # radius of the smallest and the largest mass in link radii
OWN_COLOR: Color = (190, 195, 205, 255)  # of geometry that has none
FRAME = 0.07  # length of a frame's axes as a share of the reach
# Texts, as shares of the reach: over the tool, one over the other, below a place; a letter's width.
LABEL_GAP, LABEL_STEP, PLACE_GAP, LABEL_LETTER = 0.075, 0.072, 0.04, 0.026


def draw_arm(writer: Writer, robot: Robot, arm: AnimatedArm, end: Times) -> None:
    """Draw an arm along its motion; until ``end`` (last values [1]) it stays in its last pose."""
    look, name, count = arm.look, arm.name, robot.joint_count
    times, q = _held(arm.times, arm.q, end)
    poses = link_poses(robot, q)
    origins, rotations = poses[:, :, :3, 3], poses[:, :, :3, :3]
    start = np.broadcast_to(robot.base[:3, 3], origins[:, 0].shape)
    bare = not look.solid or not drawn_geometry(robot.shapes).shapes
    if bare:
        _draw_link(writer, link_path(name, 0, "shape"), look, times, start, origins[:, 1])
    else:
        _draw_geometry(writer, robot, name)
    axes = rr.TransformAxes3D(FRAME * reach(robot))
    for k in range(1, count + 1):
        path = link_path(name, k)
        pose = rr.Transform3D.columns(
            translation=origins[:, k], quaternion=quaternions(rotations[:, k])
        )
        writer.columns(path, times, pose)
        step = np.einsum("nij,ni->nj", rotations[:, k], origins[:, k + 1] - origins[:, k])
        if bare:
            _draw_link(writer, f"{path}/shape", look, times, np.zeros_like(step), step)
            _draw_joint(writer, f"{path}/joint", look, robot.joint_types[k - 1])
        writer.static(f"{path}/frame", axes)
    for k, radius in enumerate(_mass_radii(robot), start=1):
        place, size = robot.links[k - 1].center_of_mass, radius * look.radius
        ball = rr.Points3D([place], radii=size, colors=[MASS_COLOR])
        writer.static(link_path(name, k, "center_of_mass"), ball)
    # labels and arrows hang on the tool, so it does not turn; its frame does
    tool = origins[:, -1]
    writer.columns(tool_path(name), times, rr.Transform3D.columns(translation=tool))
    turned = rr.Transform3D.columns(quaternion=quaternions(rotations[:, -1]))
    writer.columns(tool_path(name, "frame"), times, turned)
    writer.static(tool_path(name, "frame"), axes)
    ball = rr.Points3D([[0, 0, 0]], radii=1.4 * look.radius, colors=[look.color])
    writer.static(tool_path(name, "ball"), ball)
    _draw_trail(writer, arm, times, tool)


class Geometry(NamedTuple):
    """What is drawn of a robot's own geometry, and why something is not."""

    shapes: tuple[tuple[Shape, Mesh | None], ...]
    missing: tuple[str, ...]


@lru_cache(maxsize=8)
def drawn_geometry(shapes: tuple[Shape, ...]) -> Geometry:
    """Visual shapes, collision shapes of links without any; none if one is not read."""
    seen = {shape.link for shape in shapes if shape.role == "visual"}
    wanted = [s for s in shapes if s.role == "visual" or s.link not in seen]
    try:
        found = tuple((s, read_mesh(s) if s.kind == "mesh" else None) for s in wanted)
    except InputError as problem:
        return Geometry((), (f"Links are drawn as capsules: {problem}.",))
    return Geometry(found, ())


def _draw_geometry(writer: Writer, robot: Robot, name: str) -> None:
    """The robot's own geometry, each shape rigid in its link."""
    for index, (shape, mesh) in enumerate(drawn_geometry(robot.shapes).shapes, start=1):
        path = f"{link_path(name, shape.frame)}/geometry_{index}"
        pose = shape.pose
        color = OWN_COLOR if shape.color is None else tuple(round(255 * c) for c in shape.color)
        style: dict[str, Any] = {"colors": [color], "fill_mode": "solid"}
        if mesh is not None:
            own = None if shape.color is not None else mesh.colors
            drawn: Any = rr.Mesh3D(
                vertex_positions=mesh.vertices.astype(np.float32),
                triangle_indices=mesh.triangles,
                vertex_normals=_normals(mesh).astype(np.float32),
                vertex_colors=own,
                albedo_factor=None if own is not None else color,
            )
        elif shape.kind == "box":
            drawn = rr.Boxes3D(half_sizes=[shape.size / 2], **style)
        elif shape.kind == "sphere":
            drawn = rr.Ellipsoids3D(radii=[shape.size[0]], **style)
        elif shape.kind == "cylinder":
            drawn = rr.Cylinders3D(radii=[shape.size[0]], lengths=[shape.size[1]], **style)
        else:
            below = np.eye(4)  # Rerun's capsules begin at their origin
            below[2, 3] = -shape.size[1] / 2
            pose = pose @ below
            drawn = rr.Capsules3D(radii=[shape.size[0]], lengths=[shape.size[1]], **style)
        writer.static(path, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        writer.static(path, drawn)


def _normals(mesh: Mesh) -> FloatArray:
    """Unit normals [N,3] of the vertices: without them the viewer does not shade."""
    corners = mesh.vertices[mesh.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(mesh.vertices)
    for corner in range(3):
        np.add.at(normals, mesh.triangles[:, corner], across)
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, size, out=np.zeros_like(normals), where=size > 0)


def _held(times: Times, values: FloatArray, end: Times) -> tuple[Times, FloatArray]:
    """Times and values [N,...] with the last value once more at ``end``, if that comes later."""
    if all(float(end[key][0]) <= value[-1] for key, value in times.items()):
        return times, values
    longer = {key: np.append(value, end[key]) for key, value in times.items()}
    return longer, np.concatenate([values, values[-1:]])


def _draw_link(
    writer: Writer, path: str, look: Look, times: Times, start: FloatArray, end: FloatArray
) -> None:
    """A capsule between points [N,3] in the link frame."""
    vectors = end - start
    lengths = np.linalg.norm(vectors, axis=1)
    if lengths.max() < NOWHERE:
        return
    fixed = np.ptp(vectors, axis=0).max() < 1e-9 * max(1.0, lengths.max())
    shape = rr.Capsules3D.from_fields(
        lengths=lengths[:1] if fixed else None,
        quaternions=along_z(vectors[:1]) if fixed else None,
        translations=start[:1],
        radii=[look.radius],
        colors=[look.color],
        fill_mode="solid",
    )
    writer.static(path, shape)
    if not fixed:  # a prismatic joint stretches it
        stretched = rr.Capsules3D.columns(lengths=lengths, quaternions=along_z(vectors))
        writer.columns(path, times, stretched)


def _draw_joint(writer: Writer, path: str, look: Look, kind: str) -> None:
    """A drum about the axis of a revolute joint, a box along that of a prismatic one."""
    radius, length = (factor * look.radius for factor in JOINT)
    if kind == "revolute":
        shape = rr.Cylinders3D(
            lengths=[length], radii=[radius], colors=[look.color], fill_mode="solid"
        )
    else:
        half = [[radius, radius, length / 2]]
        shape = rr.Boxes3D(half_sizes=half, colors=[look.color], fill_mode="solid")
    writer.static(path, shape)


def _mass_radii(robot: Robot) -> FloatArray:
    """Radii [n] of the balls in link radii: their volumes are as the masses, down to a least one.

    Empty for a robot without masses.
    """
    masses = np.array([link.mass for link in robot.links])
    if not masses.size:
        return masses
    least, most = MASS
    return np.maximum(least, most * np.cbrt(masses / masses.max()))


def draw_labels(
    writer: Writer,
    robot: Robot,
    arms: Sequence[AnimatedArm],
    eye: Eye,
    places: FloatArray,
    names: Sequence[str],
) -> None:
    """Titles over the tools at such heights that from ``eye`` no text hides another one.

    ``places`` [m,3] have texts already, their names. Arms that stop early come first: the later
    ones evade those that stand still. The timelines differ in who is where at the same moment.
    """
    size, up, towards = reach(robot), upward(robot), eye.position - eye.target
    right = np.cross(up, towards) / np.linalg.norm(np.cross(up, towards))
    above = np.cross(towards, right) / np.linalg.norm(towards)
    titled = [arm for arm in arms if arm.title]
    for arm in titled:
        label = rr.Points3D.from_fields(
            radii=[1e-3 * arm.look.radius],
            colors=[arm.look.line_color],
            labels=[arm.title],
            show_labels=True,
        )
        writer.static(tool_path(arm.name, "label"), label)
    for timeline in (TIME, PROGRESS):
        taken = [
            (np.zeros(1), place[None] @ right, place[None] @ above - PLACE_GAP * size, len(name))
            for place, name in zip(places, names, strict=True)
        ]
        for arm in sorted(titled, key=lambda arm: (arm.times[timeline][-1], not arm.look.solid)):
            t, tool = arm.times[timeline], link_origins(robot, arm.q)[:, -1]
            across, lowest = tool @ right, tool @ above + LABEL_GAP * size
            high = lowest
            for other_t, other_across, other_high, letters in taken * len(taken):
                at = np.maximum(np.searchsorted(other_t, t, side="right") - 1, 0)
                width = LABEL_LETTER * size * (len(arm.title) + letters) / 2
                clash = np.abs(across - other_across[at]) < width
                clash &= np.abs(high - other_high[at]) < 0.999 * LABEL_STEP * size
                high = np.where(clash, other_high[at] + LABEL_STEP * size, high)
            taken.append((t, across, high, len(arm.title)))
            height = LABEL_GAP * size + (high - lowest) / (above @ up)
            columns = rr.Points3D.columns(positions=height[:, None] * up)
            writer.columns(tool_path(arm.name, "label"), {timeline: t}, columns)


def _draw_trail(writer: Writer, arm: AnimatedArm, times: Times, tool: FloatArray) -> None:
    """A short strip a frame; the view shows those up to its time cursor."""
    look, path = arm.look, arm_path(arm.name, "trail")
    radius = (0.2 if look.solid else 0.15) * look.radius
    writer.static(path, rr.LineStrips3D.from_fields(radii=[radius], colors=[look.line_color]))
    strips = np.stack([tool[:-1], tool[1:]], axis=1).astype(np.float32)
    later = {key: value[1:] for key, value in times.items()}
    writer.columns(path, later, rr.LineStrips3D.columns(strips=strips))
