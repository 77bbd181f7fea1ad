"""What acts on an arm: torque at every joint, velocity of the tool, force in the wrist."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.fast_calls import buffered_call
from microbot_ocp.motion import State
from microbot_ocp.robot import JointLimits, Robot, forward_kinematics, jacobian
from microbot_ocp.views._scene import reach
from microbot_ocp.views.recording._animated_arm import (
    FORCE_COLOR,
    NEAR_COLOR,
    NEUTRAL_COLOR,
    SATURATED_COLOR,
    VELOCITY_COLOR,
    AnimatedArm,
    Color,
)
from microbot_ocp.views.recording._limits import signed_share
from microbot_ocp.views.recording._writer import Writer, link_path, tool_path

POINTS = 25  # of an arc
RING = 3.4  # radius of the arc in link radii
SLIDE = 10.0  # length of the arrow at the limit in link radii
BARB = 0.28  # length of the arrow head in arc radii
LONGEST = 0.3  # share of the reach that the largest arrow of a recording is long


def draw_torques(writer: Writer, robot: Robot, limits: JointLimits, arm: AnimatedArm) -> None:
    """In every link frame an arc around the axis, closed at the limit, or an arrow along a slide.

    A thin circle or line shows the limit.
    """
    size = arm.look.radius
    circle = arcs(np.array([1.0]), RING * size)[0, :POINTS]
    whole = np.array([0.0, 0.0, SLIDE * size])
    beside = np.array([RING * size, 0.0, 0.0])  # a slide's link lies along its axis
    for joint, kind in enumerate(robot.joint_types):
        path = link_path(arm.name, joint + 1, "torque")
        share, at_limit = signed_share(limits, "tau", arm.curves["tau"][:, joint], joint)
        colors = _share_colors(share, at_limit)
        if kind == "revolute":
            limit = [circle]
            columns = rr.LineStrips3D.columns(
                strips=arcs(share, RING * size).astype(np.float32),
                radii=np.where(at_limit, 0.5, 0.3) * size,
                colors=colors,
            )
        else:
            limit = [[beside - whole, beside + whole]]
            columns = rr.Arrows3D.columns(
                vectors=np.clip(share, -1.0, 1.0)[:, None] * whole,
                origins=np.tile(beside, (len(share), 1)),
                radii=np.where(at_limit, 0.8, 0.5) * size,
                colors=colors,
            )
        thin = rr.LineStrips3D(limit, radii=[0.06 * size], colors=[NEUTRAL_COLOR])
        writer.static(f"{path}/limit", thin)
        writer.columns(path, arm.times, columns)


def arcs(share: FloatArray, radius: float) -> FloatArray:
    """Polylines [N,POINTS+3,3] around the z axis, a full turn at a share of 1, with a head."""
    sweep = 2 * np.pi * np.clip(share, -1.0, 1.0)[:, None]
    angle = sweep * np.linspace(0.0, 1.0, POINTS)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    tip = ring[:, -1]
    last = angle[:, -1:]
    along = np.sign(sweep) * np.hstack([-np.sin(last), np.cos(last), np.zeros_like(last)])
    size = BARB * np.minimum(1.0, np.abs(sweep) / 0.5)  # a short arc has a small head
    barbs = [tip - size * along + side * 0.6 * size * tip for side in (1.0, -1.0)]
    head = np.stack([barbs[0], tip, barbs[1]], axis=1)
    return radius * np.concatenate([ring, head], axis=1)


def _share_colors(share: FloatArray, at_limit: np.ndarray) -> np.ndarray:
    """Colours [N,4] of shares [N] of a limit, and of the samples [N] at it."""
    part = np.clip(np.abs(share), 0.0, 1.0)[:, None]
    low, high = np.array(NEUTRAL_COLOR, dtype=float), np.array(NEAR_COLOR, dtype=float)
    colors = np.rint(low + part * (high - low)).astype(np.uint8)
    colors[at_limit] = SATURATED_COLOR
    return colors


class Arrows(NamedTuple):
    """One kind of arrow at the tool for every arm, all to one scale."""

    name: str
    quantity: str  # of the curve of their lengths
    color: Color  # where no other arm needs telling apart
    vectors: tuple[FloatArray, ...]  # [N,3] an arm, m/s or N
    scale: float  # metres drawn for each m/s or N


def arrows(robot: Robot, arms: Sequence[AnimatedArm]) -> list[Arrows]:
    """Velocities, and forces of a robot with masses, of all arms that move."""
    speeds = [tool_velocity(robot, arm.state) for arm in arms]
    found = [_scaled(robot, "velocity", "speed", VELOCITY_COLOR, speeds)]
    if robot.has_dynamics:
        forces = [wrist_force(robot, arm.state) for arm in arms]
        found.append(_scaled(robot, "force", "force", FORCE_COLOR, forces))
    return found


def _scaled(
    robot: Robot, name: str, quantity: str, color: Color, vectors: Sequence[FloatArray]
) -> Arrows:
    """The largest of all is as long as a share of the reach."""
    largest = max((float(np.linalg.norm(v, axis=1).max()) for v in vectors), default=0.0)
    scale = LONGEST * reach(robot) / largest if largest > 1e-9 else 0.0
    return Arrows(name, quantity, color, tuple(vectors), scale)


def draw_arrows(writer: Writer, arms: Sequence[AnimatedArm], kind: Arrows) -> None:
    """Arrows at the tools, to scale."""
    if kind.scale == 0.0:
        return
    for arm, values in zip(arms, kind.vectors, strict=True):
        path = tool_path(arm.name, kind.name)
        color = kind.color if len(arms) == 1 else arm.look.line_color
        style = rr.Arrows3D.from_fields(radii=[0.35 * arm.look.radius], colors=[color])
        writer.static(path, style)
        writer.columns(path, arm.times, rr.Arrows3D.columns(vectors=kind.scale * values))


def legend(robot: Robot, alone: bool, scales: Sequence[float]) -> str:
    """A sentence on what is drawn in space; ``scales`` of velocity and force arrows, m a unit."""
    parts = []
    if robot.has_dynamics:
        parts.append(
            "arcs around the joints: torque, closed and pink at its limit (arrows for slides)"
        )
    if any(scales):
        arrow = "pale blue arrow" if alone else "arrow at the tool"
        parts.append(f"{arrow}: velocity, {scales[0]:.3g} m drawn per m/s")
    if alone and len(scales) > 1:
        parts.append(f"yellow arrow: force in the wrist, {1e3 * scales[1]:.3g} mm drawn per N")
    if alone and robot.has_dynamics:
        parts.append("green balls: centres of mass, their volume as the mass")
    hidden = "frames" if alone else "frames, centres of mass, forces, velocities of ghosts"
    parts.append(f"hidden, shown from the blueprint panel: {hidden}")
    return f"In space: {'; '.join(parts)}."


def tool_velocity(robot: Robot, state: State) -> FloatArray:
    """Velocity [N,3] of the tool's origin in the base frame, m/s."""
    count = len(state.q)
    columns = buffered_call(jacobian(robot).map(count))(state.q.T)
    linear = columns[:3].reshape(3, count, robot.joint_count)
    return np.einsum("cni,ni->nc", linear, state.qd)


