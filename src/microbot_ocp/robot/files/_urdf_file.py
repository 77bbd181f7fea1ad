"""A URDF file as data: its links and joints as they stand there, every number checked by name.

Format: https://wiki.ros.org/urdf/XML. Defaults are those of the format; what the format demands but
files leave out all the same is filled in with a remark.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.limits import JOINT_QUANTITIES
from microbot_ocp.robot._shapes import ROLES, SIZES, Role, Shape
from microbot_ocp.robot._transforms import rotation_of
from microbot_ocp.robot.files._mesh_files import find_mesh
from microbot_ocp.robot.files._remarks import Remarks

EXTENSION = "microbot_ocp"
ACCELERATION = "drake:acceleration"  # attribute of <limit> by which Drake extends the format
MOVING = ("revolute", "continuous", "prismatic")
HELD = ("planar", "floating", "spherical")  # a serial chain has no such joints
# What a joint's extension element may hold: rotor inertia, and limits that <limit> has no room for.
RANGES = tuple(key for key in JOINT_QUANTITIES if key != "q")
EXTRA_KEYS = ("armature", *(f"{quantity}_{side}" for quantity in RANGES for side in ("min", "max")))
Colors = dict[str | None, tuple[float, ...]]  # name of a material -> red, green, blue, opacity
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

    name: str
    inertial: Inertial | None
    shapes: tuple[Shape, ...]


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
    extension = root.find(EXTENSION)
    about = {} if extension is None else dict(extension.attrib)
    for key in about:
        checks.one_of(f"<{EXTENSION}>", key, ("gravity", "description"))
    colors: Colors = {}
    for material in root.findall("material"):
        try:
            if color := _color(material, {}):
                colors[material.get("name")] = color
        except InputError as problem:
            remarks.add("materials that cannot be read are left out", str(problem))
    links = {
        name: UrdfLink(
            name,
            _inertial(element, name, remarks),
            tuple(_shapes(element, name, colors, folder, remarks)),
        )
        for name, element in _named(root, "link").items()
    }
    joints = {name: _joint(e, name, remarks) for name, e in _named(root, "joint").items()}
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
    element: Element | None,
    key: str,
    label: str,
    default: float = 0.0,
    at_least: float | None = None,
) -> float:
    text = None if element is None else element.get(key)
    label = f"{key} of {label}"
    return (
        default
        if text is None
        else checks.number(label, number_from(label, text), at_least=at_least)
    )


def numbers_from(label: str, text: str) -> list[float]:
    """Return the numbers that stand in a text."""
    return [number_from(label, entry) for entry in text.split()]


def _vector(element: Element, key: str, label: str, default: str, count: int = 3) -> FloatArray:
    return checks.array(label, numbers_from(label, element.get(key, default)), (count,))


def _frame(element: Element, label: str) -> FloatArray:
    """Return the transform [4,4] of an element's <origin>; the identity without one."""
    frame, origin = np.eye(4), element.find("origin")
    if origin is None:
        return frame
    frame[:3, :3] = rotation_of(_vector(origin, "rpy", label, "0 0 0"))
    frame[:3, 3] = _vector(origin, "xyz", label, "0 0 0")
    return np.where(np.abs(frame) < 1e-15, 0.0, frame)  # without the dust of right angles


def _inertial(link: Element, name: str, remarks: Remarks) -> Inertial | None:
    element = link.find("inertial")
    if element is None:
        return None
    label = f"link {name!r}"
    mass, tensor = element.find("mass"), element.find("inertia")
    if mass is None or "value" not in mass.attrib:
        raise InputError(f"mass of {label} lacks value")
    value = _finite(mass, "value", f"the mass of {label}", at_least=0.0)
    inertia = np.zeros((3, 3))
    if tensor is None:
        if value:
            remarks.add("links with a mass but no inertia are read as point masses", repr(name))
    else:
        missing = [key for key in MOMENTS if key not in tensor.attrib]
        if missing:
            raise InputError(f"inertia of {label} lacks {', '.join(missing)}")
        xx, xy, xz, yy, yz, zz = (
            _finite(tensor, key, f"the inertia of {label}") for key in MOMENTS
        )
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return Inertial(value, inertia, _frame(element, f"inertial origin of {label}"))


