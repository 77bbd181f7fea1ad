"""Segments between stops: tool lines, tool circles, joint lines, blended corners.

A segment adds limits that hold on it alone: the distance of the tool from its curve, and the angle
to the orientation at the nearest place of the curve. Solver, certificate, figures and tables treat
them like torque limits. A norm has no derivative at zero, which slows solvers down. Therefore a
tube is an octagonal prism with edges at the tolerance from the curve, and an angle is bounded by
its components about three axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp.limits import Limit

TOLERANCE, ORIENTATION_TOLERANCE = 1e-3, 0.01  # usual ones of a tool line or an arc, m and rad
DIRECTIONS = np.arange(4) / 4 * np.pi  # normals of the octagon's sides, rad
SIDE = float(np.cos(np.pi / 8))  # distance of the octagon's sides, per radius of its corners


Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Line:
    """Straight line of the tool from one stop to the next, with a turn about a fixed axis.

    The orientation is kept if both stops have one; a joint pose has one if the arm has at least six
    joints. A turn that a stop leaves free is free on the line, too.

    Parameters
    ----------
    tolerance : float
        Radius of the tube around the line for the tool's origin, m; at most a tenth of the reach.
    orientation_tolerance : float
        Largest angle to the orientation at the nearest place of the line, rad.

    Raises
    ------
    InputError
        A tolerance is not above zero.
    """

    tolerance: float = TOLERANCE
    orientation_tolerance: float = ORIENTATION_TOLERANCE

    def __post_init__(self) -> None:
        checks.number("tolerance of a line", self.tolerance, "m", above=0.0)
        _check_turn(self.orientation_tolerance)


MOST_TURNS = 20  # largest number of full turns of one circle


@dataclass(frozen=True)
class Circle:
    """Arc of the tool from one stop to the next, on a circle through a third point.

    Parameters
    ----------
    through : array_like [3] or [2,3]
        Point of the arc between its ends, in the base frame, m. A full circle, with both ends at
        one place, needs two points in their order along the circle.
    tolerance : float
        Radius of the tube around the arc for the tool's origin, m.
    orientation_tolerance : float
        Largest angle to the orientation at the nearest place of the arc, rad.
    turns : int
        Number of additional full turns.

    Raises
    ------
    InputError
        An invalid point, a tolerance not above zero, or turns that are not a whole number.
    """

    through: Any
    tolerance: float = TOLERANCE
    orientation_tolerance: float = ORIENTATION_TOLERANCE
    turns: int = 0

    def __post_init__(self) -> None:
        two = checks.numbers("through", self.through).ndim > 1
        point = checks.array("through", self.through, (2, 3) if two else (3,), "m")
        points = tuple(map(tuple, point.tolist())) if two else tuple(point.tolist())
        object.__setattr__(self, "through", points)
        checks.whole("turns of a circle", self.turns, at_least=0, at_most=MOST_TURNS)
        checks.number("tolerance of a circle", self.tolerance, "m", above=0.0)
        _check_turn(self.orientation_tolerance)


@dataclass(frozen=True)
class JointLine:
    """Straight line of all joints from one stop to the next.

    Parameters
    ----------
    tolerance : float
        Largest Euclidean distance from the line in joint space, rad (m).

    Raises
    ------
    InputError
        The tolerance is not above zero.
    """

    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        checks.number("tolerance of a joint line", self.tolerance, "rad", above=0.0)


@dataclass(frozen=True)
class Corner:
    """Ball of a blended corner, in which the tool stays; centre and radius in m."""

    center: Numbers
    radius: float


Segment = Line | Circle | JointLine | Corner | None
Curved = Line | Circle


LARGEST_TURN = 1.0  # largest tolerance of an orientation, rad


def _check_turn(value: float) -> None:
    checks.number("orientation_tolerance", value, "rad", above=0.0, at_most=LARGEST_TURN)


# curves -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Straight:
    """A straight line between two points [d] of the tool or of the joints."""

    start: Numbers
    end: Numbers

    @property
    def length(self) -> float:
        return float(np.linalg.norm(np.subtract(self.end, self.start)))

    def points(self, shares: FloatArray) -> FloatArray:
        """Return points [N,d] at shares [N] of the length."""
        return np.array(self.start) + shares[:, None] * np.subtract(self.end, self.start)

    def share(self, point: Any) -> Any:
        """Return the share of the length at the point's projection on the line, an expression."""
        along = ca.DM(np.subtract(self.end, self.start))
        return ca.dot(point - ca.DM(self.start), along) / self.length**2

    def across(self, point: Any) -> list[Any]:
        """Return the offsets from the line in d - 1 normal directions, expressions."""
        way = np.subtract(self.end, self.start) / self.length
        normals = np.linalg.svd(way[None, :])[2][1:]
        offset = point - ca.DM(self.start)
        return [ca.dot(offset, ca.DM(normal)) for normal in normals]


