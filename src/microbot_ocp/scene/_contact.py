"""Distances between an arm and a scene by coal, independent of the functions of the solvers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, cached_property, lru_cache, partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.fast_calls import deferred_call
from microbot_ocp._base.needed import needed
from microbot_ocp._base.threads import cached_in_thread
from microbot_ocp.robot import Capsule, LinkHull, Robot, link_hull, link_poses, transform_of
from microbot_ocp.scene._obstacles import (
    MOST_FACES,
    TINY,
    Box,
    Cylinder,
    HalfSpace,
    Obstacle,
    Sphere,
    core_radius,
    has_many_faces,
)
from microbot_ocp.scene._pairs import ACCURACY
from microbot_ocp.scene._scene import Pair, Scene, clearances, separated_pairs, with_arm_capsules

LARGE = 1e3  # half the edge of a half space's box, m


class Nearest(NamedTuple):
    """Nearest points of a pair of bodies.

    Attributes
    ----------
    pair : Pair
        Pair of bodies.
    distance : float
        Distance of the two, m; negative if they overlap.
    on_arm, on_other : array [3]
        Nearest points in the base frame, m.
    """

    pair: Pair
    distance: float
    on_arm: FloatArray
    on_other: FloatArray


class ContactModel:
    """Arm and surroundings as coal's geometries; evaluates distances in a pose, in one thread.

    The distance of a pair is bounded by the capsules around its links; their convex hulls are
    evaluated only if that bound does not decide.
    """

    def __init__(self, robot: Robot, pairs: Sequence[Pair], unwatched: Sequence[Pair] = ()) -> None:
        self._coal, self._robot = coal(), robot
        self.pairs = tuple(pairs)
        self.unwatched = tuple(dict.fromkeys(pair.label for pair in unwatched))
        # The planner branches on these values: they must not change by a bit with a compiler.
        self._poses = deferred_call(link_poses(robot))
        # Pose of each body in its frame and its transform in coal; hulls share that of their frame.
        self._placed: dict[tuple[int, Obstacle | None], tuple[FloatArray, Any]] = {}
        self._sides: list[tuple[Any, ...]] = []  # transforms of both bodies of each pair
        self._bounds: list[tuple[Any, ...] | None] = []  # capsules that bound the hulls of a pair
        self._solid = cache(partial(_solid_of, self._coal))
        self._around = cache(_around)
        self._functor = cache(self._new_functor)
        for pair in self.pairs:
            self._sides.append(self._places(pair, pair.capsule, pair.other))
            around = [self._around(thing) for thing in (pair.capsule, pair.other)]
            if around == [pair.capsule, pair.other]:
                self._bounds.append(None)
            else:
                self._bounds.append((self._functor(*around), *self._places(pair, *around)))
        moving = [(frame, *placed) for (frame, _), placed in self._placed.items() if frame]
        self._frames = np.array([frame for frame, _, _ in moving], dtype=int)
        self._locals = np.array([local for _, local, _ in moving])
        self._moving = [transform for _, _, transform in moving]
        self._request, self._result = self._coal.DistanceRequest(), self._coal.DistanceResult()

    def _places(self, pair: Pair, one: Obstacle, other: Obstacle) -> tuple[Any, ...]:
        """Return the transforms of two bodies that stand for a pair."""
        return self._place(pair.frame, one), self._place(pair.other_frame, other)

    def _place(self, frame: int, thing: Obstacle) -> Any:
        """Return the transform of a body; hulls of links have that of their frame."""
        key = frame, None if isinstance(thing, LinkHull) else thing
        if key not in self._placed:
            pose = self._solid(thing)[1]
            self._placed[key] = pose, self._coal.Transform3s(pose[:3, :3], pose[:3, 3])
        return self._placed[key][1]

    def poses(self, q: FloatArray) -> FloatArray:
        """Return the poses [N,k,4,4] of all moving bodies for q [N,n]."""
        poses = np.asarray(self._poses(np.ascontiguousarray(q, dtype=float)))
        return poses.reshape(len(q), 4, -1, 4).transpose(0, 2, 1, 3)[:, self._frames] @ self._locals

    @cached_property
    def motions(self) -> tuple[Any, np.ndarray, FloatArray]:
        """Function of all motions, the row of its second output for each pair, and the bodies.

        The function ``(q, slopes) -> poses, motions [A,13]`` returns the poses of the links and,
        seen from the other body, the ends of different axes, their velocities and the largest speed
        of the capsule. The rows of bodies [k,17] are arguments of ``parting``.
        """
        axes = [(pair.frame, pair.capsule, pair.other_frame) for pair in self.pairs]
        row_of = {axis: row for row, axis in enumerate(dict.fromkeys(axes))}
        others = [_body(p.capsule, self._around(p.other), self._solid) for p in self.pairs]
        function = deferred_call(_motions(self._robot, tuple(row_of)))
        return function, np.array([row_of[axis] for axis in axes]), np.array(others)

    def parted(
        self,
        q: FloatArray,
        slopes: FloatArray,
        pose: np.ndarray,
        pair: np.ndarray,
        rates: FloatArray,
        half: float,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the poses of the links in poses q [N,n] that move by slopes [N,n], and [3,K] of
        ``parting`` for K combinations of pose and pair, whose points move by ``rates`` [K,2].
        """
        function, row_of, bodies = self.motions
        links, motions = function(q, slopes)
        return links, parting()(motions[pose, row_of[pair]], bodies[pair], rates, half).T

    def put(self, poses: FloatArray) -> None:
        """Set the moving bodies to their poses [k,4,4]."""
        for moving, turn, shift in zip(
            self._moving, poses[:, :3, :3], poses[:, :3, 3], strict=True
        ):
            moving.setTransform(turn, shift)

    def distance(self, index: int, enough: float = np.inf) -> float:
        """Return the distance of a pair in the current pose, m; negative if they overlap.

        A distance above ``enough`` (m) may be replaced by a lower bound above ``enough``. If parts
        of links overlap, the result is the depth of one of them.
        """
        pair, bound = self.pairs[index], self._bounds[index]
        # Capsules contain their links, so their distance is a lower bound.
        if bound is not None:
            self._last = bound
            self._result.clear()
            least = bound[0](*bound[1:], self._request, self._result)
            if least > enough:
                return least
        return self._least(pair.capsule, pair.other, self._sides[index], enough)

    def exact(self, index: int, links: FloatArray, enough: float) -> float:
        """Return ``distance`` of a pair for poses of the links [4, 4 (n+1)], without capsules."""
        pair, sides = self.pairs[index], self._sides[index]
        places = (pair.frame, pair.capsule), (pair.other_frame, pair.other)
        for side, (frame, thing) in zip(sides, places, strict=True):
            if frame:
                pose = links[:, 4 * frame : 4 * frame + 4] @ self._solid(thing)[1]
                side.setTransform(pose[:3, :3], pose[:3, 3])
        return self._least(pair.capsule, pair.other, sides, enough)

    def _new_functor(self, one: Obstacle, other: Obstacle) -> Any:
        """Return coal's distance function of two bodies."""
        return self._coal.ComputeDistance(self._solid(one)[0], self._solid(other)[0])

    def _least(self, one: Capsule, other: Obstacle, sides: tuple[Any, ...], enough: float) -> float:
        """Return the distance of two bodies; links are refined by their parts."""
        functor = self._functor(one, other)
        self._result.clear()
        least = functor(*sides, self._request, self._result)
        self._last = functor, *sides
        parts = one.parts if isinstance(one, LinkHull) else ()
        others = other.parts if isinstance(other, LinkHull) else ()
        if least > enough or not (parts or others):
            return least
        # The larger of two divided links is divided first; the recursion divides the other.
        pairs = [(part, other) for part in parts]
        if isinstance(other, LinkHull) and others and (not parts or other.radius > one.radius):
            pairs = [(one, part) for part in others]
        least, nearest = np.inf, self._last
        for pair in pairs:
            apart = self._least(*pair, sides, min(enough, least))
            if apart < least:
                least, nearest = apart, self._last
            if least <= 0.0:
                break
        self._last = nearest
        return least

    def direction(self, index: int) -> FloatArray:
        """Return the unit vector [3] from the other body of a pair to the arm; zero at contact."""
        # The nearest points of overlapping bodies lie the other way round.
        side = 1.0 if self.distance(index) > 0.0 else -1.0
        on_arm, on_other = self._points()
        way = side * (on_arm - on_other)
        apart = float(np.linalg.norm(way))
        return way / apart if apart > ACCURACY else np.zeros(3)

    def _points(self) -> tuple[FloatArray, FloatArray]:
        """Return the nearest points [3] of the last evaluated pair."""
        functor, *sides = self._last
        result = self._result
        result.clear()
        functor(*sides, self._request, result)
        return np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())

    def distances(self, q: FloatArray) -> FloatArray:
        """Return the distances [N,k] of all pairs in poses q [N,n], m."""
        distances = np.empty((len(q), len(self.pairs)))
        for row, poses in zip(distances, self.poses(q), strict=True):
            self.put(poses)
            row[:] = [self.distance(index) for index in range(len(self.pairs))]
        return distances

    def nearest(self, q: FloatArray) -> Nearest:
        """Return the nearest pair in a pose [n]."""
        self.put(self.poses(np.reshape(q, (1, -1)))[0])
        least, index = np.inf, 0
        for k in range(len(self.pairs)):
            apart = self.distance(k, least)
            if apart < least:
                least, index = apart, k
        apart = self.distance(index)
        return Nearest(self.pairs[index], apart, *self._points())


