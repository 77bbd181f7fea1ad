"""Capsules around a robot's links, fitted to their geometry; meshes need the extra ``urdf``.

A capsule is the set of all points within a radius of a segment. The distance between two capsules
is that of their segments less the radii, which is differentiable and cheap. The fit starts at the
principal axes of the points and descends to the direction of least volume. Across the direction,
the radius is that of the smallest enclosing circle; along it, the segment is the shortest that
covers all points.

A link that one capsule fits badly is cut by planes across principal axes, triangle by triangle. The
part of a solid between two planes lies inside the hull of its surface there, so no part is lost.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import combinations
from operator import itemgetter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.needed import needed
from microbot_ocp._base.quasi_random import evenly_spread_step
from microbot_ocp.robot._model import Robot
from microbot_ocp.robot._shapes import ROLES, Capsule, Role, Shape, read_mesh
from microbot_ocp.robot._transforms import dh_transform

SUPPORT_DIRECTIONS = 400  # number of directions in which the outermost points are searched
LINK_HALVINGS = 4  # levels of division of a link into cells, whose hulls approximate the link


def fit_capsules(
    robot: Robot, role: Role = "collision", *, added_volume: float = 0.3, most: int = 2
) -> dict[int, tuple[Capsule, ...]]:
    """Return as few capsules as fit closely around the geometry of each link.

    A link has one capsule if that adds no more volume than allowed. Otherwise planes cut the link
    into parts, each with its own capsule, until the volume is allowed or ``most`` is reached. The
    capsules of a link contain all of it.

    Parameters
    ----------
    robot : Robot
        Robot with ``shapes``, as from a URDF file.
    role : str
        Kind of geometry: "collision" or "visual".
    added_volume : float
        Largest volume that the capsules of a link may add, relative to the link's volume.
    most : int
        Largest number of capsules of a link, 1 to 32, even if they add more volume.

    Returns
    -------
    dict
        Capsules that are rigid in a frame, by the frame's number: 0 for the base, 1 to n for the
        links. Frames without geometry are left out. ``excess`` of a capsule is its distance from
        the geometry.

    Raises
    ------
    InputError
        A mesh file cannot be read, the extra ``urdf`` is missing, the ratio is below 0, or the
        count is out of range.
    """
    checks.one_of("role", role, ROLES)
    ratio = checks.number("added_volume", added_volume, at_least=0.0)
    count = int(checks.number("most", most, at_least=1, at_most=32))
    by_link: dict[tuple[int, str], list[Shape]] = {}
    for shape in robot.shapes:
        if shape.role == role:
            by_link.setdefault((shape.frame, shape.link), []).append(shape)
    fitted: dict[int, tuple[Capsule, ...]] = {}
    for (frame, link), shapes in sorted(by_link.items()):
        around = (replace(capsule, name=link) for capsule in _around(shapes, ratio, count))
        fitted[frame] = (*fitted.get(frame, ()), *around)
    return fitted


LINK_RADIUS = 1 / 30  # default radius of links, per total length of all links


def link_capsules(robot: Robot, radius: ArrayLike | None = None) -> dict[int, tuple[Capsule, ...]]:
    """Return capsules along the links of a robot that has only DH rows.

    Capsules follow the common normal from the origin of a frame to the next axis, and that axis to
    the next origin, as most links do. The last capsule ends at the tool. A prismatic joint has a
    capsule around its sliding part, as long as its travel.

    Parameters
    ----------
    robot : Robot
    radius : float or array_like [n+1], optional
        Radius of all links, or of each from the base to the last, m; default a thirtieth of their
        total length.

    Returns
    -------
    dict
        Capsules by frame, as from :func:`fit_capsules`, without those of length zero.

    Raises
    ------
    InputError
        A radius is not positive, or a prismatic joint has no position limits.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> capsules = mo.robot.link_capsules(mo.load_robot("planar_2r"), 0.05)
    >>> {frame: len(found) for frame, found in capsules.items()}
    {1: 1, 2: 1}
    """
    robot = robot.chain
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
        # The common normal ends at the bend, from which the offset d leads to the next origin.
        bend = before[:3, 3] + robot.a[joint] * before[:3, 0]
        segments += [(joint, before[:3, 3], bend), (joint, bend, step[:3, 3])]
        if slides:
            segments.append((joint + 1, np.array([0.0, 0.0, low - high]), np.zeros(3)))
        before = np.eye(4)
    segments.append((count, np.zeros(3), robot.tool[:3, 3]))
    lengths = [float(np.linalg.norm(end - start)) for _, start, end in segments]
    total = sum(lengths)
    default = total * LINK_RADIUS if radius is None else radius
    sizes = checks.array("radius", np.atleast_1d(checks.numbers("radius", default)), (None,), "m")
    if sizes.size not in (1, count + 1):
        raise InputError(f"radius must be one number or {count + 1}, not {sizes.size}")
    given = np.broadcast_to(sizes, count + 1)
    if (given <= 0).any():
        raise InputError(f"radius must be above 0 m, not {given.min():g}")
    capsules: dict[int, tuple[Capsule, ...]] = {}
    for (frame, start, end), length in zip(segments, lengths, strict=True):
        if length > ROUNDING * total:
            named = robot.links[frame - 1].name if frame and robot.links else None
            name = named or (f"link {frame}" if frame else "base")
            capsule = Capsule(start, end, float(given[frame]), name)
            capsules[frame] = (*capsules.get(frame, ()), capsule)
    return capsules


def enclosing_capsule(points: ArrayLike) -> Capsule:
    """Return the smallest capsule found around points [N,3], m; every point is inside."""
    places = checks.array("points", points, (None, 3), "m")
    if not len(places):
        raise InputError("points must be at least one, not 0")
    outer = _outermost(places)
    starts = sorted((_along(outer, u).volume, tuple(u)) for u in (*_principal(places), *np.eye(3)))
    return _along(places, _downhill(outer, np.array(starts[0][1])))


def _around(shapes: list[Shape], added_volume: float, most: int) -> list[Capsule]:
    """Return capsules around the shapes of a link."""
    (first, *others) = shapes
    if not others and first.kind in ("sphere", "cylinder", "capsule"):
        half = first.size[1] / 2 if first.size.size == 2 else 0.0
        center, axis, radius = first.pose[:3, 3], first.pose[:3, 2], float(first.size[0])
        # Height of the capsule's caps beyond the cylinder.
        excess = radius if first.kind == "cylinder" else 0.0
        return [Capsule(center - half * axis, center + half * axis, radius, excess=excess)]
    link = _LinkFit(_Surface.of(shapes))
    divisions = [[_Part(link.surface)]]
    while len(divisions) < most and link.added_volume(divisions[-1]) > added_volume:
        parts = divisions[-1]
        trials = (
            [finer for other in parts for finer in (halves if other is part else (other,))]
            for part in parts
            for halves in part.halves
        )
        best = min(trials, key=link.added_volume, default=None)
        if best is None:
            break
        divisions.append([_Part(part.surface) for part in best])
    parts = min(divisions, key=link.added_volume)
    return [replace(part.capsule, excess=link.excess(part, parts)) for part in parts]


@dataclass(frozen=True, eq=False)
class LinkHull(Capsule):
    """Convex hull of a link or of a part of one, given by its corners [V,3].

    ``parts`` enclose the link more closely: hulls of its halves on both sides of a plane. The
    capsule encloses the hull.
    """

    corners: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    parts: tuple[LinkHull, ...] = ()


@lru_cache(maxsize=64)
def link_hull(shapes: tuple[Shape, ...], frame: int, link: str) -> LinkHull | None:
    """Return the hull of a link's collision geometry, in its frame; None if it has no volume."""
    place = frame, link, "collision"
    chosen = [shape for shape in shapes if (shape.frame, shape.link, shape.role) == place]
    if not chosen:
        return None
    return _hull(_Surface.of(chosen), link, LINK_HALVINGS)[0]


