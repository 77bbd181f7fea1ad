"""Certification of a motion through stops: every segment under its own limits and payload.

Stops and tool lines are measured by formulas that the solver does not use: angles from the norm of
the difference of two rotations, distances to a polyline of many points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.check import Check, problems_of
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.certificate._certificate import Certificate, LimitCheck
from microbot_ocp.certificate._certification import Tolerances, certificate_of, summary
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import JUMP_GAP, Motion, State, jump_gaps, nearest_samples, torque_along
from microbot_ocp.planning.search import stretches, tool_poses
from microbot_ocp.planning.task import EXACT_TOLERANCE, Circle, JointLine, Line, Stop, Task
from microbot_ocp.robot import Robot, forward_kinematics, jacobian

POINTS = 2001  # points of the polyline that represents a curve
STILL = 1e-4  # largest velocity at rest, and error of a required velocity, rad/s (m/s)


def certificate_of_task(
    task: Task, motion: Motion, tolerances: Tolerances, *, simulated: bool = True
) -> Certificate:
    """Certify a motion whose marks give the times of a task's stops."""
    parts, problems = [], []
    history = motion.history(cycle=task.cycle)
    places = stretches(task, motion)
    for start, end, robot, _ in places:
        part, states = _part(motion, robot, start, end), history.between(start, end)
        family = LimitFamily.of(robot)
        certificate = certificate_of(
            family, part, None, tolerances, states, start, simulated=simulated
        )
        parts.append((end - start, certificate))
        if not certificate.ok:
            sentence = certificate.verdict.removeprefix("Failed: ").rstrip(".")
            problems.append(f"between {start:.4g} s and {end:.4g} s: {sentence}")
    segments = _check_segments(task, motion)
    steps = _steps(motion, [start for start, *_ in places[1:]])
    checks = [*steps, *_check_stops(task, motion), *segments]
    problems += problems_of(checks)
    whole = _merged(motion, parts)
    sentence = "; ".join(problems or [summary(whole, simulated=simulated), *map(str, segments)])
    return replace(
        whole,
        ok=not problems,
        verdict=f"{'Failed' if problems else 'Passed'}: {sentence}.",
        checks=(*whole.checks, *checks),
    )


def _part(motion: Motion, robot: Robot, start: float, end: float) -> Motion:
    """Return the motion between two sample times, with the torques of the robot in that segment.

    A further sample is inserted into the first interval, because a motion whose samples all are
    breaks counts as a motion without known breaks.
    """
    t = motion.t
    start, end = t[nearest_samples(t, np.array([start, end]))]
    here = (t >= start) & (t <= end)
    last = np.flatnonzero(here)[-1]
    if t[last] < motion.duration and jump_gaps(t)[last - 1]:
        here[last] = False  # the second sample of a jump belongs to the next segment
    times = np.insert(t[here], 1, t[here][:2].mean())
    state, tau = motion.sample(times), motion.tau[here]
    expected = torque_along(robot, State(*(column[:3] for column in state)))
    between = expected[1] + (tau[:2] - expected[::2]).mean(axis=0)
    assert motion.breaks is not None
    inner = motion.breaks[(motion.breaks > start) & (motion.breaks < end - 2 * JUMP_GAP)]
    breaks = np.concatenate([[start], inner, times[-1:]]) - start
    tau = np.insert(tau, 1, between, axis=0)
    return Motion(times - start, *state, tau, label=motion.label, breaks=breaks)


def _steps(motion: Motion, times: Sequence[float]) -> list[Check]:
    """Check that position and velocity are continuous from one segment to the next."""
    checks = []
    for time in times:
        before, after = (motion.sample([time + k * 2 * JUMP_GAP]) for k in (-1, 1))
        moved = after.q - before.q - 2 * JUMP_GAP * (before.qd + after.qd)
        # The velocity may change by the accelerations beside the jump, over the time between both.
        still = STILL + 4 * JUMP_GAP * float(np.abs([before.qdd, after.qdd]).max())
        for what, unit, steps, allowed in (
            ("position", "rad", moved, EXACT_TOLERANCE),
            ("velocity", "rad/s", after.qd - before.qd, still),
        ):
            step = float(np.abs(steps).max())
            problem = f"the {what} jumps by {step:.3g} {unit} at {time:.4g} s"
            passed = not step > allowed
            name = f"step of the {what}"
            checks.append(Check(name, passed, problem, "", time, step, allowed, unit))
    return checks


