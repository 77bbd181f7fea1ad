"""URDF and SRDF files as data: what stands there, every number checked by name.

Formats: https://wiki.ros.org/urdf/XML, with its defaults; what the format demands but files leave
out all the same is filled in with a remark. http://wiki.ros.org/srdf is what MoveIt says of a robot
beside its URDF: read are the chains of groups, named states, and the pairs of links whose
collisions are disabled; what is about planning groups alone has no place in a robot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming
from microbot_ocp._base.reading import bytes_of
from microbot_ocp.limits import JOINT_QUANTITIES
from microbot_ocp.robot._shapes import ROLES, SIZES, Role, Shape
from microbot_ocp.robot._transforms import rotation_of, transform_of, without_dust
from microbot_ocp.robot.files._ros_files import find_mesh
from microbot_ocp.robot.files._xml import Remarks, read_xml

EXTENSION = "microbot_ocp"
ACCELERATION = "drake:acceleration"  # attribute of <limit> by which Drake extends the format
MOVING = ("revolute", "continuous", "prismatic")
HELD = ("planar", "floating", "spherical")  # a serial chain has no such joints
# What a joint's extension element may hold: rotor inertia, and limits that <limit> has no room for.
RANGES = tuple(key for key in JOINT_QUANTITIES if key != "q")
EXTRA_KEYS = ("armature", *(f"{quantity}_{side}" for quantity in RANGES for side in ("min", "max")))
UNREAD = ("disable_default_collisions", "enable_collisions", "link_sphere_approximation")  # of SRDF
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass, kg, and inertia [3,3] about the centre of mass, kg m^2, in a ``frame`` [4,4]."""

    mass: float
    inertia: FloatArray
    frame: FloatArray


@dataclass(frozen=True, eq=False)
class UrdfLink:
    """A link: its mass properties, and its geometry in its own frame."""

    inertial: Inertial | None = None
    shapes: tuple[Shape, ...] = ()


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A joint; what does not belong to its type is left at its default."""

    name: str
    type: str
    parent: str
    child: str
    frame: FloatArray  # [4,4] in the parent
    axis: FloatArray = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))  # unit vector
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    effort: float = math.inf
    acceleration: float = math.inf
    damping: float = 0.0
    friction: float = 0.0
    leader: str | None = None  # joint that it mimics
    multiplier: float = 1.0
    offset: float = 0.0
    extra: dict[str, str] = field(default_factory=dict)

    @property
    def moves(self) -> bool:
        """Whether a chain may have it as one of its joints."""
        return self.type in MOVING


@dataclass(frozen=True, eq=False)
class UrdfFile:
    """All of a file."""

    name: str
    links: dict[str, UrdfLink]
    joints: dict[str, UrdfJoint]
    gravity: list[float]
    description: str


def urdf_file(root: Element, origin: str, folder: Path | None, remarks: Remarks) -> UrdfFile:
    """Return the file whose root element is ``root``; meshes are looked for from ``folder``."""
    if root.tag != "robot":
        raise InputError(f"it is not a URDF: its root is <{root.tag}>, not <robot>")
    about = dict(_part(root, EXTENSION).attrib)
    for key in about:
        checks.one_of(f"<{EXTENSION}>", key, ("gravity", "description"))
    reader = _Reader(root, folder, remarks)
    links = {name: reader.link(element, name) for name, element in _named(root, "link").items()}
    joints = {name: reader.joint(e, name) for name, e in _named(root, "joint").items()}
    gravity = numbers_from("gravity", about.get("gravity", "0 0 -9.81"))
    name = root.get("name") or Path(origin).stem
    return UrdfFile(name, links, joints, gravity, about.get("description", ""))


def _named(root: Element, kind: str) -> dict[str, Element]:
    elements: dict[str, Element] = {}
    for element in root.findall(kind):
        name = element.get("name")
        if not name or name in elements:
            what = f"two {kind}s named {name!r}" if name else f"a {kind} without a name"
            raise InputError(f"it has {what}")
        elements[name] = element
    return elements


def _part(element: Element, kind: str) -> Element:
    """Return the first child of a kind; one without attributes where there is none."""
    part = element.find(kind)
    return Element(kind) if part is None else part


def number_from(label: str, text: str) -> float:
    """Return the number that ``text`` says; it may be infinite or NaN."""
    try:
        if "_" in text or not text.isascii():  # Python would read 1_0 as 10
            raise ValueError
        return float(text)
    except ValueError:
        advice = ": expand the xacro first" if "${" in text or "$(" in text else ""
        raise InputError(f"{label} must be a number, not {text!r}{advice}") from None


def _finite(
    element: Element, key: str, label: str, default: float = 0.0, at_least: float | None = None
) -> float:
    if key not in element.attrib:
        return default
    label = f"{key} of {label}"
    return checks.number(label, number_from(label, element.attrib[key]), at_least=at_least)


def numbers_from(label: str, text: str) -> list[float]:
    """Return the numbers that stand in a text."""
    return [number_from(label, entry) for entry in text.split()]


def _vector(element: Element, key: str, label: str, default: str, count: int = 3) -> FloatArray:
    return checks.array(label, numbers_from(label, element.get(key, default)), (count,))


def _frame(element: Element, label: str) -> FloatArray:
    """Return the transform [4,4] of an element's <origin>; the identity without one."""
    origin = _part(element, "origin")
    rotation = rotation_of(_vector(origin, "rpy", label, "0 0 0"))
    return without_dust(transform_of(rotation, _vector(origin, "xyz", label, "0 0 0")))


