"""One solution or every branch for a pose of the tool, with a status."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.quasi_random import quasi_random
from microbot_ocp._base.status import Status
from microbot_ocp.inverse_kinematics import _search as search
from microbot_ocp.inverse_kinematics._kernels import generic_rank, joint_scale, pose_of
from microbot_ocp.inverse_kinematics._result import IKSolution, read_only
from microbot_ocp.robot import Robot, checked_rotations, stretched_out

REACHED = "The tool reaches the target within the joint limits."


def solve_ik(
    robot: Robot,
    position: ArrayLike,
    orientation: ArrayLike | None = None,
    seed: ArrayLike | None = None,
    *,
    time_limit: float = np.inf,
) -> IKSolution:
    """Return joint positions that bring the tool to a position and, optionally, an orientation.

    Parameters
    ----------
    robot : Robot
        Arm with its position limits.
    position : array_like [3]
        Tool origin in the base frame, m.
    orientation : array_like [3,3], optional
        Rotation of the tool in the base frame. If the arm cannot reach both, the position is kept
        and the angle to the orientation is minimised.
    seed : array_like [n], optional
        Joint positions, rad (prismatic: m), from which the search descends to the nearest branch,
        or to a nearby point of a continuum. If that fails, starts farther and farther away follow,
        and a search of all branches. Default: the most central of all branches.
    time_limit : float
        Wall time, s, after which an unfinished search has the status "time limit".

    Returns
    -------
    IKSolution
        Solution; if the target is missed, the nearest pose with its status and advice.

    Raises
    ------
    InputError
        A shape is wrong, a number is not finite, or the matrix is no rotation.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> found = mo.solve_ik(mo.load_robot("microbot"), [3, -1, 4.5], seed=[0, 1, -1])
    >>> np.degrees(found.q).round(4).tolist()
    [-18.4349, 105.8439, -111.3819]
    """
    begin = time.perf_counter()
    target = checked_target(position, orientation)
    with deadline.within(time_limit):
        if seed is None:
            return nearest_solution(robot, target, None, begin)
        wanted = checks.array("seed", seed, (robot.joint_count,), "rad (prismatic: m)")
        return _from_seeds(robot, target[None], wanted[None])[0]


def solve_ik_each(
    robot: Robot,
    positions: ArrayLike,
    orientations: ArrayLike | None = None,
    seeds: ArrayLike | None = None,
    *,
    time_limit: float = np.inf,
) -> tuple[IKSolution, ...]:
    """Run :func:`solve_ik` with a seed, for many targets at once.

    Parameters
    ----------
    robot : Robot
        Arm with its position limits.
    positions : array_like [N,3]
        Tool origins in the base frame, m.
    orientations : array_like [N,3,3], optional
        Rotations of the tool in the base frame.
    seeds : array_like [N,n] or [n], optional
        Seeds for each target, or one for all, rad (prismatic: m). Default: the middle of the
        limits.
    time_limit : float
        Wall time, s, after which unfinished targets have the status "time limit".

    Returns
    -------
    tuple of IKSolution, N
        One solution per target, in the order of the targets.

    Raises
    ------
    InputError
        The arguments are refused as by :func:`solve_ik`.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> line = np.linspace([3, -1, 4.5], [3, 1, 4.5], 50)
    >>> robot = mo.load_robot("microbot")
    >>> found = mo.inverse_kinematics.solve_ik_each(robot, line, seeds=[0, 1, -1])
    >>> len(found), all(solution.solved for solution in found)
    (50, True)
    """
    targets = checked_targets(positions, orientations)
    given = search.middle(robot) if seeds is None else seeds
    shape = (robot.joint_count,) if np.ndim(given) == 1 else (len(targets), robot.joint_count)
    wanted = checks.array("seeds", given, shape, "rad (prismatic: m)")
    wanted = np.broadcast_to(wanted, (len(targets), shape[-1]))
    return _in_parts(partial(_from_seeds, robot), time_limit, targets, wanted)


PART = 64  # targets solved at once under a time limit


def _in_parts(solve: Callable[..., Any], time_limit: float, *rows: FloatArray) -> tuple[Any, ...]:
    """Solve rows of targets (and seeds), part by part until the time is over."""
    with deadline.within(time_limit):
        count = len(rows[0])
        size = PART if np.isfinite(deadline.until()) else count
        parts = [slice(k, k + size) for k in range(0, count, size)]
        return tuple(chain(*(solve(*(each[part] for each in rows)) for part in parts)))


def _timed_out(robot: Robot, targets: FloatArray) -> list[IKSolution]:
    still = np.zeros(len(targets), dtype=int)
    q = np.tile(search.middle(robot), (len(targets), 1))
    return _solutions(robot, targets, q, still, 0.0, Status.TIME_LIMIT)


def _from_seeds(robot: Robot, targets: FloatArray, seeds: FloatArray) -> tuple[IKSolution, ...]:
    """Solve from the seeds [N,n]; search all branches of targets for which that fails."""
    begin = time.perf_counter()
    if deadline.over():
        return tuple(_timed_out(robot, targets))
    q, solved = search.descend_from(robot, seeds, targets)
    share = (time.perf_counter() - begin) / len(targets)
    solutions = iter(_solutions(robot, targets[solved], q[solved], None, share))
    return tuple(
        next(solutions) if good else nearest_solution(robot, target, seed, time.perf_counter())
        for good, target, seed in zip(solved, targets, seeds, strict=True)
    )


def solve_ik_all(
    robot: Robot,
    position: ArrayLike,
    orientation: ArrayLike | None = None,
    *,
    time_limit: float = np.inf,
) -> tuple[IKSolution, ...]:
    """Return every branch within the joint limits that brings the tool to a pose.

    Parameters
    ----------
    robot : Robot
        Arm with its position limits.
    position : array_like [3]
        Tool origin in the base frame, m.
    orientation : array_like [3,3], optional
        Rotation of the tool in the base frame.
    time_limit : float
        Wall time, s, after which an unfinished search has the status "time limit".

    Returns
    -------
    tuple of IKSolution
        Solutions, the most central first. Branches are different modulo a turn; each is moved by
        full turns as near to the middle of the limits as possible. A continuum (``self_motion``
        above 0: redundant arms, some singular poses) is represented by its members that are locally
        nearest to the middle. If no branch exists, the only entry is the nearest pose with its
        status.

    Raises
    ------
    InputError
        The arguments are refused as by :func:`solve_ik`.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> len(mo.solve_ik_all(mo.load_robot("microbot"), [3, -1, 4.5]))
    4
    """
    with deadline.within(time_limit):
        return _branches(robot, checked_target(position, orientation)[None])[0]


def solve_ik_batch(
    robot: Robot,
    positions: ArrayLike,
    orientations: ArrayLike | None = None,
    *,
    time_limit: float = np.inf,
) -> tuple[tuple[IKSolution, ...], ...]:
    """Run :func:`solve_ik_all` for positions [N,3] and orientations [N,3,3] at once.

    Returns
    -------
    tuple of tuples of IKSolution
        Result of :func:`solve_ik_all` for every target.

    Raises
    ------
    InputError
        The arguments are refused as by :func:`solve_ik`.
    """
    targets = checked_targets(positions, orientations)
    return _in_parts(partial(_branches, robot), time_limit, targets)


def _branches(robot: Robot, targets: FloatArray) -> tuple[tuple[IKSolution, ...], ...]:
    begin = time.perf_counter()
    if deadline.over():
        return tuple((solution,) for solution in _timed_out(robot, targets))
    wanted, everything = search.middle(robot), search.find_branches(robot, targets)
    owners = np.repeat(np.arange(len(targets)), [len(branches.q) for branches in everything])
    q = np.concatenate([branches.q for branches in everything])
    rows, inside = search.within_limits(robot, q, wanted)
    order = np.lexsort((np.linalg.norm(rows - wanted, axis=1), owners))
    order = order[inside[order]]
    q, owners = rows[order], owners[order]
    motions = np.concatenate([branches.self_motion for branches in everything])[order]
    share = (time.perf_counter() - begin) / len(targets)
    solutions: list[list[IKSolution]] = [[] for _ in targets]
    if len(q):
        flat = _solutions(robot, targets[owners], q, motions, share)
        for index, solution in zip(owners, flat, strict=True):
            solutions[index].append(solution)
    for index, branches in enumerate(everything):
        if not solutions[index]:
            solutions[index].append(_unreached(robot, targets[index], branches, wanted, share))
    return tuple(map(tuple, solutions))


def branches_by_nlp(
    robot: Robot, position: ArrayLike, orientation: ArrayLike | None = None, starts: int = 32
) -> FloatArray:
    """Find branches [K,n] by NLPs only, slower than :func:`solve_ik_all` and independent of it.

    From each of ``starts`` evenly spread starts IPOPT minimises the distance in joint space to the
    start, subject to the target and the limits. Answers are verified by forward kinematics and
    compared modulo a turn.
    """
    target = checked_target(position, orientation)
    low, high = search.start_range(robot)
    rank = generic_rank(robot, target.size)
    spread = low + (high - low) * quasi_random(starts, robot.joint_count)
    rows = [search.nearest_by_nlp(robot, start, target, start, rank) for start in spread]
    q = np.clip(np.vstack(rows), *robot.limits.bounds("q"))
    q = q[search.reaches(*search.task_errors(robot, q, np.tile(target, (len(q), 1))))]
    q, _ = search.within_limits(robot, q, search.middle(robot))
    return search.clusters(robot, q, search.SAME_JOINTS)[0]


def nearest_solution(
    robot: Robot, target: FloatArray, seed: FloatArray | None, begin: float
) -> IKSolution:
    """Return the solution of a checked target nearest to the seed [n] or to the limits' middle."""
    wanted = search.middle(robot) if seed is None else np.array(seed)
    branches = search.find_branches(robot, target[None])[0]
    rows, inside = search.within_limits(robot, branches.q, wanted)
    rows, motions = rows[inside], branches.self_motion[inside]
    if seed is not None and (motions.any() or not len(rows)):
        rows, motions = _nearer_members(robot, target, rows, motions, wanted)
    if not len(rows):
        return _unreached(robot, target, branches, wanted, time.perf_counter() - begin)
    chosen = [np.argmin(np.linalg.norm((rows - wanted) / joint_scale(robot), axis=1))]
    used = time.perf_counter() - begin
    return _solutions(robot, target[None], rows[chosen], motions[chosen], used)[0]