@dataclass(frozen=True)
class CircleArc:
    """An arc about a centre, from the unit vector ``x`` towards ``y`` by an angle, rad."""

    center: Numbers
    x: Numbers
    y: Numbers
    radius: float
    angle: float

    @classmethod
    def through(cls, start: FloatArray, middle: FloatArray, end: FloatArray) -> CircleArc:
        """Return the arc from start to end through middle, points [3], m."""
        a, b = middle - start, end - start
        normal = np.cross(a, b)
        size = float(normal @ normal)
        if size <= ROUNDING * float(a @ a) * float(b @ b):
            raise InputError(
                "its three points must be apart and not on a straight line: "
                f"{start.tolist()}, {middle.tolist()}, {end.tolist()}"
            )
        # Circumcentre of a triangle: ((b.b) n x a - (a.a) n x b) / (2 n.n) from its first corner.
        to_center = ((b @ b) * np.cross(normal, a) - (a @ a) * np.cross(normal, b)) / (2 * size)
        center, radius = start + to_center, float(np.linalg.norm(to_center))
        x = (start - center) / radius
        y = np.cross(normal / np.sqrt(size), x)
        angle = float(np.arctan2((end - center) @ y, (end - center) @ x)) % (2 * np.pi)
        parts = (tuple(part.tolist()) for part in (center, x, y))
        return cls(*parts, radius=radius, angle=angle)

    def turned(self, turns: int) -> CircleArc:
        """Return the arc with additional full turns."""
        return replace(self, angle=self.angle + 2 * np.pi * turns)

    @property
    def length(self) -> float:
        return self.radius * self.angle

    def points(self, shares: FloatArray) -> FloatArray:
        """Return points [N,3] at shares [N] of the length."""
        turn = self.angle * shares[:, None]
        around = np.cos(turn) * np.array(self.x) + np.sin(turn) * np.array(self.y)
        return np.array(self.center) + self.radius * around

    def share(self, point: Any) -> Any:
        """Return the share of the length at the point's projection on the arc, an expression."""
        across, up = self._in_plane(point)
        # Angles are measured from the middle of the arc: the jump of atan2 lies far from both ends.
        middle = 0.5 * self.angle
        turned = ca.atan2(
            np.cos(middle) * up - np.sin(middle) * across,
            np.cos(middle) * across + np.sin(middle) * up,
        )
        return 0.5 + turned / self.angle

    def across(self, point: Any) -> list[Any]:
        """Return the radial offset from the arc and the one out of its plane, expressions."""
        across, up = self._in_plane(point)
        out_of_plane = ca.dot(point - ca.DM(self.center), ca.DM(np.cross(self.x, self.y)))
        return [ca.sqrt(across**2 + up**2) - self.radius, out_of_plane]

    def _in_plane(self, point: Any) -> tuple[Any, Any]:
        offset = point - ca.DM(self.center)
        return ca.dot(offset, ca.DM(self.x)), ca.dot(offset, ca.DM(self.y))


Curve = Straight | CircleArc


