"""Distances between an arm and a scene by coal: none of the functions that solvers see is used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.fast_calls import fast_call
from microbot_ocp._base.needed import needed
from microbot_ocp._base.threads import cached_in_thread
from microbot_ocp.robot import Capsule, Robot, link_poses
from microbot_ocp.robot._capsules import LinkSurface
from microbot_ocp.scene._obstacles import (
    MOST_FACES,
    Box,
    ConvexMesh,
    Cylinder,
    HalfSpace,
    Obstacle,
    Sphere,
    has_many_faces,
)
from microbot_ocp.scene._pairs import ACCURACY as ACCURACY
from microbot_ocp.scene._scene import Pair, Scene, surface_pairs, with_arm_capsules


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

    def __init__(self, robot: Robot, pairs: Sequence[Pair]) -> None:
        self._coal = coal()
        self.robot, self.pairs = robot, tuple(pairs)
        self._poses = fast_call(link_poses(robot))
        self._placed: dict[tuple[int, int], int] = {}
        self._local: list[tuple[int, FloatArray, FloatArray]] = []  # frame, turn, shift
        self._transforms: list[Any] = []
        self._computed: list[tuple[Any, Any, Any]] = []  # functor, and both transforms
        self._shapes: dict[int, Any] = {}
        for pair in self.pairs:
            arm = self._place(pair.frame, pair.capsule)
            other = self._place(pair.other_frame, pair.other)
            shapes = self._shapes[id(pair.capsule)], self._shapes[id(pair.other)]
            functor = self._coal.ComputeDistance(*shapes)
            self._computed.append((functor, self._transforms[arm], self._transforms[other]))
        moving = [k for k, (frame, _, _) in enumerate(self._local) if frame]
        local = np.tile(np.eye(4), (len(moving), 1, 1))
        for row, (_, turn, shift) in zip(local, (self._local[k] for k in moving), strict=True):
            row[:3, :3], row[:3, 3] = turn, shift
        frames = np.array([self._local[k][0] for k in moving], dtype=int)
        self._moving = frames, local, [self._transforms[k] for k in moving]
        self._request, self._result = self._coal.DistanceRequest(), self._coal.DistanceResult()

    def _place(self, frame: int, thing: Obstacle) -> int:
        """Return index of the transform of a thing, with its shape made when it is first met."""
        key = frame, id(thing)
        if key not in self._placed:
            shape, turn, shift = self._shape_of(thing)
            self._shapes[id(thing)] = shape
            self._placed[key] = len(self._transforms)
            self._local.append((frame, turn, shift))
            self._transforms.append(self._coal.Transform3s(turn, shift))
        return self._placed[key]

    def _shape_of(self, thing: Obstacle) -> tuple[Any, FloatArray, FloatArray]:
        """Return coal's shape of a thing, its turn [3,3] and origin [3]."""
        coal, unturned = self._coal, np.eye(3)
        if isinstance(thing, Sphere):
            return coal.Sphere(thing.radius), unturned, thing.center
        if isinstance(thing, LinkSurface):
            return _bounding_volumes(coal, thing), unturned, np.zeros(3)
        if isinstance(thing, Capsule):
            along = thing.end - thing.start
            length, middle = float(np.linalg.norm(along)), (thing.start + thing.end) / 2
            if length < 1e-12:
                return coal.Sphere(thing.radius), unturned, middle
            return coal.Capsule(thing.radius, length), rotation_to(along / length), middle
        if isinstance(thing, HalfSpace):
            return coal.Halfspace(thing.normal, thing.offset), unturned, np.zeros(3)
        turn, shift = np.array(thing.pose[:3, :3]), np.array(thing.pose[:3, 3])
        if isinstance(thing, Box):
            return coal.Box(*thing.size), turn, shift
        if isinstance(thing, Cylinder):
            return coal.Cylinder(thing.radius, thing.length), turn, shift
        assert isinstance(thing, ConvexMesh)
        points = coal.StdVec_Vec3s()
        for vertex in thing.vertices:
            points.append(vertex)
        return coal.Convex.convexHull(points, False, ""), turn, shift

    def poses(self, q: FloatArray) -> FloatArray:
        """Return poses [N,n+1,4,4] of the base and the links for q [N,n]."""
        poses = np.asarray(self._poses(np.ascontiguousarray(q, dtype=float)))
        return poses.reshape(len(q), 4, -1, 4).transpose(0, 2, 1, 3)

    def put(self, poses: FloatArray) -> None:
        """Bring what moves into a pose [n+1,4,4]."""
        frames, local, transforms = self._moving
        placed = poses[frames] @ local  # all at once: a call of its own for each costs thrice that
        for transform, turn, shift in zip(
            transforms, placed[:, :3, :3], placed[:, :3, 3], strict=True
        ):
            transform.setTransform(turn, shift)

    def distance(self, index: int) -> float:
        """Return the distance of a pair where it stands, m; negative where it overlaps."""
        functor, arm, other = self._computed[index]
        self._result.clear()
        return functor(arm, other, self._request, self._result)

    def direction(self, index: int) -> FloatArray:
        """Return unit vector [3] from the other thing of a pair to the arm; zero at contact."""
        side = 1.0 if self.distance(index) > 0.0 else -1.0
        on_arm, on_other = self._points()
        way = side * (on_arm - on_other)
        apart = float(np.linalg.norm(way))
        return way / apart if apart > ACCURACY else np.zeros(3)

    def _points(self) -> tuple[FloatArray, FloatArray]:
        """Return the nearest points [3] of the pair that was asked for last."""
        result = self._result
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
        apart = self.distances(np.reshape(q, (1, -1)))[0]
        index = int(apart.argmin())
        self.distance(index)
        return Nearest(self.pairs[index], float(apart[index]), *self._points())


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
def _contact_model(robot: Robot, scene: Scene, _shapes: tuple[Any, ...]) -> ContactModel:
    """Return the model; robots are equal whatever their shapes, which the cache must tell apart."""
    pairs = (*scene.pairs(robot), *_seen_by_surface(robot, surface_pairs(scene, robot)))
    if not pairs:
        raise InputError("scene must have something that the arm may touch: it has no pair")
    return ContactModel(robot, pairs)


def _seen_by_surface(robot: Robot, pairs: tuple[Pair, ...]) -> tuple[Pair, ...]:
    """Return those of pairs of surfaces that may not touch.

    Without an SRDF file, which says it, those may touch that do so in the zero pose.
    """
    if not pairs or robot.disabled_pairs is not None:
        return pairs
    zero = ContactModel(robot, pairs).distances(np.zeros((1, robot.joint_count)))[0]
    return tuple(pair for pair, apart in zip(pairs, zero, strict=True) if apart > ACCURACY)


def _bounding_volumes(coal: Any, link: LinkSurface) -> Any:
    """Return coal's tree of bounding volumes over a link's triangles."""
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(link.triangles), 3 * len(link.triangles))
    for triangle in link.triangles:
        model.addTriangle(*triangle)
    model.endModel()
    return model


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
