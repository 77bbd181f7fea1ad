"""Files of acceleration limits in the formats of other planners."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.writing import write_whole
from microbot_ocp.robot import Robot
from microbot_ocp.robot.files import robot_to_urdf

FORMS = {"moveit": (".yaml", ".yml"), "curobo": (".yml", ".yaml"), "urdf": (".urdf",)}


def form_of(path: str | Path, form: str | None) -> str:
    """Return the format of a file: ``form`` if given, otherwise chosen by the file's ending."""
    ending = Path(path).suffix.lower()
    if form is None:
        form = "urdf" if ending == ".urdf" else "moveit"
    checks.one_of("form", form, FORMS)
    if ending not in FORMS[form]:
        raise InputError(f"a file for {form} must end in {' or '.join(FORMS[form])}, not {path}")
    return form


def write(
    path: str | Path,
    form: str,
    robot: Robot,
    speed: FloatArray,
    qdd_max: FloatArray,
    qddd_max: FloatArray | None,
    remark: str,
) -> Path:
    """Write limits of speed, acceleration and jerk [n] to a file; return its path."""
    if form == "urdf":
        limited = robot.with_limits(qd_max=speed)
        return write_whole(path, _urdf(limited, qdd_max, qddd_max))
    rows = [f"# {remark}"]
    if form == "moveit":
        rows.append("joint_limits:")
        for k, name in enumerate(robot.joint_names):
            rows += [f"  {_quoted(name)}:", "    has_velocity_limits: true"]
            rows += [f"    max_velocity: {float(speed[k])!r}", "    has_acceleration_limits: true"]
            rows.append(f"    max_acceleration: {float(qdd_max[k])!r}")
            rows.append(f"    has_jerk_limits: {'false' if qddd_max is None else 'true'}")
            rows += [] if qddd_max is None else [f"    max_jerk: {float(qddd_max[k])!r}"]
    else:
        rows += ["robot_cfg:", "  kinematics:", "    cspace:"]
        rows.append(f"      joint_names: [{', '.join(map(_quoted, robot.joint_names))}]")
        rows.append(f"      max_acceleration: {_numbers(qdd_max)}")
        rows += [] if qddd_max is None else [f"      max_jerk: {_numbers(qddd_max)}"]
    return write_whole(path, "\n".join(rows) + "\n")


def _urdf(robot: Robot, qdd_max: FloatArray, qddd_max: FloatArray | None) -> str:
    """Return the robot as URDF 1.2, which has attributes for limits of acceleration and jerk."""
    root = ElementTree.fromstring(robot_to_urdf(robot.with_limits(qdd_max=float("inf"))))
    root.set("version", "1.2")
    joints = {joint.get("name"): joint for joint in root.iter("joint")}
    for k, name in enumerate(robot.joint_names):
        if (limit := joints[name].find("limit")) is None:
            limit = ElementTree.SubElement(joints[name], "limit")
        limit.set("acceleration", repr(float(qdd_max[k])))
        if qddd_max is not None:
            limit.set("jerk", repr(float(qddd_max[k])))
    ElementTree.indent(root)
    text = ElementTree.tostring(root, "unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'


def _numbers(values: FloatArray) -> str:
    return f"[{', '.join(repr(value) for value in values.tolist())}]"


def _quoted(name: str) -> str:
    """Return a name in double quotes, with escapes that YAML and JSON share."""
    return json.dumps(name, ensure_ascii=False)