@dataclass(frozen=True)
class Turning:
    """Orientation along a curve: a turn about a fixed axis.

    Attributes
    ----------
    start : tuple of rows
        Rotation of the tool in the base frame at the start.
    axis : tuple [3]
        Axis of the turn in the base frame.
    angle : float
        Angle of the turn, rad.
    free : int or None
        Index of the tool's axis about which any turn is allowed.
    """

    start: tuple[Numbers, ...]
    axis: Numbers
    angle: float
    free: int | None = None

    @classmethod
    def between(
        cls, start: FloatArray | None, end: FloatArray | None, free: int | None
    ) -> Turning | None:
        """Return the turn from one rotation [3,3] to another, or from free axis to free axis.

        The result is None if an end has no orientation.
        """
        if start is None or end is None:
            return None
        if free is None:
            # The skew part of a rotation is its axis times the sine, its trace 1 + 2 cosine.
            change = end @ start.T
            sine = np.array(ca.inv_skew(ca.DM(change))).ravel()
            cosine = 0.5 * (np.trace(change) - 1.0)
        else:
            sine = np.cross(start[:, free], end[:, free])
            cosine = float(start[:, free] @ end[:, free])
        size = float(np.linalg.norm(sine))
        angle = float(np.arctan2(size, cosine))
        if np.pi - angle < 1e-3:
            raise InputError(
                "the orientations at its two ends are half a turn apart: the way from one to the "
                "other is not unique, give a stop in between"
            )
        turns = size > ROUNDING
        axis = sine / size if turns else np.array([0.0, 0.0, 1.0])
        rows = tuple(tuple(row) for row in start.tolist())
        return cls(rows, tuple(axis.tolist()), angle if turns else 0.0, free)

    def rotation(self, share: Any) -> Any:
        """Return the rotation [3,3] at a share of the length, a number or an expression.

        Rodrigues' formula: ``(I + sin(a) K + (1 - cos(a)) K^2) R_start`` with K = skew(axis).
        """
        k = ca.DM(ca.skew(ca.DM(self.axis)))
        turn = self.angle * share
        change = ca.DM.eye(3) + ca.sin(turn) * k + (1.0 - ca.cos(turn)) * (k @ k)
        return change @ ca.DM(np.array(self.start))


# limits -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Across:
    """Offsets across a curve: of the tool's origin in four directions, m, or of the joints, rad."""

    curve: Curve
    of_joints: bool = False

    def __call__(self, state: Any) -> Any:
        if self.of_joints:
            return ca.vertcat(*self.curve.across(state.q))
        u, v = self.curve.across(state.tool[:3, 3])
        return ca.vertcat(*(np.cos(a) * u + np.sin(a) * v for a in DIRECTIONS))


@dataclass(frozen=True)
class _Beyond:
    """Overshoot of the tool's origin, or of the joints, beyond an end of a curve, m (rad).

    The value is negative between the ends, and smooth: ``L s (s - 1)`` with the length L and the
    share s is to first order the distance to the nearer end. The squared offset across the curve,
    per tolerance, rounds the end of the tube within a ball of the tolerance.
    """

    curve: Curve
    tolerance: float
    of_joints: bool = False

    def __call__(self, state: Any) -> Any:
        point = state.q if self.of_joints else state.tool[:3, 3]
        share = self.curve.share(point)
        aside = ca.sumsqr(ca.vertcat(*self.curve.across(point)))
        # The parabola L s (s - 1) has the slopes -L and L at both ends, so it measures distance
        # there.
        return self.curve.length * share * (share - 1.0) + aside / self.tolerance


@dataclass(frozen=True)
class _SquaredDistance:
    """Squared distance of the tool's origin from a point, m^2, which is smooth at the point."""

    center: Numbers

    def __call__(self, state: Any) -> Any:
        return ca.sumsqr(state.tool[:3, 3] - ca.DM(self.center))


@dataclass(frozen=True)
class _Angle:
    """Components of the sine of the angle to the orientation at the nearest place of a curve."""

    curve: Curve
    turning: Turning

    def __call__(self, state: Any) -> Any:
        share = self.curve.share(state.tool[:3, 3])
        wanted, turned = self.turning.rotation(share), state.tool[:3, :3]
        return orientation_error(wanted, turned, self.turning.free)