# stops --------------------------------------------------------------------------------------------


def _check_stops(task: Task, motion: Motion) -> list[Check]:
    checks = []
    for k, (stop, mark) in enumerate(zip(task.stops, motion.marks, strict=True)):
        state = motion.sample([mark.time])
        misses = stop_misses(task.robot, stop, state.q[0])
        qd = state.qd[0]
        if task.at_rest(k):
            misses["velocity", "rad/s"] = float(np.abs(qd).max()) - STILL
        elif not isinstance(stop.velocity, str | None):
            velocity, unit = qd, "rad/s"
            if stop.q is None:
                velocity, unit = (np.array(jacobian(task.robot)(state.q[0])) @ qd)[:3], "m/s"
            misses["velocity", unit] = float(np.abs(velocity - stop.velocity).max()) - STILL
        if stop.acceleration is not None and task.family.jerk_matters:
            off = np.abs(state.qdd[0] - stop.acceleration).max()
            allowed = STILL * max(1.0, np.abs(stop.acceleration).max())
            misses["acceleration", "rad/s^2"] = float(off - allowed)
        for (what, unit), miss in misses.items():
            problem = f"stop {stop.name!r} is missed in its {what} by {miss:.3g} {unit}"
            where = stop.name, mark.time, miss, 0.0, unit, "via"
            checks.append(Check(what, not miss > 0.0, problem, *where))
    if task.cycle:
        first, last = motion.sample([0.0]), motion.sample([motion.duration])
        for what, a, b in (("position", first.q, last.q), ("velocity", first.qd, last.qd)):
            off = float(np.abs(a - b).max())
            problem = f"start and end of the cycle differ in {what} by {off:.3g}"
            end = motion.duration
            checks.append(Check(f"{what} of the cycle", off <= STILL, problem, "", end, off, STILL))
    return checks


def stop_misses(robot: Robot, stop: Stop, q: FloatArray) -> dict[tuple[str, str], float]:
    """Return the excess of a pose [n] over the tolerances of a stop, by quantity and unit.

    Negative values are within the tolerance; a millionth of a metre or radian is allowed on top.
    """
    slack = EXACT_TOLERANCE
    if stop.q is not None:
        return {("joint pose", "rad"): _beyond(stop, q - np.array(stop.q)) - slack}
    tool = np.array(forward_kinematics(robot)(q))
    misses = {("position", "m"): _beyond(stop, tool[:3, 3] - np.array(stop.position)) - slack}
    if stop.orientation is not None:
        wanted = np.array(stop.orientation)
        angle = angle_between(wanted, tool[:3, :3], stop.free_axis)
        misses["orientation", "rad"] = angle - stop.orientation_tolerance - slack
    return misses


def _beyond(stop: Stop, offset: FloatArray) -> float:
    if stop.box is not None:
        return float((np.abs(offset) - stop.box).max())
    return float(np.linalg.norm(offset)) - float(stop.tolerance)


def angle_between(wanted: FloatArray, actual: FloatArray, free: int | None) -> float:
    """Return the angle between two rotations [3,3], or between two of their axes, rad."""
    if free is not None:
        a, b = wanted[:, free], actual[:, free]
        return float(2 * np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b)))
    difference = np.linalg.norm(wanted - actual)  # 2 sqrt(2) sin(angle / 2)
    return float(2 * np.arcsin(min(1.0, difference / np.sqrt(8.0))))


# segments -----------------------------------------------------------------------------------------


def _check_segments(task: Task, motion: Motion) -> list[Check]:
    checks: list[Check] = []
    t, samples = motion.history()[:2]
    for k, kind in enumerate(task.segments):
        start = motion.marks[k].time + float(task.dwells[k])
        here = (t >= start) & (t <= motion.marks[k + 1].time)
        q = samples.q[here]
        if isinstance(kind, JointLine):
            ends = [np.array(task.stops[i].q) for i in (k, k + 1)]
            shares = np.linspace(0.0, 1.0, POINTS)[:, None]
            distance = _to_polyline(q, ends[0] + shares * (ends[1] - ends[0]))[0].max()
            checks.append(_near(task.name_of(k), "distance", distance, kind.tolerance, "rad"))
        elif isinstance(kind, Line | Circle):
            checks += _check_curve(task, k, kind, q)
    return checks


