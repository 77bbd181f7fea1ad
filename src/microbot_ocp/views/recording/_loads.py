"""Torque at every joint, velocity of the tool and force in the wrist, drawn in space."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np
import rerun as rr

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.fast_calls import buffered_call
from microbot_ocp.motion import State
from microbot_ocp.robot import JointLimits, Robot, forward_kinematics, jacobian
from microbot_ocp.views import _palette as palette
from microbot_ocp.views._scene import reach
from microbot_ocp.views._style import LINE_RADIUS, TORQUE_RING, Color
from microbot_ocp.views.recording._animated_arm import AnimatedArm
from microbot_ocp.views.recording._limits import signed_share
from microbot_ocp.views.recording._writer import Writer, plot_path

LONGEST_ARROW = 0.3  # longest arrow at a tool, relative to the reach
THICKNESS = 0.3  # radius of an arrow or arc, in link radii


def draw_torques(writer: Writer, robot: Robot, limits: JointLimits, arm: AnimatedArm) -> None:
    """Draw the torque of every joint: an arc, closed at the limit, or an arrow along a slide.

    A thin circle or line shows the limit.
    """
    size, ring = arm.look.radius, TORQUE_RING * arm.look.radius
    circle = arcs(np.array([1.0]), ring)[0, :-3]
    whole, beside = np.array([0.0, 0.0, 3.0 * ring]), np.array([ring, 0.0, 0.0])
    for joint, kind in enumerate(robot.joint_types):
        path = arm.link(robot.joint_frames[joint], "torque")
        share, at_limit = signed_share(limits, "tau", arm.curves["tau"][:, joint], joint)
        colors, radii = _share_colors(share, at_limit), np.where(at_limit, 0.5, THICKNESS) * size
        if kind == "revolute":
            limit = [circle]
            strips = arcs(share, ring).astype(np.float32)
            columns = rr.LineStrips3D.columns(strips=strips, radii=radii, colors=colors)
        else:  # the arrow stands beside the link, which lies along the axis of a slide
            limit = [[beside - whole, beside + whole]]
            columns = rr.Arrows3D.columns(
                vectors=np.clip(share, -1.0, 1.0)[:, None] * whole,
                origins=np.tile(beside, (len(share), 1)),
                radii=radii,
                colors=colors,
            )
        thin = rr.LineStrips3D(
            limit, radii=[LINE_RADIUS * reach(robot) / 4], colors=[palette.NEUTRAL]
        )
        writer.static(f"{path}/limit", thin)
        writer.columns(path, arm.times, columns)


def arcs(share: FloatArray, radius: float) -> FloatArray:
    """Return polylines [N,28,3] around the z axis, a full turn at a share of 1.

    The last three points are the head of an arrow.
    """
    sweep = 2 * np.pi * np.clip(share, -1.0, 1.0)[:, None]
    angle = sweep * np.linspace(0.0, 1.0, 25)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    tip = ring[:, -1]
    along = np.sign(sweep) * np.column_stack([-tip[:, 1], tip[:, 0], tip[:, 2]])
    size = 0.28 * np.minimum(1.0, np.abs(sweep) / 0.5)  # a short arc has a small head
    barbs = [tip - size * along + side * 0.6 * size * tip for side in (1.0, -1.0)]
    head = np.stack([barbs[0], tip, barbs[1]], axis=1)
    return radius * np.concatenate([ring, head], axis=1)


def _share_colors(share: FloatArray, at_limit: np.ndarray) -> np.ndarray:
    """Return colours [N,4] for shares [N] of a limit and the mask [N] of samples at the limit."""
    part = np.clip(np.abs(share), 0.0, 1.0)[:, None]
    low, high = np.array(palette.NEUTRAL, dtype=float), np.array(palette.NEAR, dtype=float)
    colors = np.rint(low + part * (high - low)).astype(np.uint8)
    colors[at_limit] = palette.SATURATED
    return colors


class Arrows(NamedTuple):
    """Arrows of one kind at the tools of all arms, with one scale."""

    name: str
    quantity: str  # key of the curve of their lengths
    color: Color  # colour for a single arm; several arms have their own colours
    vectors: tuple[FloatArray, ...]  # [N,3] an arm, m/s or N
    scale: float  # drawn length per m/s or N, m; the largest arrow is a share of the reach


def arrows(robot: Robot, arms: Sequence[AnimatedArm]) -> list[Arrows]:
    """Return tool velocities and, for a robot with masses, wrist forces of all moving arms."""
    rows = [("velocity", "speed", palette.MOTION, tool_velocity)]
    if robot.has_dynamics:
        rows.append(("force", "force", palette.NEAR, wrist_force))
    kinds = []
    for name, quantity, color, function in rows:
        vectors = tuple(function(robot, arm.state) for arm in arms)
        largest = max((float(np.linalg.norm(v, axis=1).max()) for v in vectors), default=0.0)
        scale = LONGEST_ARROW * reach(robot) / largest if largest > ROUNDING else 0.0
        kinds.append(Arrows(name, quantity, color, vectors, scale))
    return kinds


def draw_arrows(writer: Writer, arms: Sequence[AnimatedArm], kind: Arrows) -> None:
    """Draw scaled arrows at the tools, and their lengths as curves."""
    for arm, vectors in zip(arms, kind.vectors, strict=True):
        arm.draw_curve(writer, plot_path(kind.quantity), np.linalg.norm(vectors, axis=1))
        if kind.scale:
            color = kind.color if len(arms) == 1 else arm.look.line_color
            style = rr.Arrows3D.from_fields(radii=[THICKNESS * arm.look.radius], colors=[color])
            writer.static(arm.tool(kind.name), style)
            lengths = rr.Arrows3D.columns(vectors=kind.scale * vectors)
            writer.columns(arm.tool(kind.name), arm.times, lengths)


def legend(robot: Robot, alone: bool, scales: Sequence[float]) -> str:
    """Return a legend of the view in space; ``scales`` of velocity and force arrows, m per unit."""
    parts = []
    if robot.has_dynamics:
        torque = "torque, closed and pink at its limit (arrows for slides)"
        parts.append(f"arcs around the joints: {torque}")
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
    """Return the velocity [N,3] of the tool's origin in the base frame, m/s."""
    count = len(state.q)
    columns = buffered_call(jacobian(robot).map(count))(state.q.T)
    linear = columns[:3].reshape(3, count, robot.joint_count)
    return np.einsum("cni,ni->nc", linear, state.qd)