def _nearer_members(
    robot: Robot, target: FloatArray, rows: FloatArray, motions: np.ndarray, wanted: FloatArray
) -> tuple[FloatArray, np.ndarray]:
    """Move members of continua among solutions [K,n] to their places nearest to ``wanted``.

    The solution downhill from ``wanted`` is added, because a representative may lie on another part
    of its continuum.
    """
    bounds = robot.limits.q_min, robot.limits.q_max
    downhill, errors = search.descend(robot, np.clip(wanted, *bounds)[None], target[None], bounds)
    if errors[0] < search.goal(robot):
        rows = np.vstack([rows, downhill])
        motions = np.append(motions, search.motions_of_one(robot, downhill, target))
    moved, moves = np.array(rows), np.flatnonzero(motions)
    nearest = search.nearest_on_continuum(robot, rows[moves], target, wanted)
    for k, best in zip(moves, nearest, strict=True):
        moved[k] = rows[k] if best is None else best
    return moved, motions


FAR_OFF = 10.0  # ratio of distance to the stretched arm above which units look wrong
FARTHEST = 1e6  # distance beyond which double precision cannot resolve a reach, m


def checked_target(position: ArrayLike, orientation: ArrayLike | None) -> FloatArray:
    """Return a checked position [3] and orientation [3,3] as a row [3] or [12]."""
    if np.shape(position) == (4, 4):
        raise InputError("position must have shape [3], not [4, 4]: give pose[:3, 3], pose[:3, :3]")
    if orientation is not None and np.shape(orientation) in ((3,), (4,)):
        raise InputError("orientation must be a matrix [3, 3]: mo.robot.rotation_of(rpy) makes one")
    place = checks.array("position", position, (3,), "m")
    _check_near("position", place)
    if orientation is None:
        return np.array(place)
    turn = checks.array("orientation", orientation, (3, 3))
    return np.concatenate([place, _rotation_rows("orientation", turn[None])[0]])


