"""Ways of a task through the branches of the inverse kinematics.

Every stop has the branches that reach it. A tool line or circle connects a branch at its start to
the branch at its end. Ways through all stops are sorted by a rough estimate of their duration, and
the solver starts from the best way through each branch.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.inverse_kinematics import (
    IKPath,
    IKSolution,
    follow_ik,
    solve_ik_all,
    solve_ik_each,
    start_range,
)
from microbot_ocp.limits import MotionSamples
from microbot_ocp.motion import PiecewisePolynomial, polynomial_of
from microbot_ocp.planning.path import time_path
from microbot_ocp.planning.task import (
    EXACT_TOLERANCE,
    TYPICAL_SPEED,
    Circle,
    Line,
    Stop,
    Task,
    check_held,
    fastest_tool,
    length_text,
    reach_of,
)
from microbot_ocp.robot import Robot, forward_kinematics, jacobian
from microbot_ocp.trajectories import spline

TURNS = 8  # tool orientations tried about a free axis
ROWS = 33  # poses at which a tool line is followed
SAME_BRANCH = 0.05  # largest joint difference of two poses on one branch, rad (m)
APART = 0.9  # largest joint difference at the stops of two ways to one optimum, rad (m)
MOST_WAYS = 12
SLIDING = 1.03  # assumed gain in the bound of a redundant arm that slides to another pose
FURTHER_POSES = 64  # poses at random of a redundant arm at a stop among obstacles
REDUNDANT = 1e-4  # singular value of the tool Jacobian of a redundant direction, per reach
Poses = list[FloatArray]  # one joint pose [n] per branch
Picks = tuple[int, ...]  # number of the branch at each stop
Joined = dict[tuple[int, int], FloatArray | None]  # branches at both ends: joint path, if known

_even = np.linspace(0.0, 1.0, ROWS)
EASED = _even**3 * (10.0 - 15.0 * _even + 6.0 * _even**2)  # quintic from rest to rest
WEIGHTS = np.geomspace(100.0, 1.0, 5)  # damping, tolerances per rad (m): decreasing, as in LM


@dataclass(frozen=True, eq=False)
class Way:
    """Branches at the stops, and the joint paths between them.

    Attributes
    ----------
    via : array [m,n], rad (m)
        Joint poses at the stops.
    paths : tuple of array [N,n]
        Joint positions along every segment from rest to rest, at even times, rad (m).
    branches : tuple of int
        Number of the branch at each stop, from 1; 1 for a given joint pose.
    """

    via: FloatArray
    paths: tuple[FloatArray, ...]
    branches: tuple[int, ...]

    @property
    def name(self) -> str:
        """Name with the branch at each stop, such as "branches 1-3-3-1"."""
        return "branches " + "-".join(map(str, self.branches))


def straight_way(via: FloatArray) -> Way:
    """Return the way along straight joint segments between poses [m,n], rad (m)."""
    paths = (a + EASED[:, None] * (b - a) for a, b in itertools.pairwise(via))
    return Way(via, tuple(paths), (1,) * len(via))


def ways_through(task: Task, is_free: Callable[[int, FloatArray], bool] | None = None) -> list[Way]:
    """Return ways through every branch of every stop, the shortest estimated duration first.

    ``is_free`` tells, of the number of a stop and a pose [n], if the arm touches nothing there. A
    redundant arm then has further poses at the stop, from which the free ones are chosen. A stop
    without a free pose keeps all its branches.

    Raises
    ------
    InputError
        A stop is out of reach, or no branch follows a tool line.
    """
    nodes = [list(_branches(task.robot, stop)) for stop in task.stops]
    if is_free is not None:
        more = (_spread_poses(task.robot, stop) for stop in task.stops)
        free = ([q for q in poses if is_free(k, q)] for k, poses in enumerate(more))
        nodes = [poses or every for poses, every in zip(free, nodes, strict=True)]
    nodes = [_held_at_rest(task, index, poses) for index, poses in enumerate(nodes)]
    if task.cycle:
        nodes[-1] = nodes[0] = _held_at_rest(task, len(nodes) - 1, nodes[0])
    edges: list[Joined] = []
    for index, kind in enumerate(task.segments):
        if isinstance(kind, Line | Circle):
            nodes[index], nodes[index + 1], joint_paths = _followed(task, index, nodes)
            edges.append(joint_paths)
        else:
            edges.append(_free(nodes[index], nodes[index + 1]))
    if task.cycle and len(nodes[-1]) != len(nodes[0]):
        nodes[0] = nodes[-1]  # a line may have added branches of the first stop
    candidates = [_realised(task, nodes, edges, picks) for picks in _picks(task, nodes, edges)]
    ways = [way for way in candidates if way is not None]
    ways.sort(key=lambda way: _time(way, _speeds(task.robot)))
    if not ways:
        raise InputError(
            "no branch of the arm leads through all stops: a tool line ends on a branch "
            "on which the next one cannot begin"
        )
    # Ways that are near at every stop lead to one optimum.
    chosen: list[Way] = []
    for way in ways:
        if all(np.abs(way.via - other.via).max() > APART for other in chosen):
            chosen.append(way)
    return chosen[:MOST_WAYS]


def _free(starts: Poses, ends: Poses) -> Joined:
    """Return all pairs of branches at two stops, without joint paths."""
    return dict.fromkeys(itertools.product(range(len(starts)), range(len(ends))))


# branches of a stop -------------------------------------------------------------------------------


@lru_cache(maxsize=256)
def few_poses(robot: Robot, stop: Stop) -> FloatArray | None:
    """Return the joint poses [k,n] of a stop, rad (m); None if there are infinitely many.

    A joint pose with a tolerance counts as its middle. A tool pose has finitely many poses if the
    Jacobian of the given components has full column rank in each of them.
    """
    if stop.q is not None:
        return np.array([stop.q])
    if np.any(stop.slack) or stop.orientation_tolerance or stop.free_turn:
        return None
    try:
        poses = np.array(_branches(robot, stop))
    except InputError:
        return None
    rows = 3 if stop.orientation is None else 6
    for q in poses:
        slopes = np.array(jacobian(robot)(q))[:rows]
        # Rotations times the reach have the unit of translations, m.
        slopes[3:] *= reach_of(robot)
        least = REDUNDANT * reach_of(robot)
        if np.linalg.matrix_rank(slopes, tol=least) < robot.joint_count:
            return None
    return poses


@lru_cache(maxsize=256)
def _branches(robot: Robot, stop: Stop) -> tuple[FloatArray, ...]:
    if stop.q is not None:
        return (np.array(stop.q),)
    assert stop.position is not None
    place, turned = stop.pose(robot)
    poses: list[FloatArray] = []
    missed: list[IKSolution] = []
    for orientation in _turned(turned, stop.free_axis):
        for solution in solve_ik_all(robot, place, orientation):
            if not solution.solved and not _within(stop, solution):
                missed.append(solution)
            elif all(np.abs(solution.q - other).max() > SAME_BRANCH for other in poses):
                poses.append(solution.q)
    if not poses:
        raise InputError(_out_of_reach(robot, stop, missed))
    return tuple(poses)


@lru_cache(maxsize=256)
def _spread_poses(robot: Robot, stop: Stop) -> tuple[FloatArray, ...]:
    """Return the branches at a stop, and further poses at random if there are infinitely many."""
    branches = _branches(robot, stop)
    if few_poses(robot, stop) is not None:
        return branches
    place, turned = stop.pose(robot)
    size = FURTHER_POSES, robot.joint_count
    seeds = np.random.default_rng(0).uniform(*start_range(robot), size)
    orientations: Any = None
    if turned is not None:
        about_axis = itertools.cycle(_turned(turned, stop.free_axis))
        orientations = list(itertools.islice(about_axis, FURTHER_POSES))
    found = solve_ik_each(robot, np.tile(place, (FURTHER_POSES, 1)), orientations, seeds)
    return (*branches, *(solution.q for solution in found if solution.solved))


def _held_at_rest(task: Task, index: int, poses: Poses) -> Poses:
    """Return the poses of a stop in which the torques hold the arm; all if the stop is not exact.

    Raises
    ------
    InputError
        The torques hold none of the poses.
    """
    stop = task.stops[index]
    given = 3 if stop.orientation is None else 6 - (stop.free_turn is not None)
    exact = np.all(np.array(stop.tolerance) == 0.0) and stop.orientation_tolerance == 0.0
    if stop.q is not None or not exact or task.robot.joint_count > given:
        return poses
    held, refused = [], None
    for q in poses:
        try:
            check_held(task, index, q)
            held.append(q)
        except InputError as problem:
            refused = refused or problem
    if not held:
        assert refused is not None
        raise refused
    return held


def _turned(turned: FloatArray | None, axis: int | None) -> list[FloatArray | None]:
    """Return the orientation, or several about a free axis of the tool."""
    if turned is None or axis is None:
        return [turned]
    angles = 2 * np.pi * np.arange(TURNS) / TURNS
    return [turned @ _about(axis, angle) for angle in angles]


def _about(axis: int, angle: float) -> FloatArray:
    """Return the rotation [3,3] by an angle, rad, about a coordinate axis."""
    rotation = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotation[[i, j], [i, j]] = np.cos(angle)
    rotation[i, j], rotation[j, i] = -np.sin(angle), np.sin(angle)
    return rotation


def _within(stop: Stop, solution: IKSolution) -> bool:
    """Return True if the pose of a failed solution is within the tolerance of its stop."""
    reach = float(np.min(stop.tolerance))
    return (
        solution.position_error <= reach + EXACT_TOLERANCE
        and solution.orientation_error <= stop.orientation_tolerance + ROUNDING
    )


def _out_of_reach(robot: Robot, stop: Stop, missed: Sequence[IKSolution]) -> str:
    best = min(missed, key=lambda s: (s.position_error, s.orientation_error))
    beyond = best.position_error - float(np.min(stop.tolerance))
    far = length_text(beyond) if beyond > EXACT_TOLERANCE else ""
    turned = best.orientation_error - stop.orientation_tolerance
    turn = f"{np.degrees(turned):.3g} deg" if turned > EXACT_TOLERANCE else ""
    if best.status is Status.ORIENTATION_MISSED:
        return f"stop {stop.name!r} is reached, but not in its orientation: missed by {turn}"
    names = _held(robot, best.q) if best.status is Status.LIMITS else []
    at = f": {', '.join(names)} at {'its limit' if len(names) == 1 else 'their limits'}"
    unit = "; that looks like millimetres: positions are in m"
    hint = unit if "millimetres" in best.advice else ""
    return f"stop {stop.name!r} is out of reach by {far or turn}{at if names else ''}{hint}"


def _held(robot: Robot, q: FloatArray) -> list[str]:
    limits = robot.limits
    at = np.minimum(np.abs(q - limits.q_min), np.abs(q - limits.q_max)) < 1e-3
    return [name for name, held in zip(robot.joint_names, at, strict=True) if held]


# tool lines ---------------------------------------------------------------------------------------


def _followed(task: Task, index: int, nodes: list[Poses]) -> tuple[Poses, Poses, Joined]:
    """Return the branches at both ends of a tool line, and the joint paths between them.

    The line is followed from its end if only the end is a joint pose.
    """
    starts, ends = list(nodes[index]), list(nodes[index + 1])
    backwards = task.stops[index + 1].q is not None and task.stops[index].q is None
    origin, target = (ends, starts) if backwards else (starts, ends)
    joint_paths: Joined = {}
    failures: list[tuple[float, str]] = []
    for a, q in enumerate(list(origin)):
        places = _places(task, index, q, backwards)
        poses = follow_ik(task.robot, *places, seed=q)
        near_line = _near_line(task, index, places, q)
        if not poses.solved:
            share, reason = _why(task.robot, poses)
            failures.append((1.0 - share if backwards else share, reason))
        # The exact path and the near one may end on different branches: both are kept.
        for path in (poses.q if poses.solved else None, near_line):
            if path is None:
                continue
            near = [_apart(task.robot, path[-1], other) for other in target]
            if near and min(near) < SAME_BRANCH:
                b = int(np.argmin(near))
            elif task.stops[index if backwards else index + 1].q is None:
                target.append(path[-1])
                b = len(target) - 1
            else:
                why = "it ends on another branch than that of the joint pose there"
                failures.append((1.0, why))
                continue
            pair = (b, a) if backwards else (a, b)
            joint_paths.setdefault(pair, path[::-1] if backwards else path)
    if joint_paths:
        return starts, ends, joint_paths
    curve = task.curves[index]
    if curve is None or curve[1] is None or curve[1].free is None:
        share, reason = max(failures)
        raise InputError(
            f"{task.name_of(index)} not reachable from {share:.2f} of its length: {reason}"
        )
    return starts, ends, _free(starts, ends)  # the solver may find a path by turning the free axis


Places = tuple[FloatArray, FloatArray | None]  # tool positions [N,3], m, and rotations [N,3,3]


def _places(task: Task, index: int, q: FloatArray, backwards: bool) -> Places:
    """Return tool poses along a line that is followed from a joint pose at its start or end."""
    curve = task.curves[index]
    assert curve is not None
    way, turning = curve
    positions, orientations = way.points(EASED), None
    if turning is not None:
        orientations = np.array([np.array(turning.rotation(s)) for s in EASED])
        if turning.free is not None:  # keep the turn that the arm has at the first pose
            tool = np.array(forward_kinematics(task.robot)(q))[:3, :3]
            turn = orientations[-1 if backwards else 0].T @ tool
            i, j = (turning.free + 1) % 3, (turning.free + 2) % 3
            # The rotation about the free axis nearest to R = turn maximises the trace:
            # tan(angle) = (R_ji - R_ij) / (R_ii + R_jj).
            angle = np.arctan2(turn[j, i] - turn[i, j], turn[i, i] + turn[j, j])
            orientations = orientations @ _about(turning.free, angle)
    if backwards:
        positions = positions[::-1]
        orientations = None if orientations is None else orientations[::-1]
    return positions, orientations


def _near_line(task: Task, index: int, places: Places, q: FloatArray) -> FloatArray | None:
    """Return joint poses [N,n] near a tool line from q on; None if they do not reach its end.

    Damped least squares within the tolerances, with small steps between poses. The path passes a
    singular pose on which the exact line would end or turn a joint at once. Source: Buss,
    "Introduction to inverse kinematics with Jacobian transpose, pseudoinverse and damped least
    squares methods".
    """
    kind, robot, (positions, orientations) = task.segments[index], task.robot, places
    assert isinstance(kind, Line | Circle)
    last, path, low, high = len(positions) - 1, [q], robot.limits.q_min, robot.limits.q_max
    sizes = np.repeat([kind.tolerance, kind.orientation_tolerance], 3)
    sizes = sizes[: 3 if orientations is None else 6, None]
    for k in range(1, last):
        here = path[-1]
        for weight in WEIGHTS:
            # Minimise |J step - missed|^2 / tolerance^2 + weight^2 |q - q_previous|^2, by
            # Gauss-Newton: the second term keeps joints near the previous pose.
            pose = np.array(forward_kinematics(robot)(here))
            missed = positions[k] - pose[:3, 3]
            if orientations is not None:
                turn = 0.5 * np.cross(pose[:3, :3].T, orientations[k].T).sum(axis=0)
                missed = np.append(missed, turn)
            rows = np.array(jacobian(robot)(here))[: sizes.size] / sizes
            slope = np.vstack([rows, weight * np.eye(q.size)])
            wanted = np.append(missed / sizes[:, 0], weight * (path[-1] - here))
            here = np.clip(here + np.linalg.lstsq(slope, wanted)[0], low, high)
        path.append(here)
    turned = None if orientations is None else orientations[last:]
    end = follow_ik(robot, positions[last:], turned, seed=path[-1])
    path = np.vstack([*path, end.q])
    if not end.solved or np.abs(np.diff(path, axis=0)).max() > APART:
        return None
    family = task.families[index]
    uses = family.use(MotionSamples.at_rest(path), family.of_order(0)).values()
    return path if max(float(use.max()) for use in uses) <= 1.0 + ROUNDING else None


def _why(robot: Robot, poses: IKPath) -> tuple[float, str]:
    missed = [k for k, status in enumerate(poses.statuses) if not status.solved]
    row = min([*missed, *poses.jumps])
    share = float(EASED[max(row - 1, 0)])
    status = poses.statuses[row]
    if status is Status.OUT_OF_REACH:
        return share, f"out of reach by {1000 * poses.position_error[row]:.3g} mm"
    held = _held(robot, poses.q[row])
    if not held and status.solved:
        held = _held(robot, poses.q[max(row - 1, 0)])
    if held:
        return share, f"limit of {', '.join(held)}"
    if status is Status.LIMITS:
        return share, "a position limit"
    if status.solved:
        return share, "the branch ends there, at a limit or a singular pose"
    missed_by = np.degrees(poses.orientation_error[row])
    return share, f"the orientation is missed by {missed_by:.3g} deg"


def _apart(robot: Robot, q: FloatArray, other: FloatArray) -> float:
    """Return the largest joint difference of two poses modulo full turns, rad (m)."""
    step = q - other
    step = np.where(robot.whole_turns, (step + np.pi) % (2 * np.pi) - np.pi, step)
    return float(np.abs(step).max())


# ways through all stops ---------------------------------------------------------------------------


def _speeds(robot: Robot) -> FloatArray:
    size = np.minimum(-robot.limits.qd_min, robot.limits.qd_max)
    return np.where(np.isfinite(size) & (size > 0), size, TYPICAL_SPEED)


def _near(robot: Robot, q: FloatArray, other: FloatArray) -> FloatArray:
    """Return a pose [n] moved by full turns to be nearest to another, within the limits."""
    turn = 2 * np.pi * robot.whole_turns
    low, high = robot.limits.q_min - ROUNDING, robot.limits.q_max + ROUNDING
    nearest = q + turn * np.round((other - q) / (2 * np.pi))
    best = nearest
    # Only joints outside of their limits are moved by another turn.
    for shifted in (nearest - turn, nearest + turn, q):
        best = np.where((best < low) | (best > high), shifted, best)
    return best


def _cost(task: Task, a: FloatArray, b: FloatArray) -> float:
    return float((np.abs(_near(task.robot, b, a) - a) / _speeds(task.robot)).max())


def _picks(task: Task, nodes: list[Poses], edges: list[Joined]) -> list[Picks]:
    """Return the cheapest way through every branch of every stop, as numbers of branches."""
    costs = [
        {(a, b): _cost(task, nodes[k][a], nodes[k + 1][b]) for a, b in joint_paths}
        for k, joint_paths in enumerate(edges)
    ]
    if not task.cycle:
        return sorted(_through(costs, range(len(nodes[0])), range(len(nodes[-1]))))
    return sorted(set().union(*(_through(costs, [k], [k]) for k in range(len(nodes[0])))))


def _through(
    costs: list[dict[tuple[int, int], float]], starts: Iterable[int], ends: Iterable[int]
) -> set[Picks]:
    """Return the cheapest ways through each branch between given first and last branches.

    Forward and backward dynamic programming: the cheapest way through a branch joins the cheapest
    ways to it from both ends.
    """
    back = [{(b, a): cost for (a, b), cost in row.items()} for row in reversed(costs)]
    forward = _cheapest(costs, starts, lambda way, to: (*way, to))
    backward = _cheapest(back, ends, lambda way, to: (to, *way))[::-1]
    return {
        (*before[b][1], *after[b][1][1:])
        for before, after in zip(forward, backward, strict=True)
        for b in before.keys() & after.keys()
    }


def _cheapest(
    costs: list[dict[tuple[int, int], float]],
    starts: Iterable[int],
    longer: Callable[[Picks, int], Picks],
) -> list[dict[int, tuple[float, Picks]]]:
    """Return the cost and the picks of the cheapest way to every branch of each stop."""
    ways: list[dict[int, tuple[float, Picks]]] = [{a: (0.0, (a,)) for a in starts}]
    for row in costs:
        best: dict[int, tuple[float, Picks]] = {}
        for (a, b), cost in row.items():
            if a in ways[-1]:
                total = ways[-1][a][0] + cost, longer(ways[-1][a][1], b)
                best[b] = min(best.get(b, total), total)
        ways.append(best)
    return ways


def _realised(task: Task, nodes: list[Poses], edges: list[Joined], picks: Picks) -> Way | None:
    """Return a way with each pose moved by full turns to be near the one before; None if open."""
    robot = task.robot
    q = [nodes[k][pick] for k, pick in enumerate(picks)]
    fixed = [k for k, stop in enumerate(task.stops) if stop.q is not None]
    origin = fixed[0] if fixed else 0
    for k in range(origin - 1, -1, -1):
        q[k] = _near(robot, q[k], q[k + 1])
    for k in range(origin + 1, len(q)):
        q[k] = q[k] if task.stops[k].q is not None else _near(robot, q[k], q[k - 1])
    if task.cycle and np.abs(q[-1] - q[0]).max() > SAME_BRANCH:
        return None
    if task.cycle:
        q[-1] = q[0]
    paths: list[FloatArray] = []
    for k, joint_paths in enumerate(edges):
        path = joint_paths[picks[k], picks[k + 1]]
        if path is None:
            path = q[k] + EASED[:, None] * (q[k + 1] - q[k])
        else:
            # The joint path was followed from a pose that may differ by full turns.
            apart = q[k] - path[0]
            path = path + np.round(apart / (2 * np.pi)) * 2 * np.pi * (np.abs(apart) > np.pi)
            if np.abs(path[-1] - q[k + 1]).max() > 10 * SAME_BRANCH:
                return None
        paths.append(path)
    return Way(np.array(q), tuple(paths), tuple(pick + 1 for pick in picks))


def least_time(task: Task, way: Way) -> float:
    """Return the duration of a way at the velocity and acceleration limits, s, without dwells.

    On each segment the joint that takes longest counts, alone: from rest it needs the time
    v / (2 a) more than at its highest velocity v, or has not reached it after d = v^2 / (2 a).
    """
    limits = task.robot.limits
    speed, acceleration = (np.abs(limits.bounds(key)).max(axis=0) for key in ("qd", "qdd"))
    slack = [stop.slack if stop.q is not None else 0.0 for stop in task.stops]
    total = 0.0
    for k, (start, end) in enumerate(itertools.pairwise(way.via)):
        rests = int(task.at_rest(k)) + int(task.at_rest(k + 1))
        distance = np.maximum(np.abs(end - start) - slack[k] - slack[k + 1], 0.0)
        moving = distance > 0.0
        if moving.any():
            d, v, a = distance[moving], speed[moving], acceleration[moving]
            with np.errstate(divide="ignore", invalid="ignore"):
                more = np.where(np.isinf(a), 0.0, rests * v / (2.0 * a))  # s beyond d / v
                times = np.where(d >= v * more, d / v + more, np.sqrt(2.0 * rests * d / a))
            total += float(times.max())
    return total


def bound_of(task: Task, way: Way) -> float:
    """Return a duration that no motion through the poses of a way beats, s, without dwells.

    A redundant or tolerant stop may move its pose: there the bound is divided by a factor, and is
    an estimate.
    """
    exact = all(few_poses(task.robot, stop) is not None for stop in task.stops)
    return least_time(task, way) / (1.0 if exact else SLIDING)


def _time(way: Way, speeds: FloatArray) -> float:
    steps = np.abs(np.diff(way.via, axis=0))
    times = np.divide(steps, speeds, out=np.zeros_like(steps), where=steps > 0.0)
    return float(times.max(axis=1).sum())


def least_duration(task: Task) -> float:
    """Return a lower bound on the duration of every motion of the task, s.

    Between joint poses the slowest joint moves at its highest velocity; the cheapest branches
    count. At a stop with infinitely many poses the tool covers its distance at a speed that the
    joints cannot exceed together.
    """
    robot = task.robot
    speeds = np.maximum(-robot.limits.qd_min, robot.limits.qd_max)
    fastest = fastest_tool(robot)
    poses = [few_poses(robot, stop) for stop in task.stops]
    least = np.zeros(1)  # one entry per branch at the stop, or one for infinitely many poses
    # Dynamic programming: least[b] bounds the time to branch b of the current stop.
    for k, (a, b) in enumerate(itertools.pairwise(task.stops)):
        before, after = poses[k], poses[k + 1]
        if before is None or after is None:
            way = _tool_distance(robot, a, b) / fastest
            least = np.full(1 if after is None else len(after), least.min() + way)
            continue
        slack = sum(stop.slack for stop in (a, b) if stop.q is not None)
        room = np.maximum(_joint_distances(robot, before, after) - slack, 0.0)
        times = np.divide(room, speeds, out=np.zeros_like(room), where=room > 0.0)
        least = (least[:, None] + times.max(axis=2)).min(axis=0)
    return float(least.min() + task.dwells.sum())


def _joint_distances(robot: Robot, before: FloatArray, after: FloatArray) -> FloatArray:
    """Return distances [k,l,n] of joint poses [k,n] from others [l,n], up to allowed turns."""
    apart = np.abs(after[None] - before[:, None])
    turns = (robot.limits.q_max - robot.limits.q_min >= 2 * np.pi) & robot.whole_turns
    return np.where(turns, np.abs((apart + np.pi) % (2 * np.pi) - np.pi), apart)


def _tool_distance(robot: Robot, before: Stop, after: Stop) -> float:
    """Return the least distance of the tool between two stops, m; 0 if a joint pose is tolerant."""
    if any(stop.q is not None and np.any(stop.slack) for stop in (before, after)):
        return 0.0
    apart = np.abs(before.pose(robot)[0] - after.pose(robot)[0])
    for stop in (before, after):
        apart = apart if stop.q is not None else np.maximum(apart - stop.slack, 0.0)
    return float(np.linalg.norm(apart))


def segment_timings(task: Task, way: Way, compiled: bool) -> tuple[PiecewisePolynomial | None, ...]:
    """Return the best timing from rest to rest of every segment of a way; None for an infeasible
    one.
    """
    rows = zip(way.paths, task.payloads, strict=True)
    return tuple(
        _best_timing(payload.on(task.robot), path.tobytes(), len(path), compiled)
        for path, payload in rows
    )


@lru_cache(maxsize=256)  # each holds about 1 MB
def _best_timing(
    robot: Robot, path_bytes: bytes, count: int, compiled: bool
) -> PiecewisePolynomial | None:
    """Return the best timing of one path [count,n]; cached, as orders of stops share segments."""
    shape = spline(np.frombuffer(path_bytes).reshape(count, -1), np.linspace(0.0, 1.0, count))
    with contextlib.suppress(InputError):
        timing = time_path(robot, shape, compiled=compiled)
        if timing.solved:
            motion = timing.motion()
            return polynomial_of(motion)
    return None