def _around(thing: Obstacle) -> Obstacle:
    """Return the capsule around a hull of a link; any other body unchanged."""
    if not isinstance(thing, LinkHull):
        return thing
    return Capsule(thing.start, thing.end, thing.radius)


@lru_cache(maxsize=64)
def _motions(robot: Robot, axes: tuple[tuple[int, Capsule, int], ...]) -> ca.Function:
    """Return the function of ``ContactModel.motions``; axes are frame, capsule, other frame."""
    q, slopes = (ca.SX.sym(name, robot.joint_count) for name in ("q", "slopes"))
    placed = link_poses(robot)(q)
    poses, rates = (ca.horzsplit(x, 4) for x in (placed, ca.jtimes(placed, q, slopes)))
    rows = []
    for frame, capsule, other in axes:
        # A point x that the other body sees at y = T^-1 x moves there by dy = T^-1 (dx - dT y).
        back, origin, ends, speeds = poses[other][:3, :3].T, poses[other][:3, 3], [], []
        for point in (capsule.start, capsule.end):
            end, speed = (x[frame][:3, :] @ [*point, 1.0] for x in (poses, rates))
            ends.append(back @ (end - origin))
            speeds.append(back @ (speed - rates[other][:3, :] @ ca.vertcat(ends[-1], 1.0)))
        spins = [ca.inv_skew(rates[k][:3, :3] @ poses[k][:3, :3].T) for k in (frame, other)]
        spin = ca.norm_2(spins[0] - spins[1])
        fastest = ca.fmax(*map(ca.norm_2, speeds)) + capsule.radius * spin
        rows.append(ca.vertcat(*ends, *speeds, fastest))
    outputs = ca.cse([ca.densify(placed), ca.densify(ca.horzcat(*rows).T)])
    return ca.Function("motions", [q, slopes], outputs)


