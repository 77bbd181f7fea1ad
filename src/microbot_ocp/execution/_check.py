"""Certificate of any trajectory as a controller executes it."""

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
from microbot_ocp.planning.task import Segment, Task
from microbot_ocp.robot import Robot, gravity_torque
from microbot_ocp.scene import Scene

AT_REST = float(np.finfo(np.float32).eps)  # tolerance of joint_trajectory_controller, rad/s


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
    """Certify any trajectory as a controller would execute it.

    The executed motion, see :func:`executed`, is certified by :func:`certify` under the limits of
    the robot and of the profile. It is not re-simulated, because a file of positions holds no
    torques.

    Parameters
    ----------
    robot : Robot
        Arm that executes the trajectory.
    trajectory : path, Motion or CommandRows
        Trajectory file, see :func:`~microbot_ocp.execution.read_rows`; or a motion, which is
        sampled at the profile's rate.
    profile : str or Profile
        Profile of the controller; see :func:`load_profile`.
    scene : Scene, optional
        Obstacles to keep clear of, proved between the rows, too.
    limit_tolerance : float
        Allowed relative violation of a limit.
    via_q, segments, cycle
        Stops of the motion, see :func:`certify`; every segment is certified with its payload. The
        marks of the trajectory give the times of the stops.

    Returns
    -------
    Certificate
        Certificate; ``limit_checks`` has the worst use of every limit, with joint and time.

    Raises
    ------
    InputError
        The file cannot be read, its joints or the profile do not fit the robot, or the motion
        belongs to an arm with another payload.

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
    why = "although the efforts belong to another arm or payload"
    if rows.marks:
        names = ", ".join(mark.name for mark in rows.marks)
        why = f"because the marks ({names}) do not tell the payload"
    assumed = f"assumed: {robot.name} with its own payload all along, {why}"
    return replace(certificate, verdict=f"{certificate.verdict[:-1]}; {assumed}.")


def _efforts_fit(robot: Robot, rows: CommandRows) -> bool | None:
    """Return True if the efforts of rows, with or without gravity, are those of the robot.

    The result is None if the rows have no efforts, or too little data to decide.
    """
    if rows.tau is None or rows.qd is None or rows.qdd is None or not rows.tau.any():
        return None
    state, most = State(rows.q, rows.qd, rows.qdd), Tolerances().torque * np.abs(rows.tau).max()
    whole = rows.tau - torque_along(robot, state)
    return any(np.abs(off).max() <= most for off in (whole, whole + _gravity(robot, state)))


def efforts(robot: Robot, state: State, profile: Profile) -> FloatArray:
    """Return the efforts [N,n] that a profile requires: torques with or without gravity."""
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
    """Certify the executed curve of rows; a profile may require rest at both ends."""
    subject = task or LimitFamily.of(robot, profile.limits_of(robot))
    tolerances = Tolerances(limit=limit_tolerance)
    certificate = certified(subject, curve, scene, tolerances, simulated=simulated)
    if not profile.rests or rows.qd is None:
        return certificate
    rests = []
    for name, k in (("first", 0), ("last", -1)):
        speed = float(np.abs(rows.qd[k]).max())
        problem = f"the {name} row moves at {speed:.3g} rad/s, but must be at rest"
        where = f"{name} row", float(rows.t[k]), speed, AT_REST, "rad/s"
        rests.append(Check("rest", speed <= AT_REST, problem, *where))
    verdict = certificate.verdict
    if moving := "; ".join(problems_of(rests)):
        others = verdict.removeprefix("Failed: ") if not certificate.ok else "limits are kept."
        verdict = f"Failed: {moving}; {others}"
    every = (*certificate.checks, *rests)
    return replace(certificate, ok=certificate.ok and not moving, verdict=verdict, checks=every)