CONVEX_SHARE = 0.999  # share of its hull's volume from which a link counts as convex


def _hull(surface: _Surface, link: str, halvings: int) -> tuple[LinkHull | None, float]:
    """Return the hull of a surface with its parts, None for a flat one, and their volume, m^3."""
    corners, volume = surface.hull
    if corners is None:
        return None, 0.0
    parts: tuple[LinkHull, ...] = ()
    if halvings:
        axes = _principal(corners)
        # The best plane is that whose two hulls have the least volume.
        cuts = [sides for axis in axes for sides in surface.halved(axis, 1)]
        sides = min(cuts, key=lambda cut: sum(side.hull[1] for side in cut), default=())
        halves = [_hull(side, link, halvings - 1) for side in sides]
        held = sum(half[1] for half in halves)
        if all(half[0] for half in halves) and 0.0 < held < CONVEX_SHARE * volume:
            volume, parts = held, tuple(half[0] for half in halves if half[0])
    c = _rough_capsule(corners)
    return LinkHull(c.start, c.end, c.radius, link, corners=corners, parts=parts), volume


@dataclass(frozen=True, eq=False)
class _Surface:
    """Triangles [T,3] of indices into ``places`` [P,3], m, which several surfaces may share."""

    places: FloatArray
    triangles: NDArray[np.intp]

    @classmethod
    def of(cls, shapes: Sequence[Shape]) -> _Surface:
        """Return the surface of shapes."""
        points = np.concatenate([_triangles(shape) for shape in shapes]).reshape(-1, 3)
        places, indices = np.unique(points, axis=0, return_inverse=True)
        return cls(places, indices.reshape(-1, 3))

    @property
    def points(self) -> FloatArray:
        """Corners [3 T,3] of the triangles in sequence, m."""
        return self.places[self.triangles.ravel()]

    @cached_property
    def hull(self) -> tuple[FloatArray | None, float]:
        """Corners [V,3] of the convex hull, None for a flat one, and its volume, m^3."""
        spatial = needed("scipy.spatial", "hulls of links need", "cell")
        # The hull is slow, so each place enters it once.
        used = np.zeros(len(self.places), dtype=bool)
        used[self.triangles] = True
        points = self.places[used]
        try:
            hull = spatial.ConvexHull(points)
        except spatial.QhullError:
            return None, 0.0
        return points[hull.vertices], float(hull.volume)

    def halved(self, axis: FloatArray, count: int) -> Iterator[tuple[_Surface, _Surface]]:
        """Yield the triangles on both sides of each of ``count`` planes across an axis."""
        heights = (self.places @ axis)[self.triangles]
        for plane in np.linspace(heights.min(), heights.max(), count + 2)[1:-1].tolist():
            sides = self._cut(heights - plane)
            if all(len(side.triangles) for side in sides):
                yield sides

    def _cut(self, heights: FloatArray) -> tuple[_Surface, _Surface]:
        """Return triangles below and above a plane, from the corners' heights over it [T,3].

        Triangles that cross the plane are divided.
        """
        below, above = (heights <= 0.0).all(axis=1), (heights >= 0.0).all(axis=1)
        crossing = ~(below | above)
        heights, rows = heights[crossing], np.arange(int(crossing.sum()))[:, None]
        up = (heights > 0.0).sum(axis=1) == 1  # the corner that is alone on its side is above
        alone = np.where(up, heights.argmax(axis=1), heights.argmin(axis=1))
        order = (alone[:, None] + np.arange(3)) % 3
        (h0, h1, h2), corners = heights[rows, order].T[:, :, None], self.triangles[crossing]
        i, j, k = corners[rows, order].T
        a, b, c = (self.places[index] for index in (i, j, k))
        # At p and q the edges of the single corner a cross the plane.
        p, q = a + h0 / (h0 - h1) * (b - a), a + h0 / (h0 - h2) * (c - a)
        at_p = len(self.places) + np.arange(len(p))
        at_q = at_p + len(p)
        places = np.concatenate([self.places, p, q])
        tips = np.column_stack([i, at_p, at_q])
        feet = np.concatenate([np.column_stack([at_p, j, k]), np.column_stack([at_p, k, at_q])])
        both = np.tile(up, 2)
        lower = np.concatenate([self.triangles[below], tips[~up], feet[both]])
        upper = np.concatenate([self.triangles[above & ~below], tips[up], feet[~both]])
        return _Surface(places, lower), _Surface(places, upper)