@lru_cache(maxsize=1)
def parting() -> Any:
    """Return ``(motion, body, rates, half) -> [distance, least, approach]`` of many pairs.

    They are a lower bound of the distance of a capsule from another body, one that holds while the
    motion goes on by ``half`` either way, and the largest approach meanwhile. ``rates`` bounds the
    first and second derivative of all points. The plane in the point of the body that is nearest to
    the axis parts the two until an end of the axis reaches it. Bounds below zero say nothing.
    """
    sizes = {"motion": 13, "body": 17, "rates": 2, "half": 1}
    motion, body, rates, half = given = [ca.SX.sym(*item) for item in sizes.items()]
    back, edges, (radius, thick) = (
        ca.reshape(body[:9], 3, 3).T,
        body[12:15],
        ca.vertsplit(body[15:]),
    )
    one, two = (back @ (motion[k : k + 3] - body[9:12]) for k in (0, 3))

    def nearest(x: ca.SX) -> ca.SX:
        inward = ca.fmin(1.0, radius / (ca.norm_2(x[:2]) + TINY))
        return ca.fmin(ca.fmax(ca.vertcat(inward * x[:2], x[2]), -edges), edges)

    x = middle = (one + two) / 2
    along = (two - one) / 2
    for _ in range(3):  # more projections part hardly more
        share = ca.dot(nearest(x) - middle, along) / (ca.dot(along, along) + TINY)
        x = middle + ca.fmin(ca.fmax(share, -1.0), 1.0) * along
    place = nearest(x)
    normal = (x - place) / (ca.norm_2(x - place) + TINY)
    heights = [ca.dot(normal, end - place) - thick for end in (one, two)]
    falls = [half * ca.fabs(ca.dot(normal, back @ motion[k : k + 3])) for k in (6, 9)]
    more, distance = 0.5 * half**2 * rates[1], ca.fmin(*heights)
    least = ca.fmin(heights[0] - falls[0], heights[1] - falls[1]) - more
    least = ca.fmax(least, distance - half * rates[0])
    approach = ca.fmin(half * rates[0], half * motion[12] + more)
    outputs = ca.cse([ca.densify(ca.vertcat(distance, least, approach))])
    return deferred_call(ca.Function("parting", given, outputs))