def _joint(element: Element, name: str, remarks: Remarks) -> UrdfJoint:
    label = f"joint {name!r}"
    kind = element.get("type")
    if kind not in (*MOVING, *HELD, "fixed"):
        raise InputError(
            f"{label} is {kind}: only {', '.join((*MOVING, *HELD))} and fixed joints can be read"
        )
    ends = [
        "" if (end := element.find(role)) is None else end.get("link", "")
        for role in ("parent", "child")
    ]
    frame = _frame(element, f"origin of {label}")
    if kind not in MOVING:
        return UrdfJoint(name, kind, *ends, frame=frame)
    extension, mimic = element.find(EXTENSION), element.find("mimic")
    extra = {} if extension is None else dict(extension.attrib)
    for key in extra:
        checks.one_of(f"<{EXTENSION}> of {label}", key, EXTRA_KEYS)
    dynamics, limit = element.find("dynamics"), element.find("limit")
    lower, upper = _range(limit, kind, name, remarks)
    return UrdfJoint(
        name,
        kind,
        *ends,
        frame=frame,
        axis=_axis(element, name, remarks),
        lower=lower,
        upper=upper,
        velocity=_bound(limit, "velocity", label, remarks),
        effort=_bound(limit, "effort", label, remarks),
        acceleration=_bound(limit, ACCELERATION, label, remarks),
        damping=_finite(dynamics, "damping", label, at_least=0.0),
        friction=_finite(dynamics, "friction", label, at_least=0.0),
        leader=None if mimic is None else mimic.get("joint", ""),
        multiplier=_finite(mimic, "multiplier", f"the mimic of {label}", 1.0),
        offset=_finite(mimic, "offset", f"the mimic of {label}"),
        extra=extra,
    )


def _axis(joint: Element, name: str, remarks: Remarks) -> FloatArray:
    """Return unit axis [3] of a moving joint in its own frame."""
    element = joint.find("axis")
    given = Element("axis") if element is None else element
    axis = _vector(given, "xyz", f"axis of joint {name!r}", "1 0 0")
    length = float(np.linalg.norm(axis))
    if length < 1e-6:
        raise InputError(
            f"axis of joint {name!r} must be a unit vector, not {axis.tolist()} of length "
            f"{length:.6g}"
        )
    if abs(length - 1) > 1e-3:  # a unit vector written with four digits is within 1e-4 of one
        remarks.add("axes are scaled to unit vectors", f"of joint {name!r}, of length {length:.6g}")
    return axis / length


def _bound(limit: Element | None, key: str, label: str, remarks: Remarks) -> float:
    """Return a bound of speed, effort or acceleration; infinite without one, which files write
    as 0.
    """
    text = None if limit is None else limit.get(key)
    if text is None or number_from(f"{key} of {label}", text) == math.inf:
        return math.inf
    bound = _finite(limit, key, label, at_least=0.0)
    if bound == 0.0:
        remarks.add(
            "limits of 0 are read as not stated: there is no such limit", f"{key} of {label}"
        )
    return bound or math.inf


def _range(limit: Element | None, kind: str, name: str, remarks: Remarks) -> tuple[float, float]:
    """Return lower and upper position of a joint, rad or m."""
    if kind == "continuous":
        return -math.inf, math.inf
    given = {} if limit is None else limit.attrib
    if not given.keys() & {"lower", "upper"}:
        remarks.add("joints without lower and upper limit are read as unlimited", repr(name))
        return -math.inf, math.inf
    sides = []
    for side in ("lower", "upper"):
        label = f"{side} limit of joint {name!r}"
        sides.append(number_from(label, given.get(side, "0")))  # as URDF has it
        if math.isnan(sides[-1]):
            raise InputError(f"{label} must be a number, not nan")
    return sides[0], sides[1]


def _shapes(
    link: Element, name: str, colors: Colors, folder: Path | None, remarks: Remarks
) -> list[Shape]:
    """Return the geometry of a link that can be read; what cannot is remarked and left out."""
    shapes = []
    for role in ROLES:
        for element in link.findall(role):
            try:
                shapes.append(_shape(element, role, name, colors, folder, remarks))
            except InputError as problem:
                remarks.add("geometry that cannot be read is left out", str(problem))
    return shapes


def _shape(
    element: Element,
    role: Role,
    name: str,
    colors: Colors,
    folder: Path | None,
    remarks: Remarks,
) -> Shape:
    label = f"{role} geometry of link {name!r}"
    given = next((child for child in element.iterfind("geometry/*") if child.tag in SIZES), None)
    if given is None:
        raise InputError(f"{label} must be one of {', '.join(SIZES)}")
    path = ""
    if given.tag == "mesh":
        path = find_mesh(given.get("filename", ""), folder, remarks)
    return Shape(
        frame=0,
        pose=_frame(element, f"origin of the {label}"),
        kind=given.tag,
        size=np.array(_size(given, label)),
        role=role,
        link=name,
        path=path,
        color=_color(element.find("material"), colors),
    )


def _size(element: Element, label: str) -> list[float]:
    """Return the size of a shape, in the order of ``SIZES``."""
    if element.tag == "mesh":
        values = numbers_from(f"scale of the {label}", element.get("scale", "1 1 1"))
        return values * 3 if len(values) == 1 else values
    if element.tag == "box":
        return numbers_from(f"size of the {label}", element.get("size", ""))
    names = SIZES[element.tag]
    return [number_from(f"{name} of the {label}", element.get(name, "")) for name in names]


def _color(material: Element | None, colors: Colors) -> tuple[float, ...] | None:
    if material is None:
        return None
    color = material.find("color")
    if color is None:
        return colors.get(material.get("name"))
    label = f"color of material {material.get('name')!r}"
    return tuple(_vector(color, "rgba", label, "", 4).tolist())
