"""A checked task of stops and segments: limits, payloads and conditions of every segment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError, warn_user
from microbot_ocp.limits import JointLimits, LimitFamily, Limits
from microbot_ocp.planning.task._blending import curve_of, segment_name, with_corners_cut
from microbot_ocp.planning.task._checks import (
    check_limits,
    check_pace,
    check_positions,
    check_rest,
    farthest_tool,
    fastest_tool,
)
from microbot_ocp.planning.task._segments import (
    Circle,
    Corner,
    Curve,
    JointLine,
    Line,
    Segment,
    Turning,
    corner_limit,
    curve_limits,
    joint_line_limits,
    orientation_error,
)
from microbot_ocp.planning.task._stops import (
    EXACT_TOLERANCE,
    Bounds,
    Conditions,
    EndConditions,
    Payload,
    Row,
    Stop,
)
from microbot_ocp.robot import Robot, forward_kinematics, jacobian

EMPTY = Payload(0.0)


@dataclass(frozen=True, eq=False)
class Task:
    """Checked stops and segments; :func:`task_of` makes them.

    A cycle repeats its first stop at the end.

    Attributes
    ----------
    family : LimitFamily
        Limits that hold everywhere, of the robot with an empty tool.
    stops : tuple of Stop, m
        Named stops; a blended corner is a pair of stops.
    segments : tuple of Segment, m - 1
        Segments; None for a free one.
    cycle : bool
    around : optional
        Required distances from obstacles: ``limits(index)`` are further limits of a segment.
    """

    family: LimitFamily
    stops: tuple[Stop, ...]
    segments: tuple[Segment, ...]
    cycle: bool = False
    around: Any = None

    @classmethod
    def through(cls, family: LimitFamily, via: FloatArray) -> Task:
        """Return the task of checked via points [m,n], rad (m), passed at any velocity."""
        stops = tuple(Stop(q=point, name=f"via {k + 1}") for k, point in enumerate(via))
        return cls(family, stops, (None,) * (len(stops) - 1))

    @cached_property
    def is_plain(self) -> bool:
        """True for joint poses alone, passed at any velocity, from rest to rest."""
        given = self.cycle or self.around is not None or any(self.segments)
        return not given and all(
            s.q is not None and s == Stop(s.q, name=s.name) for s in self.stops
        )

    @property
    def robot(self) -> Robot:
        """Robot with an empty tool."""
        return self.family.robot

    @property
    def dwells(self) -> FloatArray:
        """Dwells [m] at the stops, s; a cycle dwells at its first stop, not again at the last."""
        seconds = np.array([stop.dwell for stop in self.stops])
        if self.cycle:
            seconds[-1] = 0.0
        return seconds

    @cached_property
    def payloads(self) -> tuple[Payload, ...]:
        """Payload of every segment."""
        held, payloads = EMPTY, []
        if self.cycle:
            # A cycle begins with the payload that it ends with.
            held = next((s.payload for s in reversed(self.stops) if s.payload is not None), EMPTY)
        for stop in self.stops[:-1]:
            held = held if stop.payload is None else stop.payload
            payloads.append(held)
        return tuple(payloads)

    @cached_property
    def curves(self) -> tuple[tuple[Curve, Turning | None] | None, ...]:
        """Curve of every tool line and circle, with the orientation along it; None elsewhere."""
        return tuple(map(self._curve, range(len(self.segments))))

    def _curve(self, index: int) -> tuple[Curve, Turning | None] | None:
        kind = self.segments[index]
        if not isinstance(kind, Line | Circle):
            return None
        before, after = self.stops[index], self.stops[index + 1]
        for stop in (before, after):
            if stop.q is None and np.any(np.isinf(np.array(stop.tolerance))):
                raise InputError(
                    f"{self.name_of(index)}: it needs both ends, but a coordinate of stop "
                    f"{stop.name!r} is free"
                )
        return curve_of(self.robot, kind, before, after)

    @cached_property
    def robots(self) -> tuple[Robot, ...]:
        """Robot of every segment, with its payload and the limits of the segment."""
        return tuple(map(self._robot, range(len(self.segments))))

    def _robot(self, index: int) -> Robot:
        kind, robot = self.segments[index], self.payloads[index].on(self.robot)
        curve = self.curves[index]
        limits: tuple[Any, ...] = ()
        if curve is not None and isinstance(kind, Line | Circle):
            # The tube around a curve and the lines between joint poses are limits of their segment
            # alone.
            limits = curve_limits(kind, *curve)
        elif isinstance(kind, Corner):
            limits = (corner_limit(kind),)
        elif isinstance(kind, JointLine):
            ends = [self.stops[k].q for k in (index, index + 1)]
            limits = joint_line_limits(kind, *map(np.array, ends))
        if self.around is not None:
            limits = (*limits, *self.around.limits(index))
        return robot.with_limits(also=(*robot.limits.also, *limits)) if limits else robot

    @cached_property
    def families(self) -> tuple[LimitFamily, ...]:
        """Limits of every segment."""
        return tuple(map(LimitFamily.of, self.robots))

    def name_of(self, index: int) -> str:
        """Return the name of a segment, such as "tool line from stop 'pick' to stop 'place'"."""
        return segment_name(self.segments[index], *self.stops[index : index + 2])

    def at_rest(self, index: int) -> bool:
        """Return True if the arm rests at a stop."""
        stop, last = self.stops[index], len(self.stops) - 1
        if stop.velocity is not None:
            still = isinstance(stop.velocity, tuple) and not any(stop.velocity)
            return stop.velocity == "rest" or still
        ends = index in (0, last) and not self.cycle
        return ends or bool(stop.dwell) or stop.payload is not None

    def pace(self, index: int) -> tuple[float, ...] | None:
        """Return the given velocity at a stop, empty at rest; None if any velocity is allowed."""
        if self.at_rest(index):
            return ()
        velocity = self.stops[index].velocity
        return velocity if isinstance(velocity, tuple) else None

    @cached_property
    def conditions(self) -> Conditions:
        """Conditions of the optimal-control problem."""
        last = len(self.stops) - 1
        ends = [self._end(k) for k in range(last + 1)]
        closed: tuple[str, ...] = ()
        if self.cycle:
            first = self.stops[0]
            # A quantity that is fixed at the first stop needs no condition of closure: it would be
            # a redundant equation.
            fixed = first.q is not None and first.box is not None and not first.box.any()
            moves = not self.at_rest(0)
            demanded = {"q": not fixed, "qd": moves, "qdd": moves and self.family.jerk_matters}
            closed = tuple(key for key, is_closed in demanded.items() if is_closed)
            # A closed quantity is free at the last stop: the condition of closure fixes it there.
            given = ends[0]
            free = np.full(self.robot.joint_count, np.inf)
            qd = given.qd if "qd" not in closed else (-free, free)
            q = given.q if "q" not in closed else (-free, free)
            ends[-1] = replace(given, q=q, qd=qd, rows=())
        return Conditions(self.robots, tuple(ends), closed)

    def _end(self, index: int) -> EndConditions:
        stop, robot = self.stops[index], self.robot
        free = np.full(robot.joint_count, np.inf)
        q: Bounds = (-free, free)
        qd: Bounds = (-free, free)
        rows: list[Row] = []
        if stop.q is not None and stop.box is not None:
            # Position limits cut the box of the tolerance, but never the given pose.
            limits, target = robot.limits, np.array(stop.q)
            q = (
                np.maximum(target - stop.box, np.minimum(limits.q_min, target)),
                np.minimum(target + stop.box, np.maximum(limits.q_max, target)),
            )
        else:
            rows += pose_rows(robot, stop)
        rest, zero, pace = self.at_rest(index), np.zeros(robot.joint_count), self.pace(index)
        if pace is not None:
            given = zero if rest else np.array(pace)
            if rest or stop.q is not None:
                qd = (given, given)
            else:
                speed = partial(_tool_velocity, robot)
                rows.append(Row("velocity of the tool", speed, (given, given)))
        rated, qdd = self.family.jerk_matters, None
        if rated and (rest or stop.acceleration is not None):
            given = zero if stop.acceleration is None else np.array(stop.acceleration)
            qdd = (given, given)
        ends = (_effective(robot, stop, row) for row in rows)
        jumps = pace is not None and not rated
        return EndConditions(q, qd, tuple(filter(None, ends)), qdd=qdd, acceleration_jumps=jumps)


AT_MOST_ONE: Bounds = np.array([-np.inf]), np.array([1.0])


def _tool_velocity(robot: Robot, q: Any, qd: Any) -> Any:
    return (jacobian(robot)(q) @ qd)[:3]


def pose_rows(robot: Robot, stop: Stop) -> list[Row]:
    """Return the conditions on the pose at a stop that are not bounds of joints."""
    rows = []
    if stop.q is not None:
        target, size = np.array(stop.q), float(stop.tolerance)
        # The squared distance is smooth at the centre, where the distance itself has no derivative.
        ball = lambda q, _: ca.sumsqr((q - target) / size)  # noqa: E731
        return [Row("distance from the joint pose", ball, AT_MOST_ONE)]
    place, turned = stop.pose(robot)
    box = stop.box
    if box is None:
        radius = float(stop.tolerance)

        def distance(q: Any, _: Any) -> Any:
            return ca.sumsqr((forward_kinematics(robot)(q)[:3, 3] - place) / radius)

        rows.append(Row("distance of the tool", distance, AT_MOST_ONE))
    elif (bounded := np.flatnonzero(np.isfinite(box))).size:

        def offset(q: Any, _: Any) -> Any:
            miss = forward_kinematics(robot)(q)[:3, 3] - place
            return ca.vertcat(*(miss[int(k)] for k in bounded))

        rows.append(Row("position of the tool", offset, (-box[bounded], box[bounded])))
    if turned is not None:
        wanted = ca.DM(turned)

        def error(q: Any, _: Any) -> Any:
            tool = forward_kinematics(robot)(q)[:3, :3]
            return orientation_error(wanted, tool, stop.free_axis)

        if stop.orientation_tolerance:
            # The error vector has the length sin(angle).
            largest = np.sin(stop.orientation_tolerance)
            ball = lambda q, qd: ca.sumsqr(error(q, qd) / largest)  # noqa: E731
            rows.append(Row("orientation of the tool", ball, AT_MOST_ONE))
        else:
            zero = np.zeros(3 if stop.free_axis is None else 2)
            rows.append(Row("orientation of the tool", error, (zero, zero)))
    return rows


RANDOM_STATES = 3  # states at which the slopes of a condition are evaluated


def _effective(robot: Robot, stop: Stop, row: Row) -> Row | None:
    """Return a condition without equations that no joint affects, such as a planar arm's height.

    Solvers that eliminate fixed variables reject such equations.

    Raises
    ------
    InputError
        A removed equation does not hold.
    """
    low, high = row.bounds
    q, qd = (ca.SX.sym(name, robot.joint_count) for name in ("q", "qd"))
    value, state = row.expression(q, qd), ca.vertcat(q, qd)
    # An equation with zero slope at random states is constant with probability one.
    along = ca.Function("along", [state], [value, ca.jacobian(value, state)])
    states = np.random.default_rng(0).uniform(-1.0, 1.0, (RANDOM_STATES, 2 * robot.joint_count))
    values, slopes = zip(*(map(np.array, along(x)) for x in states), strict=True)
    size = np.max([np.abs(slope).max(axis=1) for slope in slopes], axis=0)
    fixed = (size <= ROUNDING * max(1.0, size.max())) & (low == high)
    off = np.abs(values[0][:, 0] - low)[fixed]
    if off.size and off.max() > EXACT_TOLERANCE:
        raise InputError(
            f"{row.name} of stop {stop.name!r} is off by {off.max():.3g} whatever the joints do"
        )
    free = np.flatnonzero(~fixed)
    chosen = partial(_chosen, row.expression, free.tolist())
    return replace(row, expression=chosen, bounds=(low[free], high[free])) if free.size else None


def _chosen(expression: Callable[..., Any], rows: list[int], q: Any, qd: Any) -> Any:
    return expression(q, qd)[rows]


# checks -------------------------------------------------------------------------------------------


def is_task(via: Any) -> bool:
    """Return True if some of the via points are stops."""
    return isinstance(via, list | tuple) and any(isinstance(point, Stop) for point in via)


MOST_STOPS = 200  # largest number of stops


def task_of(
    robot: Robot,
    stops: Sequence[Any],
    limits: Limits | JointLimits | None = None,
    *,
    segments: Sequence[Segment] | None = None,
    cycle: bool = False,
) -> Task:
    """Return the checked task of stops, or joint poses [n], and of the segments between them.

    Raises
    ------
    InputError
        Fewer than two stops, a joint pose outside its limits or not holdable at rest, a segment
        that does not fit its stops, or a blend longer than its lines.
    """
    family = check_limits(robot, limits)
    given = [stop if isinstance(stop, Stop) else Stop(q=stop) for stop in stops]
    given = [stop.named(f"stop {k + 1}") for k, stop in enumerate(given)]
    names = [stop.name for stop in given]
    if len(set(names)) < len(names):
        raise InputError(f"the names of stops must differ: {', '.join(names)}")
    least = 1 if cycle else 2
    if not least <= len(given) <= MOST_STOPS:
        raise InputError(f"a task must have {least} to {MOST_STOPS} stops, not {len(given)}")
    if cycle:
        given.append(given[0])
    kinds = list(segments) if segments is not None else [None] * (len(given) - 1)
    _check_kinds(kinds, given, cycle)
    task = Task(family, tuple(given), tuple(kinds), cycle)
    _check_stops(task)
    stops, kinds = with_corners_cut(robot, given, kinds)
    task = replace(task, stops=stops, segments=kinds)
    if cycle:
        _check_put_down(task)
    _check_rests(task)
    return task


def _check_kinds(kinds: Sequence[Segment], stops: Sequence[Stop], cycle: bool) -> None:
    """Raise InputError unless the segments fit the stops, whose first is repeated in a cycle."""
    if len(kinds) != len(stops) - 1:
        raise InputError(
            f"segments must have {len(stops) - 1} entries, one between two stops"
            + (" and one back to the first" if cycle else "")
            + f", not {len(kinds)}"
        )
    for k, kind in enumerate(kinds):
        if kind is not None and not isinstance(kind, Line | Circle | JointLine):
            raise InputError(
                f"segment {k + 1} must be a Line, Circle or JointLine, or None where the way is "
                f"free, not {kind!r}"
            )
        if isinstance(kind, JointLine) and any(s.q is None for s in stops[k : k + 2]):
            raise InputError(
                f"{segment_name(kind, *stops[k : k + 2])}: it needs a joint pose, q, at both ends"
            )


LOOSEST_TOLERANCE = 0.1  # largest radius of a ball or a tube, share of the reach


def _check_tolerance(robot: Robot, where: str, tolerance: Any, of_joints: bool) -> None:
    """Raise InputError if a finite tolerance is larger than the arm's range."""
    finite = np.array(tolerance)[np.isfinite(tolerance)]
    largest = float(np.max(finite, initial=0.0))
    if of_joints and largest > 2 * np.pi and set(robot.joint_types) == {"revolute"}:
        raise InputError(f"tolerance of {where} is {largest:g} rad, more than a whole turn")
    is_box = np.ndim(tolerance) > 0
    reach = farthest_tool(robot)
    if not of_joints and largest > (reach if is_box else LOOSEST_TOLERANCE * reach):
        share = "" if is_box else "a tenth of what "
        free = "; inf, in a tolerance of three numbers, leaves a coordinate free"
        raise InputError(
            f"tolerance of {where} is {largest:g} m, more than {share}the arm reaches "
            f"({reach:.3g} m)" + (free if where.startswith("stop") else "")
        )


