"""The positions that count: boxes of joints, those that hold the tool in a box, poses of a path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.acceleration._demand import Boxes
from microbot_ocp.acceleration._forms import Terms, tool_terms
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Robot
from microbot_ocp.scene import Box

MOST_POSES = 5000  # of a path: each is a box to begin with, for every joint, side and payload


@dataclass(frozen=True, eq=False)
class Places:
    """Boxes [K,n] of joint positions, rad (m), and a box that the tool's origin is in."""

    boxes: Boxes
    tool: Terms | None = None
    tool_half: ArrayLike = np.inf
    words: str = "joint limits"

    def inside(self, q: FloatArray) -> np.ndarray:
        """Return which positions [B] count of [B,n] in one of the boxes."""
        if self.tool is None:
            return np.ones(len(q), dtype=bool)
        return np.all(np.abs(self.tool.at(q)[:, 0]) <= self.tool_half, axis=1)

    def across(self, low: FloatArray, high: FloatArray) -> tuple[np.ndarray, FloatArray]:
        """Return which boxes [B] may hold a position that counts, and how much each joint [B,n]
        moves the tool there across the border, in half widths of the tool's box.
        """
        if self.tool is None:
            return np.ones(len(low), dtype=bool), np.zeros_like(low)
        half, most = (high - low) / 2, np.asarray(self.tool_half)
        terms = self.tool.at((low + high) / 2)
        moved = half[:, :, None] * np.abs(terms[:, 1:])
        swing, away = moved.sum(axis=1) + self.tool.rest(half), np.abs(terms[:, 0])
        straddles = away + swing > most
        return np.all(away - swing <= most + 1e-9, axis=1), (
            moved * (straddles / most)[:, None]
        ).sum(axis=2)


def places(robot: Robot, region: Any) -> Places:
    """Return the region that a user means.

    Raises
    ------
    InputError
        Positions outside of the joint limits, a lower end above its upper one, joints without
        limits, what is none of these.
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
    turns = robot.whole_turns & (high - low > 2 * np.pi)  # all that is beyond recurs
    low, high = np.where(turns, -np.pi, low), np.where(turns, np.pi, high)
    for k in np.flatnonzero(~np.isfinite(low + high)):
        raise InputError(
            f"region of {robot.joint_names[k]} must be finite: the joint has no limits, give "
            "region=(lower, upper)"
        )
    boxes = Boxes(low[None], high[None])
    if not isinstance(region, Box):
        return Places(boxes, words=words)
    tool = tool_terms(robot, region.pose, low, high)
    found = Places(boxes, tool, region.size / 2, "a box of tool positions")
    q = np.random.default_rng(0).uniform(low, high, (100_000, robot.joint_count))
    if not found.inside(q).any():
        raise InputError(
            "region must hold positions of the tool: none of 100,000 poses has its origin in the "
            f"box of {region.size.tolist()} m about {region.pose[:3, 3].tolist()} m"
        )
    return found


def _along(robot: Robot, poses: FloatArray, words: str) -> Places:
    """Return the boxes between each pose [N,n] of a path and the next."""
    low, high = robot.limits.bounds("q")
    if not 1 <= len(poses) <= MOST_POSES:
        raise InputError(f"region must have 1 to {MOST_POSES} poses, not {len(poses)}")
    for row, k in np.argwhere((poses < low - 1e-9) | (poses > high + 1e-9))[:1]:
        raise InputError(
            f"pose {row + 1} of region must be within the limits of {robot.joint_names[k]}, "
            f"[{low[k]:g}, {high[k]:g}] {robot.unit('q', int(k))}, not {poses[row, k]:g}"
        )
    before, after = (poses[:-1], poses[1:]) if len(poses) > 1 else (poses, poses)
    return Places(Boxes(np.minimum(before, after), np.maximum(before, after)), words=words)
