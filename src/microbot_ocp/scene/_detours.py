"""Joint paths around obstacles by OMPL's planners, shortened and with rounded corners.

Searches are numbered: the number determines the planner, its seed, its longest edge and its largest
number of poses. A search ends by a count, so equal numbers give equal paths, and different numbers
often pass an obstacle on different sides. Random shortcuts shorten the resulting polyline, and
curves round its corners if they keep clear. Segments and curves are proved to keep clear, not
sampled.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.needed import needed
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.robot import Robot
from microbot_ocp.scene._clearance import levers_of
from microbot_ocp.scene._contact import ContactModel, Nearest, contact_model
from microbot_ocp.scene._pairs import ACCURACY
from microbot_ocp.scene._scene import Scene, with_arm_capsules

TURN = np.pi  # range beyond start and goal of joints without limits, rad
USUAL_SPEED = 2.0  # assumed speed of joints without a speed limit, rad/s
FIRST_CHECKS = 1_400  # poses of the first search; each later one may check twice as many
FIRST_SEARCHES = 4  # searches by RRT-Connect; after them all planners take turns
# Longest edges of a planner's tree, shares of the extent of the joint space: short ones pass narrow
# places, long ones find other sides of an obstacle. An edge is kept whole or not at all.
EDGES = 0.04, 0.2
PLANNERS = ("RRTConnect", "LBKPIECE1", "BKPIECE1")
SHORTCUTS = 60
BLENDS = (0.5, 0.35, 0.2, 0.1, 0.05, 0.02)  # sizes of a corner, relative to the shorter segment
_planning = threading.Lock()  # OMPL has one random sequence for all threads


@dataclass(frozen=True, eq=False)
class Detour:
    """Result of a search for a path around obstacles.

    Attributes
    ----------
    name : str
        "straight", or the number of the search.
    path : PiecewisePolynomial or None
        Path over the length of the polyline, with joints weighted by their speeds.
    corners : array [m,n] or None
        Corners of the polyline, rad (m).
    checks : int
        Number of poses checked.
    left : float
        Remaining distance to the goal if no path was found, rad.
    """

    name: str
    path: PiecewisePolynomial | None
    corners: FloatArray | None
    checks: int
    left: float = 0.0


class Surroundings:
    """Arm in a scene with the queries of a path search.

    Attributes
    ----------
    least : float
        Smallest distance that can be proved to keep the clearance, m.
    checks : int
        Number of poses checked so far.
    """

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self.robot, self.scene = with_arm_capsules(robot), scene
        self.model: ContactModel = contact_model(robot, scene)
        self.least, self.checks = scene.clearance + ACCURACY, 0
        farthest = np.abs(robot.limits.bounds("q")).max(axis=0)
        farthest = np.where(np.isfinite(farthest), farthest, 2 * np.pi)
        self._row_of = self.model.motions[1]
        arm, firsts = self.robot, np.unique(self._row_of, return_index=True)[1]
        sizes = np.abs(arm.transmission)
        farthest = sizes @ farthest + np.abs(arm.chain_positions(np.zeros(arm.joint_count)))
        levers = levers_of(arm.chain, [self.model.pairs[k] for k in firsts], farthest)
        # Joints j <= k give a point the second derivative z_j x (z_k x r), at most the lever of k.
        one, two = np.indices(2 * levers.shape[1:])
        bends = levers[:, np.maximum(one, two)] * (levers > 0.0)[:, np.minimum(one, two)]
        self._bends = sizes.T @ bends @ sizes
        self._levers = levers @ sizes

    def collision(self, q: FloatArray) -> Nearest | None:
        """Return the nearest pair in a pose [n] if it is within the clearance, else None."""
        nearest = self.model.nearest(q)
        return nearest if nearest.distance <= self.least else None

    def is_free(self, q: FloatArray) -> bool:
        """Return True if all pairs keep the clearance in a pose [n]."""
        return self.is_clear(q, q)

    def is_clear(self, start: FloatArray, end: FloatArray) -> bool:
        """Return True if the straight segment between two poses is proved to keep the clearance."""
        way = end - start
        return self.is_clear_along(np.array([start, way]), 1.0, np.abs(way), 0.0 * way)

    def rates(self, slopes: FloatArray, bends: FloatArray) -> FloatArray:
        """Return bounds [k,2] of the first and second derivative of all points of each pair.

        ``slopes`` and ``bends`` [n] bound those of the joints.
        """
        second = self._bends @ slopes @ slopes + self._levers @ bends
        return np.column_stack([self._levers @ slopes, second])[self._row_of]

    def is_clear_along(
        self, curve: FloatArray, length: float, slopes: FloatArray, bends: FloatArray
    ) -> bool:
        """Return True if a curve over a parameter from 0 to ``length`` is proved to keep clear.

        ``curve`` [k,n] holds the coefficients of its polynomial; ``slopes`` and ``bends`` [n] bound
        the first and second derivative of each joint. An interval is halved until the distances in
        its middle exceed the largest approach within it; the proof fails if the approach is below
        the accuracy of distances.
        """
        half, powers = 0.5 * length, np.arange(len(curve))
        slope = curve[1:] * powers[1:, None]
        rates = self.rates(slopes, bends)
        middles, pairs = np.array([half]), np.arange(len(self._row_of))
        which = np.zeros(len(pairs), dtype=int)
        while len(middles):
            self.checks += len(middles)
            terms = middles[:, None] ** powers
            moving = terms @ curve, terms[:, :-1] @ slope
            poses, bounds = self.model.parted(*moving, which, pairs, rates[pairs], half)
            now, least, approach = bounds
            unsure = least <= self.least
            # Exact geometry decides where capsules touch, the likeliest collision first.
            near = np.flatnonzero(now <= self.least)
            for k in near[np.argsort(now[near])].tolist():
                apart = self.model.exact(int(pairs[k]), poses[which[k]], self.least)
                room = apart - self.least
                if room <= 0.0:
                    return False
                unsure[k] = room <= approach[k]
            if (unsure & (approach < ACCURACY)).any() or (unsure.any() and deadline.over()):
                return False
            counts, half = np.bincount(which[unsure], minlength=len(middles)), 0.5 * half
            halved = np.flatnonzero(counts)
            middles, counts = middles[halved], counts[halved]
            middles = np.concatenate([middles - half, middles + half])
            which = np.repeat(np.arange(len(middles)), np.concatenate([counts, counts]))
            pairs = np.concatenate([pairs[unsure], pairs[unsure]])
        return True


def detour(
    around: Surroundings, start: FloatArray, goal: FloatArray, seed: int, number: int
) -> Detour:
    """Find a path from one pose [n] to another; the straight one if it keeps clear.

    Parameters
    ----------
    around : Surroundings
        Arm in its scene.
    start, goal : array [n]
        End poses, rad (m).
    seed : int
        Seed common to all searches.
    number : int
        Number of the search, from 0; later searches check more poses, by several planners.

    Raises
    ------
    InputError
        OMPL is not installed.
    """
    if around.is_clear(start, goal):
        corners = np.array([start, goal])
        return Detour("straight", rounded(around, corners), corners, 1)
    with _planning:
        return _searched(around, start, goal, seed, number)


def _searched(
    around: Surroundings, start: FloatArray, goal: FloatArray, seed: int, number: int
) -> Detour:
    # Most problems need few poses and some need very many, so the first searches stay short. Every
    # planner is used once before the number of poses is doubled again.
    rounds, turn = divmod(max(number - FIRST_SEARCHES, 0), len(PLANNERS))
    doublings = min(number, FIRST_SEARCHES) + rounds
    base, geometric, util = (
        needed(f"ompl.{name}", "a way around obstacles needs", "cell")
        for name in ("base", "geometric", "util")
    )
    util.noOutputHandler()
    own_seed = (seed * FIRST_SEARCHES + number) % (2**32 - 1) + 1
    util.RNG.setSeed(own_seed)
    planner_kind = getattr(geometric, PLANNERS[turn])
    begun, most = around.checks, FIRST_CHECKS * 2**doublings
    # OMPL's Euclidean metric is applied to weighted joints; locked joints leave the space.
    weights = _weights(around.robot)
    low, high = _bounds(around.robot, start, goal)
    moving = np.flatnonzero(high - low > ROUNDING)
    space = base.RealVectorStateSpace(len(moving))
    bounds = base.RealVectorBounds(len(moving))
    for k, joint in enumerate(moving.tolist()):
        bounds.setLow(k, float(low[joint] * weights[joint]))
        bounds.setHigh(k, float(high[joint] * weights[joint]))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)

    def pose(state: Any) -> FloatArray:
        q = start.copy()
        q[moving] = [state[k] for k in range(len(moving))]
        q[moving] /= weights[moving]
        return q

    def is_over() -> bool:
        return around.checks - begun > most or deadline.over()

    class Proof(base.MotionValidator):
        def checkMotion(self, first: Any, second: Any) -> bool:
            return not is_over() and around.is_clear(pose(first), pose(second))

    # OMPL does not keep this Python object alive.
    proof = Proof(information)
    information.setStateValidityChecker(lambda state: around.is_free(pose(state)))
    information.setMotionValidator(proof)
    information.setup()
    problem = base.ProblemDefinition(information)
    ends = []
    for q in (start, goal):
        state = space.allocState()
        for k, joint in enumerate(moving.tolist()):
            state[k] = float(q[joint] * weights[joint])
        ends.append(state)
    problem.setStartAndGoalStates(*ends, ROUNDING)
    planner = planner_kind(information)
    planner.setRange(EDGES[number % len(EDGES)] * space.getMaximumExtent())
    planner.setProblemDefinition(problem)
    planner.setup()
    # OMPL would wait for another start or goal without end if it rejects one of these.
    valid = all(space.satisfiesBounds(s) and information.isValid(s) for s in ends)
    if valid:
        planner.solve(
            base.PlannerTerminationCondition(lambda: problem.hasExactSolution() or is_over())
        )
    spent = around.checks - begun
    if not problem.hasExactSolution():
        left = float(problem.getSolutionDifference())  # negative if the search was not started
        if left < 0.0:
            left = float(np.linalg.norm((goal - start) * weights))
        return Detour(str(number), None, None, spent, left / float(weights[moving].max()))
    solution = problem.getSolutionPath()
    corners = np.array([pose(solution.getState(row)) for row in range(solution.getStateCount())])
    corners[0], corners[-1] = start, goal
    corners = _shortened(around, corners, own_seed)
    return Detour(str(number), rounded(around, corners), corners, spent)


def _shortened(around: Surroundings, corners: FloatArray, seed: int) -> FloatArray:
    """Shorten a polyline [m,n] by random shortcuts and by dropping needless corners."""
    random = np.random.default_rng(seed)
    path = _without_needless(around, corners)
    for _ in range(SHORTCUTS):
        if len(path) < 3:
            break
        lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
        ends = np.concatenate([[0.0], np.cumsum(lengths)])
        first, last = np.sort(random.uniform(0.0, ends[-1], 2))
        i, j = (int(np.searchsorted(ends, at, side="right")) - 1 for at in (first, last))
        j = min(j, len(path) - 2)
        if i >= j:
            continue
        leaves, joins = (
            path[k] + (at - ends[k]) / lengths[k] * (path[k + 1] - path[k])
            for k, at in ((i, first), (j, last))
        )
        if around.is_clear(leaves, joins):
            path = np.vstack([path[: i + 1], leaves, joins, path[j + 1 :]])
            apart = np.linalg.norm(np.diff(path, axis=0), axis=1) > ROUNDING
            path = path[np.append(True, apart)]
    return _without_needless(around, path)


def _without_needless(around: Surroundings, corners: FloatArray) -> FloatArray:
    """Drop every corner of a polyline that can be skipped, from the start on."""
    rows, at = [0], 0
    while at < len(corners) - 1:
        later = range(len(corners) - 1, at + 1, -1)
        at = next((j for j in later if around.is_clear(corners[at], corners[j])), at + 1)
        rows.append(at)
    return corners[rows]


def rounded(around: Surroundings, corners: FloatArray) -> PiecewisePolynomial:
    """Round the corners of a polyline [m,n] by curves that keep clear.

    Parabolas give the fastest motions. If jerk or torque rates are limited, the curvature must be
    continuous: the arm would have to stop at a jump of the curvature.
    """
    steps = np.diff(corners, axis=0)
    lengths = np.linalg.norm(steps * _weights(around.robot), axis=1)
    tangents = steps / lengths[:, None]
    smooth = LimitFamily.of(around.robot).jerk_matters
    taken = np.zeros(len(corners))  # length of each corner's curve, on either side
    for k in range(1, len(corners) - 1):
        room = min(lengths[k - 1], lengths[k])
        slopes = np.abs(tangents[k - 1 : k + 1]).max(axis=0)
        for share in BLENDS:
            size = share * room
            curve = _blend(corners[k], tangents[k - 1], tangents[k], size, smooth)
            bends = 0.75 / size * np.abs(tangents[k] - tangents[k - 1])
            if around.is_clear_along(curve, 2 * size, slopes, bends):
                taken[k] = size
                break
    breaks, pieces = [0.0], []

    def add(length: float, curve: FloatArray) -> None:
        if length > ROUNDING:
            breaks.append(breaks[-1] + length)
            pieces.append(curve)

    for k, length in enumerate(lengths):
        begin = corners[k] + taken[k] * tangents[k]
        straight = np.zeros((5, corners.shape[1]))
        straight[:2] = begin, tangents[k]
        add(length - taken[k] - taken[k + 1], straight)
        if taken[k + 1]:
            curve = _blend(corners[k + 1], tangents[k], tangents[k + 1], taken[k + 1], smooth)
            add(2 * taken[k + 1], curve)
    return PiecewisePolynomial(np.array(breaks), np.array(pieces))


def _blend(
    corner: FloatArray, before: FloatArray, after: FloatArray, size: float, smooth: bool
) -> FloatArray:
    """Return coefficients [5,n] of a curve around a corner, over a parameter from 0 to 2 size.

    Its slope changes from one tangent to the other: linearly, or as 3 s^2 - 2 s^3 if ``smooth``,
    so its second derivative is at most 1.5 times their difference over the length.
    """
    change, length = after - before, 2 * size
    curve = np.zeros((5, corner.size))
    curve[:2] = corner - size * before, before
    if smooth:
        curve[3:] = change / length**2, -change / (2 * length**3)
    else:
        curve[2] = change / (2 * length)
    return curve


def _weights(robot: Robot) -> FloatArray:
    """Return joint weights that make lengths of paths proportional to travel times."""
    low, high = robot.limits.bounds("qd")
    speed = np.maximum(-low, high)
    speed = np.where(np.isfinite(speed) & (speed > 0), speed, USUAL_SPEED)
    return speed.max() / speed


def _bounds(robot: Robot, start: FloatArray, goal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the search range of the joints: their limits, and not far beyond both ends."""
    low, high = robot.limits.bounds("q")
    least, most = np.minimum(start, goal), np.maximum(start, goal)
    low, high = np.maximum(low, least - TURN), np.minimum(high, most + TURN)
    locked = robot.limits.qd_max == 0.0
    return np.where(locked, start, low), np.where(locked, start, high)
