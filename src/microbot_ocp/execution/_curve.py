"""Curve that the drives follow when a controller executes rows, as a motion.

Controllers that hold commands, such as libfranka, define velocity, acceleration and jerk by the
differences of commands from step to step. The cubic B-spline with the commands as control points
has these derivatives: its jerk within a step is the third difference, its acceleration at the steps
the second. It is at rest one step before the first command and one step after the last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp.certificate import Tolerances
from microbot_ocp.execution._load import given_task, refuse_other_arm
from microbot_ocp.execution._profile import HELD, Profile, load_profile
from microbot_ocp.execution._rows import CommandRows
from microbot_ocp.motion import (
    JUMP_GAP,
    Mark,
    Motion,
    PiecewisePolynomial,
    State,
    nearest_samples,
    quintic_between,
)
from microbot_ocp.planning.search import motion_along
from microbot_ocp.planning.task import Segment, Task
from microbot_ocp.robot import Robot
from microbot_ocp.scene import Scene, with_arm_capsules

NEAR = Tolerances().via  # largest deviation, rad (m): the tolerance of via points


def executed(
    robot: Robot,
    motion: Motion | CommandRows,
    profile: str | Profile,
    *,
    via_q: Sequence[Any] | None = None,
    segments: Sequence[Segment] | None = None,
    cycle: bool = False,
) -> Motion:
    """Return the executed motion of a controller that plays the samples of a motion.

    Parameters
    ----------
    robot : Robot
        Arm that executes the motion.
    motion : Motion or CommandRows
        Motion to execute; it is sampled at the profile's rate, to a whole number of steps, and held
        beyond its end. Rows are taken as they are.
    profile : str or Profile
        Profile of the controller; see :func:`load_profile`.
    via_q, segments, cycle
        Stops of the motion, see :func:`certify`; torques are computed with the payload at each
        time.

    Returns
    -------
    Motion
        Executed motion with torques by inverse dynamics. Under a profile that holds commands it is
        two steps longer than the rows, and its marks are a step later.

    Raises
    ------
    InputError
        The number of joints differs, the profile has no rate, the rows lack a quantity that the
        profile interpolates or are not one per step, or the motion has another payload.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> shape = mo.quintic([[0.0, 0.0, 0.0], [0.5, 0.8, 0.4]], [0.0, 2.0])
    >>> motion = mo.Motion.from_polynomial(robot, shape, label="quintic")
    >>> round(mo.executed(robot, motion, "hold@500").duration, 6)
    2.004
    """
    chosen = load_profile(profile)
    checks.joints("motion", motion.q.shape[1], robot)
    task = played_task(robot, chosen, via_q, segments, cycle)
    if isinstance(motion, CommandRows):
        return played(robot, motion, chosen, task)
    refuse_other_arm(robot, motion, task)
    return played(robot, rows_of(motion, chosen), chosen, task)


def played(robot: Robot, rows: CommandRows, chosen: Profile, task: Task | None = None) -> Motion:
    """Return the executed motion of rows, through the stops of a task if given."""
    curve = RULES[chosen.interpolation](rows, chosen)
    delay = chosen.step if chosen.interpolation in HELD else 0.0  # the curve lags the rows
    marks = [Mark(mark.time + delay, mark.name) for mark in rows.marks]
    origin = {"method": "execution by a controller", "profile": chosen.name}
    about: Any = {"label": f"{rows.label}, by {chosen.name}", "provenance": origin}
    # Limits may change at a mark, so every mark is a break.
    inner = np.array([mark.time for mark in marks[1:-1]])
    curve = curve.divided(
        inner[np.abs(inner - curve.breaks[nearest_samples(curve.breaks, inner)]) > JUMP_GAP]
    )
    if task is None:
        return Motion.from_polynomial(robot, curve, marks=marks, **about)
    return motion_along(task, curve, marks, **about)


def played_task(
    robot: Robot,
    profile: Profile,
    via_q: Sequence[Any] | None,
    segments: Sequence[Segment] | None,
    cycle: bool,
    scene: Scene | None = None,
) -> Task | None:
    """Return the task of stops under the limits of robot and profile, as a controller keeps it.

    Stops without a rest get the tolerance of via points on top of their own.
    """
    arm = robot if scene is None else with_arm_capsules(robot)  # parts are attached to capsules
    task = given_task(arm, profile.limits_of(robot), via_q, segments, cycle)
    if task is None:
        return None
    stops = list(task.stops)
    for k, stop in enumerate(stops):
        if not task.at_rest(k):
            turn = stop.orientation_tolerance + (stop.orientation is not None) * NEAR
            near = np.add(stop.tolerance, NEAR)
            stops[k] = replace(stop, tolerance=near, orientation_tolerance=turn)
    return replace(task, stops=tuple(stops))


def rows_of(motion: Motion, profile: Profile) -> CommandRows:
    """Return the samples of a motion at the rate of a profile; a row beyond its end is at rest.

    Torques are interpolated from the stored ones.
    """
    step = profile.step
    count = max(1, checks.step_count(motion.duration, step))
    t = np.linspace(0.0, count * step, count + 1)
    state = motion.sample(np.minimum(t, motion.duration))
    beyond = t > motion.duration * (1 + ROUNDING)
    still = ~beyond[:, None]
    tau = np.column_stack([np.interp(t, motion.t, column) for column in motion.tau.T])
    return CommandRows(
        t, state.q, state.qd * still, state.qdd * still, tau, motion.label, motion.marks
    )


def _held(rows: CommandRows, profile: Profile) -> PiecewisePolynomial:
    step = profile.step
    late = np.flatnonzero(np.abs(rows.t - step * np.arange(rows.t.size)) >= 0.5 * step)
    if late.size:
        k = int(late[0])
        raise InputError(
            f"row {k + 1} is at {rows.t[k]:.6g} s, but profile {profile.name!r} plays it at "
            f"{k * step:.6g} s, a row a step of {step:g} s: resample it"
        )
    return spline_of(rows.q, step)


def _linear(rows: CommandRows, profile: Profile) -> PiecewisePolynomial:
    step = profile.step
    count = checks.step_count(float(rows.t[-1]), step)
    t = np.minimum(np.arange(count + 1) * step, rows.t[-1])
    return spline_of(np.column_stack([np.interp(t, rows.t, column) for column in rows.q.T]), step)


def spline_of(q: FloatArray, step: float) -> PiecewisePolynomial:
    """Return the uniform cubic B-spline with control points [N,n], which lags them by one step."""
    # Repeated end commands make the spline begin and end at rest.
    control = np.concatenate([q[:1], q[:1], q, q[-1:], q[-1:]])
    first, second, third = (np.diff(control, n=order, axis=0) for order in (1, 2, 3))
    pieces = len(third)
    # Power coefficients: (c0 + 4 c1 + c2) / 6, (c2 - c0) / 2h, second / 2h^2, third / 6h^3.
    terms = (
        control[1 : pieces + 1] + second[:pieces] / 6.0,
        0.5 * (first[:pieces] + first[1 : pieces + 1]) / step,
        0.5 * second[:pieces] / step**2,
        third / (6.0 * step**3),
    )
    breaks = np.linspace(0.0, pieces * step, pieces + 1)
    return PiecewisePolynomial(breaks, np.stack(terms, axis=1))


def _cubic(rows: CommandRows, profile: Profile) -> PiecewisePolynomial:
    qd, h = _needed(rows, "qd", profile), np.diff(rows.t)[:, None]
    q, slope = rows.q[:-1], np.diff(rows.q, axis=0) / h
    second = (3.0 * slope - 2.0 * qd[:-1] - qd[1:]) / h
    third = (qd[:-1] + qd[1:] - 2.0 * slope) / h**2
    return PiecewisePolynomial(rows.t, np.stack([q, qd[:-1], second, third], axis=1))


def _quintic(rows: CommandRows, profile: Profile) -> PiecewisePolynomial:
    qd, qdd = (_needed(rows, key, profile) for key in ("qd", "qdd"))
    start, end = (State(rows.q[k], qd[k], qdd[k]) for k in (slice(-1), slice(1, None)))
    return PiecewisePolynomial(rows.t, quintic_between(start, end, np.diff(rows.t)))


def _needed(rows: CommandRows, key: str, profile: Profile) -> FloatArray:
    values = getattr(rows, key)
    if values is None:
        raise InputError(f"profile {profile.name!r} needs {key} in every row")
    return values


RULES = {"hold": _held, "linear": _linear, "cubic": _cubic, "quintic": _quintic}
