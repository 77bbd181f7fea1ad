"""Capsules around a robot's links, fitted to their geometry; meshes need the extra ``urdf``.

A capsule is the set of all points within a radius of a segment: its distance to others is that of
two segments less the radii, which has derivatives and costs little. The fit looks for the direction
that gives the least volume, from the principal axes of the points downhill. Across it, the radius
is that of the smallest enclosing circle; along it, the segment is the shortest that covers all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.robot._model import Robot, dh_transform
from microbot_ocp.robot._shapes import ROLES, Capsule, Role, Shape, read_mesh


@dataclass(frozen=True)
class CapsuleFit:
    """Settings by which capsules are fitted around shapes.

    Attributes
    ----------
    sides : of the polygon around a circle
    directions : in which a sphere is sampled, and points are searched for the outermost
    sphere_slack : times the radius: points this far out span a polyhedron that holds the sphere
    slender : share of the total length of all links: their radius where none is given
    finest_step : rad, last step of the search for the direction
    """

    sides: int = 32
    directions: int = 400
    sphere_slack: float = 1.02
    slender: float = 1 / 30
    finest_step: float = 1e-3


CAPSULE_FIT = CapsuleFit()


def fit_capsules(robot: Robot, role: Role = "collision") -> dict[int, tuple[Capsule, ...]]:
    """Capsules that hold the geometry of a robot, one for each link of its file that has any.

    Parameters
    ----------
    robot : Robot
        As read from a URDF file: with ``shapes``.
    role : str
        Which geometry: "collision" or "visual".

    Returns
    -------
    dict
        Frame, 0 for the base frame and 1 to n for the link frames, to the capsules that are rigid
        in it. A frame without geometry is left out.

    Raises
    ------
    InputError
        A mesh file that cannot be read, or the extra ``urdf`` missing to read it.
    """
    checks.one_of("role", role, ROLES)
    by_link: dict[tuple[int, str], list[Shape]] = {}
    for shape in robot.shapes:
        if shape.role == role:
            by_link.setdefault((shape.frame, shape.link), []).append(shape)
    found: dict[int, tuple[Capsule, ...]] = {}
    for (frame, link), shapes in sorted(by_link.items()):
        capsule = replace(_around(shapes), name=link)
        found[frame] = (*found.get(frame, ()), capsule)
    return found


def link_capsules(robot: Robot, radius: ArrayLike | None = None) -> dict[int, tuple[Capsule, ...]]:
    """Capsules along the links of a robot of which only the DH rows are known.

    They go from the origin of a frame along the common normal to the next axis, and along that to
    the next origin, as most links do; the last one goes straight to the tool. A prismatic joint has
    one about its sliding part, as long as its travel.

    Parameters
    ----------
    robot : Robot
    radius : float or array_like [n+1], optional
        Of all, or from the base to the last link, m; default a thirtieth of their total length.

    Returns
    -------
    dict
        As :func:`fit_capsules`. Coinciding origins have none between them.

    Raises
    ------
    InputError
        A radius that is not positive, a prismatic joint without limits of its position.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> capsules = mo.link_capsules(mo.load_robot("planar_2r"), 0.05)
    >>> {frame: len(found) for frame, found in capsules.items()}
    {1: 1, 2: 1}
    """
    count = robot.joint_count
    segments: list[tuple[int, FloatArray, FloatArray]] = []
    before = robot.base
    for joint in range(count):
        slides = robot.joint_types[joint] == "prismatic"
        low, high = (float(side[joint]) for side in robot.limits.bounds("q"))
        if slides and not np.isfinite(high - low):
            raise InputError(
                f"joint {robot.joint_names[joint]!r} slides without limits of its position: give "
                "the capsules of its links by robot.with_capsules"
            )
        row = (robot.alpha[joint], robot.a[joint], robot.d[joint] + (low if slides else 0.0))
        step = before @ dh_transform(*row, robot.theta_offset[joint], robot.beta[joint])
        bend = before[:3, 3] + robot.a[joint] * before[:3, 0]
        segments += [(joint, before[:3, 3], bend), (joint, bend, step[:3, 3])]
        if slides:
            segments.append((joint + 1, np.array([0.0, 0.0, low - high]), np.zeros(3)))
        before = np.eye(4)
    segments.append((count, np.zeros(3), robot.tool[:3, 3]))
    lengths = [float(np.linalg.norm(end - start)) for _, start, end in segments]
    total = sum(lengths)
    default = total * CAPSULE_FIT.slender if radius is None else radius
    sizes = checks.array("radius", np.atleast_1d(checks.numbers("radius", default)), (None,), "m")
    if sizes.size not in (1, count + 1):
        raise InputError(f"radius must be one number or {count + 1}, not {sizes.size}")
    given = np.broadcast_to(sizes, count + 1)
    if (given <= 0).any():
        raise InputError(f"radius must be above 0 m, not {given.min():g}")
    found: dict[int, tuple[Capsule, ...]] = {}
    for (frame, start, end), length in zip(segments, lengths, strict=True):
        if length > 1e-9 * total:
            name = (robot.links[frame - 1].name if frame and robot.links else None) or (
                f"link {frame}" if frame else "base"
            )
            capsule = Capsule(start, end, float(given[frame]), name)
            found[frame] = (*found.get(frame, ()), capsule)
    return found


def enclosing_capsule(points: ArrayLike) -> Capsule:
    """The smallest capsule found around points [N,3], m; every point is inside."""
    places = checks.array("points", points, (None, 3), "m")
    if not len(places):
        raise InputError("points must be at least one, not 0")
    outer = places if len(places) < CAPSULE_FIT.directions else _outermost(places)
    centered = places - places.mean(axis=0)
    principal = np.linalg.eigh(centered.T @ centered)[1].T
    starts = sorted((_along(outer, u).volume, tuple(u)) for u in (*principal, *np.eye(3)))
    return _along(places, _downhill(outer, np.array(starts[0][1])))


def _around(shapes: list[Shape]) -> Capsule:
    """One capsule around the shapes of a link."""
    (first, *others) = shapes
    if not others and first.kind in ("sphere", "cylinder", "capsule"):
        half = first.size[1] / 2 if first.size.size == 2 else 0.0
        center, axis = first.pose[:3, 3], first.pose[:3, 2]
        return Capsule(center - half * axis, center + half * axis, float(first.size[0]))
    return enclosing_capsule(np.vstack([_points(shape) for shape in shapes]))


def _points(shape: Shape) -> FloatArray:
    """Points [N,3] whose convex hull holds the shape, in the shape's link frame."""
    if shape.kind == "mesh":
        points = read_mesh(shape).vertices
    elif shape.kind == "box":
        points = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T * shape.size
    elif shape.kind == "cylinder":
        turn = np.arange(CAPSULE_FIT.sides) * 2 * np.pi / CAPSULE_FIT.sides
        rim = (
            shape.size[0]
            / np.cos(np.pi / CAPSULE_FIT.sides)
            * np.array([np.cos(turn), np.sin(turn)])
        )
        ends = np.repeat([-0.5, 0.5], CAPSULE_FIT.sides) * shape.size[1]
        points = np.column_stack([np.tile(rim.T, (2, 1)), ends])
    else:
        half = shape.size[1] / 2 if shape.kind == "capsule" else 0.0
        ball, shift = (
            CAPSULE_FIT.sphere_slack * shape.size[0] * _directions(),
            np.array([0.0, 0.0, half]),
        )
        points = np.vstack([ball + shift, ball - shift])
    return points @ shape.pose[:3, :3].T + shape.pose[:3, 3]