HEAVIEST_PAYLOAD = 1000.0  # largest payload, per mass of the arm


def _check_payload(robot: Robot, stop: Stop) -> None:
    """Raise InputError for a payload far heavier than the arm; warn above the arm's own mass."""
    assert stop.payload is not None
    if not robot.has_dynamics:
        raise InputError(
            f"stop {stop.name!r} has a payload, but robot {robot.name!r} has no masses"
        )
    mass = sum(link.mass for link in robot.links)
    sentence = f"payload of stop {stop.name!r} is {stop.payload.mass:g} kg, more than "
    times, weight = HEAVIEST_PAYLOAD, f"what the arm weighs itself ({mass:.3g} kg)"
    if stop.payload.mass > times * mass > 0.0:
        raise InputError(f"{sentence}{times:g} times {weight}; that looks like grams")
    if stop.payload.mass > mass > 0.0:
        warn_user(f"{sentence}{weight}; that looks like grams")


def _check_velocity(robot: Robot, stop: Stop) -> None:
    low, high = robot.limits.qd_min, robot.limits.qd_max
    given = np.array(stop.velocity)
    for j in np.flatnonzero((given < low) | (given > high)).tolist():
        raise InputError(
            f"velocity of stop {stop.name!r} is outside the limits: joint "
            f"{robot.joint_names[j]!r} at {given[j]:.6g}, allowed {low[j]:.6g} to {high[j]:.6g} "
            f"{'rad/s' if robot.joint_types[j] == 'revolute' else 'm/s'}"
        )


