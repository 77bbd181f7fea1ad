"""Entities of a recording in space: base, marked places, arms, surroundings."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp.robot import Robot
from microbot_ocp.scene import with_arm_capsules
from microbot_ocp.views import _palette as palette, _solids as solids, _style as style
from microbot_ocp.views._eye import Eye, grid_spacing, upward
from microbot_ocp.views._scene import link_poses, reach, tool_places
from microbot_ocp.views.recording._animated_arm import AnimatedArm, Look
from microbot_ocp.views.recording._limits import LimitPlot
from microbot_ocp.views.recording._writer import (
    PROGRESS,
    TIME,
    WORLD,
    Times,
    Writer,
    along_z,
    plot_path,
    quaternions,
)

MASS_RADII = (style.BALL_RADIUS, 2.2)  # least and largest radius of a centre of mass, in link radii
LETTER_WIDTH = 0.026  # width of a letter, relative to the reach
CLEARANCE = LimitPlot(plot_path("clearance", "nearest"), "clearance [mm]")


def draw_base(
    writer: Writer,
    robot: Robot,
    places: FloatArray,
    names: Sequence[str],
    target: FloatArray | None = None,
) -> None:
    """Draw the base plate, a post from the base frame to the plate, and places [m,3] with names.

    The axes of the target [4,4] are drawn, too.
    """
    size, up, base = reach(robot), upward(robot), robot.base[:3, 3]
    axis = int(np.abs(up).argmax())
    view = f"RIGHT_HAND_{'XYZ'[axis]}_{'UP' if up[axis] > 0 else 'DOWN'}"
    writer.static(WORLD, getattr(rr.ViewCoordinates, view))
    edge = style.FRAME_LENGTH
    plate = rr.Boxes3D(
        half_sizes=[size * np.array([edge, edge, 2 * style.LINE_RADIUS])],
        centers=[base],
        quaternions=quaternions(robot.base[None, :3, :3]),
        colors=[palette.DULL],
        fill_mode="solid",
    )
    writer.static(f"{WORLD}/base", plate)
    if np.linalg.norm(base) > ROUNDING:
        post = rr.LineStrips3D(
            [[np.zeros(3), base]], radii=style.LINE_RADIUS * size, colors=[palette.DULL]
        )
        writer.static(f"{WORLD}/base/post", post)
    if target is not None:
        writer.frame(f"{WORLD}/target", target)
        writer.static(f"{WORLD}/target", rr.TransformAxes3D(2 * style.FRAME_LENGTH * size))
    if len(places):
        alike = np.linalg.norm(places[:, None] - places, axis=2) < ROUNDING
        labels = [", ".join(compress(names, row)) for row in alike]  # one label for all names
        look = {"radii": style.LINK_RADIUS * size, "colors": [palette.BRIGHT]}
        spheres = rr.Points3D(places, labels=labels, show_labels=True, **look)
        writer.static(f"{WORLD}/places", spheres)


def draw_surroundings(
    writer: Writer, robot: Robot, around: solids.DrawnSurroundings, arm: AnimatedArm
) -> None:
    """Draw obstacles, capsules of the arm, tubes and frames of the task, and carried parts."""
    for obstacle, solid in around.obstacles(robot):
        writer.solid(rr.new_entity_path([WORLD, "scene", obstacle.name]), solid)
    if around.scene is not None:
        for number, (frame, capsule) in enumerate(with_arm_capsules(robot).capsules, start=1):
            solid = solids.capsule_solid(capsule, palette.CAPSULE)
            writer.solid(arm.link(frame, f"capsule_{number}"), solid)
    task = f"{WORLD}/task"
    for number, tube in enumerate(around.tubes, start=1):
        strip = rr.LineStrips3D([tube.points], radii=tube.radius, colors=[palette.TUBE])
        writer.static(f"{task}/tube_{number}", strip)
    for number, pose in enumerate(around.stops, start=1):
        writer.frame(f"{task}/stop_{number}", pose)
        writer.static(f"{task}/stop_{number}", rr.TransformAxes3D(0.5 * grid_spacing(robot)))
    for number, (payload, poses) in enumerate(around.parts, start=1):
        path, turned = f"{task}/part_{number}", quaternions(poses[:, :3, :3])
        columns = rr.Transform3D.columns(translation=poses[:, :3, 3], quaternion=turned)
        writer.columns(path, arm.times, columns)
        for k, solid in enumerate(solids.part_solids(payload), start=1):
            writer.solid(f"{path}/solid_{k}", solid)
        if payload.mass:
            weight = {"radii": [0.0], "colors": [palette.PART], "labels": [f"{payload.mass:g} kg"]}
            writer.static(f"{path}/mass", rr.Points3D([payload.center_of_mass], **weight))


def draw_nearest(
    writer: Writer, robot: Robot, around: solids.DrawnSurroundings, arm: AnimatedArm, end: Times
) -> None:
    """Draw the line between the closest points with its length, and the length as a curve."""
    nearest = around.nearest(arm.times[TIME], arm.q)
    if around.scene is None or not nearest:
        return
    path, radius = f"{WORLD}/scene/nearest", style.LINE_RADIUS * reach(robot)
    ends = np.array([(near.on_arm, near.on_other) for near in nearest])
    millimetres = 1e3 * np.array([near.distance for near in nearest])
    labels = [f"{n.pair.label}: {d:.1f} mm" for n, d in zip(nearest, millimetres, strict=True)]
    writer.strips(path, radius, palette.NEAR)
    writer.columns(path, arm.times, rr.LineStrips3D.columns(strips=list(ends)))
    at_obstacle = f"{path}/distance"  # the label stands at the obstacle, apart from arm labels
    writer.static(at_obstacle, rr.Points3D.from_fields(colors=[palette.NEAR], radii=[radius]))
    points = rr.Points3D.columns(positions=ends[:, 1], labels=labels)
    writer.columns(at_obstacle, arm.times, points)
    arm.draw_curve(writer, CLEARANCE.path, millimetres)
    writer.level(f"{CLEARANCE.path}/limit_lower", 1e3 * around.scene.clearance, end)


def draw_arm(writer: Writer, robot: Robot, arm: AnimatedArm, end: Times) -> None:
    """Draw an arm along its motion; it stays in its last pose until ``end`` (last values [1])."""
    look, times, q = arm.look, arm.times, arm.q
    if any(float(end[key][0]) > value[-1] for key, value in times.items()):
        times = {key: np.append(value, end[key]) for key, value in times.items()}
        q = np.vstack([q, q[-1:]])
    poses = link_poses(robot, q)
    origins, rotations = poses[:, :, :3, 3], poses[:, :, :3, :3]
    geometry = solids.drawn_geometry(robot.shapes).solids if look.solid else ()
    for index, (frame, solid) in enumerate(geometry, start=1):
        writer.solid(arm.link(frame, f"geometry_{index}"), solid)
    if not geometry:
        start = np.broadcast_to(robot.base[:3, 3], origins[:, 0].shape)
        _draw_link(writer, arm.link(0, "shape"), look, times, start, origins[:, 1])
    axes = rr.TransformAxes3D(style.FRAME_LENGTH * reach(robot))
    radii = _mass_radii(robot)
    for k, kind in enumerate(robot.chain.joint_types, start=1):
        turned = quaternions(rotations[:, k])
        pose = rr.Transform3D.columns(translation=origins[:, k], quaternion=turned)
        writer.columns(arm.link(k), times, pose)
        writer.static(arm.link(k, "frame"), axes)
        if not geometry:
            step = np.einsum("nij,ni->nj", rotations[:, k], origins[:, k + 1] - origins[:, k])
            _draw_link(writer, arm.link(k, "shape"), look, times, np.zeros_like(step), step)
            writer.solid(arm.link(k, "joint"), solids.joint_solid(kind, look.radius, look.color))
        if radii.size:
            place, size = robot.links[k - 1].center_of_mass, radii[k - 1] * look.radius
            ball = rr.Points3D([place], radii=size, colors=[palette.MASS])
            writer.static(arm.link(k, "center_of_mass"), ball)
    # The tool entity only translates, because labels and arrows are its children; a child frame
    # rotates.
    tool = origins[:, -1]
    writer.columns(arm.tool(), times, rr.Transform3D.columns(translation=tool))
    turned = rr.Transform3D.columns(quaternion=quaternions(rotations[:, -1]))
    writer.columns(arm.tool("frame"), times, turned)
    writer.static(arm.tool("frame"), axes)
    ball = rr.Points3D([[0, 0, 0]], radii=style.BALL_RADIUS * look.radius, colors=[look.color])
    writer.static(arm.tool("ball"), ball)
    # The trail is one short strip per sample: the view shows the strips up to the time cursor.
    radius = style.LINE_RADIUS * reach(robot) * (1.0 if look.solid else 0.5)
    writer.strips(arm.path("trail"), radius, look.line_color)
    pieces = np.stack([tool[:-1], tool[1:]], axis=1).astype(np.float32)
    strips = rr.LineStrips3D.columns(strips=pieces)
    writer.columns(arm.path("trail"), {key: value[1:] for key, value in times.items()}, strips)


def _draw_link(
    writer: Writer, path: str, look: Look, times: Times, start: FloatArray, end: FloatArray
) -> None:
    """Draw a capsule between points [N,3] in the link frame."""
    vectors = end - start
    lengths = np.linalg.norm(vectors, axis=1)
    if lengths.max() < ROUNDING:
        return
    fixed = np.ptp(vectors, axis=0).max() < ROUNDING * max(1.0, lengths.max())
    shape = rr.Capsules3D.from_fields(
        lengths=lengths[:1] if fixed else None,
        quaternions=along_z(vectors[:1]) if fixed else None,
        translations=start[:1],
        radii=[look.radius],
        colors=[look.color],
        fill_mode="solid",
    )
    writer.static(path, shape)
    if not fixed:  # a prismatic joint changes its length
        stretched = rr.Capsules3D.columns(lengths=lengths, quaternions=along_z(vectors))
        writer.columns(path, times, stretched)


def _mass_radii(robot: Robot) -> FloatArray:
    """Return the radii [n] of the centres of mass, in link radii; empty without masses.

    The volume is proportional to the mass, down to a smallest radius.
    """
    masses = np.array([link.mass for link in robot.links])
    if not masses.size:
        return masses
    least, most = MASS_RADII
    return np.maximum(least, most * np.cbrt(masses / masses.max()))


def draw_labels(
    writer: Writer,
    robot: Robot,
    arms: Sequence[AnimatedArm],
    eye: Eye,
    places: FloatArray,
    names: Sequence[str],
) -> None:
    """Draw titles above the tools at heights at which no text hides another one seen from ``eye``.

    The names at ``places`` [m,3] count as texts. Arms that stop early are placed first, so that
    moving titles evade resting ones. Each timeline has its own heights, because the arms meet at
    other samples.
    """
    size, up, (right, above, _) = reach(robot), eye.up, eye.axes
    step = style.LABEL_HEIGHT * size
    titled = [arm for arm in arms if arm.title]
    for arm in titled:
        look = {"radii": [0.0], "colors": [arm.look.line_color]}
        label = rr.Points3D.from_fields(labels=[arm.title], show_labels=True, **look)
        writer.static(arm.tool("label"), label)
    for timeline in (TIME, PROGRESS):
        taken = [
            (np.zeros(1), place[None] @ right, place[None] @ above - step / 2, len(name))
            for place, name in zip(places, names, strict=True)
        ]
        for arm in sorted(titled, key=lambda arm: (arm.times[timeline][-1], not arm.look.solid)):
            t, tool = arm.times[timeline], tool_places(robot, arm.q)
            across, lowest = tool @ right, tool @ above + step
            high = lowest
            # Repeat the list: moving above one text may cause a clash with an earlier one.
            for other_t, other_across, other_high, letters in taken * len(taken):
                at = np.maximum(np.searchsorted(other_t, t, side="right") - 1, 0)
                width = LETTER_WIDTH * size * (len(arm.title) + letters) / 2
                clash = np.abs(across - other_across[at]) < width
                clash &= np.abs(high - other_high[at]) < (1.0 - ROUNDING) * step
                high = np.where(clash, other_high[at] + step, high)
            taken.append((t, across, high, len(arm.title)))
            height = step + (high - lowest) / (above @ up)
            columns = rr.Points3D.columns(positions=height[:, None] * up)
            writer.columns(arm.tool("label"), {timeline: t}, columns)
