"""One solution or every branch for a pose of the tool, with a status that says what was found."""

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
    """Return joint positions that bring the tool to a position and, if asked, an orientation.

    Parameters
    ----------
    robot : Robot
        Its position limits hold.
    position : array_like [3]
        Tool origin in the base frame, m.
    orientation : array_like [3,3], optional
        Rotation of the tool in the base frame. Where the arm lacks the freedom the position is
        held and the least angle to the orientation is sought.
    seed : array_like [n], optional
        Joint positions, rad (prismatic: m): the search goes downhill from them, which leads to the
        branch nearest to them if they are close to it, and on a continuum to about the nearest
        point. Where it leads nowhere, starts farther and farther off follow, then a search of all
        branches. Default: of all branches the most central one.
    time_limit : float
        Wall time, s, after which what is not found yet has the status "time limit".

    Returns
    -------
    IKSolution
        Always; a target that is not reached has a status, the nearest pose and a sentence.

    Raises
    ------
    InputError
        Wrong shapes, numbers that are not finite, a matrix that is not a rotation.

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
        Its position limits hold.
    positions : array_like [N,3]
        Tool origins in the base frame, m.
    orientations : array_like [N,3,3], optional
        Rotations of the tool in the base frame.
    seeds : array_like [N,n] or [n], optional
        One a target, or one for all, rad (prismatic: m). Default: the middle of the limits.
    time_limit : float
        Wall time, s, after which what is not found yet has the status "time limit".

    Returns
    -------
    tuple of IKSolution, N

    Raises
    ------
    InputError
        As for :func:`solve_ik`.

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


PART = 64  # targets that are solved at once where there is a time limit


def _in_parts(solve: Callable[..., Any], time_limit: float, *rows: FloatArray) -> tuple[Any, ...]:
    """Return what is solved of rows of targets (and seeds), part after part until the time is
    over.
    """
    with deadline.within(time_limit):
        count = len(rows[0])
        size = PART if np.isfinite(deadline.until()) else count
        parts = [slice(k, k + size) for k in range(0, count, size)]
        return tuple(chain(*(solve(*(each[part] for each in rows)) for part in parts)))


def _given_up(robot: Robot, targets: FloatArray) -> list[IKSolution]:
    still = np.zeros(len(targets), dtype=int)
    q = np.tile(search.middle(robot), (len(targets), 1))
    return _solutions(robot, targets, q, still, 0.0, Status.TIME_LIMIT)


def _from_seeds(robot: Robot, targets: FloatArray, seeds: FloatArray) -> tuple[IKSolution, ...]:
    """Return downhill from the seeds [N,n]; by a search of all branches where that fails."""
    begin = time.perf_counter()
    if deadline.over():
        return tuple(_given_up(robot, targets))
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
    position : array_like [3]
        Tool origin in the base frame, m.
    orientation : array_like [3,3], optional
        Rotation of the tool in the base frame.
    time_limit : float
        Wall time, s, after which what is not found yet has the status "time limit".

    Returns
    -------
    tuple of IKSolution
        The most central first. Branches are told apart modulo a turn; each is given as near to the
        middle of the limits as whole turns allow. A continuum (``self_motion`` above 0: redundant
        arms, some singular poses) is given by its members that are locally nearest to the middle.
        Never empty: where no branch exists, the one entry is the nearest pose and its status says
        why.

    Raises
    ------
    InputError
        As for :func:`solve_ik`.

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
        For every target what :func:`solve_ik_all` returns.

    Raises
    ------
    InputError
        As for :func:`solve_ik`.
    """
    targets = checked_targets(positions, orientations)
    return _in_parts(partial(_branches, robot), time_limit, targets)


def _branches(robot: Robot, targets: FloatArray) -> tuple[tuple[IKSolution, ...], ...]:
    begin = time.perf_counter()
    if deadline.over():
        return tuple((solution,) for solution in _given_up(robot, targets))
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
            solutions[index].append(_missed(robot, targets[index], branches, wanted, share))
    return tuple(map(tuple, solutions))


def branches_by_nlp(
    robot: Robot, position: ArrayLike, orientation: ArrayLike | None = None, starts: int = 32
) -> FloatArray:
    """Give branches [K,n] by an NLP alone: slower than :func:`solve_ik_all` and independent of it.

    From each of ``starts`` evenly spread starts IPOPT seeks the joints nearest to it that meet the
    target within the limits; answers are verified by forward kinematics and told apart modulo a
    turn.
    """
    return search.by_nlp(robot, checked_target(position, orientation), starts)


def nearest_solution(
    robot: Robot, target: FloatArray, seed: FloatArray | None, begin: float
) -> IKSolution:
    """Return the solution of a checked target nearest to the seed [n] (default: the middle of
    limits).
    """
    wanted = search.middle(robot) if seed is None else np.array(seed)
    branches = search.find_branches(robot, target[None])[0]
    rows, inside = search.within_limits(robot, branches.q, wanted)
    rows, motions = rows[inside], branches.self_motion[inside]
    if seed is not None and (motions.any() or not len(rows)):
        rows, motions = _nearer_members(robot, target, rows, motions, wanted)
    if not len(rows):
        return _missed(robot, target, branches, wanted, time.perf_counter() - begin)
    chosen = [np.argmin(np.linalg.norm((rows - wanted) / joint_scale(robot), axis=1))]
    used = time.perf_counter() - begin
    return _solutions(robot, target[None], rows[chosen], motions[chosen], used)[0]


def _nearer_members(
    robot: Robot, target: FloatArray, rows: FloatArray, motions: np.ndarray, wanted: FloatArray
) -> tuple[FloatArray, np.ndarray]:
    """Return solutions [K,n] with those of continua moved to where they are nearest to ``wanted``.

    What lies straight downhill from ``wanted`` is added: a representative may sit on another part
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


FAR_OFF = 10.0  # times the stretched arm: a target that far off is in another unit
FARTHEST = 1e6  # m; beyond, nothing is left of a reach in double precision


def checked_target(position: ArrayLike, orientation: ArrayLike | None) -> FloatArray:
    """Return the row [3] or [12] of a checked position [3] and orientation [3,3]."""
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
    """Return rows [N,3] or [N,12] of checked positions [N,3] and orientations [N,3,3]."""
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
    """Return columns [N,9] of rotations [N,3,3], made exact; ``name`` has a place for the index."""
    # The nearest true rotation: digits lost in a file must not keep a pose from being reached.
    left, _, right = np.linalg.svd(checked_rotations(name, turns))
    return (left @ right).swapaxes(1, 2).reshape(-1, 9)


def _missed(
    robot: Robot, target: FloatArray, branches: search.Found, wanted: FloatArray, used: float
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
        return False  # the search has looked beyond the limits already
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
    """Give one solution a row of targets [K,w] and q [K,n], measured anew; motions [K] if known."""
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
        held = np.minimum(np.abs(q - limits.q_min), np.abs(q - limits.q_max)) < 1e-6
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
