"""Distances between an arm and a scene by coal: none of the functions that solvers see is used."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.fast_calls import deferred_call
from microbot_ocp._base.needed import needed
from microbot_ocp._base.threads import cached_in_thread
from microbot_ocp.robot import Capsule, Robot, link_poses
from microbot_ocp.robot._capsules import LinkHull, link_hull
from microbot_ocp.robot._transforms import transform_of
from microbot_ocp.scene._obstacles import (
    MOST_FACES,
    Box,
    Cylinder,
    HalfSpace,
    Obstacle,
    Sphere,
    has_many_faces,
)
from microbot_ocp.scene._pairs import ACCURACY
from microbot_ocp.scene._scene import Pair, Scene, clearances, told_apart, with_arm_capsules


class Nearest(NamedTuple):
    """Where a pair is nearest.

    Attributes
    ----------
    pair : Pair
    distance : float
        m; negative where they overlap.
    on_arm, on_other : array [3]
        Nearest points in the base frame, m.
    """

    pair: Pair
    distance: float
    on_arm: FloatArray
    on_other: FloatArray


class ContactModel:
    """An arm and what it may touch, ready to be asked for distances in a pose, by one thread."""

    def __init__(self, robot: Robot, pairs: Sequence[Pair], unwatched: Sequence[Pair] = ()) -> None:
        self._coal = coal()
        self.pairs = tuple(pairs)
        self.unwatched = tuple(dict.fromkeys(pair.label for pair in unwatched))
        # with and without a compiler to the bit the same: a search goes on from what a pose decided
        self._poses = deferred_call(link_poses(robot))
        # of a thing in its frame, None for hulls of links: its pose there, and coal's transform
        self._placed: dict[tuple[int, Obstacle | None], tuple[FloatArray, Any]] = {}
        self._sides: list[tuple[Any, ...]] = []  # transforms of the two of each pair
        self._bounds: list[tuple[Any, ...] | None] = []  # by capsules around links
        self._solid = cache(partial(_solid_of, self._coal))
        self._functors: dict[tuple[Obstacle, Obstacle], Any] = {}
        self._capsules: dict[LinkHull, Capsule] = {}  # around hulls
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
        row_of = {id(transform): row for row, transform in enumerate(self._moving)}
        self._rows = [  # that each pair needs
            {row_of[id(at)] for at in (*sides, *(bound or ())[1:]) if id(at) in row_of}
            for sides, bound in zip(self._sides, self._bounds, strict=True)
        ]
        self._request, self._result = self._coal.DistanceRequest(), self._coal.DistanceResult()

    def _around(self, thing: Obstacle) -> Obstacle:
        """Return the capsule around a hull of a link; anything else itself."""
        if not isinstance(thing, LinkHull):
            return thing
        return self._capsules.setdefault(thing, Capsule(thing.start, thing.end, thing.radius))

    def _places(self, pair: Pair, one: Obstacle, other: Obstacle) -> tuple[Any, ...]:
        """Return the transforms of what stands for the two of a pair."""
        return self._place(pair.frame, one), self._place(pair.other_frame, other)

    def _place(self, frame: int, thing: Obstacle) -> Any:
        """Return the transform of a thing; hulls of links stand in their frame itself."""
        key = frame, None if isinstance(thing, LinkHull) else thing
        if key not in self._placed:
            pose = self._solid(thing)[1]
            self._placed[key] = pose, self._coal.Transform3s(pose[:3, :3], pose[:3, 3])
        return self._placed[key][1]

    def poses(self, q: FloatArray) -> FloatArray:
        """Return poses [N,k,4,4] of all that moves for q [N,n]."""
        poses = np.asarray(self._poses(np.ascontiguousarray(q, dtype=float)))
        return poses.reshape(len(q), 4, -1, 4).transpose(0, 2, 1, 3)[:, self._frames] @ self._locals

    def rows(self, pairs: Iterable[int]) -> list[int]:
        """Return the rows of a pose that pairs need."""
        return sorted(set[int]().union(*(self._rows[index] for index in pairs)))

    def put(self, poses: FloatArray, rows: Sequence[int] | None = None) -> None:
        """Bring what moves into a pose [k,4,4], or only some rows of it."""
        turns, shifts, moving = poses[:, :3, :3], poses[:, :3, 3], self._moving
        for row in range(len(moving)) if rows is None else rows:
            moving[row].setTransform(turns[row], shifts[row])

    def distance(self, index: int, enough: float = np.inf) -> float:
        """Return the distance of a pair where it stands, m; negative where it overlaps.

        Of one that is farther apart than is ``enough``, m, something between the two. Where parts
        of links overlap, by how much one of them does.
        """
        pair, bound = self.pairs[index], self._bounds[index]
        if bound is not None:
            self._last = bound
            self._result.clear()
            least = bound[0](*bound[1:], self._request, self._result)
            if least > enough:
                return least
        return self._least(pair.capsule, pair.other, self._sides[index], enough)

    def _functor(self, one: Obstacle, other: Obstacle) -> Any:
        """Return coal's function of the distance of two things, made when it is first needed."""
        key = one, other
        if key not in self._functors:
            shapes = (self._solid(thing)[0] for thing in key)
            self._functors[key] = self._coal.ComputeDistance(*shapes)
        return self._functors[key]

    def _least(self, one: Capsule, other: Obstacle, sides: tuple[Any, ...], enough: float) -> float:
        """Return the distance of two things at their places, of links by their parts."""
        functor = self._functor(one, other)
        self._result.clear()
        least = functor(*sides, self._request, self._result)
        self._last = functor, *sides
        parts = one.parts if isinstance(one, LinkHull) else ()
        others = other.parts if isinstance(other, LinkHull) else ()
        if least > enough or not (parts or others):
            return least
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
        """Return unit vector [3] from the other thing of a pair to the arm; zero at contact."""
        side = 1.0 if self.distance(index) > 0.0 else -1.0
        on_arm, on_other = self._points()
        way = side * (on_arm - on_other)
        apart = float(np.linalg.norm(way))
        return way / apart if apart > ACCURACY else np.zeros(3)

    def _points(self) -> tuple[FloatArray, FloatArray]:
        """Return the nearest points [3] of the pair that was asked for last."""
        functor, *sides = self._last
        result = self._result
        result.clear()
        functor(*sides, self._request, result)
        return np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())

    def distances(self, q: FloatArray) -> FloatArray:
        """Return distances [N,k] of all pairs in poses q [N,n], m."""
        distances = np.empty((len(q), len(self.pairs)))
        for row, poses in zip(distances, self.poses(q), strict=True):
            self.put(poses)
            row[:] = [self.distance(index) for index in range(len(self.pairs))]
        return distances

    def nearest(self, q: FloatArray) -> Nearest:
        """Return the nearest of all pairs in a pose [n]."""
        self.put(self.poses(np.reshape(q, (1, -1)))[0])
        least, index = np.inf, 0
        for k in range(len(self.pairs)):
            apart = self.distance(k, least)
            if apart < least:
                least, index = apart, k
        apart = self.distance(index)
        return Nearest(self.pairs[index], apart, *self._points())


