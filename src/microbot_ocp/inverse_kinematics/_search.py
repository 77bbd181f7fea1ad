"""Search of solutions from seeds, and of every branch of many targets, by one compiled descent.

Completeness: starts are added until several of them led to every branch found. For arms of revolute
joints with as many joints as equations, the signs of the Jacobian's determinant over all branches
must also add up to zero: the joint angles form a compact torus, the poses are not compact, so the
map between them has degree zero. A missed branch leaves a remainder.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.quasi_random import quasi_random
from microbot_ocp.inverse_kinematics import _kernels as kernels
from microbot_ocp.inverse_kinematics._result import read_only
from microbot_ocp.robot import Robot

POSE_TOLERANCE = 1e-8  # largest error of a solution, m and rad
CONTINUUM_SAMPLES = 12  # solutions that represent a continuum
SAME_JOINTS = 1e-5  # joint difference that counts as zero, rad (prismatic: share of the reach)
# Joint difference up to which two solutions may be one root, or stand for one place of a continuum.
NEARBY = 0.02

SEARCH = kernels.Descent(patience=16, polish=2)
SLIDE = kernels.Descent(nearest=70, polish=2)  # reaches a target and slides along its continuum
DOWNHILL = kernels.Descent()  # approaches a target that may be out of reach
# The attempts start at the seed, then farther and farther away. Half of the starts reach most
# targets; within limits a few targets of a 7R arm need 200 starts, more than a search of all
# branches would try.
FROM_SEED = kernels.Descent(attempts=100, patience=24, polish=2, nearest=10)


@dataclass
class BranchSet:
    """Solutions q [K,n] of one target, with the number of self-motions of each [K].

    ``reached`` is True if any start reached the target; a continuum may be reached without a member
    inside the limits.
    """

    q: FloatArray
    self_motion: np.ndarray
    reached: bool


@lru_cache(maxsize=64)
def middle(robot: Robot) -> FloatArray:
    """Return the middle of the joint limits [n]; with an open side, the value nearest to zero."""
    lower, upper = robot.limits.bounds("q")
    closed = np.isfinite(lower) & np.isfinite(upper)
    half = (np.where(closed, lower, 0.0) + np.where(closed, upper, 0.0)) / 2
    return read_only(np.where(closed, half, np.clip(0.0, lower, upper)))


@lru_cache(maxsize=64)
def start_range(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Return the range of starts: the limits, at most half a turn (the reach) from the middle."""
    around = np.where(robot.whole_turns, np.pi, kernels.reach(robot))
    lower, upper = robot.limits.bounds("q")
    low = np.maximum(lower, middle(robot) - around)
    return read_only(low), read_only(np.minimum(upper, middle(robot) + around))


def difference(robot: Robot, ours: FloatArray, theirs: FloatArray) -> FloatArray:
    """Return joint differences: revolute ones modulo a turn, prismatic ones over the reach."""
    gap = ours - theirs
    turned = (gap + np.pi) % (2 * np.pi) - np.pi
    return np.where(robot.whole_turns, turned, gap / kernels.joint_scale(robot))