def wrist_force(robot: Robot, state: State) -> FloatArray:
    """Return the force [N,3] of the arm on its last link, base frame, N.

    It is ``m (a - g)`` with the mass of the last link (and of bodies fixed to it), the acceleration
    of its centre of mass and the acceleration of gravity. A force sensor in the last joint would
    measure it.
    """
    acceleration = buffered_call(_last_acceleration(robot).map(len(state.q)))
    columns = acceleration(state.q.T, state.qd.T, state.qdd.T)
    return robot.links[-1].mass * (columns.T - robot.gravity)


@lru_cache(maxsize=64)
def _last_acceleration(robot: Robot) -> ca.Function:
    """Return ``(q, qd, qdd) -> a[3]`` of the last link's centre of mass, base frame, m/s^2."""
    q, qd, qdd = (ca.SX.sym(name, robot.joint_count) for name in ("q", "qd", "qdd"))
    pose = forward_kinematics(robot, robot.link_count)(q)
    place = (pose @ ca.vertcat(ca.DM(robot.links[-1].center_of_mass), 1))[:3]
    velocity = ca.jtimes(place, q, qd)
    acceleration = ca.jtimes(velocity, q, qd) + ca.jtimes(velocity, qd, qdd)
    return ca.Function("last_acceleration", [q, qd, qdd], [ca.densify(acceleration)])
