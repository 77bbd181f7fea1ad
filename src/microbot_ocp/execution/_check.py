"""Anyone's trajectory judged: the certificate of what the controller makes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.check import Check, problems_of
from microbot_ocp._base.checks import FloatArray, naming
from microbot_ocp.certificate import Certificate, Tolerances, certified
from microbot_ocp.execution._curve import played, played_task, rows_of
from microbot_ocp.execution._load import refuse_other_arm
from microbot_ocp.execution._profile import Profile, load_profile
from microbot_ocp.execution._rows import CommandRows, read_rows
from microbot_ocp.limits import ROUNDING, LimitFamily
from microbot_ocp.motion import Motion, State, torque_along
from microbot_ocp.planning import Segment, Task
from microbot_ocp.robot import Robot, gravity_torque
from microbot_ocp.scene import Scene

AT_REST = float(np.finfo(np.float32).eps)  # rad/s: as joint_trajectory_controller compares


def check(
    robot: Robot,
    trajectory: str | Path | Motion | CommandRows,
    profile: str | Profile,
    *,
    scene: Scene | None = None,
    limit_tolerance: float = ROUNDING,
    via_q: Sequence[Any] | None = None,
    segments: Sequence[Segment] | None = None,
    cycle: bool = False,
) -> Certificate:
    """Judge anyone's trajectory as a controller would play it.

    It is :func:`certify` of what :func:`executed` makes of the rows, under the limits of the robot
    and of the profile, without the simulation: a file of positions has no torques to be simulated
    with.

    Parameters
    ----------
    robot : Robot
    trajectory : path, Motion or CommandRows
        A file as of :func:`~microbot_ocp.execution.read_rows`; a motion, saved or not, is sampled
        at the profile's rate.
    profile : str or Profile
        As of :func:`load_profile`.
    scene : Scene, optional
        Obstacles to keep clear of, proved between the rows, too.
    limit_tolerance : float
        Relative violation of a limit that still passes.
    via_q, segments, cycle
        Of a motion through stops, as of :func:`certify`: every stretch is judged with what the tool
        holds. The marks of the trajectory say when the stops are reached.

    Returns
    -------
    Certificate
        ``limit_checks`` has the worst use of every limit, with joint, time and amount.

    Raises
    ------
    InputError
        A file that cannot be read, other joints, a profile that does not fit, a motion of an arm
        with another payload.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> shape = mo.quintic([[0.0, 0.0, 0.0], [0.5, 0.8, 0.4]], [0.0, 0.5])
    >>> motion = mo.Motion.from_polynomial(robot, shape, label="quintic")
    >>> mo.check(robot, motion, "hold@500").verdict[:42]
    'Failed: velocity of shoulder is 2.9999 rad'
    """
    chosen = load_profile(profile)
    chosen.limits_of(robot)  # refuses another number of joints
    is_file = isinstance(trajectory, str | Path)
    rows = read_rows(trajectory, robot) if is_file else trajectory
    allowed = checks.number("limit_tolerance", limit_tolerance, at_least=0.0)
    task = played_task(robot, chosen, via_q, segments, cycle, scene)
    with naming(f"{Path(trajectory).name}: " if is_file else ""):
        if isinstance(rows, Motion):
            refuse_other_arm(robot, rows, task)
            rows = rows_of(rows, chosen)
        checks.joints("motion", rows.q.shape[1], robot)
        curve = played(robot, rows, chosen, task)
    certificate = judged(robot, rows, curve, chosen, task, scene, allowed, simulated=False)
    fit = _efforts_fit(robot, rows)
    if task or fit or not robot.has_dynamics or (fit is None and not rows.marks):
        return certificate
    why = "though the efforts are of another arm or load"
    if rows.marks:
        names = ", ".join(mark.name for mark in rows.marks)
        why = f"as marks ({names}) do not say what the tool holds"
    assumed = f"assumed: {robot.name} as it is all the way, {why}"
    return replace(certificate, verdict=f"{certificate.verdict[:-1]}; {assumed}.")


def _efforts_fit(robot: Robot, rows: CommandRows) -> bool | None:
    """Return whether efforts of rows, with gravity or without, are those of the arm as it is; None
    where rows have none, or too little to tell.
    """
    if rows.tau is None or rows.qd is None or rows.qdd is None or not rows.tau.any():
        return None
    state, most = State(rows.q, rows.qd, rows.qdd), Tolerances().torque * np.abs(rows.tau).max()
    whole = rows.tau - torque_along(robot, state)
    return any(np.abs(off).max() <= most for off in (whole, whole + _gravity(robot, state)))


def efforts(robot: Robot, state: State, profile: Profile) -> FloatArray:
    """Return torques [N,n] as a profile wants them."""
    tau = torque_along(robot, state)
    return tau if profile.gravity else tau - _gravity(robot, state)


def _gravity(robot: Robot, state: State) -> FloatArray:
    if not robot.has_dynamics:
        return np.zeros_like(state.q)
    return np.array(gravity_torque(robot).map(len(state.q))(state.q.T)).T


def judged(
    robot: Robot,
    rows: CommandRows,
    curve: Motion,
    profile: Profile,
    task: Task | None,
    scene: Scene | None,
    limit_tolerance: float = ROUNDING,
    *,
    simulated: bool,
) -> Certificate:
    """Return the certificate of the curve that a controller makes of rows."""
    subject = task or LimitFamily.of(robot, profile.limits_of(robot))
    tolerances = Tolerances(limit=limit_tolerance)
    certificate = certified(subject, curve, scene, tolerances, simulated=simulated)
    if not profile.rests or rows.qd is None:
        return certificate
    rests = []
    for name, k in (("first", 0), ("last", -1)):
        speed = float(np.abs(rows.qd[k]).max())
        problem = f"the {name} row moves at {speed:.3g} rad/s"
        where = f"{name} row", float(rows.t[k]), speed, AT_REST, "rad/s"
        rests.append(Check("rest", speed <= AT_REST, problem, *where))
    verdict = certificate.verdict
    if moving := "; ".join(problems_of(rests)):
        others = verdict.removeprefix("Failed: ") if not certificate.ok else "limits are kept."
        verdict = f"Failed: {moving}; {others}"
    every = (*certificate.checks, *rests)
    return replace(certificate, ok=certificate.ok and not moving, verdict=verdict, checks=every)
