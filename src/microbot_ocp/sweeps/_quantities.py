"""Quantities that may vary between cases: names, widths, units, and the task of one case."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.inverse_kinematics import solve_ik
from microbot_ocp.limits import changes_by_name
from microbot_ocp.robot import Robot, joint_scale
from microbot_ocp.tasks import KEYS

POSE = re.compile(r"(start|goal|via[1-9]\d*)_(q|position)")
DYNAMICS = ("masses", "viscous_friction", "coulomb_friction", "gravity")
"""Quantities that need a new solver; limits, poses and payload are inputs of a prepared solver."""
LIMITS = tuple(key for key in KEYS["limits"] if not key.endswith("_deg"))
Values = Mapping[str, FloatArray]


class NoTask(Exception):
    """Failure to build the task of a case, because a pose is not reached."""

    def __init__(self, status: Status, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


@dataclass(frozen=True, eq=False)
class CaseTask:
    """Task of one case.

    Attributes
    ----------
    robot : Robot
        Robot with the masses, friction, gravity and limits of the case, without its payload.
    payload : float
        Point mass at the tool, kg.
    via_q : array [m,n], rad (m)
    """

    robot: Robot
    payload: float
    via_q: FloatArray


def plain_name(name: str) -> str:
    """Return the name of a quantity without ``_deg``."""
    return name.removesuffix("_deg")


def check_name(name: str) -> None:
    """Raise InputError, with a suggestion, if a quantity is unknown."""
    plain = plain_name(name)
    angular = plain == name or name in KEYS["limits"] or plain.endswith("_q")
    if angular and (POSE.fullmatch(plain) or plain in (*DYNAMICS, "payload", *LIMITS)):
        return
    allowed = ["start_q", "start_q_deg", "start_position", "goal_q", "goal_q_deg", "goal_position"]
    allowed += ["via1_q", "via1_q_deg", "via1_position", "payload", *DYNAMICS, *KEYS["limits"]]
    hint = checks.did_you_mean(name, allowed) or ";"
    raise InputError(
        f"{name} is no quantity that may vary{hint} allowed: start_, goal_, via1_, via2_... with "
        "q, q_deg or position; payload, " + ", ".join(DYNAMICS) + ", and limits such as qd_max"
    )


def widths(robot: Robot, name: str) -> tuple[int, ...]:
    """Return the allowed numbers of components of a quantity."""
    plain, count = plain_name(name), robot.joint_count
    pose = POSE.fullmatch(plain)
    if pose:
        return (3,) if pose[2] == "position" else (count,)
    if plain in ("payload", "gravity", "masses"):
        return {"payload": (1,), "gravity": (3,), "masses": (robot.link_count,)}[plain]
    return (1, robot.link_count if plain in DYNAMICS else count)


def scale_to_si(robot: Robot, name: str, width: int) -> FloatArray:
    """Return the factors [width] to SI units, which are not 1 for a name in degrees."""
    if plain_name(name) == name:
        return np.ones(width)
    scale = joint_scale(robot)
    return scale if width == scale.size else scale[:1]


def column_names(name: str, width: int) -> tuple[str, ...]:
    """Return the column names of a quantity: its name, numbered from 1 if it has components."""
    return (name,) if width == 1 else tuple(f"{name}_{k + 1}" for k in range(width))


def pose_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the poses of a task in order: start, via points by number, goal.

    Raises
    ------
    InputError
        A missing start or goal, a pose given twice, a gap in the numbers of the via points.
    """
    poses: dict[str, str] = {}
    for name in names:
        pose = POSE.fullmatch(name)
        if pose and poses.setdefault(pose[1], name) != name:
            raise InputError(f"{pose[1]} is given twice, by {poses[pose[1]]} and {name}")
    for end in ("start", "goal"):
        if end not in poses:
            raise InputError(f"{end}_q, {end}_q_deg or {end}_position is missing")
    between = [f"via{k + 1}" for k in range(len(poses) - 2)]
    missing = [name for name in between if name not in poses]
    if missing:
        raise InputError(f"{missing[0]}_q or {missing[0]}_position is missing: via points count up")
    return tuple(poses[name] for name in ("start", *between, "goal"))


def robot_with(robot: Robot, values: Values) -> Robot:
    """Return the robot with the masses, friction, gravity and limits of a case, not its payload."""
    count = robot.link_count
    links = list(robot.links)
    for name in set(DYNAMICS[:3]) & set(values):
        if not links:
            raise InputError(f"{name} cannot vary: robot {robot.name!r} has no links with masses")
    if "masses" in values:
        for k, mass in enumerate(values["masses"]):
            size = mass / links[k].mass if links[k].mass else 1.0
            links[k] = replace(links[k], mass=float(mass), inertia=links[k].inertia * size)
    for name in set(DYNAMICS[1:3]) & set(values):
        for k, value in enumerate(np.broadcast_to(values[name], count)):
            links[k] = replace(links[k], **{name: float(value)})
    changed = robot if links == list(robot.links) else robot.with_links(links)
    if "gravity" in values:
        changed = changed.with_gravity(values["gravity"])
    given = {name: value for name, value in values.items() if name in LIMITS}
    if not given:
        return changed
    limits = {name: v.tolist() if v.size > 1 else v.item() for name, v in given.items()}
    return changed.with_limits(**changes_by_name(changed.limits.also, limits))


def task_of(robot: Robot, poses: tuple[str, ...], values: Values) -> CaseTask:
    """Return the task of a case.

    The inverse kinematics of a tool position starts from the pose before it.

    Raises
    ------
    NoTask
        A tool position that is not reached.
    InputError
        Values that no robot has, such as a negative mass.
    """
    arm = robot_with(robot, values)
    via: list[FloatArray] = []
    for name in poses:
        if name.endswith("_q"):
            via.append(values[name])
            continue
        solution = solve_ik(arm, values[name], seed=via[-1] if via else np.zeros(robot.joint_count))
        if not solution.solved:
            raise NoTask(solution.status, f"{name}: {solution.advice or solution.status.sentence}")
        via.append(solution.q)
    payload = float(values["payload"][0]) if "payload" in values else 0.0
    return CaseTask(arm, payload, np.array(via))
