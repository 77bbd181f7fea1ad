"""URDF files of robots."""

from __future__ import annotations

import math
from collections.abc import Iterable
from xml.etree import ElementTree

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.robot._links import Link
from microbot_ocp.robot._model import Robot
from microbot_ocp.robot._shapes import SIZES, Shape
from microbot_ocp.robot._transforms import dh_transform, fixed_angles
from microbot_ocp.robot.files._urdf_file import ACCELERATION, EXTENSION, MOMENTS, RANGES


def robot_to_urdf(robot: Robot) -> str:
    """Return the text of the URDF file of a robot, with equal poses, dynamics and geometry.

    The root link is ``base_link``, the last one ``tool``. Rotor inertia, gravity, and limits that
    URDF cannot express are in elements ``<microbot_ocp>``, which :func:`microbot_ocp.load_robot`
    reads and other programs ignore. Needs no extra.
    """
    if robot.rotors:
        raise InputError(
            f"robot {robot.name!r} has rotors, for which URDF has no place: write TOML, or put "
            "inertia times gear_ratio squared into armature"
        )
    root = ElementTree.Element("robot", name=robot.name)
    about = {"gravity": _vector(robot.gravity)}
    if robot.description:
        about["description"] = robot.description
    ElementTree.SubElement(root, EXTENSION, about)
    names = _link_names(robot)
    for index, name in enumerate(names):
        link = ElementTree.SubElement(root, "link", name=name)
        if robot.has_dynamics and 0 < index <= robot.link_count:
            _write_inertial(link, robot.links[index - 1])
        for shape in robot.shapes:
            if shape.frame == index:
                _write_shape(link, shape)
    chain = robot.chain
    for joint in range(robot.link_count):
        columns = (robot.alpha, robot.a, robot.d, robot.theta_offset, robot.beta)
        placement = dh_transform(*(column[joint] for column in columns))
        if joint == 0:
            placement = robot.base @ placement
        element = _write_joint(root, chain.joint_names[joint], names[joint : joint + 2], placement)
        _write_moving(element, chain, joint)
        if follows := robot.mimic.get(chain.joint_names[joint]):
            driver, factor, offset = follows
            about = {"joint": driver, "multiplier": repr(factor), "offset": repr(offset)}
            ElementTree.SubElement(element, "mimic", about)
    name = _unused("tool_joint", chain.joint_names)
    _write_joint(root, name, names[-2:], robot.tool).set("type", "fixed")
    if any(ACCELERATION in limit.attrib for limit in root.iter("limit")):
        root.set("xmlns:drake", "http://drake.mit.edu")
    ElementTree.indent(root)
    text = ElementTree.tostring(root, "unicode")
    try:
        ElementTree.fromstring(text)
    except ElementTree.ParseError as problem:  # XML excludes most control characters
        raise InputError(
            f"robot {robot.name!r} cannot be written as XML: {problem}; look at its names or "
            "description"
        ) from None
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'


def _unused(name: str, taken: Iterable[str]) -> str:
    taken = set(taken)
    while name in taken:
        name += "_"
    return name


def _link_names(robot: Robot) -> list[str]:
    """Return names of links, all different: base_link, one per joint, tool."""
    names = ["base_link"]
    for joint, joint_name in enumerate(robot.chain.joint_names):
        link = robot.links[joint].name if robot.has_dynamics else None
        names.append(_unused(link if link and link != joint_name else f"{joint_name}_link", names))
    return [*names, _unused("tool", names)]


def _vector(values: FloatArray) -> str:
    return " ".join(repr(float(value)) for value in values)


def _write_inertial(element: ElementTree.Element, link: Link) -> None:
    inertial = ElementTree.SubElement(element, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_vector(link.center_of_mass), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=repr(link.mass))
    upper = map(repr, link.inertia[np.triu_indices(3)].tolist())
    ElementTree.SubElement(inertial, "inertia", dict(zip(MOMENTS, upper, strict=True)))


def _write_shape(link: ElementTree.Element, shape: Shape) -> None:
    element = ElementTree.SubElement(link, shape.role)
    _write_origin(element, shape.pose)
    geometry = ElementTree.SubElement(element, "geometry")
    if shape.kind == "mesh":
        given = {"filename": shape.path, "scale": _vector(shape.size)}
    elif shape.kind == "box":
        given = {"size": _vector(shape.size)}
    else:
        given = dict(zip(SIZES[shape.kind], map(repr, shape.size.tolist()), strict=True))
    ElementTree.SubElement(geometry, shape.kind, given)
    if shape.color is not None:
        material = ElementTree.SubElement(element, "material", name="")
        ElementTree.SubElement(material, "color", rgba=_vector(np.array(shape.color)))


def _write_origin(element: ElementTree.Element, placement: FloatArray) -> None:
    rpy = _vector(fixed_angles(placement[:3, :3]))
    ElementTree.SubElement(element, "origin", xyz=_vector(placement[:3, 3]), rpy=rpy)


def _write_joint(
    root: ElementTree.Element, name: str, links: list[str], placement: FloatArray
) -> ElementTree.Element:
    joint = ElementTree.SubElement(root, "joint", name=name)
    ElementTree.SubElement(joint, "parent", link=links[0])
    ElementTree.SubElement(joint, "child", link=links[1])
    _write_origin(joint, placement)
    return joint


def _write_moving(element: ElementTree.Element, robot: Robot, joint: int) -> None:
    """Write type, axis, limits, friction and extension of a moving joint."""
    prismatic = robot.joint_types[joint] == "prismatic"
    q_min, q_max = (float(bound[joint]) for bound in robot.limits.bounds("q"))
    unlimited = math.isinf(q_min) and math.isinf(q_max)
    turning = "continuous" if unlimited else "revolute"
    element.set("type", "prismatic" if prismatic else turning)
    ElementTree.SubElement(element, "axis", xyz="0 0 1")
    limit, extra = dict[str, str](), dict[str, str]()
    if prismatic or not unlimited:
        limit = {"lower": repr(q_min), "upper": repr(q_max)}
    for quantity in RANGES:
        key = {"qd": "velocity", "tau": "effort", "qdd": ACCELERATION}.get(quantity, "")
        lower, upper = (float(bound[joint]) for bound in robot.limits.bounds(quantity))
        size = max(-lower, upper)
        if key and 0.0 < size < math.inf:  # other programs take 0 as unlimited
            limit[key] = repr(size)
        if (lower, upper) != ((-size, size) if limit.get(key) else (-math.inf, math.inf)):
            extra[f"{quantity}_min"], extra[f"{quantity}_max"] = repr(lower), repr(upper)
    if limit:
        ElementTree.SubElement(element, "limit", limit)
    if robot.has_dynamics:
        link = robot.links[joint]
        friction = {"damping": link.viscous_friction, "friction": link.coulomb_friction}
        if any(friction.values()):
            given = {key: repr(value) for key, value in friction.items()}
            ElementTree.SubElement(element, "dynamics", given)
        if link.armature:
            extra["armature"] = repr(link.armature)
    if extra:
        ElementTree.SubElement(element, EXTENSION, extra)