def _solid_of(coal: Any, thing: Obstacle) -> tuple[Any, FloatArray]:
    """Return coal's shape of a thing and its pose [4,4] in the frame that it is rigid in."""
    if isinstance(thing, Sphere):
        return coal.Sphere(thing.radius), transform_of(np.eye(3), thing.center)
    if isinstance(thing, LinkHull):
        return _hull_of(coal, thing.corners), np.eye(4)
    if isinstance(thing, Capsule):
        along = thing.end - thing.start
        length, middle = float(np.linalg.norm(along)), (thing.start + thing.end) / 2
        if length < 1e-12:
            return coal.Sphere(thing.radius), transform_of(np.eye(3), middle)
        return coal.Capsule(thing.radius, length), transform_of(rotation_to(along / length), middle)
    if isinstance(thing, HalfSpace):
        return coal.Halfspace(thing.normal, thing.offset), np.eye(4)
    if isinstance(thing, Box):
        return coal.Box(*thing.size), thing.pose
    if isinstance(thing, Cylinder):
        return coal.Cylinder(thing.radius, thing.length), thing.pose
    return _hull_of(coal, thing.vertices), thing.pose


def _hull_of(coal: Any, corners: FloatArray) -> Any:
    points = coal.StdVec_Vec3s()
    for corner in corners:
        points.append(corner)
    return coal.Convex.convexHull(points, False, "")