def wrist_force(robot: Robot, state: State) -> FloatArray:
    """Force [N,3] with which the arm holds its last link and what is fixed to it, base frame, N.

    ``m (a - g)`` with the mass of the last link, the acceleration of its centre of mass and the
    acceleration of free fall: what a force sensor in the last joint would read.
    """
    count = len(state.q)
    acceleration = buffered_call(_last_acceleration(robot).map(count))
    columns = acceleration(state.q.T, state.qd.T, state.qdd.T)
    return robot.links[-1].mass * (columns.T - robot.gravity)


@lru_cache(maxsize=64)
def _last_acceleration(robot: Robot) -> ca.Function:
    """``(q, qd, qdd) -> a[3]`` of the last link's centre of mass in the base frame, m/s^2."""
    q, qd, qdd = (ca.SX.sym(name, robot.joint_count) for name in ("q", "qd", "qdd"))
    pose = forward_kinematics(robot, robot.joint_count)(q)
    place = (pose @ ca.vertcat(ca.DM(robot.links[-1].center_of_mass), 1))[:3]
    velocity = ca.jtimes(place, q, qd)
    acceleration = ca.jtimes(velocity, q, qd) + ca.jtimes(velocity, qd, qdd)
    return ca.Function("last_acceleration", [q, qd, qdd], [ca.densify(acceleration)])