def _near(segment: str, what: str, value: float, tolerance: float, unit: str) -> Check:
    """Check that a motion stays within a tolerance of a segment, with the margin of limits."""
    where = segment, np.nan, float(value), tolerance, unit, "segment"
    check = Check(what, not value > (1.0 + 1e-3) * tolerance, "", *where)
    return replace(check, problem=f"{check} is exceeded")


def _check_curve(task: Task, k: int, kind: Line | Circle, q: FloatArray) -> list[Check]:
    oriented = task.curves[k]
    assert oriented is not None
    curve, turning = oriented
    poses = tool_poses(task.robot, q)
    line = curve.points(np.linspace(0.0, 1.0, POINTS))
    distance, share = _to_polyline(poses[:, :3, 3], line)
    name = task.name_of(k)
    near = _near(name, "distance", distance.max(), kind.tolerance, "m")
    if turning is None:
        return [near]
    angles = [
        angle_between(np.array(ca.DM(turning.rotation(s))), pose[:3, :3], turning.free)
        for s, pose in zip(share, poses, strict=True)
    ]
    return [near, _near(name, "angle", max(angles), kind.orientation_tolerance, "rad")]


def _to_polyline(points: FloatArray, line: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return distances [N] to a polyline [M,d] with even steps, and the nearest fractions [N]."""
    distance, share = np.empty(len(points)), np.empty(len(points))
    for row, point in enumerate(points):
        nearest = int(((line - point) ** 2).sum(axis=1).argmin())
        best = np.inf
        for i in {max(nearest - 1, 0), min(nearest, len(line) - 2)}:
            way = line[i + 1] - line[i]
            s = float(np.clip((point - line[i]) @ way / (way @ way), 0.0, 1.0))
            off = float(np.linalg.norm(point - line[i] - s * way))
            if off < best:
                best, share[row] = off, (i + s) / (len(line) - 1)
        distance[row] = best
    return distance, share


# merging ------------------------------------------------------------------------------------------


# A figure of the merged certificate is the worst of its parts; the fields named beside it are
# taken out of the part with the worst value.
WORST = {
    "defect": ("defect_joint", "defect_time"),
    "condition_peak": ("condition_time", "condition_pose"),
    "path_position_error": ("path_error_time",),
    "stored_torque_error": ("stored_torque_joint", "stored_torque_time"),
    "between_samples_error": ("between_samples_time",),
    "undetermined_fraction": ("undetermined_direction",),
    **dict.fromkeys(("final_position_error", "final_velocity_error", "grid_step"), ()),
    **dict.fromkeys(("grid_ratio", "position_defect", "amplification"), ()),
}


def _merged(motion: Motion, parts: Sequence[tuple[float, Certificate]]) -> Certificate:
    """Return one certificate for consecutive parts: the worst of each figure, with its time."""
    lengths, certificates = zip(*parts, strict=True)
    figures: dict[str, Any] = {}
    for key, others in WORST.items():
        values = np.array([getattr(certificate, key) for certificate in certificates], dtype=float)
        worst = np.argmin(values) if key == "grid_ratio" else np.argmax(np.nan_to_num(values))
        figures |= {name: getattr(certificates[worst], name) for name in (key, *others)}
    for key in ("saturated_fraction", "undetermined_fraction"):
        figures[key] = float(np.average([getattr(c, key) for c in certificates], weights=lengths))
    statuses = [c.resimulation_status for c in certificates if not c.resimulation_status.solved]
    return Certificate(
        label=motion.label,
        ok=all(c.ok for c in certificates),
        verdict="",
        limit_checks=_merged_limits(parts),
        resimulation_status=statuses[0] if statuses else Status.SOLVED,
        segments=sum(c.segments for c in certificates),
        unjudged=certificates[0].unjudged,
        wall_time=sum(c.wall_time for c in certificates),
        checks=tuple(check for c in certificates for check in c.checks),
        **figures,
    )


def _merged_limits(parts: Sequence[tuple[float, Certificate]]) -> tuple[LimitCheck, ...]:
    checks: dict[str, LimitCheck] = {}
    for check in (check for _, certificate in parts for check in certificate.limit_checks):
        earlier = checks.setdefault(check.quantity, check)
        both = np.fmax(earlier.utilisation, check.utilisation)
        higher = check.largest_use > earlier.largest_use
        checks[check.quantity] = replace(check if higher else earlier, utilisation=both)
    return tuple(checks.values())
