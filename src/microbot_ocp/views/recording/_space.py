"""What stands in space around the arms: base, marked places, obstacles, tool lines and parts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import Robot
from microbot_ocp.scene import with_arm_capsules
from microbot_ocp.views._eye import grid_spacing, upward
from microbot_ocp.views._scene import reach
from microbot_ocp.views._solids import capsule_solid, part_solids
from microbot_ocp.views._style import STYLE
from microbot_ocp.views._surroundings import DrawnSurroundings
from microbot_ocp.views.recording._animated_arm import AnimatedArm
from microbot_ocp.views.recording._limits import LimitPlot
from microbot_ocp.views.recording._writer import TIME, WORLD, Times, Writer, quaternions

CLEARANCE = LimitPlot("clearance", "nearest", "clearance [mm]")


def draw_base(
    writer: Writer,
    robot: Robot,
    places: FloatArray,
    names: Sequence[str],
    target: FloatArray | None = None,
) -> None:
    """Draw the base plate, a post from the base frame to it, and places [m,3] with names.

    Of the target [4,4] the axes are drawn.
    """
    size, up = reach(robot), upward(robot)
    axis = int(np.abs(up).argmax())
    view = f"RIGHT_HAND_{'XYZ'[axis]}_{'UP' if up[axis] > 0 else 'DOWN'}"
    writer.static(WORLD, getattr(rr.ViewCoordinates, view))
    base = robot.base[:3, 3]
    plate = rr.Boxes3D(
        half_sizes=[[STYLE.plate * size, STYLE.plate * size, 0.008 * size]],
        centers=[base],
        quaternions=quaternions(robot.base[None, :3, :3]),
        colors=[STYLE.dull],
        fill_mode="solid",
    )
    writer.static(f"{WORLD}/base", plate)
    if np.linalg.norm(base) > 1e-9:
        post = rr.LineStrips3D([[np.zeros(3), base]], radii=0.006 * size, colors=[STYLE.dull])
        writer.static(f"{WORLD}/base/post", post)
    if target is not None:
        writer.frame(f"{WORLD}/target", target)
        writer.static(f"{WORLD}/target", rr.TransformAxes3D(0.12 * size))
    if len(places):
        labels = [_label(place, places, names) for place in places]
        spheres = rr.Points3D(
            places, radii=0.022 * size, colors=[STYLE.bright], labels=labels, show_labels=True
        )
        writer.static(f"{WORLD}/places", spheres)


def _label(place: FloatArray, places: FloatArray, names: Sequence[str]) -> str:
    """Join the names of all that are at one place."""
    here = np.linalg.norm(places - place, axis=1) < 1e-6
    return ", ".join(name for name, same in zip(names, here, strict=True) if same)


def draw_surroundings(
    writer: Writer, robot: Robot, around: DrawnSurroundings, arm: AnimatedArm
) -> None:
    """Draw obstacles and capsules of the arm, tubes and frames of its task, and its parts."""
    for name, solid in around.obstacles(robot):
        writer.solid(rr.new_entity_path([WORLD, "scene", name]), solid)
    if around.scene is not None:
        for number, (frame, capsule) in enumerate(with_arm_capsules(robot).capsules, start=1):
            solid = capsule_solid(capsule, STYLE.capsule)
            writer.solid(arm.link(frame, f"capsule_{number}"), solid)
    task = f"{WORLD}/task"
    for number, tube in enumerate(around.tubes, start=1):
        strip = rr.LineStrips3D([tube.points], radii=tube.radius, colors=[STYLE.tube])
        writer.static(f"{task}/tube_{number}", strip)
    for number, pose in enumerate(around.stops, start=1):
        writer.frame(f"{task}/stop_{number}", pose)
        axes = rr.TransformAxes3D(0.5 * grid_spacing(robot))
        writer.static(f"{task}/stop_{number}", axes)
    for number, (payload, poses) in enumerate(around.parts, start=1):
        path, turned = f"{task}/part_{number}", quaternions(poses[:, :3, :3])
        columns = rr.Transform3D.columns(translation=poses[:, :3, 3], quaternion=turned)
        writer.columns(path, arm.times, columns)
        for k, solid in enumerate(part_solids(payload), start=1):
            writer.solid(f"{path}/solid_{k}", solid)
        if payload.mass:
            weight = {"radii": [0.0], "colors": [STYLE.part], "labels": [f"{payload.mass:g} kg"]}
            writer.static(f"{path}/mass", rr.Points3D([payload.center_of_mass], **weight))


def draw_nearest(
    writer: Writer, robot: Robot, around: DrawnSurroundings, arm: AnimatedArm, end: Times
) -> None:
    """Draw the line between the nearest points with its length, which is a curve, too."""
    nearest = around.nearest(arm.times[TIME], arm.q)
    if around.scene is None or not nearest:
        return
    path, radius = f"{WORLD}/scene/nearest", 0.004 * reach(robot)
    ends = np.array([(near.on_arm, near.on_other) for near in nearest])
    millimetres = 1e3 * np.array([near.distance for near in nearest])
    labels = [f"{n.pair.label}: {d:.1f} mm" for n, d in zip(nearest, millimetres, strict=True)]
    writer.strips(path, radius, STYLE.near)
    writer.columns(path, arm.times, rr.LineStrips3D.columns(strips=list(ends)))
    at_obstacle = f"{path}/distance"  # where no label of the arm stands
    writer.static(at_obstacle, rr.Points3D.from_fields(colors=[STYLE.near], radii=[radius]))
    points = rr.Points3D.columns(positions=ends[:, 1], labels=labels)
    writer.columns(at_obstacle, arm.times, points)
    arm.draw_curve(writer, CLEARANCE.path, millimetres)
    writer.level(f"{CLEARANCE.path}/limit_lower", 1e3 * around.scene.clearance, end)