def _body(capsule: Capsule, other: Obstacle, solid: Any) -> list[float]:
    """Return a body for ``parting``: turn, place, half edges and radius of its core, both radii.

    The core is a box, or the cylinder of that radius; a box around a mesh.
    """
    pose, edges, radius, thick = solid(other)[1].copy(), np.zeros(3), np.inf, core_radius(other)
    if isinstance(other, Capsule):
        edges[2] = 0.5 * np.linalg.norm(other.end - other.start)
    elif isinstance(other, HalfSpace):  # a box that is larger than any arm
        edges[:] = LARGE
        pose = transform_of(rotation_to(other.normal), (other.offset - LARGE) * other.normal)
    elif isinstance(other, Cylinder):
        edges[:], radius = [np.inf, np.inf, 0.5 * other.length], other.radius
    elif isinstance(other, Box):
        edges = 0.5 * other.size
    elif not isinstance(other, Sphere):
        low, high = other.vertices.min(axis=0), other.vertices.max(axis=0)
        edges = 0.5 * (high - low)
        pose[:3, 3] += pose[:3, :3] @ (0.5 * (high + low))
    return [*pose[:3, :3].ravel("F"), *pose[:3, 3], *edges, radius, thick + capsule.radius]


def _solid_of(coal: Any, thing: Obstacle) -> tuple[Any, FloatArray]:
    """Return coal's shape of a body and its pose [4,4] in its frame."""
    if isinstance(thing, Sphere):
        return coal.Sphere(thing.radius), transform_of(np.eye(3), thing.center)
    if isinstance(thing, LinkHull):
        return _link_solid(thing), np.eye(4)
    if isinstance(thing, Capsule):
        along = thing.end - thing.start
        length, middle = float(np.linalg.norm(along)), (thing.start + thing.end) / 2
        if length == 0.0:
            return coal.Sphere(thing.radius), transform_of(np.eye(3), middle)
        return coal.Capsule(thing.radius, length), transform_of(rotation_to(along / length), middle)
    if isinstance(thing, HalfSpace):
        return coal.Halfspace(thing.normal, thing.offset), np.eye(4)
    if isinstance(thing, Box):
        return coal.Box(*thing.size), thing.pose
    if isinstance(thing, Cylinder):
        return coal.Cylinder(thing.radius, thing.length), thing.pose
    return _hull_of(coal, thing.vertices), thing.pose


