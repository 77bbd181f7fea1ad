"""One arm in space: links, joints, centres of mass, frames, tool, label and trail."""

from __future__ import annotations

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import Robot
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.recording import _paths as entities
from microbot_ocp.views.recording._animated_arm import Actor, Look
from microbot_ocp.views.recording._camera import upward
from microbot_ocp.views.recording._palette import MASS_COLOR
from microbot_ocp.views.recording._rotations import along_z, quaternions
from microbot_ocp.views.recording._writer import Times, Writer

NOWHERE = 1e-6  # m, below which a link has no length
JOINT = (1.5, 3.6)  # radius and length of a joint in link radii
MASS = (1.3, 2.2)  # radius of the smallest and the largest mass in link radii
FRAME = 0.07  # length of a frame's axes as a share of the reach


def draw(writer: Writer, robot: Robot, actor: Actor, end: Times) -> None:
    """Draw an arm along its motion; until ``end`` (last values [1]) it stays in its last pose."""
    look = actor.look
    times, q = held(actor.times, actor.q, end)
    poses = scene.link_poses(robot, q)
    origins = poses[:, :, :3, 3]
    start = np.broadcast_to(robot.base[:3, 3], origins[:, 0].shape)
    _link(writer, entities.link(actor.name, 0, "shape"), look, times, start, origins[:, 1])
    count = robot.joint_count
    for frame in range(1, count + 2):
        path = entities.link(actor.name, frame) if frame <= count else entities.tool(actor.name)
        rotations = poses[:, frame, :3, :3]
        turned = quaternions(rotations)
        if frame > count:  # the tool itself does not turn: labels and arrows hang on it
            writer.columns(path, times, rr.Transform3D.columns(translation=origins[:, frame]))
            turn = rr.Transform3D.columns(quaternion=turned)
            writer.columns(f"{path}/frame", times, turn)
        else:
            pose = rr.Transform3D.columns(translation=origins[:, frame], quaternion=turned)
            writer.columns(path, times, pose)
            step = np.einsum("nij,ni->nj", rotations, origins[:, frame + 1] - origins[:, frame])
            _link(writer, f"{path}/shape", look, times, np.zeros_like(step), step)
            _joint(writer, f"{path}/joint", look, robot.joint_types[frame - 1])
        axes = rr.TransformAxes3D(FRAME * scene.reach(robot))
        writer.static(f"{path}/frame", axes)
    _masses(writer, robot, actor)
    _tool(writer, robot, actor)
    _trail(writer, actor, times, origins[:, -1])


def held(times: Times, values: FloatArray, end: Times) -> tuple[Times, FloatArray]:
    """Times and values [N,...] with the last value once more at ``end``, if that comes later."""
    if all(float(end[key][0]) <= value[-1] for key, value in times.items()):
        return times, values
    longer = {key: np.append(value, end[key]) for key, value in times.items()}
    return longer, np.concatenate([values, values[-1:]])


def _link(
    writer: Writer, path: str, look: Look, times: Times, start: FloatArray, end: FloatArray
) -> None:
    """Capsule between points [N,3] in the link frame."""
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


def _joint(writer: Writer, path: str, look: Look, kind: str) -> None:
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


def _masses(writer: Writer, robot: Robot, actor: Actor) -> None:
    """A ball at every centre of mass, its volume in proportion to the mass."""
    for frame, radius in enumerate(mass_radii(robot), start=1):
        ball = rr.Points3D(
            [robot.links[frame - 1].center_of_mass],
            radii=radius * actor.look.radius,
            colors=[MASS_COLOR],
        )
        writer.static(entities.link(actor.name, frame, "center_of_mass"), ball)


def mass_radii(robot: Robot) -> FloatArray:
    """Radii [n] of the balls in link radii: their volumes are as the masses, down to a least one.

    Empty for a robot without masses.
    """
    masses = np.array([link.mass for link in robot.links])
    if not masses.size:
        return masses
    least, most = MASS
    return np.maximum(least, most * np.cbrt(masses / masses.max()))


def _tool(writer: Writer, robot: Robot, actor: Actor) -> None:
    look = actor.look
    ball = rr.Points3D([[0, 0, 0]], radii=1.4 * look.radius, colors=[look.color])
    writer.static(entities.tool(actor.name, "ball"), ball)
    if not actor.title:
        return
    # all arms meet at their ends, so every label hangs at its own height
    label = rr.Points3D(
        [look.label_height * upward(robot)],
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
