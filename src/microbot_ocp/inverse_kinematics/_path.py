"""Inverse kinematics along a line of targets on one branch, with adaptive steps."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.inverse_kinematics import _search as search
from microbot_ocp.inverse_kinematics._kernels import joint_scale
from microbot_ocp.inverse_kinematics._result import IKPath, read_only
from microbot_ocp.inverse_kinematics._solve import checked_targets, nearest_solution
from microbot_ocp.robot import Robot, nearest_rotation

LARGEST_STEP = 0.1  # step of a joint above which a segment is halved, rad (or share of the reach)
HALVINGS = 20  # largest number of successive halvings of a segment
BRANCHES = 24  # largest number of start poses tried at the first target


def follow_ik(
    robot: Robot,
    positions: ArrayLike,
    orientations: ArrayLike | None = None,
    seed: ArrayLike | None = None,
    *,
    time_limit: float = np.inf,
) -> IKPath:
    """Return joint positions along a line of targets, continuous from row to row.

    Between neighbouring targets the tool moves on a straight line and turns about a fixed axis. If
    a joint would move far in one step, targets in between are solved as well, so that the branch is
    kept.

    Parameters
    ----------
    robot : Robot
        Arm with its position limits.
    positions : array_like [N,3]
        Tool origins in the base frame, m.
    orientations : array_like [N,3,3], optional
        Rotations of the tool in the base frame.
    seed : array_like [n], optional
        Joint positions, rad (prismatic: m), that select the nearest branch. Default: the most
        central branch of the first target that can be followed to the end.
    time_limit : float
        Wall time, s, after which unsolved rows have the status "time limit".

    Returns
    -------
    IKPath
        Joint positions; rows that are not reached hold the nearest pose found and their status.

    Raises
    ------
    InputError
        A shape is wrong, a number is not finite, or a matrix is no rotation.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> line = np.linspace([3, -1, 4.5], [3, 1, 4.5], 50)
    >>> followed = mo.follow_ik(mo.load_robot("microbot"), line)
    >>> followed.solved, followed.largest_step < 0.02
    (True, True)
    """
    targets = checked_targets(positions, orientations)
    with deadline.within(time_limit):
        return _path(robot, targets, seed)


def _path(robot: Robot, targets: FloatArray, seed: ArrayLike | None) -> IKPath:
    begin = time.perf_counter()
    if seed is not None:
        wanted = checks.array("seed", seed, (robot.joint_count,), "rad (prismatic: m)")
        starts = nearest_solution(robot, targets[0], wanted, begin).q[None]
    else:
        branches = search.find_branches(robot, targets[:1])[0]
        rows, inside = search.within_limits(robot, branches.q, search.middle(robot))
        starts = rows[inside]
        if not len(starts):
            starts = nearest_solution(robot, targets[0], None, begin).q[None]
        starts = _with_turns(robot, starts)
    lengths = []  # number of rows along which each start can be followed
    for start in starts if len(starts) > 1 else ():
        lengths.append(_rows_followed(robot, targets, start))
        if lengths[-1] == len(targets) or deadline.over():
            break
    chosen = starts[int(np.argmax(lengths))] if lengths else starts[0]
    return _followed(robot, targets, chosen, begin)


def _with_turns(robot: Robot, starts: FloatArray) -> FloatArray:
    """Add to start poses [K,n] those a full turn of one joint away within limits.

    The most central poses come first, at most ``BRANCHES``.
    """
    low, high = robot.limits.bounds("q")
    rows = [starts]
    for joint in np.flatnonzero(robot.whole_turns & (np.isfinite(low) | np.isfinite(high))):
        for turn in (-2 * np.pi, 2 * np.pi):
            moved = np.array(starts)
            moved[:, joint] += turn
            value = moved[:, joint]
            rows.append(moved[(value >= low[joint]) & (value <= high[joint])])
    everything = np.concatenate(rows)
    order = np.argsort(np.linalg.norm(everything - search.middle(robot), axis=1))
    return everything[order][:BRANCHES]


def _rows_followed(robot: Robot, targets: FloatArray, start: FloatArray) -> int:
    here, where = start, targets[0]
    for row, target in enumerate(targets):
        following = _advance(robot, here, where, target)
        if following is None:
            return row
        here, where = following, target
    return len(targets)


def _followed(robot: Robot, targets: FloatArray, start: FloatArray, begin: float) -> IKPath:
    q, statuses, jumps = [], [], []
    here, where = start, targets[0]
    reached = True  # True if the previous row was reached, so that its branch can be kept
    for row, target in enumerate(targets):
        if deadline.over():
            left = len(targets) - row
            q += [here] * left
            statuses += [Status.TIME_LIMIT] * left
            break
        following = _advance(robot, here, where, target) if reached else None
        if following is not None:
            here, status = following, Status.SOLVED
        else:
            here, status = _nearest_other_pose(robot, here, target, begin)
            # Beyond an unreachable stretch the arm may return to the branch that it left.
            lost = row > 0 and (reached or _step(robot, here, q[-1]) > 0.5)
            if status is Status.SOLVED and lost:
                jumps.append(row)
        reached, where = status is Status.SOLVED, target
        q.append(here)
        statuses.append(status)
    joints = np.array(q)
    distance, angle = search.task_errors(robot, joints, targets)
    largest = float(np.abs(np.diff(joints, axis=0)).max()) if len(joints) > 1 else 0.0
    advice = _path_advice(statuses, distance, jumps, largest)
    q, distance, angle = (read_only(values) for values in (joints, distance, angle))
    used = time.perf_counter() - begin
    return IKPath(q, tuple(statuses), distance, angle, largest, tuple(jumps), advice, used)


def _advance(
    robot: Robot, q: FloatArray, origin: FloatArray, target: FloatArray, halvings: int = HALVINGS
) -> FloatArray | None:
    """Move from q at ``origin`` to ``target`` on one branch; return None if that fails.

    A step above ``LARGEST_STEP`` may lead to another branch, so the segment is halved instead.
    """
    ended, errors = search.descend(robot, q[None], target[None], robot.limits.bounds("q"))
    if errors[0] < search.goal(robot) and _step(robot, ended[0], q) <= LARGEST_STEP:
        return ended[0]
    if halvings == 0 or np.array_equal(origin, target) or deadline.over():
        return None
    between = _halfway(origin, target)
    half = _advance(robot, q, origin, between, halvings - 1)
    return None if half is None else _advance(robot, half, between, target, halvings - 1)


def _step(robot: Robot, ours: FloatArray, theirs: FloatArray) -> float:
    """Return the largest joint change, full turns included, rad (prismatic: share of the reach)."""
    return float(np.abs((ours - theirs) / joint_scale(robot)).max())


def _halfway(origin: FloatArray, target: FloatArray) -> FloatArray:
    """Return the target half-way on the line, and half-way in the turn about its fixed axis."""
    middle_point = (origin + target) / 2
    if origin.size > 3:
        # The rotation nearest to the mean of two rotations is the one half-way between them.
        middle_point[3:] = nearest_rotation(middle_point[3:].reshape(3, 3)).ravel()
    return middle_point


def _nearest_other_pose(
    robot: Robot, q: FloatArray, target: FloatArray, begin: float
) -> tuple[FloatArray, Status]:
    """Return a solution on another branch, else the nearest pose that the arm can move into."""
    other = nearest_solution(robot, target, q, begin)
    if other.solved:
        return other.q, other.status
    local, converged = search.nearest_pose(robot, target, q)
    distance = search.task_errors(robot, local[None], target[None])[0][0]
    near = distance <= other.position_error + search.POSE_TOLERANCE
    return (local if near and converged else other.q), other.status


def _path_advice(
    statuses: list[Status], distance: FloatArray, jumps: list[int], largest: float
) -> str:
    missed = [row for row, entry in enumerate(statuses) if entry is not Status.SOLVED]
    parts = []
    if missed:
        worst = int(np.argmax(distance))
        parts.append(
            f"{len(missed)} of {len(statuses)} targets are missed, the first is row {missed[0]} "
            f"({statuses[missed[0]]}), the worst row {worst} by {distance[worst]:.6g} m."
        )
    if jumps:
        rows = ", ".join(map(str, jumps[:5])) + (", ..." if len(jumps) > 5 else "")
        parts.append(
            f"The branch ends before row {rows} (a limit or a fold); the joints jump to another "
            "branch there. Another seed, a shorter line or a way round may keep one branch."
        )
    if not parts:
        parts.append(f"All {len(statuses)} targets are reached on one branch.")
    if largest > 0.5:
        parts.append(
            f"A joint moves {largest:.3g} between two rows: the line passes near a singularity; "
            "more rows there make the motion smoother."
        )
    return " ".join(parts)