def checked_targets(positions: ArrayLike, orientations: ArrayLike | None) -> FloatArray:
    """Return checked positions [N,3] and orientations [N,3,3] as rows [N,3] or [N,12]."""
    places = checks.array("positions", positions, (None, 3), "m")
    if not len(places):
        raise InputError("positions must have at least one row, not 0")
    _check_near("positions", places)
    if orientations is None:
        return np.array(places)
    turns = checks.array("orientations", orientations, (len(places), 3, 3))
    return np.hstack([places, _rotation_rows("orientations[{}]", turns)])


def _check_near(name: str, places: FloatArray) -> None:
    far = float(np.abs(places).max())
    if far > FARTHEST:
        raise InputError(f"{name} must be within {FARTHEST:g} m of the base, not {far:g} m")


def _rotation_rows(name: str, turns: FloatArray) -> FloatArray:
    """Return the columns [N,9] of rotations [N,3,3], made exact; ``name`` may hold an index."""
    # Rounded matrices of a file are replaced by the nearest rotation, so the pose can be reached.
    left, _, right = np.linalg.svd(checked_rotations(name, turns))
    return (left @ right).swapaxes(1, 2).reshape(-1, 9)


def _unreached(
    robot: Robot, target: FloatArray, branches: search.BranchSet, wanted: FloatArray, used: float
) -> IKSolution:
    """Return the nearest pose for a target that no branch within limits reaches."""
    begin = time.perf_counter()
    pose, converged = search.nearest_pose(robot, target)
    q, _ = search.within_limits(robot, pose[None], wanted)
    distance, angle = search.task_errors(robot, q, target[None])
    motions = np.zeros(1, dtype=int)
    if search.reaches(distance, angle):
        status = Status.SOLVED
        motions = search.motions_of_one(robot, q, target)
    elif deadline.over():
        status = Status.TIME_LIMIT
    elif not converged:
        status = Status.NOT_CONVERGED
    elif branches.reached or _reached_without_limits(robot, target):
        status = Status.LIMITS
    else:
        near = search.reaches(distance, 0.0)
        status = Status.ORIENTATION_MISSED if near else Status.OUT_OF_REACH
    used += time.perf_counter() - begin
    return _solutions(robot, target[None], q, motions, used, status)[0]


