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
from microbot_ocp.execution._moved_in import MoveLeg, Part, drawn_in, state_of
from microbot_ocp.execution._profile import HELD, Profile, load_profile
from microbot_ocp.execution._rows import CommandRows
from microbot_ocp.limits import LIMIT_TOLERANCE, ROUNDING, LimitFamily
from microbot_ocp.motion import JUMP_GAP, Columns, Mark, Motion, State, write_columns
from microbot_ocp.planning import FREE, Segment, Task, limits_digest, time_optimal
from microbot_ocp.planning.free._within_limits import SLOWING
from microbot_ocp.robot import Robot
from microbot_ocp.scene import Scene


@dataclass(frozen=True, eq=False)
class ControllerCommand:
    """A motion as a controller gets it.

    Attributes
    ----------
    profile : Profile
    rows : CommandRows
        One a step, from rest to rest, with efforts as the profile wants them.
    executed : Motion
        What the controller makes of them.
    certificate : Certificate
        Of ``executed``, under the limits of the robot and of the profile.
    planned_duration, cost : float
        Duration of the motion, s, and what the rows take longer.
    """

    profile: Profile
    rows: CommandRows
    executed: Motion
    certificate: Certificate
    planned_duration: float
    cost: float

    @property
    def accepted(self) -> bool:
        """Whether the certificate passed."""
        return self.certificate.ok

    def export(self, path: str | Path, robot: Robot) -> Path:
        """Write the rows: the quantities that the controller wants, and the marks.

        Formats are those of :meth:`~microbot_ocp.Motion.export`, without films.

        Raises
        ------
        InputError
            The certificate did not pass; another ending.
        """
        if not self.accepted:
            raise InputError(
                f"profile {self.profile.name!r} does not accept it: {self.certificate.verdict}"
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
    """Make rows of a motion that a controller accepts.

    The motion is sampled at the rate of the profile, to a whole number of steps. Where what the
    controller makes of the rows exceeds a limit, of the robot or of the profile, the motion is
    slowed down evenly, until it does not any more. Where accelerations or torques that jump cost
    more than some steps so, they are rounded off: by the cubic B-spline of samples some steps
    apart, at most 1e-3 rad (m) off. A motion of :func:`microbot_ocp.time_optimal` through joint
    poses, without a ``scene``, is also planned again with a limit of the jerk, so that only its via
    points stay; the label of the rows says so. Of these the soonest is returned. Where their
    execution would leave a tool line or a range of positions, rows are moved in.

    Of a motion through stops this is done from rest to rest with what the tool holds there, so that
    grip and release are at rows; the certificate is that of every stretch.

    Parameters
    ----------
    robot : Robot
    motion : Motion
        At rest at both ends.
    profile : str or Profile
        As of :func:`load_profile`.
    scene : Scene, optional
        Obstacles that the executed motion keeps clear of: proved, not mended.
    via_q, segments, cycle
        Of a motion through stops, as of :func:`certify`.

    Returns
    -------
    ControllerCommand
        ``accepted`` says whether the certificate passed, ``cost`` how many seconds the controller
        costs.

    Raises
    ------
    InputError
        A motion that moves at an end, or that slowing down does not help much: it leaves the
        position limits, or jumps where the profile allows no jump. Plan under
        ``profile.limits_of(robot)`` then. A motion of an arm with another payload, or of other
        stops.

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
                f"motion must {end} at rest to be a controller's, not at {speed:.3g} rad/s"
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
    """Return another plan through the via points, whose accelerations take two steps to change by
    their largest, where a motion of :func:`time_optimal` under these limits costs much as it is.

    A jerk costs a plan little, but rows that see a jump of the acceleration much. No other motion
    is planned again: one that is slower than such a plan had other limits or a wish besides.
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
    """Refuse a motion that leaves the positions which the robot and a profile allow."""
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
    """Return rows of a motion through stops, slowed down from rest to rest.

    Where commands are held their curve is at rest a step later, and it leaves a step before: there
    is a row more on both sides of every rest.
    """
    step, pad = profile.step, int(profile.interpolation in HELD)
    last = len(task.stops) - 1
    rests = [k for k in range(last + 1) if k in (0, last) or task.at_rest(k)]
    still = np.zeros_like(motion.q[:1])
    pieces = [State(motion.q[:1], still, still)]
    count, marks = 0, []  # rows after the first one

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
    """Return the motion from one stop where it rests to the next, without acceleration at both."""
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
    """Return rows of the motion slowed down until its execution keeps all limits, those of each
    segment there.

    With a ``window`` it is first made what a controller makes of it that holds its samples so many
    steps.
    """
    motion, profile, robot = leg.motion, leg.profile, leg.families[0].robot
    steps = max(1, int(np.ceil(motion.duration / profile.step - ROUNDING)))
    most = int(SLOWING.most_evenly * steps) + 1
    while True:
        slowed = motion.stretched(robot, steps * profile.step / motion.duration)
        if window:
            rounding = replace(profile, interpolation="hold", rate=1.0 / (window * profile.step))
            slowed = played(robot, rows_of(slowed, rounding), rounding)
        rows, parts = drawn_in(leg, rows_of(slowed, profile))
        off = np.abs(slowed.qdd).max() * (window * profile.step) ** 2 / 6.0
        factor, worst = _slower(parts)
        factor = max(factor, np.sqrt(off / NEAR))
        if factor <= 1.0:
            return rows
        if steps >= most:
            why = f"it is off by {off:.3g} rad" if worst is None else worst.excess
            raise InputError(
                f"motion cannot be slowed down for profile {profile.name!r}: {why}; plan under the "
                "limits of the profile, profile.limits_of(robot), and tool lines within less"
            )
        # what asks for more than there is, as a place does that is left, may ask for less later
        goal = steps * factor if steps * factor <= most else np.sqrt(steps * most)
        steps = max(steps + 1, int(np.ceil(goal)))


def _soonest(leg: MoveLeg) -> CommandRows:
    """Return rows of the motion slowed down as it is, or rounded off, whichever takes less time.

    Where an acceleration jumps, polynomials between two rows make too much of it, and differences
    of rows see a jerk and a torque rate that only much slower motions leave within bounds. The
    cubic B-spline of samples some steps apart jumps nowhere, and its knots are at rows. It takes
    two of these steps more.
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
    return best or _accepted(leg)  # which says what is in the way


def _windows(motion: Motion, profile: Profile) -> list[int]:
    """Return steps between samples of a spline that may be near enough, the most first."""
    most = max(float(np.abs(motion.qdd).max()), ROUNDING)
    seconds = min(np.sqrt(6.0 * NEAR / most), 0.5 * motion.duration)
    window = int(np.ceil(seconds / profile.step))  # what is slowed down is nearer
    return [window >> halvings for halvings in range(window.bit_length())]


def _slower(parts: Sequence[Part]) -> tuple[float, LimitCheck | None]:
    """Return by what a curve has to be slower to keep all limits, about or somewhat less, and the
    check that asks for it.

    A limit of a derivative of some order is used by the power of it less; of a torque all but the
    part of gravity. Infinite where a place is left, as slowing down is no other place.
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
        raise InputError("give rate or profile, not both: a profile has a rate")
    if robot is None:
        raise InputError("a profile needs the robot: give robot=...")
    return commanded(robot, motion, profile, **given).export(path, robot)
