"""Velocity of the tool and the force in the wrist as arrows at the tool."""

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
from microbot_ocp.robot import Robot, forward_kinematics, jacobian
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.recording import _curves as curves, _paths as entities
from microbot_ocp.views.recording._animated_arm import Actor
from microbot_ocp.views.recording._palette import FORCE_COLOR, VELOCITY_COLOR, Color
from microbot_ocp.views.recording._writer import Writer

LONGEST = 0.3  # share of the reach that the largest arrow of a recording is long


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


class Arrows(NamedTuple):
    """One kind of arrow for every arm, all to one scale."""

    name: str
    quantity: str  # of the curve of their lengths
    color: Color  # where no other arm needs telling apart
    vectors: tuple[FloatArray, ...]  # [N,3] an arm, m/s or N
    scale: float  # metres drawn for each m/s or N


def arrows(robot: Robot, actors: Sequence[Actor]) -> list[Arrows]:
    """Velocities, and forces of a robot with masses, of all arms that move."""
    speeds = [tool_velocity(robot, actor.state) for actor in actors]
    kinds = [_scaled(robot, "velocity", "speed", VELOCITY_COLOR, speeds)]
    if robot.has_dynamics:
        forces = [wrist_force(robot, actor.state) for actor in actors]
        kinds.append(_scaled(robot, "force", "force", FORCE_COLOR, forces))
    return kinds


def _scaled(
    robot: Robot, name: str, quantity: str, color: Color, vectors: Sequence[FloatArray]
) -> Arrows:
    """The largest of all is as long as a share of the reach."""
    largest = max((float(np.linalg.norm(v, axis=1).max()) for v in vectors), default=0.0)
    scale = LONGEST * scene.reach(robot) / largest if largest > 1e-9 else 0.0
    return Arrows(name, quantity, color, tuple(vectors), scale)


def draw(writer: Writer, actors: Sequence[Actor], kind: Arrows) -> None:
    """Arrows at the tools, and curves of their lengths."""
    alone = len(actors) == 1
    for actor, values in zip(actors, kind.vectors, strict=True):
        curves.draw_tool(writer, actor, kind.quantity, np.linalg.norm(values, axis=1))
        if kind.scale == 0.0:
            continue
        path = entities.tool(actor.name, kind.name)
        color = kind.color if alone else actor.look.line_color
        style = rr.Arrows3D.from_fields(radii=[0.35 * actor.look.radius], colors=[color])
        writer.static(path, style)
        writer.columns(path, actor.times, rr.Arrows3D.columns(vectors=kind.scale * values))