class _Reader:
    """The links and joints of a file; what is filled in or left out is remarked."""

    def __init__(self, root: Element, folder: Path | None, remarks: Remarks) -> None:
        self.folder, self.remarks = folder, remarks
        self.colors: dict[str, tuple[float, ...]] = {}  # red, green, blue, opacity by name
        for material in root.findall("material"):
            try:
                if color := self._color(material):
                    self.colors[material.get("name", "")] = color
            except InputError as problem:
                remarks.add("materials that cannot be read are left out", str(problem))

    def link(self, element: Element, name: str) -> UrdfLink:
        """Return a link; geometry that cannot be read is left out."""
        shapes = []
        for role in ROLES:
            for part in element.findall(role):
                try:
                    shapes.append(self._shape(part, role, name))
                except InputError as problem:
                    self.remarks.add("geometry that cannot be read is left out", str(problem))
        inertial = element.find("inertial")
        of = None if inertial is None else self._inertial(inertial, name)
        return UrdfLink(of, tuple(shapes))

    def _inertial(self, element: Element, name: str) -> Inertial:
        label = f"link {name!r}"
        mass, tensor = _part(element, "mass"), element.find("inertia")
        if "value" not in mass.attrib:
            raise InputError(f"mass of {label} lacks value")
        value = _finite(mass, "value", f"the mass of {label}", at_least=0.0)
        inertia = np.zeros((3, 3))
        if tensor is None:
            if value:
                kind = "links with a mass but no inertia are read as point masses"
                self.remarks.add(kind, repr(name))
        else:
            missing = [key for key in MOMENTS if key not in tensor.attrib]
            if missing:
                raise InputError(f"inertia of {label} lacks {', '.join(missing)}")
            upper = np.triu_indices(3)
            inertia[upper] = [_finite(tensor, k, f"the inertia of {label}") for k in MOMENTS]
            inertia.T[upper] = inertia[upper]
        return Inertial(value, inertia, _frame(element, f"inertial origin of {label}"))

    def joint(self, element: Element, name: str) -> UrdfJoint:
        """Return a joint."""
        label = f"joint {name!r}"
        kind = element.get("type")
        if kind not in (*MOVING, *HELD, "fixed"):
            readable = ", ".join((*MOVING, *HELD))
            raise InputError(f"{label} is {kind}: only {readable} and fixed joints can be read")
        ends = [_part(element, role).get("link", "") for role in ("parent", "child")]
        frame = _frame(element, f"origin of {label}")
        if kind not in MOVING:
            return UrdfJoint(name, kind, *ends, frame=frame)
        extra, mimic = dict(_part(element, EXTENSION).attrib), _part(element, "mimic")
        for key in extra:
            checks.one_of(f"<{EXTENSION}> of {label}", key, EXTRA_KEYS)
        dynamics, limit = _part(element, "dynamics"), _part(element, "limit")
        lower, upper = self._range(limit, kind, name)
        return UrdfJoint(
            name,
            kind,
            *ends,
            frame=frame,
            axis=self._axis(element, name),
            lower=lower,
            upper=upper,
            velocity=self._bound(limit, "velocity", label),
            effort=self._bound(limit, "effort", label),
            acceleration=self._bound(limit, ACCELERATION, label),
            damping=_finite(dynamics, "damping", label, at_least=0.0),
            friction=_finite(dynamics, "friction", label, at_least=0.0),
            leader=None if element.find("mimic") is None else mimic.get("joint", ""),
            multiplier=_finite(mimic, "multiplier", f"the mimic of {label}", 1.0),
            offset=_finite(mimic, "offset", f"the mimic of {label}"),
            extra=extra,
        )

    def _axis(self, joint: Element, name: str) -> FloatArray:
        """Return unit axis [3] of a moving joint in its own frame."""
        axis = _vector(_part(joint, "axis"), "xyz", f"axis of joint {name!r}", "1 0 0")
        length = float(np.linalg.norm(axis))
        if length < 1e-6:
            raise InputError(
                f"axis of joint {name!r} must be a unit vector, not {axis.tolist()} of length "
                f"{length:.6g}"
            )
        if abs(length - 1) > 1e-3:  # a unit vector written with four digits is within 1e-4 of one
            item = f"of joint {name!r}, of length {length:.6g}"
            self.remarks.add("axes are scaled to unit vectors", item)
        return axis / length

    def _bound(self, limit: Element, key: str, label: str) -> float:
        """Return a bound of speed, effort or acceleration; infinite without one, which files write
        as 0.
        """
        if number_from(f"{key} of {label}", limit.get(key, "inf")) == math.inf:
            return math.inf
        bound = _finite(limit, key, label, at_least=0.0)
        if bound == 0.0:
            kind = "limits of 0 are read as not stated: there is no such limit"
            self.remarks.add(kind, f"{key} of {label}")
        return bound or math.inf

    def _range(self, limit: Element, kind: str, name: str) -> tuple[float, float]:
        """Return lower and upper position of a joint, rad or m."""
        if kind == "continuous":
            return -math.inf, math.inf
        if not limit.attrib.keys() & {"lower", "upper"}:
            what = "joints without lower and upper limit are read as unlimited"
            self.remarks.add(what, repr(name))
            return -math.inf, math.inf
        sides = []
        for side in ("lower", "upper"):
            label = f"{side} limit of joint {name!r}"
            sides.append(number_from(label, limit.get(side, "0")))  # as URDF has it
            if math.isnan(sides[-1]):
                raise InputError(f"{label} must be a number, not nan")
        return sides[0], sides[1]

    def _shape(self, element: Element, role: Role, name: str) -> Shape:
        label = f"{role} geometry of link {name!r}"
        given = next((part for part in element.iterfind("geometry/*") if part.tag in SIZES), None)
        if given is None:
            raise InputError(f"{label} must be one of {', '.join(SIZES)}")
        path = ""
        if given.tag == "mesh":
            path = find_mesh(given.get("filename", ""), self.folder, self.remarks)
        pose, size = _frame(element, f"origin of the {label}"), np.array(_size(given, label))
        color = self._color(_part(element, "material"))
        return Shape(0, pose, given.tag, size, role, name, path, color)

    def _color(self, material: Element) -> tuple[float, ...] | None:
        color, name = material.find("color"), material.get("name")
        if color is None:
            return self.colors.get(name) if name else None
        return tuple(_vector(color, "rgba", f"color of material {name!r}", "", 4).tolist())


