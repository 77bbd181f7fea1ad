"""Joint paths around obstacles by OMPL's RRT-Connect, shortened and with rounded corners.

Each seed leads to one path, often on another side of an obstacle. A path is a polyline at first;
random shortcuts take its detours away, and parabolas, as long as they keep clear, its corners.
Everything follows from the seeds: the search ends by counts, not by the clock.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from threading import RLock
from typing import Any

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.robot import Robot
from microbot_ocp.scene._clearance import levers_of
from microbot_ocp.scene._contact import ContactModel, Nearest, contact_model
from microbot_ocp.scene._scene import MARGIN, Scene, with_arm_capsules

TURN = np.pi  # rad: how far beyond both ends joints without limits may go
USUAL_SPEED = 2.0  # rad/s of joints without a limit of their speed
STEP = 0.06  # rad: the longest step between two poses that the planner looks at
MOST_CHECKS = 40_000  # poses looked at by one search
SHORTCUTS = 60
FINEST = 4e-3  # rad (m): a piece of a segment that is not divided further
BLENDS = (0.5, 0.35, 0.2, 0.1, 0.05, 0.02)  # of the neighbouring segments, that a corner may take
MARGINS = 1.5  # times that of the limit, kept by paths


@dataclass(frozen=True, eq=False)
class Detour:
    """What a search for a way around obstacles led to.

    Attributes
    ----------
    seed : int
    path : PiecewisePolynomial or None
        Its parameter is the distance along the polyline, with joints weighed by their speeds.
    checks : int
        Poses looked at.
    left : float
        How far from the goal the search came, rad, where there is no path.
    """

    seed: int
    path: PiecewisePolynomial | None
    checks: int
    left: float = 0.0


class Surroundings:
    """An arm in a scene, as a search for paths sees it."""

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self.robot, self.scene = with_arm_capsules(robot), scene
        self.model: ContactModel = contact_model(robot, scene)
        radii = np.array([pair.radii for pair in self.model.pairs])
        self.least = scene.clearance + MARGINS * MARGIN * (radii + scene.clearance)
        low, high = robot.limits.bounds("q")
        self._farthest = np.where(
            np.isfinite(low) & np.isfinite(high), np.maximum(np.abs(low), np.abs(high)), 2 * np.pi
        )
        self.levers = levers_of(self.robot, self.model.pairs, self._farthest)
        self._suspect = 0

    def collision(self, q: FloatArray) -> Nearest | None:
        """The pair that is nearest in a pose [n], where it is nearer than the clearance."""
        found = self.model.nearest(q)
        return found if found.distance <= self.scene.clearance else None

    def is_free(self, q: FloatArray) -> bool:
        """Whether all pairs keep the distance that paths keep; the last culprit is asked first."""
        model = self.model
        model.put(model.poses(q[None])[0])
        if model.distance(self._suspect) <= self.least[self._suspect]:
            return False
        for index, least in enumerate(self.least):
            if model.distance(index) <= least:
                self._suspect = index
                return False
        return True

    def is_clear(self, start: FloatArray, end: FloatArray) -> bool:
        """Whether the straight segment between two poses keeps the distance all along."""
        half = 0.5 * np.abs(end - start)
        middle = 0.5 * (start + end)
        room = self.model.distances(middle[None])[0] - self.least
        if room.min() <= 0.0:
            return False
        if (room > self.levers @ half).all() or half.max() < FINEST:
            return True
        return self.is_clear(start, middle) and self.is_clear(middle, end)


def detours(
    around: Surroundings, start: FloatArray, goal: FloatArray, seeds: Iterator[int] | range
) -> Iterator[Detour]:
    """Ways from a pose [n] to another, one a seed; the straight one alone where that is clear.

    Raises
    ------
    InputError
        OMPL is not installed.
    """
    if around.is_clear(start, goal):
        weights = _weights(around.robot)
        yield Detour(-1, rounded(around, np.array([start, goal]), weights), 1)
        return
    for seed in seeds:
        yield _detour(around, start, goal, seed)


_planning = RLock()  # OMPL's random numbers come from one generator for all threads


def _detour(around: Surroundings, start: FloatArray, goal: FloatArray, seed: int) -> Detour:
    with _planning:
        return _detour_from(around, start, goal, seed)


def _detour_from(around: Surroundings, start: FloatArray, goal: FloatArray, seed: int) -> Detour:
    base, geometric, util = _ompl()
    util.noOutputHandler()
    util.RNG.setSeed(seed + 1)
    weights = _weights(around.robot)
    low, high = _bounds(around.robot, start, goal)
    moving = np.flatnonzero(high - low > 1e-9)
    space = base.RealVectorStateSpace(len(moving))
    bounds = base.RealVectorBounds(len(moving))
    for k, joint in enumerate(moving.tolist()):
        bounds.setLow(k, float(low[joint] * weights[joint]))
        bounds.setHigh(k, float(high[joint] * weights[joint]))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    pose, checks = start.copy(), 0

    def valid(state: Any) -> bool:
        nonlocal checks
        checks += 1
        pose[moving] = [state[k] for k in range(len(moving))]
        pose[moving] /= weights[moving]
        return around.is_free(pose)

    information.setStateValidityChecker(valid)
    step = STEP * float(weights[moving].min())
    information.setStateValidityCheckingResolution(step / space.getMaximumExtent())
    information.setup()
    problem = base.ProblemDefinition(information)
    ends = []
    for q in (start, goal):
        state = space.allocState()
        for k, joint in enumerate(moving.tolist()):
            state[k] = float(q[joint] * weights[joint])
        ends.append(state)
    problem.setStartAndGoalStates(*ends, 1e-9)
    planner = geometric.RRTConnect(information)
    planner.setProblemDefinition(problem)
    planner.setup()
    # the planner waits for another end without a check where it takes one for invalid
    known = all(space.satisfiesBounds(s) and information.isValid(s) for s in ends)
    exact = known and bool(
        planner.solve(
            base.PlannerTerminationCondition(lambda: checks > MOST_CHECKS or deadline.over())
        )
    )
    if not exact or not problem.hasExactSolution():
        left = float(problem.getSolutionDifference())  # negative where it was not begun
        if left < 0.0:
            left = float(np.linalg.norm((goal - start) * weights))
        return Detour(seed, None, checks, left / float(weights[moving].max()))
    found = problem.getSolutionPath()
    corners = np.tile(start, (found.getStateCount(), 1))
    for row in range(len(corners)):
        state = found.getState(row)
        corners[row, moving] = [state[k] for k in range(len(moving))]
        corners[row, moving] /= weights[moving]
    corners[0], corners[-1] = start, goal
    return Detour(seed, rounded(around, _shortened(around, corners, seed), weights), checks)


def _shortened(around: Surroundings, corners: FloatArray, seed: int) -> FloatArray:
    """A polyline [m,n] with random shortcuts, and without corners that are not needed."""
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
            apart = np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-6
            path = path[np.append(True, apart)]
    return _without_needless(around, path)


def _without_needless(around: Surroundings, corners: FloatArray) -> FloatArray:
    """A polyline that skips every corner that it can do without, from the start."""
    kept, at = [0], 0
    while at < len(corners) - 1:
        following = next(
            (j for j in range(len(corners) - 1, at + 1, -1)
             if around.is_clear(corners[at], corners[j])),
            at + 1,
        )  # fmt: skip
        kept.append(following)
        at = following
    return corners[kept]


def rounded(around: Surroundings, corners: FloatArray, weights: FloatArray) -> PiecewisePolynomial:
    """A polyline [m,n] whose corners are parabolas, as long as they keep clear."""
    steps = np.diff(corners, axis=0)
    lengths = np.linalg.norm(steps * weights, axis=1)
    tangents = steps / lengths[:, None]
    taken = np.zeros(len(corners))  # of both sides of a corner, as a length
    for k in range(1, len(corners) - 1):
        room = min(lengths[k - 1], lengths[k])
        for share in BLENDS:
            size = share * room
            curve = _parabola(corners[k], tangents[k - 1], tangents[k], size)
            if _curve_is_clear(around, curve, 2 * size):
                taken[k] = size
                break
    breaks, pieces = [0.0], []

    def add(length: float, curve: FloatArray) -> None:
        if length > 1e-9:
            breaks.append(breaks[-1] + length)
            pieces.append(curve)

    none = np.zeros(corners.shape[1])
    for k, length in enumerate(lengths):
        begin = corners[k] + taken[k] * tangents[k]
        add(length - taken[k] - taken[k + 1], np.array([begin, tangents[k], none]))
        if taken[k + 1]:
            curve = _parabola(corners[k + 1], tangents[k], tangents[k + 1], taken[k + 1])
            add(2 * taken[k + 1], curve)
    return PiecewisePolynomial(np.array(breaks), np.array(pieces))


def _parabola(corner: FloatArray, before: FloatArray, after: FloatArray, size: float) -> FloatArray:
    """Coefficients [3,n] of the parabola around a corner, of a parameter from 0 to twice size."""
    return np.array([corner - size * before, before, (after - before) / (4 * size)])


def _curve_is_clear(around: Surroundings, curve: FloatArray, length: float) -> bool:
    s = np.linspace(0.0, length, 9)[:, None]
    points = curve[0] + s * (curve[1] + s * curve[2])
    return all(around.is_clear(a, b) for a, b in pairwise(points))


def _weights(robot: Robot) -> FloatArray:
    """By what joints are multiplied so that their paths compare by the time that they take."""
    low, high = robot.limits.bounds("qd")
    speed = np.maximum(-low, high)
    speed = np.where(np.isfinite(speed) & (speed > 0), speed, USUAL_SPEED)
    return speed.max() / speed


def _bounds(robot: Robot, start: FloatArray, goal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where joints may go: within their limits, and not far beyond both ends."""
    low, high = robot.limits.bounds("q")
    least, most = np.minimum(start, goal), np.maximum(start, goal)
    low, high = np.maximum(low, least - TURN), np.minimum(high, most + TURN)
    locked = robot.limits.qd_max == 0.0
    return np.where(locked, start, low), np.where(locked, start, high)


def _ompl() -> tuple[Any, Any, Any]:
    try:
        from ompl import base, geometric, util
    except ImportError:
        raise InputError(
            "a way around obstacles needs the extra 'cell': pip install 'microbot_ocp[cell]'"
        ) from None
    return base, geometric, util