CUT_PLANES = 5  # number of planes across each principal axis, one of which may divide a part


@dataclass(frozen=True, eq=False)
class _Part:
    """A part of a link between planes."""

    surface: _Surface
    given: Capsule | None = None

    @cached_property
    def capsule(self) -> Capsule:
        return self.given or enclosing_capsule(self.surface.points)

    @cached_property
    def halves(self) -> list[tuple[_Part, ...]]:
        """Pairs of parts on both sides of several planes, each with a rough capsule."""
        return [
            tuple(_Part(side, _rough_capsule(side.points)) for side in sides)
            for axis in _principal(self.surface.points)
            for sides in self.surface.halved(axis, CUT_PLANES)
        ]


VOLUME_SAMPLES = 8192  # number of points for the measurement of volumes


class _LinkFit:
    """A solid, approximated by the hulls of its small cells."""

    def __init__(self, surface: _Surface) -> None:
        self.surface = surface
        # Cells halved along their longest principal axis are nearly convex.
        cells = [surface]
        for _ in range(LINK_HALVINGS):
            cells = [
                side
                for cell in cells
                for side in next(cell.halved(_principal(cell.points)[-1], 1), (cell,))
            ]
        self.supports = [(_directions() @ cell.points.T).max(axis=1) for cell in cells]
        whole = enclosing_capsule(surface.points)
        ends = np.array([whole.start, whole.end])
        low, high = ends.min(axis=0) - whole.radius, ends.max(axis=0) + whole.radius
        steps = evenly_spread_step(3)
        self.samples = low + (high - low) * (np.outer(np.arange(VOLUME_SAMPLES), steps) % 1.0)
        self.solid = self._distance(self.samples) <= 0.0

    def _distance(self, points: FloatArray) -> FloatArray:
        """Return the distance [N] of points [N,3] from the solid, m, in the tested directions."""
        # Beyond the support h of a hull in direction u the distance is at least u . x - h.
        reach = points @ _directions().T
        return np.min([(reach - support).max(axis=1) for support in self.supports], axis=0)

    def added_volume(self, parts: Sequence[_Part]) -> float:
        """Return the volume of capsules outside of the solid, relative to the solid's volume."""
        held = np.any([part.capsule.distance(self.samples) <= 0.0 for part in parts], axis=0)
        return float((held & ~self.solid).sum() / max(self.solid.sum(), 1))

    def excess(self, part: _Part, parts: Sequence[_Part]) -> float:
        """Return the largest distance of a part's capsule from the solid outside of others, m."""
        capsule, ball = part.capsule, part.capsule.radius * _directions()
        points = np.concatenate([capsule.start + ball, capsule.end + ball])
        others = [other.capsule.distance(points) > 0.0 for other in parts if other is not part]
        points = points[np.all(others, axis=0)] if others else points
        return max(float(self._distance(points).max()), 0.0) if len(points) else 0.0