@cached_in_thread(maxsize=1024)
def _link_solid(hull: LinkHull) -> Any:
    """Return coal's shape of a link, which takes longer to build than hundreds of distances."""
    return _hull_of(coal(), hull.corners)


def _hull_of(coal: Any, corners: FloatArray) -> Any:
    points = coal.StdVec_Vec3s()
    for corner in corners:
        points.append(corner)
    return coal.Convex.convexHull(points, False, "")


def facing(robot: Robot, pairs: Sequence[Pair], q: FloatArray) -> tuple[Pair, ...]:
    """Add to pairs the directions in which poses q [N,n] pass meshes with many faces.

    Solvers see such a mesh as a polyhedron around it, which may stand out by decimetres; a face in
    the direction of the arm makes it exact there.
    """
    meshes = [pair for pair in pairs if has_many_faces(pair.other)]
    if not meshes:
        return tuple(pairs)
    model = ContactModel(with_arm_capsules(robot), meshes)
    ways: dict[Pair, list[FloatArray]] = {pair: [] for pair in meshes}
    for poses in model.poses(q):
        model.put(poses)
        for index, pair in enumerate(meshes):
            ways[pair].append(model.direction(index))
    return tuple(
        replace(pair, facing=_farthest(np.array(ways[pair]))) if pair in ways else pair
        for pair in pairs
    )


def _farthest(directions: FloatArray) -> tuple[tuple[float, ...], ...]:
    """Choose at most 26 of some unit vectors [N,3] by farthest-point sampling."""
    directions = directions[directions.any(axis=1)]
    if not len(directions):
        return ()
    chosen, nearest = [directions[0]], directions @ directions[0]
    while len(chosen) < MOST_FACES:
        chosen.append(directions[nearest.argmin()])
        nearest = np.maximum(nearest, directions @ chosen[-1])
    return tuple(tuple(one.tolist()) for one in chosen)


def contact_model(robot: Robot, scene: Scene) -> ContactModel:
    """Return the contact model of an arm, with its capsules, in a scene; cached in each thread.

    Raises
    ------
    InputError
        coal is not installed, or no pair of the arm and the scene may touch.
    """
    arm = with_arm_capsules(robot)
    return _contact_model(arm, scene, arm.shapes)


@cached_in_thread(maxsize=16)
def _contact_model(robot: Robot, scene: Scene, shapes: tuple[Any, ...]) -> ContactModel:
    """Build the contact model; ``shapes`` is a cache key, since robots compare without shapes."""
    # Capsules that overlap at zero may belong to hulls that do not; only touching hulls are exempt.
    apart, overlapping = (_by_hulls(pairs, shapes) for pairs in separated_pairs(scene, robot))
    touching: tuple[Pair, ...] = ()
    if overlapping:
        zero = ContactModel(robot, overlapping).distances(np.zeros((1, robot.joint_count)))[0]
        touching = tuple(
            pair
            for pair, least in zip(overlapping, zero.tolist(), strict=True)
            if least <= ACCURACY and (robot.disabled_pairs is None or not _of_hulls(pair))
        )
    pairs = (*apart, *(pair for pair in overlapping if pair not in touching))
    if not pairs:
        raise InputError("scene must have something that the arm may touch: it has no pair")
    return ContactModel(robot, pairs, touching)


