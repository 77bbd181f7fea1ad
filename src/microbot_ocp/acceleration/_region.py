"""Regions of joint positions: a box of joints, a box for the tool, or the poses of a path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp.acceleration._demand import Boxes
from microbot_ocp.acceleration._forms import Terms, tool_terms
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Robot
from microbot_ocp.scene import Box

# Every pose of a path starts the search with one more box for each joint, side and payload.
MOST_POSES = 5000


@dataclass(frozen=True, eq=False)
class PositionRegion:
    """Region of joint positions: a union of K boxes, optionally with a box for the tool's origin.

    Attributes
    ----------
    boxes : Boxes
        Lower and upper ends [K,n] of the joint positions, rad (m).
    tool : Terms, optional
        Coordinates of the tool's origin relative to the center of the tool's box, m.
    tool_half : array_like [3]
        Half the size of the tool's box, m.
    words : str
        Description of the region for messages.
    """

    boxes: Boxes
    tool: Terms | None = None
    tool_half: ArrayLike = np.inf
    words: str = "joint limits"

    def inside(self, q: FloatArray) -> np.ndarray:
        """Return a mask [B] of the positions [B,n] that hold the tool's origin in its box."""
        if self.tool is None:
            return np.ones(len(q), dtype=bool)
        return np.all(np.abs(self.tool.at(q)[:, 0]) <= self.tool_half, axis=1)

    def across(self, low: FloatArray, high: FloatArray) -> tuple[np.ndarray, FloatArray]:
        """Return a mask [B] of boxes that may hold positions of the region, and weights [B,n].

        A weight is the distance that a joint moves the tool within the box of positions, in half
        widths of the tool's box, along axes on which the tool may cross the border.
        """
        if self.tool is None:
            return np.ones(len(low), dtype=bool), np.zeros_like(low)
        half, most = (high - low) / 2, np.asarray(self.tool_half)
        terms = self.tool.at((low + high) / 2)
        moved = half[:, :, None] * np.abs(terms[:, 1:])
        # Coordinates of the tool in a box of positions lie within ``away - swing`` and
        # ``away + swing``.
        swing, away = moved.sum(axis=1) + self.tool.tangent_error(half), np.abs(terms[:, 0])
        straddles = away + swing > most
        return np.all(away - swing <= most + ROUNDING, axis=1), (
            moved * (straddles / most)[:, None]
        ).sum(axis=2)


def position_region(robot: Robot, region: Any) -> PositionRegion:
    """Build the region from a user's argument ``region``.

    Raises
    ------
    InputError
        Positions outside of the joint limits, a lower end above its upper one, a joint without
        limits, a path of too many poses, or a tool box that no position reaches.
    """
    low, high = (bound.copy() for bound in robot.limits.bounds("q"))
    if isinstance(region, Motion):
        checks.joints("region", region.joint_count, robot)
        return _along(robot, region.q, f"the motion {region.label!r}")
    if region is not None and not isinstance(region, Box | tuple):
        poses = checks.array("region", region, (None, robot.joint_count), "rad")
        return _along(robot, poses, f"{len(poses)} poses of a path")
    words = "joint limits"
    if isinstance(region, tuple):
        if len(region) != 2:
            raise InputError(f"region as a tuple must be (lower, upper), not {len(region)} entries")
        ends = [
            checks.array(f"{side} of region", end, (robot.joint_count,), "rad")
            for side, end in zip(("lower end", "upper end"), region, strict=True)
        ]
        for k in np.flatnonzero((ends[0] > ends[1]) | (ends[0] < low) | (ends[1] > high)):
            raise InputError(
                f"region of {robot.joint_names[k]} must be a range within its limits "
                f"[{low[k]:g}, {high[k]:g}] {robot.unit('q', int(k))}, not "
                f"[{ends[0][k]:g}, {ends[1][k]:g}]"
            )
        (low, high), words = ends, "a box of joint positions"
    turns = robot.whole_turns & (high - low > 2 * np.pi)  # One turn holds all positions.
    low, high = np.where(turns, -np.pi, low), np.where(turns, np.pi, high)
    for k in np.flatnonzero(~np.isfinite(low + high)):
        raise InputError(
            f"region of {robot.joint_names[k]} must be finite: the joint has no limits, give "
            "region=(lower, upper)"
        )
    boxes = Boxes(low[None], high[None])
    if not isinstance(region, Box):
        return PositionRegion(boxes, words=words)
    tool = tool_terms(robot, region.pose, low, high)
    found = PositionRegion(boxes, tool, region.size / 2, "a box of tool positions")
    q = np.random.default_rng(0).uniform(low, high, (100_000, robot.joint_count))
    if not found.inside(q).any():
        raise InputError(
            "region must hold positions of the tool: none of 100,000 poses has its origin in the "
            f"box of {region.size.tolist()} m about {region.pose[:3, 3].tolist()} m"
        )
    return found


def _along(robot: Robot, poses: FloatArray, words: str) -> PositionRegion:
    """Build the region of the boxes between successive poses [N,n] of a path."""
    low, high = robot.limits.bounds("q")
    if not 1 <= len(poses) <= MOST_POSES:
        raise InputError(f"region must have 1 to {MOST_POSES} poses, not {len(poses)}")
    for row, k in np.argwhere((poses < low - ROUNDING) | (poses > high + ROUNDING))[:1]:
        raise InputError(
            f"pose {row + 1} of region must be within the limits of {robot.joint_names[k]}, "
            f"[{low[k]:g}, {high[k]:g}] {robot.unit('q', int(k))}, not {poses[row, k]:g}"
        )
    before, after = (poses[:-1], poses[1:]) if len(poses) > 1 else (poses, poses)
    return PositionRegion(Boxes(np.minimum(before, after), np.maximum(before, after)), words=words)
