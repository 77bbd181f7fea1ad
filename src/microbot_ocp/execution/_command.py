"""Rows that a controller accepts: a motion slowed down until its execution keeps all limits."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base.checks import InputError
from microbot_ocp.certificate import Certificate, LimitCheck, limit_checks_of
from microbot_ocp.execution._check import AT_REST, efforts, judged
from microbot_ocp.execution._curve import NEAR, played, played_task, rows_of
from microbot_ocp.execution._load import refuse_other_arm, torques_through
from microbot_ocp.execution._moved_in import MoveLeg, Part, moved_inside, state_of
from microbot_ocp.execution._profile import HELD, Profile, load_profile
from microbot_ocp.execution._rows import CommandRows
from microbot_ocp.limits import LIMIT_TOLERANCE, ROUNDING, LimitFamily
from microbot_ocp.motion import JUMP_GAP, Columns, Mark, Motion, State, write_columns
from microbot_ocp.planning.free import LARGEST_SLOWDOWN
from microbot_ocp.planning.search import FREE, time_optimal
from microbot_ocp.planning.task import Segment, Task, limits_digest
from microbot_ocp.robot import Robot
from microbot_ocp.scene import Scene


@dataclass(frozen=True, eq=False)
class ControllerCommand:
    """Motion as rows for a controller, with their execution and its certificate.

    Attributes
    ----------
    profile : Profile
        Profile of the controller.
    rows : CommandRows
        Rows, one per step, from rest to rest, with the efforts that the profile requires.
    executed : Motion
        Execution of the rows by the controller.
    certificate : Certificate
        Certificate of ``executed`` under the limits of the robot and of the profile.
    planned_duration, cost : float
        Duration of the motion, and additional duration of the rows, s.
    """

    profile: Profile
    rows: CommandRows
    executed: Motion
    certificate: Certificate
    planned_duration: float
    cost: float

    @property
    def accepted(self) -> bool:
        """True if the certificate passed."""
        return self.certificate.ok

    def export(self, path: str | Path, robot: Robot) -> Path:
        """Write the rows: the quantities that the controller requires, and the marks.

        Formats are those of :meth:`~microbot_ocp.Motion.export`, without films.

        Raises
        ------
        InputError
            The certificate did not pass, or the ending of the file is unknown.
        """
        if not self.accepted:
            raise InputError(
                f"profile {self.profile.name!r} does not accept the rows: "
                f"{self.certificate.verdict}"
            )
        marks = tuple((mark.time, mark.name) for mark in self.rows.marks)
        return write_columns(path, Columns.of(self.rows, robot, self.profile.columns, marks))


def commanded(
    robot: Robot,
    motion: Motion,
    profile: str | Profile,
    *,
    scene: Scene | None = None,
    via_q: Sequence[Any] | None = None,
    segments: Sequence[Segment] | None = None,
    cycle: bool = False,
) -> ControllerCommand:
    """Convert a motion into rows that a controller accepts.

    The motion is sampled at the rate of the profile, to a whole number of steps. If the execution
    of the rows exceeds a limit of the robot or of the profile, the motion is slowed down evenly
    until it keeps all limits. If jumps of accelerations or torques make that cost more than some
    steps, they are rounded off by the cubic B-spline of samples some steps apart, at most 1e-3 rad
    (m) away. A motion of :func:`microbot_ocp.time_optimal` through joint poses, without a
    ``scene``, is also planned again with a jerk limit; only its via points stay then, and the label
    of the rows says so. The fastest of these candidates is returned. Rows whose execution would
    leave a tool line or the position limits are moved inside.

    A motion through stops is treated from rest to rest with the payload of each segment, so that
    grip and release coincide with rows; every segment is certified.

    Parameters
    ----------
    robot : Robot
        Arm that executes the motion.
    motion : Motion
        Motion that is at rest at both ends.
    profile : str or Profile
        Profile of the controller; see :func:`load_profile`.
    scene : Scene, optional
        Obstacles that the executed motion must keep clear of: proved, but not corrected.
    via_q, segments, cycle
        Stops of the motion; see :func:`certify`.

    Returns
    -------
    ControllerCommand
        Rows and their certificate; ``accepted`` is its verdict, ``cost`` the added duration, s.

    Raises
    ------
    InputError
        The motion moves at an end, or slowing down cannot help: it leaves the position limits, or
        jumps although the profile allows no jump. Plan such motions under
        ``profile.limits_of(robot)``. Motions with another payload or with other stops are refused,
        too.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> shape = mo.shortest_duration(robot, mo.quintic([[0, 0, 0], [0.5, 0.8, 0.4]], [0, 1]))
    >>> motion = mo.Motion.from_polynomial(robot, shape.polynomial, label="quintic")
    >>> command = mo.execution.commanded(robot, motion, "hold@250")
    >>> command.accepted, command.cost < 0.01
    (True, True)
    """
    chosen = load_profile(profile)
    task = played_task(robot, chosen, via_q, segments, cycle, scene)
    refuse_other_arm(robot, motion, task)
    for end, row in (("begin", motion.qd[0]), ("end", motion.qd[-1])):
        if (speed := float(np.abs(row).max())) > AT_REST:
            raise InputError(
                f"motion must {end} at rest for a controller, not at {speed:.3g} rad/s"
            )
    _refuse_outside(robot, motion, chosen)
    if task is None:
        families = [LimitFamily.of(robot, chosen.limits_of(robot))]
        rows = _soonest(MoveLeg(families, motion, chosen))
        again = None if scene else _planned_again(robot, motion, rows, chosen)
        if again is not None:
            sooner = _soonest(MoveLeg(families, again, chosen))
            rows = sooner if sooner.t[-1] < rows.t[-1] else rows
    else:
        rows = _rows_through(task, motion, chosen)
    profile_of = partial(efforts, profile=chosen)
    rows = replace(rows, tau=torques_through(robot, rows, task, profile_of)(rows.t, state_of(rows)))
    curve = played(robot, rows, chosen, task)
    certificate = judged(robot, rows, curve, chosen, task, scene, simulated=True)
    cost = float(rows.t[-1]) - motion.duration
    return ControllerCommand(chosen, rows, curve, certificate, motion.duration, cost)


def _planned_again(
    robot: Robot, motion: Motion, rows: CommandRows, profile: Profile
) -> Motion | None:
    """Plan a motion of :func:`time_optimal` again with a jerk limit if its rows take much longer.

    Under the limit an acceleration takes two steps to change by its largest value: a jerk limit
    costs a plan little, but a jump of the acceleration costs rows much. The result is None for any
    other motion, and for one that is slower than the new plan: it had other limits or other aims.
    """
    made, limits = motion.provenance, profile.limits_of(robot)
    known = [limits_digest(each) for each in (robot.limits, limits)]
    if rows.t[-1] <= motion.duration + 3.0 * profile.step or len(motion.marks) < 2:
        return None
    if made.get("method") != FREE or made.get("limits_digest") not in known:
        return None
    via_q = motion.sample([mark.time for mark in motion.marks]).q
    jerk = np.abs(motion.qdd).max() / (2.0 * profile.step)
    gentle = robot.with_limits(limits)
    gentle = gentle.with_limits(qddd_max=np.minimum(gentle.limits.qddd_max, jerk))
    again = time_optimal(gentle, via_q, starts=1)
    slower = again.duration >= (1.0 - LIMIT_TOLERANCE) * motion.duration
    return (
        replace(again, label=f"{motion.label}, planned again") if again.solved and slower else None
    )


def _refuse_outside(robot: Robot, motion: Motion, profile: Profile) -> None:
    """Reject a motion outside the positions that the robot and a profile allow."""
    low, high = profile.limits_of(robot).bounds("q")
    beyond = np.maximum(low - motion.q, motion.q - high)
    sample, joint = np.unravel_index(int(beyond.argmax()), beyond.shape)
    if beyond[sample, joint] > NEAR:
        raise InputError(
            f"position of {robot.joint_names[joint]} is {motion.q[sample, joint]:.5g} "
            f"{robot.unit('q', int(joint))} at {motion.t[sample]:.4g} s, but robot and profile "
            f"{profile.name!r} allow {low[joint]:.5g} to {high[joint]:.5g}; plan under the "
            "limits of the profile, profile.limits_of(robot)"
        )


def _rows_through(task: Task, motion: Motion, profile: Profile) -> CommandRows:
    """Return the rows of a motion through stops, slowed down from rest to rest.

    The curve of held commands starts a step before its first row and ends a step after its last
    row, so every rest gets one more row on both sides.
    """
    step, pad = profile.step, int(profile.interpolation in HELD)
    last = len(task.stops) - 1
    rests = [k for k in range(last + 1) if k in (0, last) or task.at_rest(k)]
    still = np.zeros_like(motion.q[:1])
    pieces = [State(motion.q[:1], still, still)]
    count, marks = 0, []  # number of rows after the first one

    def hold(rows: int) -> None:
        nonlocal count
        if rows:
            count += rows
            zero = still.repeat(rows, axis=0)
            pieces.append(State(pieces[-1].q[-1:].repeat(rows, axis=0), zero, zero))

    def rest(k: int) -> None:
        marks.append(Mark(count * step, task.stops[k].name))
        hold(int(np.ceil(task.dwells[k] / step - ROUNDING)))

    for k, after in pairwise(rests):
        rest(k)
        hold(pad)
        part = _from_rest(task, motion, k, after)
        passed = task.stops[k + 1 : after]
        rows = _soonest(MoveLeg(task.families[k:after], part, profile, passed))
        marks += [Mark(count * step + mark.time, mark.name) for mark in rows.marks[1:-1]]
        pieces.append(State(*(column[1:] for column in state_of(rows))))
        count += len(rows.q) - 1
        hold(pad)
    rest(last)
    q, qd, qdd = (np.concatenate(column) for column in zip(*pieces, strict=True))
    t = step * np.arange(count + 1.0, dtype=float)
    return CommandRows(t, q, qd, qdd, label=motion.label, marks=tuple(marks))


def _from_rest(task: Task, motion: Motion, first: int, last: int) -> Motion:
    """Return the motion between two stops at rest, with zero acceleration at both."""
    start = motion.marks[first].time + float(task.dwells[first])
    end = motion.marks[last].time
    here = (motion.t > start + 2 * JUMP_GAP) & (motion.t < end - 2 * JUMP_GAP)
    t = np.concatenate([[start], motion.t[here], [end]])
    q, qd, qdd = motion.sample(t)
    qd[[0, -1]] = qdd[[0, -1]] = 0.0
    stops = motion.marks[first : last + 1]
    marks = [Mark(max(mark.time - start, 0.0), mark.name) for mark in stops]
    return Motion(t - start, q, qd, qdd, np.zeros_like(q), motion.label, marks=tuple(marks))


def _accepted(leg: MoveLeg, window: int = 0) -> CommandRows:
    """Slow the motion down until its execution keeps the limits of every segment; return its rows.

    A ``window`` replaces the motion by the B-spline of its samples that many steps apart.
    """
    motion, profile, robot = leg.motion, leg.profile, leg.families[0].robot
    steps = max(1, int(np.ceil(motion.duration / profile.step - ROUNDING)))
    most = int(LARGEST_SLOWDOWN * steps) + 1
    while True:
        slowed = motion.stretched(robot, steps * profile.step / motion.duration)
        if window:
            rounding = replace(profile, interpolation="hold", rate=1.0 / (window * profile.step))
            slowed = played(robot, rows_of(slowed, rounding), rounding)
        rows, parts = moved_inside(leg, rows_of(slowed, profile))
        # A cubic B-spline is away from its control points by about qdd h^2 / 6.
        off = np.abs(slowed.qdd).max() * (window * profile.step) ** 2 / 6.0
        factor, worst = _slowdown_factor(parts)
        factor = max(factor, np.sqrt(off / NEAR))
        if factor <= 1.0:
            return rows
        if steps >= most:
            why = f"it is off by {off:.3g} rad" if worst is None else worst.excess
            raise InputError(
                f"motion cannot be slowed down for profile {profile.name!r}: {why}; plan under the "
                "limits of the profile, profile.limits_of(robot), with smaller tool line tolerances"
            )
        # An infeasible position at this speed may become feasible at a lower one.
        goal = steps * factor if steps * factor <= most else np.sqrt(steps * most)
        steps = max(steps + 1, int(np.ceil(goal)))


def _soonest(leg: MoveLeg) -> CommandRows:
    """Return the rows of the motion slowed down, as it is or rounded off, whichever is faster.

    At a jump of the acceleration, polynomials between two rows overshoot, and differences of rows
    show a jerk and a torque rate that only much slower motions keep within limits. The cubic
    B-spline of samples some steps apart has no such jump, and its knots are rows. It takes two of
    these longer steps more.
    """
    best = None
    with suppress(InputError):
        best = _accepted(leg)
    if best and best.t[-1] <= leg.motion.duration + 3.0 * leg.profile.step:
        return best
    before = np.inf
    for window in _windows(leg.motion, leg.profile):
        with suppress(InputError):
            smooth = _accepted(leg, window)
            if smooth.t[-1] > before:
                break
            before = smooth.t[-1]
            if best is None or before < best.t[-1]:
                best = smooth
    return best or _accepted(leg)  # the second call raises the error with the reason


def _windows(motion: Motion, profile: Profile) -> list[int]:
    """Return spline windows, in steps, that may be accurate enough; the largest first."""
    most = max(float(np.abs(motion.qdd).max()), ROUNDING)
    seconds = min(np.sqrt(6.0 * NEAR / most), 0.5 * motion.duration)
    window = int(np.ceil(seconds / profile.step))  # a slower motion deviates less
    return [window >> halvings for halvings in range(window.bit_length())]


def _slowdown_factor(parts: Sequence[Part]) -> tuple[float, LimitCheck | None]:
    """Return the factor by which a curve must be slower to keep all limits, and the decisive check.

    A derivative of order k scales with the power k of the speed, so a use u needs the factor
    u^(1/k); for torques it is a lower bound, since gravity does not scale. A position limit gives
    infinity, since slowing down does not move the curve.
    """
    limits = [c for part in parts for c in limit_checks_of(*part)[0] if c.violation > ROUNDING]
    if not limits:
        return 1.0, None
    orders = {member.key: member.order for family, _ in parts for member in family}
    worst = max(limits, key=lambda check: (orders[check.quantity] == 0, check.violation))
    if not orders[worst.quantity]:
        return np.inf, worst
    return max((1.0 + c.violation) ** (1.0 / orders[c.quantity]) for c in limits), worst


def exported(
    motion: Motion,
    path: str | Path,
    profile: str | Profile,
    rate: float | None,
    robot: Robot | None,
    **given: Any,
) -> Path:
    """Write a motion for a controller; see :meth:`microbot_ocp.Motion.export`."""
    if rate is not None:
        raise InputError("give rate or profile, not both: the profile has a rate")
    if robot is None:
        raise InputError("a profile needs the robot: give robot=...")
    return commanded(robot, motion, profile, **given).export(path, robot)
