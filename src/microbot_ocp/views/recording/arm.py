"""One arm in space: links, joints, tool, label and trail."""

from __future__ import annotations

import numpy as np
import rerun as rr

from microbot_ocp.checks import FloatArray
from microbot_ocp.robot import Robot
from microbot_ocp.views import scene
from microbot_ocp.views.recording import entities
from microbot_ocp.views.recording.actors import Actor, Look
from microbot_ocp.views.recording.rotations import along_z, quaternions
from microbot_ocp.views.recording.writer import Times, Writer


def draw(writer: Writer, robot: Robot, actor: Actor, end: Times) -> None:
    """Draw an arm along its motion; until ``end`` (last values [1]) it stays in its last pose."""
    look = actor.look
    times, q = held(actor.times, actor.q, end)
    origins = scene.link_origins(robot, q)
    _link(writer, entities.link(actor.name, 0), look, times, origins[:, 1] - origins[:, 0])
    for frame in range(1, robot.joint_count + 1):
        path = entities.link(actor.name, frame)
        rotations = scene.link_rotations(robot, q, frame)
        pose = rr.Transform3D.columns(
            translation=origins[:, frame], quaternion=quaternions(rotations)
        )
        writer.columns(path, times, pose)
        step = origins[:, frame + 1] - origins[:, frame]
        _link(writer, path, look, times, np.einsum("nij,ni->nj", rotations, step))
        joint = rr.Points3D([[0, 0, 0]], radii=1.4 * look.radius, colors=[look.color])
        writer.static(f"{path}/joint", joint)
    tool = origins[:, -1]
    writer.columns(entities.tool(actor.name), times, rr.Transform3D.columns(translation=tool))
    _tool(writer, actor)
    _trail(writer, actor, times, tool)


def held(times: Times, values: FloatArray, end: Times) -> tuple[Times, FloatArray]:
    """Times and values [N,...] with the last value once more at ``end``, if that comes later."""
    if all(float(end[key][0]) <= value[-1] for key, value in times.items()):
        return times, values
    longer = {key: np.append(value, end[key]) for key, value in times.items()}
    return longer, np.concatenate([values, values[-1:]])


def _link(writer: Writer, path: str, look: Look, times: Times, vectors: FloatArray) -> None:
    """Capsule from the frame's origin along ``vectors`` [N,3] in that frame, to the next origin."""
    lengths = np.linalg.norm(vectors, axis=1)
    if lengths.max() < 1e-6:
        return
    fixed = np.ptp(vectors, axis=0).max() < 1e-9 * max(1.0, lengths.max())
    shape = rr.Capsules3D.from_fields(
        lengths=lengths[:1] if fixed else None,
        quaternions=along_z(vectors[:1]) if fixed else None,
        radii=[look.radius],
        colors=[look.color],
        fill_mode="solid",
    )
    writer.static(path, shape)
    if not fixed:  # a prismatic joint stretches it
        stretched = rr.Capsules3D.columns(lengths=lengths, quaternions=along_z(vectors))
        writer.columns(path, times, stretched)


def _tool(writer: Writer, actor: Actor) -> None:
    look = actor.look
    ball = rr.Points3D([[0, 0, 0]], radii=1.4 * look.radius, colors=[look.color])
    writer.static(entities.tool(actor.name, "ball"), ball)
    # all arms meet at their ends, so every label hangs at its own height
    label = rr.Points3D(
        [[0, 0, look.label_height]],
        radii=1e-3 * look.radius,
        colors=[look.line_color],
        labels=[actor.title],
        show_labels=True,
    )
    writer.static(entities.tool(actor.name, "label"), label)


def _trail(writer: Writer, actor: Actor, times: Times, tool: FloatArray) -> None:
    """A short strip a frame; the view shows those up to its time cursor."""
    look = actor.look
    radius = (0.2 if look.solid else 0.15) * look.radius
    path = entities.trail(actor.name)
    writer.static(path, rr.LineStrips3D.from_fields(radii=[radius], colors=[look.line_color]))
    strips = np.stack([tool[:-1], tool[1:]], axis=1).astype(np.float32)
    later = {key: value[1:] for key, value in times.items()}
    writer.columns(path, later, rr.LineStrips3D.columns(strips=strips))