def _size(element: Element, label: str) -> list[float]:
    """Return the size of a shape, in the order of ``SIZES``."""
    if element.tag == "mesh":
        values = numbers_from(f"scale of the {label}", element.get("scale", "1 1 1"))
        return values * 3 if len(values) == 1 else values
    if element.tag == "box":
        return numbers_from(f"size of the {label}", element.get("size", ""))
    names = SIZES[element.tag]
    return [number_from(f"{name} of the {label}", element.get(name, "")) for name in names]


# SRDF ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SrdfFile:
    """All of a file that a robot can hold.

    Attributes
    ----------
    tips : group -> link at the end of its chain; groups without a chain are left out
    states : names, and their joint -> position, rad or m
    disabled : pairs of links that may touch, each in alphabetical order
    """

    tips: dict[str, str]
    states: tuple[tuple[str, dict[str, float]], ...]
    disabled: tuple[tuple[str, str], ...]


def read_srdf(path: str | Path) -> SrdfFile:
    """Read an SRDF file.

    Raises
    ------
    InputError
        A file that cannot be read or is no SRDF, a name that is missing, a value that is no number.
    """
    name, remarks = Path(path).name, Remarks()
    with naming(f"{name}: "):
        content = _content(read_xml(bytes_of(path, "SRDF file"), remarks), remarks)
    remarks.warn(name)
    return content


def _content(root: Element, remarks: Remarks) -> SrdfFile:
    if root.tag != "robot":
        raise InputError(f"it is not an SRDF: its root is <{root.tag}>, not <robot>")
    for kind in UNREAD:
        if root.find(kind) is not None:
            remarks.add("elements of the SRDF are left out", f"<{kind}>")
    tips, states = dict[str, str](), list[tuple[str, dict[str, float]]]()
    for group in root.findall("group"):
        if (chain := group.find("chain")) is not None:
            tips[_text(group, "name")] = _text(chain, "tip_link")
    for state in root.findall("group_state"):
        name = _text(state, "name")
        positions = {}
        for joint in state.findall("joint"):
            label = f"value of joint {_text(joint, 'name')!r} in the state {name!r}"
            value = number_from(label, _text(joint, "value").split()[0])
            positions[_text(joint, "name")] = checks.number(label, value)
        states.append((name, positions))
    pairs = {
        tuple(sorted((_text(pair, "link1"), _text(pair, "link2"))))
        for pair in root.findall("disable_collisions")
    }
    return SrdfFile(tips, tuple(states), tuple(sorted(pairs)))  # type: ignore[arg-type]


def _text(element: Element, key: str) -> str:
    text = element.get(key, "").strip()
    if not text:
        raise InputError(f"<{element.tag}> of the SRDF lacks {key}")
    return text