def _rough_capsule(points: FloatArray) -> Capsule:
    """Return the smallest capsule along a principal axis around a subset of points [N,3]."""
    some = points[:: max(1, len(points) // SUPPORT_DIRECTIONS)]
    return min((_along(some, u) for u in _principal(some)), key=lambda capsule: capsule.volume)


POLYGON_SIDES = 32  # sides of the polygon around a circle


def _triangles(shape: Shape) -> FloatArray:
    """Return triangles [T,3,3] whose convex hull contains the shape, in the link frame."""
    if shape.kind == "mesh":
        mesh = read_mesh(shape)
        corners = mesh.triangles if len(mesh.triangles) else np.arange(len(mesh.vertices))[:, None]
        triangles = mesh.vertices[np.broadcast_to(corners, (len(corners), 3))]
    elif shape.kind == "box":
        rims = np.array([[0.0, -0.5], [np.sqrt(0.5), -0.5], [np.sqrt(0.5), 0.5], [0.0, 0.5]])
        triangles = _revolved(rims, 4) * shape.size
    else:
        sides = POLYGON_SIDES
        around = 1 / np.cos(np.pi / sides)  # factor of a polygon's corners outside of its circle
        radius, half = shape.size[0] * around, shape.size[-1] / 2 * (shape.size.size == 2)
        if shape.kind == "cylinder":
            rims = np.array([[0.0, -half], [radius, -half], [radius, half], [0.0, half]])
        else:
            turn = np.linspace(-np.pi / 2, np.pi / 2, sides // 2 + 1)
            rims = around * radius * np.column_stack([np.cos(turn), np.sin(turn)])
            rims[:, 0] = np.where(np.abs(turn) == np.pi / 2, 0.0, rims[:, 0])
            rims = np.concatenate([rims[turn <= 0] - [0, half], rims[turn >= 0] + [0, half]])
        triangles = _revolved(rims, sides)
    return triangles @ shape.pose[:3, :3].T + shape.pose[:3, 3]


def _revolved(rims: FloatArray, sides: int) -> FloatArray:
    """Return triangles [T,3,3] between successive polygons about Z, of radii and heights [K,2]."""
    turn = (2 * np.arange(sides + 1) + 1) * np.pi / sides
    circle = np.column_stack([np.cos(turn), np.sin(turn), np.ones(sides + 1)])
    rings = circle * rims[:, [0, 0, 1]][:, None]
    a, b, c, d = rings[:-1, :-1], rings[:-1, 1:], rings[1:, :-1], rings[1:, 1:]
    return np.concatenate([np.stack(t, axis=2).reshape(-1, 3, 3) for t in ((a, b, c), (b, d, c))])


def _principal(points: FloatArray) -> FloatArray:
    """Return principal axes of points [N,3], as rows."""
    centered = points - points.mean(axis=0)
    return np.linalg.eigh(centered.T @ centered)[1].T


@lru_cache
def _directions() -> FloatArray:
    """Return unit vectors spread over the sphere, on a spiral (Swinbank and Purser, 2006)."""
    index = np.arange(SUPPORT_DIRECTIONS) + 0.5
    z = 1 - 2 * index / SUPPORT_DIRECTIONS
    turn, across = np.pi * (1 + np.sqrt(5)) * index, np.sqrt(1 - z**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


def _outermost(points: FloatArray) -> FloatArray:
    """Return the points that are farthest in at least one of many directions."""
    if len(points) < SUPPORT_DIRECTIONS:
        return points
    return points[np.unique(np.argmax(_directions() @ points.T, axis=1))]


FINEST_STEP = 1e-3  # last step of the search for the direction, rad


def _downhill(points: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the unit vector near ``direction`` along which the capsule has the least volume."""
    # A pattern search: the volume has kinks where the outermost points change.
    best, step = _along(points, direction).volume, 0.2
    while step > FINEST_STEP:
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
    """Return two unit vectors orthogonal to a direction and to each other."""
    side = _unit(np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))]))
    return side, _unit(np.cross(direction, side))


def _along(points: FloatArray, direction: FloatArray) -> Capsule:
    """Return the capsule around the points whose segment has the given unit direction."""
    plane = np.column_stack(_across(direction))
    flat, along = points @ plane, points @ direction
    center = _circle_center(flat)
    across = np.linalg.norm(flat - center, axis=1)
    radius = float(across.max())
    # A cap reaches this far beyond the segment at the distance of a point from the axis.
    reach = np.sqrt(np.maximum(radius**2 - across**2, 0.0))
    # The segment covers every point if it begins before `begin` and ends after `end`.
    begin, end = float((along + reach).min()), float((along - reach).max())
    if begin > end:
        begin = end = (begin + end) / 2
    middle = plane @ center
    return Capsule(middle + begin * direction, middle + end * direction, radius)


Places = tuple[complex, ...]  # points of a plane


def _circle_center(points: FloatArray) -> FloatArray:
    """Return the centre [2] of the smallest circle around points [N,2].

    The farthest point outside joins the two or three points that determine the circle, which grows
    until no point is outside.
    """
    places = points @ [1, 1j]
    center, radius = places[0].item(), 0.0
    held: Places = (center,)
    for _ in range(1000):
        distance = np.abs(places - center)
        farthest = int(distance.argmax())
        if distance[farthest] <= radius * (1 + ROUNDING):
            break
        radius, center, held = _smallest(held, places[farthest].item())
    return np.array([center.real, center.imag])


def _smallest(held: Places, new: complex) -> tuple[float, complex, Places]:
    """Return radius, centre and two or three points of the smallest circle around some points.

    The circle passes through ``new``, which is outside of the smallest one around the others.
    """
    circles: list[tuple[complex, Places]] = [((new + p) / 2, (new, p)) for p in held]
    for pair in combinations(held, 2):
        a, b = (other - new for other in pair)
        # The centre is equidistant to the three points; collinear ones have none.
        if area := 2 * (a.conjugate() * b).imag:
            center = new - 1j * (abs(a) ** 2 * b - abs(b) ** 2 * a) / area
            circles.append((center, (new, *pair)))
    around = [
        (abs(new - center), center, members)
        for center, members in circles
        if max(abs(other - center) for other in held) <= abs(new - center) * (1 + ROUNDING)
    ]
    return min(around, key=itemgetter(0), default=(np.inf, new, held))