def facing(robot: Robot, pairs: Sequence[Pair], q: FloatArray) -> tuple[Pair, ...]:
    """Give pairs with the directions in which the arm passes meshes of many faces in poses q [N,n].

    A large mesh would be seen decimetres nearer than it is otherwise.
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
    """Return as many of some unit vectors [N,3] as solvers see, each far from those before it."""
    directions = directions[directions.any(axis=1)]
    if not len(directions):
        return ()
    chosen, nearest = [directions[0]], directions @ directions[0]
    while len(chosen) < MOST_FACES:
        chosen.append(directions[nearest.argmin()])
        nearest = np.maximum(nearest, directions @ chosen[-1])
    return tuple(tuple(one.tolist()) for one in chosen)


def contact_model(robot: Robot, scene: Scene) -> ContactModel:
    """Return the contact model of an arm, with its capsules, in a scene; cached, for each thread.

    Raises
    ------
    InputError
        coal is not installed, or there is nothing that could touch.
    """
    arm = with_arm_capsules(robot)
    return _contact_model(arm, scene, arm.shapes)


@cached_in_thread(maxsize=16)
def _contact_model(robot: Robot, scene: Scene, shapes: tuple[Any, ...]) -> ContactModel:
    """Return the model; robots are equal whatever their shapes, which the cache must tell apart."""
    apart, overlapping = (_by_hulls(pairs, shapes) for pairs in told_apart(scene, robot))
    touching: tuple[Pair, ...] = ()
    if overlapping:
        zero = ContactModel(robot, overlapping).distances(np.zeros((1, robot.joint_count)))[0]
        touching = tuple(
            pair
            for pair, least in zip(overlapping, zero.tolist(), strict=True)
            if least <= ACCURACY and not (robot.disabled_pairs is not None and _of_hulls(pair))
        )
    pairs = (*apart, *(pair for pair in overlapping if pair not in touching))
    if not pairs:
        raise InputError("scene must have something that the arm may touch: it has no pair")
    return ContactModel(robot, pairs, touching)


def _by_hulls(pairs: Sequence[Pair], shapes: tuple[Any, ...]) -> tuple[Pair, ...]:
    """Return pairs with the hulls of links in place of the capsules that were fitted around."""

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
    """Return the pairs of capsules whose links may not touch: also those that overlap at zero."""
    arm = with_arm_capsules(robot)
    apart, overlapping = told_apart(scene, arm)
    left_out = contact_model(arm, scene).unwatched if overlapping else ()
    return (*apart, *(pair for pair in overlapping if pair.label not in left_out))


def room_along(
    robot: Robot, scene: Scene, pairs: Sequence[Pair], q: FloatArray, tolerance: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what is asked of pairs of capsules along poses q [N,n], each [k], m.

    A solver may leave open a share of their distances, the ``tolerance``.

    Returns
    -------
    room : array [k]
        What they have beyond the clearance. Of capsules that overlap in the pose in which their
        links are nearest, what they have there when these come as near as twice what may be left
        open, or half as near as they do.
    most : array [k]
        What the capsules have beyond the clearance in all of the poses.
    apart : array [k]
        How near the capsules come, or where they overlap the links.
    """
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
        allowance = min(allowance, 0.5 * beyond) if beyond > 0.0 else allowance
        room[there] = near[place, there] - least + allowance
    return room, most, apart


def coal() -> Any:
    """Return the package coal.

    Raises
    ------
    InputError
        It is not installed.
    """
    return needed("coal", "distances to obstacles need", "cell")


def has_coal() -> bool:
    """Return whether coal is installed."""
    try:
        coal()
    except InputError:
        return False
    return True


def rotation_to(direction: FloatArray) -> FloatArray:
    """Return a rotation [3,3] whose Z axis is a unit vector."""
    side = np.cross(np.eye(3)[np.argmin(np.abs(direction))], direction)
    side /= np.linalg.norm(side)
    return np.column_stack([side, np.cross(direction, side), direction])