def _check_tool_velocity(robot: Robot, stop: Stop) -> None:
    most, asked = fastest_tool(robot), float(np.linalg.norm(stop.velocity))
    if asked > most:
        raise InputError(
            f"velocity of stop {stop.name!r} is {asked:.4g} m/s, more than all joints at their "
            f"limits can give the tool: {most:.4g} m/s"
        )


def _check_put_down(task: Task) -> None:
    picks = [stop for stop in task.stops[:-1] if stop.payload is not None]
    if picks and picks[0].payload != EMPTY and len(set(task.payloads)) == 1:
        raise InputError(
            f"stop {picks[0].name!r} picks {picks[0].payload.mass:g} kg in every cycle, but no "
            "stop puts them down: give a stop with payload 0, or the robot what it always holds"
        )


def _check_stops(task: Task) -> None:
    family, stops = task.family, task.stops
    for k, kind in enumerate(task.segments):
        before, after = stops[k : k + 2]
        places = [(stop.q, stop.position, stop.orientation) for stop in (before, after)]
        # An arm that moves in equal places returns: the two stops are not one.
        paces = task.pace(k), task.pace(k + 1)
        turns = None not in paces and paces[0] != paces[1]
        if places[0] == places[1] and not turns and not isinstance(kind, Circle):
            if task.cycle and len(stops) == 2:
                raise InputError("a cycle needs at least two stops, not one")
            advice = ": a cycle returns to its first stop by itself" if task.cycle else ""
            raise InputError(
                f"stops {before.name!r} and {after.name!r} are at the same place{advice}"
            )
        if isinstance(kind, Line | Circle | JointLine):
            where, of_joints = f"the {task.name_of(k)}", isinstance(kind, JointLine)
            _check_tolerance(family.robot, where, kind.tolerance, of_joints)
    for stop in stops:
        _check_tolerance(family.robot, f"stop {stop.name!r}", stop.tolerance, stop.q is not None)
        if stop.q is not None:
            checks.array(f"q of stop {stop.name!r}", stop.q, (family.robot.joint_count,), "rad")
            check_positions(family, lambda _, name=stop.name: f"stop {name!r}", np.array([stop.q]))
            if isinstance(stop.velocity, tuple):
                _check_velocity(family.robot, stop)
        elif isinstance(stop.velocity, tuple):
            _check_tool_velocity(family.robot, stop)
        if stop.payload is not None and stop.payload.mass > 0:
            _check_payload(family.robot, stop)
    if poses := [stop.q for stop in stops if stop.q is not None]:
        check_pace(family, np.array(poses), at_rest=False)


def with_torques(task: Task, share: float) -> Task:
    """Return the task with a share of the torque limits.

    Raises
    ------
    InputError
        A stop is not holdable at rest within them.
    """
    limits = task.robot.limits
    bounds = {key: share * getattr(limits, key) for key in ("tau_min", "tau_max")}
    weaker = replace(task, family=LimitFamily.of(task.robot, limits.changed(bounds)))
    _check_rests(weaker)
    return weaker


def _check_rests(task: Task) -> None:
    for index, stop in enumerate(task.stops):
        if stop.q is not None and stop.box is not None and not stop.box.any():
            check_held(task, index, np.array(stop.q))


def check_held(task: Task, index: int, q: FloatArray) -> None:
    """Raise InputError if torques do not hold the arm in a pose [n] at rest at a stop.

    The payloads before and after the stop count.
    """
    stop = task.stops[index]
    if not task.at_rest(index):
        return
    for segment in {max(index - 1, 0), min(index, len(task.segments) - 1)}:
        payload = task.payloads[segment]
        held = f" with {payload.mass:g} kg" if payload.mass else ""
        family = LimitFamily.of(payload.on(task.robot))
        check_rest(family, lambda _, label=f"stop {stop.name!r}{held}": label, q[None])
