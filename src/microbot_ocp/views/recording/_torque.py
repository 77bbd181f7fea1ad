"""Torque at every joint: an arc around its axis, closed at the limit; an arrow along a slide."""

from __future__ import annotations

import numpy as np
import rerun as rr

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import SATURATED
from microbot_ocp.robot import JointLimits, Robot
from microbot_ocp.views.recording import _paths as entities
from microbot_ocp.views.recording._animated_arm import Actor, Look
from microbot_ocp.views.recording._palette import NEUTRAL_COLOR, share_colors
from microbot_ocp.views.recording._writer import Times, Writer

POINTS = 25  # of an arc
RING = 3.4  # radius of the arc in link radii
SLIDE = 10.0  # length of the arrow at the limit in link radii
BARB = 0.28  # length of the arrow head in arc radii


def draw(writer: Writer, robot: Robot, limits: JointLimits, actor: Actor) -> None:
    """An arc or arrow in every link frame, over a thin one that shows the limit."""
    for joint, kind in enumerate(robot.joint_types):
        path = entities.link(actor.name, joint + 1, "torque")
        share, limited = torque_share(actor.values("tau")[:, joint], limits, joint)
        full = SATURATED if limited else np.inf
        if kind == "revolute":
            _arc(writer, path, actor.look, actor.times, share, full)
        else:
            _arrow(writer, path, actor.look, actor.times, share, full)


def torque_share(tau: FloatArray, limits: JointLimits, joint: int) -> tuple[FloatArray, bool]:
    """Shares [N] of the torque limit of a joint with the torque's sign, and whether it has one.

    Without a limit they are shares of the largest torque, and never count as saturated.
    """
    lower, upper = (float(bound[joint]) for bound in limits.bounds("tau"))
    own = np.where(tau >= 0.0, upper, -lower)
    if np.isfinite(own).all():
        return np.divide(tau, own, out=np.sign(tau), where=own > 0.0), True
    largest = float(np.abs(tau).max())
    return (tau / largest if largest > 0.0 else np.zeros_like(tau)), False


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


def _arc(
    writer: Writer, path: str, look: Look, times: Times, share: FloatArray, full: float
) -> None:
    radius = RING * look.radius
    circle = arcs(np.array([1.0]), radius)[0, :POINTS]
    thin = rr.LineStrips3D([circle], radii=[0.06 * look.radius], colors=[NEUTRAL_COLOR])
    writer.static(f"{path}/limit", thin)
    thick = np.where(np.abs(share) >= full, 0.5, 0.3) * look.radius
    columns = rr.LineStrips3D.columns(
        strips=arcs(share, radius).astype(np.float32),
        radii=thick,
        colors=share_colors(share, full),
    )
    writer.columns(path, times, columns)


def _arrow(
    writer: Writer, path: str, look: Look, times: Times, share: FloatArray, full: float
) -> None:
    whole = np.array([0.0, 0.0, SLIDE * look.radius])
    beside = np.array([RING * look.radius, 0.0, 0.0])  # the link itself lies along the axis
    ends = np.array([[beside - whole, beside + whole]])
    thin = rr.LineStrips3D(ends, radii=[0.06 * look.radius], colors=[NEUTRAL_COLOR])
    writer.static(f"{path}/limit", thin)
    columns = rr.Arrows3D.columns(
        vectors=np.clip(share, -1.0, 1.0)[:, None] * whole,
        origins=np.tile(beside, (len(share), 1)),
        radii=np.where(np.abs(share) >= full, 0.8, 0.5) * look.radius,
        colors=share_colors(share, full),
    )
    writer.columns(path, times, columns)