def orientation_error(wanted: Any, orientation: Any, free: int | None) -> Any:
    """Return the rotation error: sine of its angle along its axis, [3], or [2] without a free turn.

    The inputs are CasADi expressions of rotations [3,3]; the axis is in the wanted frame.
    """
    change = wanted.T @ orientation
    if free is not None:
        others = [k for k in range(3) if k != free]
        return ca.vertcat(*(change[k, free] for k in others))
    return ca.inv_skew(change)


def curve_between(kind: Curved, start: FloatArray, end: FloatArray) -> Curve:
    """Return the curve of the tool's origin from one point [3] to another, m."""
    closed = bool(np.allclose(start, end))
    if isinstance(kind, Line):
        if closed:
            raise InputError("both ends are at one place; where the tool only turns, leave it out")
        return Straight(tuple(start.tolist()), tuple(end.tolist()))
    through = np.array(kind.through)
    if closed != (through.ndim == 2):
        wanted = "two points, as both ends are" if closed else "one point, as the ends are not"
        raise InputError(f"through must be {wanted} at one place, not {through.tolist()}")
    if closed:
        full = CircleArc.through(start, *through)
        return replace(full, angle=2 * np.pi).turned(kind.turns)
    return CircleArc.through(start, through, end).turned(kind.turns)


LARGEST_ARC = 0.75 * 2 * np.pi  # largest angle of an arc with a unique nearest place, rad


def parts_of(kind: Curved, curve: Curve) -> list[tuple[float, Curved]]:
    """Return parts of a curve on which the nearest place is unique, with the share at each end."""
    if not isinstance(curve, CircleArc) or curve.angle <= LARGEST_ARC:
        return [(1.0, kind)]
    count = int(np.ceil(curve.angle / LARGEST_ARC))
    middles = curve.points((np.arange(count) + 0.5) / count)
    assert isinstance(kind, Circle)
    return [
        ((k + 1) / count, replace(kind, through=middle, turns=0))
        for k, middle in enumerate(middles)
    ]


def curve_limits(kind: Curved, curve: Curve, turning: Turning | None) -> tuple[Limit, ...]:
    """Return the limits of a tool line or circle."""
    name = "tool line" if isinstance(kind, Line) else "tool circle"
    side = SIDE * kind.tolerance
    degrees = tuple(f"{np.degrees(a):.0f} deg across" for a in DIRECTIONS)
    beyond = _Beyond(curve, kind.tolerance)
    limits = [
        Limit(name, _Across(curve), lower=-side, upper=side, unit="m", labels=degrees),
        Limit(f"{name} beyond its ends", beyond, upper=kind.tolerance, unit="m"),
    ]
    if turning is not None:
        axes = ["xyz"[k] for k in range(3) if k != turning.free]
        # Components within a box of this half width have a norm within the tolerance.
        size = float(np.sin(kind.orientation_tolerance) / np.sqrt(len(axes)))
        angle = _Angle(curve, turning)
        labels = tuple(f"tool {axis}" for axis in axes)
        limits.append(Limit("tool orientation", angle, -size, size, unit="rad", labels=labels))
    return tuple(limits)


def joint_line_limits(kind: JointLine, start: FloatArray, end: FloatArray) -> tuple[Limit, ...]:
    """Return the limits of a straight joint path."""
    curve = Straight(tuple(start.tolist()), tuple(end.tolist()))
    beyond = _Beyond(curve, kind.tolerance, of_joints=True)
    limits = [Limit("joint line beyond its ends", beyond, upper=kind.tolerance, unit="rad")]
    if start.size > 1:
        # Components within a box of this half width have a norm within the tolerance.
        size = kind.tolerance / np.sqrt(start.size - 1)
        labels = tuple(f"{k + 1} across" for k in range(start.size - 1))
        across = _Across(curve, of_joints=True)
        limits.append(Limit("joint line", across, -size, size, unit="rad", labels=labels))
    return tuple(limits)


def corner_limit(kind: Corner) -> Limit:
    """Return the limit of a blended corner."""
    distance = _SquaredDistance(kind.center)
    return Limit("squared distance from the corner", distance, upper=kind.radius**2, unit="m^2")