def _by_hulls(pairs: Sequence[Pair], shapes: tuple[Any, ...]) -> tuple[Pair, ...]:
    """Replace fitted capsules of pairs by the convex hulls of their links."""

    def judged(frame: int, thing: Obstacle) -> Obstacle:
        fitted = isinstance(thing, Capsule) and thing.excess > 0.0
        return (fitted and link_hull(shapes, frame, thing.name)) or thing

    of_hulls = []
    for pair in pairs:
        one, other = judged(pair.frame, pair.capsule), judged(pair.other_frame, pair.other)
        of_hulls.append(Pair(pair.frame, one, other, pair.other_frame))  # type: ignore[arg-type]
    return tuple(dict.fromkeys(of_hulls))


def _of_hulls(pair: Pair) -> bool:
    return isinstance(pair.capsule, LinkHull) and isinstance(pair.other, LinkHull)


def guiding_pairs(robot: Robot, scene: Scene) -> tuple[Pair, ...]:
    """Return the pairs of capsules whose links may not touch, also those that overlap at zero."""
    arm = with_arm_capsules(robot)
    apart, overlapping = separated_pairs(scene, arm)
    left_out = contact_model(arm, scene).unwatched if overlapping else ()
    return (*apart, *(pair for pair in overlapping if pair.label not in left_out))


def room_along(
    robot: Robot,
    scene: Scene,
    pairs: Sequence[Pair],
    q: FloatArray,
    tolerance: float,
    spare: float | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the distances that a limit may require of pairs along known poses q [N,n], m.

    ``tolerance`` is the fraction of a distance by which a solver may miss it. ``spare`` is the
    distance to be left between links whose capsules overlap, m, even if the poses come nearer.

    Returns
    -------
    room : array [k]
        Least distance of the capsules beyond the clearance. If the capsules overlap in the pose
        where their links are nearest: their distance there, corrected as if the links came as near
        as twice the solver's miss, or half as near as they do.
    most : array [k]
        Least distance of the capsules beyond the clearance over all poses.
    apart : array [k]
        Least distance of the capsules, or of the links if the capsules overlap.
    """
    # Hulls are nearer to the truth than capsules, so they decide where capsules overlap.
    near = clearances(robot, pairs, q)
    apart = near.min(axis=0)
    most = apart - scene.clearance
    room = most.copy()
    model = contact_model(robot, scene)
    radii = [capsule.radius for _, capsule in robot.capsules]
    left_open = tolerance * (max(radii, default=0.0) + scene.clearance)
    for label in dict.fromkeys(pairs[k].label for k in np.flatnonzero(most <= 0.0).tolist()):
        judged = [k for k, pair in enumerate(model.pairs) if pair.label == label]
        columns = [k for k, pair in enumerate(pairs) if pair.label == label and most[k] <= 0.0]
        overlapping = np.flatnonzero((near[:, columns] <= scene.clearance).any(axis=1))
        least, place = np.inf, 0
        for k, poses in zip(overlapping.tolist(), model.poses(q[overlapping]), strict=True):
            model.put(poses)
            for index in judged:
                least, place = min((least, place), (model.distance(index, least), k))
        apart[columns] = least
        there = [k for k in columns if near[place, k] <= scene.clearance]
        beyond, allowance = least - scene.clearance, 2.0 * left_open
        if spare is not None:
            allowance = spare
        elif beyond > 0.0:
            allowance = min(allowance, 0.5 * beyond)
        room[there] = near[place, there] - least + allowance
    return room, most, apart


def coal() -> Any:
    """Return the package coal.

    Raises
    ------
    InputError
        The package is not installed.
    """
    return needed("coal", "distances to obstacles need", "cell")


def has_coal() -> bool:
    """Return True if coal is installed."""
    try:
        coal()
    except InputError:
        return False
    return True


def rotation_to(direction: FloatArray) -> FloatArray:
    """Return a rotation [3,3] whose Z axis is the unit vector ``direction``."""
    side = np.cross(np.eye(3)[np.argmin(np.abs(direction))], direction)
    side /= np.linalg.norm(side)
    return np.column_stack([side, np.cross(direction, side), direction])