def _directions() -> FloatArray:
    """Unit vectors spread over the sphere, on a spiral (Swinbank and Purser, 2006)."""
    index = np.arange(CAPSULE_FIT.directions) + 0.5
    z = 1 - 2 * index / CAPSULE_FIT.directions
    turn, across = np.pi * (1 + np.sqrt(5)) * index, np.sqrt(1 - z**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


def _outermost(points: FloatArray) -> FloatArray:
    """The points that lie farthest in any of many directions."""
    return points[np.unique(np.argmax(points @ _directions().T, axis=0))]


def _downhill(points: FloatArray, direction: FloatArray) -> FloatArray:
    """Unit vector near ``direction`` along which the capsule has the least volume."""
    best, step = _along(points, direction).volume, 0.2
    while step > CAPSULE_FIT.finest_step:
        side, other = _across(direction)
        trials = [_unit(direction + step * way) for way in (side, -side, other, -other)]
        volumes = [_along(points, trial).volume for trial in trials]
        if min(volumes) < best:
            best = min(volumes)
            direction = trials[int(np.argmin(volumes))]
        else:
            step /= 2
    return direction


def _unit(vector: ArrayLike) -> FloatArray:
    return np.array(vector, dtype=float) / np.linalg.norm(vector)


def _across(direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors at right angles to a direction and to each other."""
    side = _unit(np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))]))
    return side, _unit(np.cross(direction, side))


def _along(points: FloatArray, direction: FloatArray) -> Capsule:
    """The capsule around the points whose segment has the given unit direction."""
    plane = np.column_stack(_across(direction))
    flat, along = points @ plane, points @ direction
    center = _circle_center(flat)
    across = np.linalg.norm(flat - center, axis=1)
    radius = float(across.max()) * (1 + 1e-12)  # rounding leaves no point outside
    reach = np.sqrt(np.maximum(radius**2 - across**2, 0.0))
    # The segment may begin at most here, and end at least there, to cover every point.
    begin, end = float((along + reach).min()), float((along - reach).max())
    if begin > end:
        begin = end = (begin + end) / 2
    middle = plane @ center
    return Capsule(middle + begin * direction, middle + end * direction, radius)


def _circle_center(points: FloatArray) -> FloatArray:
    """Centre [2] of the smallest circle around points [N,2].

    The point farthest outside joins those that hold the circle, which then grows; no more than
    three are ever needed.
    """
    held = [points[0]]
    center, radius = points[0], 0.0
    for _ in range(1000):
        distance = np.linalg.norm(points - center, axis=1)
        farthest = int(np.argmax(distance))
        if distance[farthest] <= radius * (1 + 1e-12) + 1e-300:
            break
        held, center, radius = _smallest([*held, points[farthest]])
    return center


def _smallest(points: list[FloatArray]) -> tuple[list[FloatArray], FloatArray, float]:
    """The two or three of up to four points that hold the smallest circle around all, and it."""
    best: tuple[list[FloatArray], FloatArray, float] = (points, points[0], np.inf)
    for count in (2, 3):
        for chosen in combinations(points, count):
            center = _through(chosen)
            if center is None:
                continue
            radius = float(np.linalg.norm(chosen[0] - center))
            outside = max(float(np.linalg.norm(p - center)) for p in points)
            if radius < best[2] and outside <= radius * (1 + 1e-9):
                best = (list(chosen), center, radius)
    return best


def _through(points: tuple[FloatArray, ...]) -> FloatArray | None:
    """Centre of the circle through two opposite points or through three; None in one line."""
    if len(points) == 2:
        return (points[0] + points[1]) / 2
    to = np.array([points[1] - points[0], points[2] - points[0]])
    size = np.abs(to).max()
    if abs(np.linalg.det(to)) <= 1e-12 * size**2:
        return None
    return points[0] + np.linalg.solve(2 * to, (to**2).sum(axis=1))
