"""Regions of joint positions: a box of joints, a box for the tool, or the poses of a path.

Poses in which an arm with capsules touches itself belong to no region. A box of positions holds
only such poses if two capsules overlap in its middle by more than the joints can move them apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp.acceleration._demand import Boxes
from microbot_ocp.acceleration._forms import Terms, tool_terms
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Capsule, Robot
from microbot_ocp.scene import ACCURACY, Box, Pair, Scene, clearances, levers_of

# Every pose of a path starts the search with one more box for each joint, side and payload.
MOST_POSES = 5000
ROUNDS, DRAWN = 50, 2000  # Random positions are drawn at most so often, and so many at a time.


@dataclass(frozen=True, eq=False)
class PositionRegion:
    """Region of joint positions: a union of K boxes, optionally with a box for the tool's origin.

    Attributes
    ----------
    robot : Robot
    boxes : Boxes
        Lower and upper ends [K,n] of the joint positions, rad (m).
    tool : Terms, optional
        Coordinates of the tool's origin relative to the center of the tool's box, m.
    tool_half : array_like [3]
        Half the size of the tool's box, m.
    words : str
        Description of the region for messages.
    """

    robot: Robot
    boxes: Boxes
    tool: Terms | None = None
    tool_half: ArrayLike = np.inf
    words: str = "joint limits"

    @cached_property
    def pairs(self) -> tuple[Pair, ...]:
        """Capsules of the arm that may not touch, without those fitted around other geometry."""
        apart = Scene().pairs(self.robot) if self.robot.capsules else ()
        return tuple(
            replace(pair, accuracy=0.0)
            for pair in apart
            if not pair.capsule.excess and isinstance(pair.other, Capsule) and not pair.other.excess
        )

    @cached_property
    def _levers(self) -> FloatArray:
        return levers_of(self.robot, self.pairs, np.abs(self.boxes).max(axis=(0, 1)))

    def inside(self, q: FloatArray) -> np.ndarray:
        """Return a mask [B] of the positions [B,n] of the boxes that belong to the region."""
        free = np.ones(len(q), dtype=bool)
        if self.pairs:
            free = np.all(clearances(self.robot, self.pairs, q) > ACCURACY, axis=1)
        if self.tool is None:
            return free
        return free & np.all(np.abs(self.tool.at(q)[:, 0]) <= self.tool_half, axis=1)

    def drawn(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw positions [count,n] at random, or fewer if most of the boxes is outside."""
        kept = np.empty((0, self.robot.joint_count))
        for _ in range(ROUNDS):
            row = rng.integers(len(self.boxes.low), size=DRAWN)
            q = rng.uniform(self.boxes.low[row], self.boxes.high[row])
            kept = np.vstack([kept, q[self.inside(q)]])
            if len(kept) >= count:
                break
        return kept[:count]

    def across(self, boxes: Boxes) -> tuple[np.ndarray, FloatArray]:
        """Return a mask [B] of boxes that may hold positions of the region, and weights [B,n].

        A weight is the distance that a joint moves the tool within the box of positions, in half
        widths of the tool's box, along axes on which the tool may cross the border; and the
        distance that it moves capsules that overlap in the middle, in sums of their radii.
        """
        middle, half = boxes.middle, boxes.half
        keep, weights = np.ones(len(half), dtype=bool), np.zeros_like(half)
        if self.pairs:
            apart = clearances(self.robot, self.pairs, middle)
            keep = np.all(apart + half @ self._levers.T + ACCURACY >= 0.0, axis=1)
            sizes = [max(pair.radii, ACCURACY) for pair in self.pairs]
            weights = (apart < 0.0) / sizes @ self._levers * half
        if self.tool is None:
            return keep, weights
        most = np.asarray(self.tool_half)
        terms = self.tool.at(middle)
        moved = half[:, :, None] * np.abs(terms[:, 1:])
        # Coordinates of the tool in a box of positions lie within ``away - swing`` and
        # ``away + swing``.
        swing, away = moved.sum(axis=1) + self.tool.tangent_error(half), np.abs(terms[:, 0])
        straddles = away + swing > most
        keep &= np.all(away - swing <= most + ROUNDING, axis=1)
        return keep, weights + (moved * (straddles / most)[:, None]).sum(axis=2)


def position_region(robot: Robot, region: Any) -> PositionRegion:
    """Build the region from a user's argument ``region``.

    Raises
    ------
    InputError
        Positions outside of the joint limits, a lower end above its upper one, a joint without
        limits, a path of too many poses, a tool box that no position reaches, or a region in which
        the arm touches itself everywhere.
    """
    found = _boxes_of(robot, region)
    if found.pairs:
        found = replace(found, words=f"{found.words}, without self-collision")
    if not len(found.drawn(1, np.random.default_rng(0))):
        raise InputError(
            f"region ({found.words}) must hold positions of the arm: none of "
            f"{ROUNDS * DRAWN:,} random ones belongs to it"
        )
    return found


def _boxes_of(robot: Robot, region: Any) -> PositionRegion:
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
        return PositionRegion(robot, boxes, words=words)
    tool = tool_terms(robot, region.pose, low, high)
    words = f"tool in a box of {region.size.tolist()} m about {region.pose[:3, 3].tolist()} m"
    return PositionRegion(robot, boxes, tool, region.size / 2, words)


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
    boxes = Boxes(np.minimum(before, after), np.maximum(before, after))
    return PositionRegion(robot, boxes, words=words)
