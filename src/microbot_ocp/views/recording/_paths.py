"""The entity tree and the timelines of every recording; ``docs/recordings.md`` describes them."""

from __future__ import annotations

import rerun as rr

from microbot_ocp.robot import Robot

TIME = "sim_time"  # duration since the start of the motion, s
PROGRESS = "progress_permille"  # share of the joint path travelled, 0 to 1000
BRANCH = "branch"  # number of a solution, from 1
WHOLE = 1000  # the last value of PROGRESS

SUMMARY = "summary"
MARKS = "marks"
SATURATION = "saturation"
PHASES = "phases"
WORLD = "world"
BASE = "world/base"
PLACES = "world/places"
TARGET = "world/target"


def arm(name: str, *below: str) -> str:
    """Path of an arm, or of something below it."""
    return "/".join([WORLD, name, *below])


def link(name: str, frame: int, *below: str) -> str:
    """Path of the link frame ``frame`` (0 is the base) of an arm, or of something in it."""
    return arm(name, f"link_{frame}", *below)


def tool(name: str, *below: str) -> str:
    """Path of an arm's tool, which does not turn, or of something at it."""
    return arm(name, "tool", *below)


def trail(name: str) -> str:
    """Path of the line that an arm's tool has left behind."""
    return arm(name, "trail")


def curve(robot: Robot, quantity: str, joint: int, leaf: str = "") -> str:
    """Path of the curves of a joint (0-based), or of one of them."""
    parts = ["plots", quantity, robot.joint_names[joint], *([leaf] if leaf else [])]
    return rr.new_entity_path(parts)


def marks(name: str) -> str:
    """Path of the named instants of a motion."""
    return f"{MARKS}/{name}"


def saturation(name: str, joint: str = "") -> str:
    """Path of the lanes that show the limits an arm is at, or of one joint's."""
    return rr.new_entity_path([SATURATION, name, *([joint] if joint else [])])


def switches(name: str, *below: str) -> str:
    """Path of the places on the trail where limits are reached or left."""
    return arm(name, "switches", *below)


def tool_curve(quantity: str, name: str = "") -> str:
    """Path of the curves of the tool's speed or force, or of progress; or of one arm's."""
    return "/".join(["plots", quantity, *([name] if name else [])])


def variable(name: str) -> str:
    """Path of the curves of a variable of an optimal-control problem."""
    return rr.new_entity_path(["plots", name])
