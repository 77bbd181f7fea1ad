"""Proof that a motion keeps clear of a scene at every instant, not only at samples.

Within a time interval of length h no point of a link moves farther from its place in the middle
than the sum over joints of speed bound times lever arm times h / 2. A pair whose distance in the
middle exceeds that bound plus the clearance keeps clear in the whole interval; otherwise the
interval is halved. The Bernstein coefficients of the motion's polynomials bound the joint speeds,
the lengths of the chain bound the lever arms in every pose. Distances are computed by coal.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import comb

import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp.motion import Motion, pieces_of
from microbot_ocp.robot import Capsule, Robot, dh_transform
from microbot_ocp.scene._contact import contact_model
from microbot_ocp.scene._pairs import ACCURACY
from microbot_ocp.scene._scene import Pair, Scene, with_arm_capsules


@dataclass(frozen=True)
class Clearance:
    """Least distance of a motion from its surroundings, and whether the clearance is proved.

    Attributes
    ----------
    minimum : float
        Least distance found, m; negative if something overlaps.
    time : float
        Time of the least distance, s.
    pair : str
        Names of the nearest pair: "forearm to post".
    proved : bool
        True if every pair is farther apart than the scene's clearance at every instant.
    at_least : float
        Distance that all pairs are proved to keep, m; minus infinity without a proof.
    wanted : float
        Clearance that the scene requires, m.
    distances : int
        Number of computed distances.
    wall_time : float
        Wall time of the proof, s.
    unwatched : tuple of str
        Links that touch in the zero pose and therefore may touch: "forearm to base".
    """

    minimum: float
    time: float
    pair: str
    proved: bool
    at_least: float
    wanted: float
    distances: int
    wall_time: float
    unwatched: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """Result in words."""
        where = f"{self.pair} at {self.time:.4g} s"
        if self.proved:
            labels = ", ".join(self.unwatched[:3]) + (", ..." if len(self.unwatched) > 3 else "")
            but = f"; not watched, as they touch in the zero pose: {labels}" if labels else ""
            return (
                f"clearance is proved: nothing comes nearer than {1e3 * self.at_least:.4g} mm, "
                f"the least distance found is {1e3 * self.minimum:.4g} mm ({where}){but}"
            )
        if self.minimum <= self.wanted:
            how = "overlap by" if self.minimum < 0 else "are apart by only"
            return f"{where} {how} {1e3 * abs(self.minimum):.4g} mm, not more than " + (
                f"{1e3 * self.wanted:.4g} mm" if self.wanted else "touching"
            )
        return (
            "clearance is not proved: some times are undecided; the least distance found is "
            f"{1e3 * self.minimum:.4g} mm ({where})"
        )


def clearance(robot: Robot, motion: Motion, scene: Scene) -> Clearance:
    """Return the least distance of a motion from its surroundings, and whether it is proved.

    Needs the extra ``cell`` (coal).

    Parameters
    ----------
    robot : Robot
        Arm with capsules or collision geometry; see :class:`Scene`.
    motion : Motion
    scene : Scene

    Returns
    -------
    Clearance
        Least distance found, and the distance that is proved, m.

    Raises
    ------
    InputError
        The motion has another number of joints than the robot, or coal is not installed.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("planar_2r")
    >>> motion = mo.Motion.from_polynomial(robot, mo.cubic([[0, 0], [1, 1]], [0, 1]), label="a")
    >>> found = mo.clearance(robot, motion, mo.Scene([mo.Sphere([0, 1.5, 0], 0.2, "ball")]))
    >>> found.proved, found.pair, round(found.minimum, 2)
    (True, 'elbow to ball', 0.39)
    """
    if motion.joint_count != robot.joint_count:
        raise InputError(
            f"motion is of {motion.joint_count} joints, but the robot has {robot.joint_count}"
        )
    scene.pairs(robot)  # raises if ``ignore`` holds an unknown name
    return clearance_along([(0.0, motion.duration, robot, scene)], motion)


def clearance_along(
    places: Sequence[tuple[float, float, Robot, Scene]], motion: Motion
) -> Clearance:
    """Find the least distance of an arm whose payload or surroundings change along a motion.

    ``places`` holds start and end (s), the robot with its payload, and the scene of each part.
    """
    started = time.perf_counter()
    speeds = _speed_bounds(motion)
    # Between samples a joint may exceed its samples by at most speed times step.
    farthest = np.abs(motion.q).max(axis=0) + (speeds * np.diff(motion.t)[:, None]).max(axis=0)
    searches = []
    for start, end, robot, scene in places:
        searches.append(_ClearanceSearch(robot, scene, motion, speeds, farthest))
        searches[-1].run(start, end)
    least = min(searches, key=lambda search: search.minimum)
    closed = not any(search.open_stretches for search in searches)
    return Clearance(
        minimum=least.minimum,
        time=least.time,
        pair=least.model.pairs[least.pair].label,
        proved=closed and least.minimum > least.wanted,
        at_least=min(search.at_least for search in searches) if closed else -np.inf,
        wanted=least.wanted,
        distances=sum(search.count for search in searches),
        wall_time=time.perf_counter() - started,
        unwatched=tuple(dict.fromkeys(sum((search.model.unwatched for search in searches), ()))),
    )


FIRST_INTERVALS = 64  # number of equal intervals at the start
MOST_DISTANCES = 2_000_000  # distances after which the proof gives up
PROVED_RATIO = 0.5  # share of the least distance beyond the clearance that is proved


class _ClearanceSearch:
    """Branch and bound over time intervals and pairs of bodies.

    Invariant: every pair at every time is in a closed interval, whose bound exceeds the clearance,
    or in an open one, which is halved next.
    """

    def __init__(
        self, robot: Robot, scene: Scene, motion: Motion, speeds: FloatArray, farthest: FloatArray
    ) -> None:
        self.motion, self.wanted = motion, scene.clearance
        self.speeds = np.vstack([speeds, speeds[-1:]])  # stretches end before the last row
        self.model = contact_model(robot, scene.without_parts_of(robot))
        self.levers = levers_of(with_arm_capsules(robot), self.model.pairs, farthest)
        self.minimum, self.time, self.pair = np.inf, 0.0, 0
        self.at_least, self.open_stretches, self.count = np.inf, 0, 0

    def run(self, begin: float, finish: float) -> None:
        edges = np.linspace(begin, finish, FIRST_INTERVALS + 1)
        pairs = len(self.model.pairs)
        start: FloatArray = np.repeat(edges[:-1], pairs)
        end: FloatArray = np.repeat(edges[1:], pairs)
        pair = np.tile(np.arange(pairs), FIRST_INTERVALS)
        while start.size:
            middle: FloatArray = 0.5 * (start + end)
            # Lipschitz bound: d(t) >= d(middle) - reach for all t of the interval.
            reach = self._reach(start, end, pair)
            sure = self._distances(middle, pair) - reach - ACCURACY
            self.count += sure.size
            # Halving goes on until the proved bound reaches this fraction of the least distance.
            beyond = max(self.minimum - ACCURACY - self.wanted, 0.0)
            enough = self.wanted + PROVED_RATIO * beyond
            closed = (sure > self.wanted) & (sure >= enough)
            if closed.any():
                self.at_least = min(self.at_least, float(sure[closed].min()))
            left = ~closed
            if self.minimum <= self.wanted or self.count > MOST_DISTANCES:
                self.open_stretches = int(left.sum())
                return
            short = left & (reach < ROUNDING)  # halves would be as undecided
            self.open_stretches += int(short.sum())
            left &= ~short
            start, middle, end = start[left], middle[left], end[left]
            start, end = np.concatenate([start, middle]), np.concatenate([middle, end])
            pair = np.tile(pair[left], 2)

    def _distances(self, times: FloatArray, pair: np.ndarray) -> FloatArray:
        """Return the distances of pairs at times, m; only those below the minimum are exact."""
        different, which = np.unique(times, return_inverse=True)
        q = self.motion.sample(different).q
        at_rest = np.zeros_like(q), which, pair, np.zeros((times.size, 2)), 0.0
        poses, (distances, *_) = self.model.parted(q, *at_rest)
        # The likeliest minimum comes first: bounds above a known distance need no exact geometry.
        for item in np.argsort(distances, kind="stable").tolist():
            if distances[item] > self.minimum:
                break
            index, links = int(pair[item]), poses[which[item]]
            distances[item] = apart = self.model.exact(index, links, self.minimum)
            if apart < self.minimum:
                self.minimum, self.time, self.pair = apart, float(times[item]), index
        return distances

    def _reach(self, start: FloatArray, end: FloatArray, pair: np.ndarray) -> FloatArray:
        """Return the largest approach of each pair within its interval, from the middle, m."""
        first = np.clip(np.searchsorted(self.motion.t, start, side="right") - 1, 0, None)
        last = np.clip(np.searchsorted(self.motion.t, end, side="left"), first + 1, None)
        edges = np.column_stack([first, np.minimum(last, self.motion.t.size - 1)]).ravel()
        speeds = np.maximum.reduceat(self.speeds, edges)[::2]  # reduceat also returns gaps between
        return 0.5 * (end - start) * (speeds * self.levers[pair]).sum(axis=1)


def _speed_bounds(motion: Motion) -> FloatArray:
    """Return bounds [N-1,n] of the joint speeds between samples.

    The Bernstein coefficients of a polynomial bound it on its interval.
    """
    pieces = pieces_of(motion)
    h = np.diff(motion.t)[:, None]
    slopes = [(k + 1) * pieces[:, k + 1] * h**k for k in range(5)]
    bounds = np.zeros_like(slopes[0])
    for j in range(5):
        # Bernstein coefficient j of a quartic sum_k s_k x^k: sum_k C(j,k) / C(4,k) s_k.
        control = sum(comb(j, k) / comb(4, k) * slopes[k] for k in range(j + 1))
        bounds = np.maximum(bounds, np.abs(control))
    return bounds


def levers_of(robot: Robot, pairs: Sequence[Pair], farthest: FloatArray) -> FloatArray:
    """Return the largest approach of each pair per unit of each joint's motion [k,n], m/rad (m/m).

    ``farthest`` [n] is the largest distance of each joint from zero, rad (m).
    """
    if robot.coupling is not None:
        sizes = np.abs(robot.transmission)
        chain = levers_of(robot.chain, pairs, sizes @ farthest + np.abs(robot.coupling.offsets))
        return chain @ sizes
    sliding = np.array([kind == "prismatic" for kind in robot.joint_types])
    rows = zip(robot.alpha, robot.a, robot.d, robot.beta, strict=True)
    offsets = [dh_transform(alpha, a, d, 0.0, beta)[:3, 3] for alpha, a, d, beta in rows]
    # The distance between two frames is at most the offset of the row plus the travel of a slide.
    steps = np.linalg.norm(offsets, axis=1) + np.where(sliding, farthest, 0.0)

    @cache
    def of(frame: int, capsule: Capsule) -> FloatArray:
        points = [capsule.start, capsule.end, *getattr(capsule, "corners", ())]
        lever_in_frame = float(np.linalg.norm(points, axis=1).max())
        levers = np.zeros(robot.joint_count)
        for joint in range(frame):
            turned = steps[joint + 1 : frame].sum() + lever_in_frame
            # A slide moves a point by its own travel, a revolute joint by angle times lever.
            levers[joint] = 1.0 if sliding[joint] else turned
        return levers

    table = []
    for pair in pairs:
        lever = of(pair.frame, pair.capsule)
        if pair.other_frame:
            # Joints before both links move both alike and leave their distance unchanged.
            lever = np.where(np.arange(robot.joint_count) < pair.other_frame, 0.0, lever)
        table.append(lever)
    return np.array(table)