def within_limits(robot: Robot, q: FloatArray, near: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Move joints [K,n] by full turns into the limits, nearest to ``near``; return success [K]."""
    lower, upper = robot.limits.bounds("q")
    turn = 2 * np.pi
    slack = ROUNDING
    first = np.ceil((lower - slack - q) / turn)
    last = np.floor((upper + slack - q) / turn)
    wished = np.round((near - q) / turn)
    moved = q + turn * np.where(
        robot.whole_turns, np.clip(wished, first, np.maximum(first, last)), 0.0
    )
    inside = (moved >= lower - slack) & (moved <= upper + slack)
    return np.clip(moved, lower, upper), np.asarray(inside.all(axis=-1))


def goal(robot: Robot) -> float:
    """Return the scaled error of a solution that is within both tolerances."""
    return POSE_TOLERANCE / max(1.0, kernels.reach(robot))


def descend(
    robot: Robot,
    q: FloatArray,
    targets: FloatArray,
    bounds: tuple[FloatArray, FloatArray] | None = None,
    given: kernels.Descent = SEARCH,
    wanted: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Run every start [B,n] towards its target [B,w]; return q [B,n] and scaled errors [B]."""
    unlimited = np.full(robot.joint_count, np.inf)
    lower, upper = (-unlimited, unlimited) if bounds is None else bounds
    state = np.concatenate([q, np.zeros((len(q), 3))], axis=1)
    ended, _, errors = kernels.descent(robot, targets.shape[1])(
        state, targets, q if wanted is None else wanted, lower, upper, *start_range(robot), given
    )
    return np.ascontiguousarray(ended[:, :-3]), errors[:, 0]


REDUNDANT_ATTEMPTS = 2000  # starts of a redundant arm


def descend_from(
    robot: Robot, seeds: FloatArray, targets: FloatArray
) -> tuple[FloatArray, np.ndarray]:
    """Find solutions [N,n] within limits from seeds [N,n]; return a mask of those that succeed."""
    bounds, given = robot.limits.bounds("q"), FROM_SEED
    clipped = np.clip(seeds, *bounds)
    if robot.joint_count > kernels.generic_rank(robot, targets.shape[1]):
        given = given._replace(attempts=REDUNDANT_ATTEMPTS)
    q, errors = descend(robot, clipped, targets, bounds, given, clipped)
    return q, errors < goal(robot)


def task_errors(robot: Robot, q: FloatArray, targets: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return distances (m) and angles (rad) [B] between the tool at q [B,n] and targets [B,w]."""
    return pose_errors(kernels.pose_of(robot)(np.ascontiguousarray(q)), targets)


def pose_errors(poses: FloatArray, targets: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return distances (m) and angles (rad) [B] between poses [B,4,4] and targets [B,w]."""
    distance = np.linalg.norm(targets[:, :3] - poses[:, :3, 3], axis=1)
    if targets.shape[1] == 3:
        return distance, np.zeros(len(targets))
    # The columns of a target's rotation are consecutive, so reshaping gives its transpose.
    turn = poses[:, :3, :3] @ targets[:, 3:].reshape(-1, 3, 3)
    twice_sine = np.linalg.norm((turn - turn.swapaxes(1, 2)).reshape(-1, 9), axis=1) / np.sqrt(2)
    return distance, np.arctan2(twice_sine, np.trace(turn, axis1=1, axis2=2) - 1)


def reaches(distance: ArrayLike, angle: ArrayLike) -> np.ndarray:
    """Return a mask of distances (m) and angles (rad) that are within the tolerances."""
    near = np.less(distance, POSE_TOLERANCE)
    return near & np.less(angle, POSE_TOLERANCE)


def clusters(robot: Robot, q: FloatArray, tolerance: float) -> tuple[FloatArray, np.ndarray]:
    """Return one row for every different solution in q [B,n], and its number of occurrences."""
    rows, _, met = _clusters_of_each(robot, q[None], np.ones((1, len(q)), dtype=bool), tolerance)
    return rows, met


def _clusters_of_each(
    robot: Robot, q: FloatArray, left: np.ndarray, tolerance: float
) -> tuple[FloatArray, np.ndarray, np.ndarray]:
    """Group the equal solutions of T targets, among those of q [T,B,n] marked ``left``.

    Returns rows [K,n], their targets [K] in order, and their numbers of occurrences.
    """
    turn = np.where(robot.whole_turns, 2 * np.pi, np.inf)
    place, which = difference(robot, q, middle(robot)), np.arange(len(q))
    targets, firsts, met = [[np.zeros(0, dtype=int)] for _ in range(3)]
    row = which
    while np.count_nonzero(left):
        first = left.argmax(axis=1)
        some = left[row, first]
        if np.count_nonzero(some) < some.size:
            which, place, left, first = (table[some] for table in (which, place, left, first))
            row = np.arange(len(which))
        gap = np.abs(place - place[row, first][:, None])
        same = (np.minimum(gap, turn - gap) < tolerance).all(axis=2) & left
        left = left ^ same
        for table, values in ((targets, which), (firsts, first), (met, same.sum(axis=1))):
            table.append(values)
    owners = np.concatenate(targets)
    order = np.argsort(owners, kind="stable")
    owners = owners[order]
    return q[owners, np.concatenate(firsts)[order]], owners, np.concatenate(met)[order]


def _merge_doubles(
    robot: Robot, q: FloatArray, owners: np.ndarray, met: np.ndarray, targets: FloatArray
) -> tuple[FloatArray, np.ndarray, np.ndarray]:
    """Merge solutions of a target whose midpoint is a solution, too: a doubled root."""
    counts = np.bincount(owners)
    one, other = np.triu_indices(counts.max(initial=0), 1)
    block, pair = np.nonzero(other < counts[:, None])
    begins = np.cumsum(counts) - counts
    pairs = begins[block, None] + np.array([one, other]).T[pair]
    gaps = np.abs(difference(robot, q[pairs[:, 0]], q[pairs[:, 1]])).max(axis=1)
    # Near a doubled root the error is quadratic, so even the midpoint is within the tolerance.
    pairs = pairs[gaps < NEARBY]
    if not len(pairs):
        return q, owners, met
    between = q[pairs[:, 0]] + difference(robot, q[pairs[:, 1]], q[pairs[:, 0]]) * (
        kernels.joint_scale(robot) / 2
    )
    one = reaches(*task_errors(robot, between, targets[owners[pairs[:, 0]]]))
    single = np.ones(len(q), dtype=bool)
    for first, second in pairs[one]:
        if single[first] and single[second]:
            met[first] += met[second]
            single[second] = False
    return q[single], owners[single], met[single]


def ranks(robot: Robot, q: FloatArray, width: int) -> np.ndarray:
    """Return the ranks [K] of the task's Jacobian at q [K,n]."""
    return _rank(np.linalg.svd(kernels.scaled_jacobian(robot, q, width), compute_uv=False))


def _rank(values: np.ndarray) -> np.ndarray:
    """Return the ranks [K] of matrices with these singular values [K,m]."""
    return (values > kernels.RANK_TOLERANCE * np.maximum(values[:, :1], ROUNDING)).sum(axis=1)


PROBE_STEP = 0.05  # step along a suspected self-motion, rad (prismatic: share of the reach)


def self_motions(robot: Robot, q: FloatArray, targets: FloatArray, rank: np.ndarray) -> np.ndarray:
    """Return the numbers [K] of directions in which joints can move at q [K,n] with a fixed tool.

    ``targets`` [K,w] are reached at q, ``rank`` [K] is the rank of the Jacobian there. At the
    generic rank the solutions form a manifold whose dimension is the number of null directions. At
    a lower rank null directions may be tangent only, as at a doubled root, so a step along each is
    taken and brought back to the target.
    """
    count, width = robot.joint_count, targets.shape[1]
    generic = kernels.generic_rank(robot, width)
    dimensions = np.where(rank == generic, count - generic, 0)
    lost = np.flatnonzero(rank < generic)
    if not lost.size:
        return dimensions
    _, _, right = np.linalg.svd(kernels.scaled_jacobian(robot, q[lost], width), full_matrices=True)
    owners = [(i, k) for i, row in enumerate(lost) for k in range(rank[row], count)]
    rows = lost[[i for i, _ in owners]]
    along = np.array([right[i, k] for i, k in owners])
    # A step along a tangent of a doubled root returns to the root; on a continuum it stays away.
    start = q[rows] + PROBE_STEP * along * kernels.joint_scale(robot)
    ended, errors = descend(robot, start, targets[rows])
    moved = difference(robot, ended, q[rows]) / PROBE_STEP
    for row in set(rows.tolist()):
        mine = moved[(rows == row) & (errors < goal(robot))]
        if len(mine):
            sizes = np.linalg.svd(mine, compute_uv=False)
            dimensions[row] = int((sizes > 0.3).sum())
    return dimensions


def motions_of_one(robot: Robot, q: FloatArray, target: FloatArray) -> np.ndarray:
    """Return the :func:`self_motions` at solutions q [K,n] of one target [w]."""
    return self_motions(robot, q, np.tile(target, (len(q), 1)), ranks(robot, q, target.size))


def _farthest_points(robot: Robot, q: FloatArray, count: int) -> FloatArray:
    """Choose at most ``count`` rows of q by farthest-point sampling, from the most central one."""
    central = np.abs(difference(robot, q, middle(robot))).max(axis=1)
    chosen = [int(np.argmin(central))]
    far = np.full(len(q), np.inf)
    while len(chosen) < min(count, len(q)):
        far = np.minimum(far, np.linalg.norm(difference(robot, q, q[chosen[-1]]), axis=1))
        chosen.append(int(np.argmax(far)))
    return q[chosen]


def nearest_on_continuum(
    robot: Robot, starts: FloatArray, target: FloatArray, wanted: FloatArray
) -> list[FloatArray | None]:
    """Find the joints nearest to ``wanted`` on the self-motion through each of ``starts`` [K,n].

    The joints are within limits; an entry is None if none are found.
    """
    bounds = robot.limits.bounds("q")
    q = np.clip(starts, *bounds)
    quick, errors = descend(robot, q, np.tile(target, (len(q), 1)), bounds, SLIDE, wanted)
    near = (errors < goal(robot)) & _are_nearest(robot, quick, target, wanted)
    return [
        nearest if good else _nearest_slowly(robot, start, target, wanted)
        for start, nearest, good in zip(q, quick, near, strict=True)
    ]


def _nearest_slowly(
    robot: Robot, q: FloatArray, target: FloatArray, wanted: FloatArray
) -> FloatArray | None:
    for _ in range(2):  # the second pass has the independent equations of the first result
        rank = max(1, int(ranks(robot, q[None], target.size)[0]))
        if rank >= robot.joint_count:
            break
        answer = nearest_by_nlp(robot, q, target, wanted, rank)
        polished, errors = descend(robot, answer, target[None], robot.limits.bounds("q"))
        if errors[0] > goal(robot):
            break
        q = polished[0]
        if _are_nearest(robot, polished, target, wanted)[0]:
            return q
    return _slide(robot, q, target, wanted)


def _are_nearest(robot: Robot, q: FloatArray, target: FloatArray, wanted: FloatArray) -> np.ndarray:
    """Return a mask of q [K,n] that are nearest to ``wanted`` on their self-motion, to first order.

    Karush, Kuhn and Tucker: wanted - q is a combination of the rows of the task's Jacobian, except
    at joints on a limit beyond which it points.
    """
    rows = kernels.scaled_jacobian(robot, q, target.size).swapaxes(1, 2)
    missing = (wanted - q) / kernels.joint_scale(robot)
    at_lower, at_upper = q <= robot.limits.q_min, q >= robot.limits.q_max
    free = ~(at_lower | at_upper)[..., None]
    weakest = kernels.RANK_TOLERANCE
    combination = np.linalg.pinv(rows * free, rcond=weakest) @ (missing[..., None] * free)
    left = missing - (rows @ combination)[..., 0]
    beyond = (at_lower & (left < 0)) | (at_upper & (left > 0))
    return np.all((np.abs(left) < SAME_JOINTS) | beyond, axis=1)


def _slide(
    robot: Robot, q: FloatArray, target: FloatArray, wanted: FloatArray
) -> FloatArray | None:
    """Move along the self-motion towards ``wanted`` by small steps while q comes nearer.

    The NLP fails if a doubled root lies on the continuum; this method does not.
    """
    bounds = robot.limits.bounds("q")
    poses, errors = descend(robot, q[None], target[None], bounds)
    if errors[0] > goal(robot):
        return None
    q, scale, length = poses[0], kernels.joint_scale(robot), 0.5
    for _ in range(60):
        _, values, right = np.linalg.svd(kernels.scaled_jacobian(robot, q[None], target.size)[0])
        rank = int(_rank(values[None])[0])
        missing = (wanted - q) / scale
        # Projection of the missing motion onto the null space of the Jacobian.
        along = right[rank:].T @ (right[rank:] @ missing)
        size = float(np.linalg.norm(along))
        if min(size, length) < SAME_JOINTS:
            break
        trial = q + along * min(1.0, length / size) * scale
        poses, errors = descend(robot, np.clip(trial, *bounds)[None], target[None], bounds)
        nearer = np.linalg.norm((wanted - poses[0]) / scale) < np.linalg.norm(missing) - ROUNDING
        if errors[0] < goal(robot) and nearer:
            q = poses[0]
        else:
            length /= 4
    return q


MOST_ROUNDS = 8  # largest number of rounds of starts


def find_branches(robot: Robot, targets: FloatArray) -> list[BranchSet]:
    """Find all solutions of every target [N,w], modulo a turn, without regard to limits.

    Continua (of redundant arms, or self-motions at singularities) are searched within the limits
    and represented by their members nearest to the middle of the limits.
    """
    count, width = robot.joint_count, targets.shape[1]
    rank = kernels.generic_rank(robot, width)
    redundant = count > rank
    balanced_when_complete = bool(robot.whole_turns.all()) and count == rank == min(width, 6)
    low, high = start_range(robot)
    if not redundant:
        # Starts cover every angle, so that solutions beyond the limits balance the degree, too.
        around = np.where(robot.whole_turns, np.pi, 0.0)
        low = np.minimum(low, middle(robot) - around)
        high = np.maximum(high, middle(robot) + around)
    bounds = robot.limits.bounds("q") if redundant else None
    size = 8 * 2 ** min(count, 3)
    pools, good = np.zeros((len(targets), 0, count)), np.zeros((len(targets), 0), dtype=bool)
    answers = [np.zeros((0, count)) for _ in targets]
    jacobian_ranks = [np.zeros(0, dtype=int) for _ in targets]
    pending = np.arange(len(targets))
    for turn in range(MOST_ROUNDS):
        starts = low + (high - low) * quasi_random(size, count, turn * size)
        poses, errors = descend(
            robot, np.tile(starts, (len(pending), 1)), np.repeat(targets[pending], size, 0), bounds
        )
        pools = np.concatenate([pools, poses.reshape(len(pending), size, count)], axis=1)
        good = np.concatenate([good, (errors < goal(robot)).reshape(len(pending), size)], axis=1)
        groups = _clusters_of_each(robot, pools, good, SAME_JOINTS)
        q, owners, met = _merge_doubles(robot, *groups, targets[pending])
        jacobians = kernels.scaled_jacobian(robot, q, width)
        values = np.linalg.svd(jacobians, compute_uv=False)
        rank, ends = _rank(values), np.searchsorted(owners, np.arange(len(pending) + 1))
        still = []
        for row, index in enumerate(pending):
            part = slice(ends[row], ends[row + 1])
            answers[index], jacobian_ranks[index] = q[part], rank[part]
            if not (
                len(q[part]) >= CONTINUUM_SAMPLES
                if redundant and len(q[part])
                else _complete(
                    jacobians[part], values[part], met[part], turn, balanced_when_complete
                )
            ):
                still.append(row)
        pending = pending[still]
        if not pending.size or deadline.over():
            break
        pools, good = pools[still], good[still]
    for index in pending if redundant else ():
        if not len(answers[index]) and not deadline.over():
            q, reached = descend_from(robot, middle(robot)[None], targets[index : index + 1])
            answers[index], jacobian_ranks[index] = q[reached], ranks(robot, q[reached], width)
    found_all = zip(answers, jacobian_ranks, targets, strict=True)
    return [_with_representatives(robot, q, rank, target) for q, rank, target in found_all]


MEETINGS = 4  # starts that must lead to every branch before the search ends


def _complete(
    jacobians: FloatArray, values: np.ndarray, met: np.ndarray, turn: int, balanced: bool
) -> bool:
    """Return True if isolated solutions, each with its number of occurrences [K], are likely all.

    ``jacobians`` [K,m,n] and their singular values ``values`` belong to the solutions.
    """
    if not len(met):
        return turn > 0
    conditions = values[:, -1] / np.maximum(values[:, 0], ROUNDING)
    if values.shape[1] < jacobians.shape[2] or conditions.min() < kernels.RANK_TOLERANCE:
        # A continuum gives new solutions in every round, so only isolated ones must recur.
        isolated = conditions >= kernels.RANK_TOLERANCE
        return turn > 0 and bool(np.all(met[isolated] >= MEETINGS))
    if met.min() < MEETINGS:
        return False
    if not balanced:
        return True
    # Degree zero: the determinants of all solutions have as many positive as negative signs.
    return abs(np.sign(np.linalg.det(jacobians)).sum()) < 0.5


def _with_representatives(
    robot: Robot, q: FloatArray, rank: np.ndarray, target: FloatArray
) -> BranchSet:
    """Replace the members of continua among q [K,n] by representatives; isolated ones stay.

    ``rank`` [K] is the rank of the Jacobian at q.
    """
    if not len(q):
        return BranchSet(q, np.zeros(0, dtype=int), False)
    deficient = rank < robot.joint_count
    isolated, suspects = q[~deficient], q[deficient]
    if not len(suspects):
        return BranchSet(q, np.zeros(len(q), dtype=int), True)
    suspects = _farthest_points(robot, suspects, CONTINUUM_SAMPLES)
    motion = motions_of_one(robot, suspects, target)
    doubled = suspects[motion == 0]
    begins, _ = within_limits(robot, suspects[motion > 0], middle(robot))
    nearest = nearest_on_continuum(robot, begins, target, middle(robot))
    settled = [best for best in nearest if best is not None]
    central = np.array(settled).reshape(-1, robot.joint_count)
    order = np.argsort(np.linalg.norm(difference(robot, central, middle(robot)), axis=1))
    central, _ = clusters(robot, central[order], NEARBY)
    everything = np.concatenate([isolated, doubled, central])
    moves = np.zeros(len(everything), dtype=int)
    if len(central):
        moves[len(isolated) + len(doubled) :] = motions_of_one(robot, central, target)
    return BranchSet(everything, moves, True)


def nearest_pose(
    robot: Robot, target: FloatArray, start: FloatArray | None = None
) -> tuple[FloatArray, bool]:
    """Find the pose of least distance, then least angle, within limits; return q and convergence.

    The search begins at ``start`` [n], or at many starts. The distance has priority: the angle has
    a weight of a thousandth, and in the end the position is solved alone.
    """
    bounds = robot.limits.bounds("q")
    low, high = start_range(robot)
    weight = 1e-3 if target.size == 12 else 1.0
    count = 64
    starts = low + (high - low) * quasi_random(count, robot.joint_count)
    if start is None:
        poses, errors = descend(
            robot, starts, np.tile(target, (count, 1)), bounds, DOWNHILL._replace(weight=weight)
        )
        poses, _ = clusters(robot, poses[np.argsort(errors)], 0.1)
    else:
        poses = np.array(start)[None]
    solve = kernels.nearest_pose_nlp(robot, target.size)
    best, best_key, converged = poses[0], (np.inf, np.inf), False
    for index, begin in enumerate(poses[: 4 if target.size == 3 else 8]):
        if index and deadline.over():
            break
        q, ended = begin, True
        for share in (weight, 0.0) if target.size == 12 else (weight,):
            answer = solve(x0=q, p=np.append(target, share), lbx=bounds[0], ubx=bounds[1])
            q = np.clip(np.array(answer["x"]).ravel(), *bounds)
            ended = bool(solve.stats()["success"]) or _stationary(robot, q, target)
            if share == weight:  # a reachable position is reached exactly
                closer, errors = descend(robot, q[None], target[None, :3], bounds)
                if errors[0] < goal(robot):
                    q, ended = closer[0], True
                    break
        distance, angle = (x[0] for x in task_errors(robot, q[None], target[None]))
        # Distances that agree within a tolerance leave the decision to the angle.
        key = (round(distance / (POSE_TOLERANCE * kernels.reach(robot))), angle)
        if key < best_key:
            best, best_key, converged = q, key, ended
    wished = middle(robot) if start is None else start
    return within_limits(robot, best[None], wished)[0][0], converged


def _stationary(robot: Robot, q: FloatArray, target: FloatArray) -> bool:
    """Return True if no joint inside its limits brings the tool nearer, to first order.

    IPOPT often stops short of its tolerance at a degenerate optimum, such as a stretched arm.
    """
    offset = (target[:3] - kernels.pose_of(robot)(q)[:3, 3]) / kernels.reach(robot)
    downhill = kernels.scaled_jacobian(robot, q[None], 3)[0].T @ offset
    limits = robot.limits
    slack = SAME_JOINTS * kernels.joint_scale(robot)
    held = ((q <= limits.q_min + slack) & (downhill < 0)) | (
        (q >= limits.q_max - slack) & (downhill > 0)
    )
    free = np.abs(np.where(held, 0.0, downhill)).max()
    return bool(free < SAME_JOINTS * max(float(np.linalg.norm(offset)), ROUNDING))


def nearest_by_nlp(
    robot: Robot, start: FloatArray, target: FloatArray, wanted: FloatArray, rank: int
) -> FloatArray:
    """Solve the NLP of the joints [1,n] nearest to ``wanted``, with rank-reduced constraints."""
    # Left singular vectors of the largest singular values combine the independent equations.
    left, _, _ = np.linalg.svd(kernels.scaled_jacobian(robot, start[None], target.size)[0])
    parameters = np.concatenate([target, wanted, left[:, :rank].T.ravel("F")])
    low, high = robot.limits.bounds("q")
    solve = kernels.nearest_joints_nlp(robot, target.size, rank)
    answer = solve(x0=start, p=parameters, lbx=low, ubx=high, lbg=0.0, ubg=0.0)
    return np.array(answer["x"]).T