def _reached_without_limits(robot: Robot, target: FloatArray) -> bool:
    if not np.isfinite(robot.limits.bounds("q")).any():
        return False
    if robot.joint_count <= generic_rank(robot, target.size):
        return False  # the search of a non-redundant arm has ignored the limits
    without = robot.with_limits(q_min=-np.inf, q_max=np.inf)
    return search.find_branches(without, target[None])[0].reached


def _solutions(
    robot: Robot,
    targets: FloatArray,
    q: FloatArray,
    motions: np.ndarray | None,
    solve_time: float,
    status: Status = Status.SOLVED,
) -> list[IKSolution]:
    """Return one solution per row of targets [K,w] and q [K,n]; compute motions [K] if None."""
    width = targets.shape[1]
    rank = search.ranks(robot, q, width)
    singular = rank < generic_rank(robot, width)
    if motions is None:
        motions = search.self_motions(robot, q, targets, rank)
    joints, poses = read_only(q), read_only(pose_of(robot)(np.ascontiguousarray(q)))
    distances, angles = search.pose_errors(poses, targets)
    columns = (column.tolist() for column in (distances, angles, motions, singular))
    return [
        IKSolution(
            joint,
            status,
            distance,
            angle,
            _advice(robot, joint, status, distance, angle, motion, lost),
            pose,
            motion,
            lost,
            solve_time,
        )
        for joint, pose, distance, angle, motion, lost in zip(joints, poses, *columns, strict=True)
    ]


def _advice(
    robot: Robot,
    q: FloatArray,
    status: Status,
    distance: float,
    angle: float,
    self_motion: int,
    singular: bool,
) -> str:
    if status is Status.SOLVED and not (self_motion or singular):
        return REACHED
    parts = [REACHED if status.solved else status.sentence]
    if status is Status.ORIENTATION_MISSED:
        parts.append(f"The orientation is missed by {np.degrees(angle):.4g} deg.")
    elif status is not Status.SOLVED:
        turn = f" and {np.degrees(angle):.4g} deg" if angle else ""
        parts.append(f"The target is missed by {distance:.6g} m{turn}.")
        if distance > FAR_OFF * stretched_out(robot):
            parts.append("That looks like millimetres: positions are in m.")
    if status is Status.LIMITS:
        limits = robot.limits
        held = np.minimum(np.abs(q - limits.q_min), np.abs(q - limits.q_max)) < search.SAME_JOINTS
        names = [name for name, at in zip(robot.joint_names, held, strict=True) if at]
        parts.append(f"At its limit: {', '.join(names)}." if names else "")
    if self_motion:
        parts.append(
            f"The joints can move in {self_motion} direction{'s' if self_motion > 1 else ''} while "
            "the tool stays: this is one point of a continuum."
        )
    elif singular and status is Status.SOLVED:
        parts.append("The arm is singular here: branches meet, or a direction of motion is lost.")
    return " ".join(part for part in parts if part)
