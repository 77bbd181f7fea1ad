"""Blended corners as pairs of stops, and long arcs in parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError, naming
from microbot_ocp.planning.task._segments import (
    Circle,
    Corner,
    Curve,
    JointLine,
    Line,
    Segment,
    Turning,
    curve_between,
    parts_of,
)
from microbot_ocp.planning.task._stops import AXES, Stop
from microbot_ocp.robot import Robot


def segment_name(kind: Segment, before: Stop, after: Stop) -> str:
    """Return the name of a segment, such as "tool line from stop 'pick' to stop 'place'"."""
    names = {Line: "tool line", Circle: "tool circle", JointLine: "joint line"}
    name = names.get(type(kind), "way")
    return f"{name} from stop {before.name!r} to stop {after.name!r}"


def curve_of(
    robot: Robot, kind: Line | Circle, before: Stop, after: Stop
) -> tuple[Curve, Turning | None]:
    """Return the curve of the tool between two stops, and the orientation along it or None."""
    (start, turned), (end, turned_after) = before.pose(robot), after.pose(robot)
    free = before.free_axis if before.free_axis is not None else after.free_axis
    with naming(f"{segment_name(kind, before, after)}: "):
        return curve_between(kind, start, end), Turning.between(turned, turned_after, free)


def with_corners_cut(
    robot: Robot, stops: Sequence[Stop], kinds: Sequence[Segment]
) -> tuple[tuple[Stop, ...], tuple[Segment, ...]]:
    """Return stops and segments, with blended corners as pairs of stops and long arcs in parts."""
    if stops[0].blend or stops[-1].blend:
        raise InputError("the first stop and the last cannot be blended corners")
    places: list[Stop] = [stops[0]]
    segments: list[Segment] = []
    for index in range(1, len(stops)):
        stop, kind = stops[index], kinds[index - 1]
        if isinstance(kind, Circle):
            between, parts = _in_parts(robot, kind, stops[index - 1], stop)
            places += between
            segments += parts
        else:
            segments.append(kind)
        if not stop.blend:
            places.append(stop)
            continue
        # A blended corner becomes two stops, where the blend begins and ends, and a segment between
        # them within the ball of the blend.
        lines = kinds[index - 1], kinds[index]
        if not all(isinstance(kind, Line) for kind in lines):
            raise InputError(
                f"stop {stop.name!r} is a blended corner: it needs lines on both sides"
            )
        before, after = (line for line in lines if isinstance(line, Line))
        cut = [_on_the_way(robot, stop, stops[k]) for k in (index - 1, index + 1)]
        if np.allclose(cut[0].position, cut[1].position):
            raise InputError(
                f"the lines at corner {stop.name!r} go there and back: leave its blend"
            )
        if _is_straight(stop, cut, min(before.tolerance, after.tolerance)):
            passed = replace(stop, blend=0.0, velocity="any")
            places.append(_within(passed, before, stop.name))
            continue
        for place, line, word in zip(cut, (before, after), ("before", "after"), strict=True):
            places.append(_within(place, line, f"{stop.name}, {word} the corner"))
        assert stop.position is not None
        segments.append(Corner(stop.position, stop.blend + before.tolerance))
    return tuple(places), tuple(segments)


def _is_straight(corner: Stop, cut: Sequence[Stop], tolerance: float) -> bool:
    """Return True if the straight way across a blend stays within the tubes of its lines."""
    start, end = (np.array(place.position) for place in cut)
    way, offset = end - start, np.array(corner.position) - start
    # The corner's projection on the straight way, and its distance from there.
    share = float(offset @ way) / float(way @ way)
    turned = [place.orientation for place in cut]
    held = None in turned or np.allclose(turned[0], turned[1])
    return held and float(np.linalg.norm(offset - share * way)) <= tolerance


def _in_parts(
    robot: Robot, kind: Circle, before: Stop, after: Stop
) -> tuple[list[Stop], list[Segment]]:
    """Return stops on a long arc, and the parts of the arc between them."""
    curve, turning = curve_of(robot, kind, before, after)
    # A long arc is divided: on a part the nearest place of the tool is unique.
    parts, places = parts_of(kind, curve), []
    for number, (share, _) in enumerate(parts[:-1], 1):
        place = _passed(curve.points(np.array([share]))[0], turning, share)
        places.append(_within(place, kind, f"{before.name}, {number}/{len(parts)} of the circle"))
    return places, [part for _, part in parts]


def _passed(point: FloatArray, turning: Turning | None, share: float) -> Stop:
    """Return a stop on a tool line or circle that the arm passes at any velocity."""
    if turning is None:
        return Stop(position=point, velocity="any")
    turn = None if turning.free is None else AXES[turning.free]
    orientation = np.array(turning.rotation(share))
    return Stop(position=point, orientation=orientation, free_turn=turn, velocity="any")


def _within(place: Stop, kind: Line | Circle, name: str) -> Stop:
    """Return a stop on a tool line or circle with the tolerance of its orientation.

    The position is exact: a position within the tube could slide along the line at no cost, a flat
    direction in which solvers take ten times the iterations.
    """
    turn = kind.orientation_tolerance if place.orientation is not None else 0.0
    return replace(place, name=name, orientation_tolerance=turn)


def _on_the_way(robot: Robot, corner: Stop, other: Stop) -> Stop:
    """Return the stop on the line from a corner to its neighbour at which the blend begins."""
    (place, turned), (far, turned_far) = corner.pose(robot), other.pose(robot)
    if corner.position is None:
        raise InputError(f"stop {corner.name!r} is a blended corner: it needs a tool position")
    length = float(np.linalg.norm(far - place))
    if corner.blend >= 0.5 * length:
        raise InputError(
            f"blend of stop {corner.name!r} must be less than half of the line to stop "
            f"{other.name!r}, {500 * length:.4g} mm, not {1000 * corner.blend:.4g} mm"
        )
    share = corner.blend / length
    turning = Turning.between(turned, turned_far, corner.free_axis)
    return _passed(place + share * (far - place), turning, share)
