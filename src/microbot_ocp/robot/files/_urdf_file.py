"""URDF and SRDF files as data, with every number checked by name.

URDF: https://wiki.ros.org/urdf/XML, with its defaults, versions 1.0 to 1.2 as in urdfdom 6; missing
mandatory entries are filled in, with a remark. SRDF: http://wiki.ros.org/srdf, MoveIt's description
of a robot beside its URDF; the reader takes the chains of groups, named states, and pairs of links
with disabled collisions, and ignores planning groups. ``ELEMENTS`` lists the parts of a URDF that
are read and those that do not affect the motion; any other part is ignored with a remark.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming
from microbot_ocp._base.reading import bytes_of
from microbot_ocp.limits import JOINT_QUANTITIES
from microbot_ocp.robot._shapes import ROLES, SIZES, Role, Shape
from microbot_ocp.robot._transforms import (
    ROUNDED,
    of_quaternion,
    rotation_of,
    transform_of,
    without_rounding,
)
from microbot_ocp.robot.files._ros_files import find_mesh
from microbot_ocp.robot.files._xml import Remarks, read_xml

EXTENSION = "microbot_ocp"
ACCELERATION = "drake:acceleration"  # attribute of <limit> in Drake's extension of the format
MOVING = ("revolute", "continuous", "prismatic")
UNSUPPORTED = ("planar", "floating", "spherical")  # joints that a serial chain cannot have
# Keys of a joint's extension element: rotor inertia, and limits that <limit> cannot express.
RANGES = tuple(key for key in JOINT_QUANTITIES if key != "q")
EXTRA_KEYS = ("armature", *(f"{quantity}_{side}" for quantity in RANGES for side in ("min", "max")))
# Prefixes of attributes and elements that do not affect the motion.
PREFIXES = ("xmlns", "sensor", "controller")
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
VERSIONS = ("1.0", "1.1", "1.2")
# Attributes and children of each element: those that are read, and those that do not affect the
# motion of an arm, some only with the value after "=". A remark names all others.
ELEMENTS = {
    "robot": (
        f"name version link joint gazebo transmission mujoco {EXTENSION}",
        "material sensor ros2_control drake:collision_filter_group",
    ),
    "link": (
        "name inertial collision contact",
        "type visual surface self_filter collision_checking self_collision_checking "
        "kinematic=0 gravity=1",
    ),
    "inertial": ("origin mass inertia", ""),
    "mass": ("value", ""),
    "inertia": (" ".join(MOMENTS), ""),
    "collision": (
        "name origin geometry",
        "material verbose contact_coefficients drake:proximity_properties",
    ),
    "contact": (  # an element of Bullet
        "",
        "lateral_friction rolling_friction spinning_friction restitution stiffness damping "
        "contact_cfm contact_erp friction_anchor",
    ),
    "origin": ("xyz rpy quat_xyzw", ""),
    "geometry": (" ".join(SIZES), "name"),
    "box": ("size", ""),
    **{kind: (" ".join(SIZES[kind]), "") for kind in ("sphere", "cylinder", "capsule")},
    "mesh": ("filename scale", "drake:declare_convex"),
    "joint": (
        f"name type origin parent child axis limit dynamics mimic safety_controller {EXTENSION} ",
        "calibration dont_collapse hardwareInterface",
    ),
    "parent": ("link", ""),
    "child": ("link", ""),
    "axis": ("xyz", ""),
    "limit": (f"lower upper effort velocity acceleration deceleration jerk {ACCELERATION}", ""),
    "dynamics": ("damping friction", "D=0 K=0 mu_coulomb=0 mu_viscous=0 spring_stiffness=0"),
    "mimic": ("joint multiplier offset", ""),
    "safety_controller": ("soft_lower_limit soft_upper_limit", "k_position k_velocity"),
    "transmission": (
        "name type actuator",
        "joint plugin mechanicalReduction robotNamespace leftActuator rightActuator flexJoint "
        "rollJoint gap_joint passive_joint use_simulated_gripper_joint",
    ),
    "actuator": (
        "name",
        "role hardwareInterface mechanicalReduction mechanical_reduction encoderReduction "
        "motorTorqueConstant",
    ),
    "gazebo": (
        "reference",
        "material visual sensor plugin camera ray contact collision mu1 mu2 fdir1 kp kd slip1 "
        "slip2 torsionalFriction maxVel minDepth maxContacts laserRetro selfCollide self_collide "
        "provideFeedback fudgeFactor stopKp stopKd stopCfm stopErp cfmDamping canonicalBody "
        "implicitSpringDamper initial_joint_position preserveFixedJoint disableFixedJointLumping "
        "dampingFactor=0 springStiffness=0 springReference=0 velocityDecay=0 kinematic=0 "
        "static=0 enable_wind=0 turnGravityOff=0 gravity=1",
    ),
    "mujoco": ("", "compiler size visual"),
}
SRDF = {
    "robot": (
        "name version group group_state disable_collisions",
        "virtual_joint end_effector joint_property",
    ),
}


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
    """A joint; attributes that its type does not have keep their defaults."""

    name: str
    type: str
    parent: str
    child: str
    frame: FloatArray  # transform [4,4] to the parent
    axis: FloatArray = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))  # unit vector
    # Lower and upper limits by the keys of JOINT_QUANTITIES, all of those that are finite.
    limits: dict[str, tuple[float, float]] = field(default_factory=dict)
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    leader: str | None = None  # name of the joint that this one mimics
    multiplier: float = 1.0
    offset: float = 0.0

    @property
    def moves(self) -> bool:
        """True if the joint can be part of a chain."""
        return self.type in MOVING

    def limit(self, quantity: str) -> tuple[float, float]:
        """Return the lower and upper limit of a quantity, infinite if there is none."""
        return self.limits.get(quantity, (-math.inf, math.inf))


@dataclass(frozen=True, eq=False)
class UrdfFile:
    """Content of a URDF file."""

    name: str
    links: dict[str, UrdfLink]
    joints: dict[str, UrdfJoint]
    gravity: list[float]
    description: str


def urdf_file(root: Element, origin: str, folder: Path | None, remarks: Remarks) -> UrdfFile:
    """Return the file with the root element ``root``; ``folder`` is the start of mesh searches."""
    if root.tag != "robot":
        raise InputError(f"it is not a URDF: its root is <{root.tag}>, not <robot>")
    about = dict(_part(root, EXTENSION).attrib)
    for key in about:
        checks.one_of(f"<{EXTENSION}>", key, ("gravity", "description"))
    remark_unread(root, ELEMENTS, remarks, "the file")
    version = root.get("version", VERSIONS[0])
    if version not in VERSIONS:
        remarks.add(f"version {version!r} of URDF is unknown: it is read as {VERSIONS[-1]}")
    elif version == VERSIONS[0] and next(root.iterfind(".//origin[@quat_xyzw]"), None) is not None:
        remarks.add("quat_xyzw is read as of version 1.1, where version 1.0 has only rpy")
    reader = _Reader(root, folder, remarks)
    links = {name: reader.link(element, name) for name, element in _named(root, "link").items()}
    joints = {name: reader.joint(e, name) for name, e in _named(root, "joint").items()}
    gravity = numbers_from("gravity", about.get("gravity", "0 0 -9.81"))
    name = root.get("name") or Path(origin).stem
    return UrdfFile(name, links, joints, gravity, about.get("description", ""))


def remark_unread(
    element: Element, table: Mapping[str, tuple[str, str]], remarks: Remarks, owner: str
) -> None:
    """Add a remark for each part of an element that the table does not list."""
    read, harmless = (names.split() for names in table[element.tag])
    parts = [(key, key, value) for key, value in element.attrib.items()]
    parts += [(part.tag, f"<{part.tag}>", part.text or part.get("value", "")) for part in element]
    for key, text, value in parts:
        known = {key, f"{key}={_plain(value)}"} & {*read, *harmless}
        if not known and key.partition(":")[0] not in PREFIXES:
            kind = "parts that may affect the motion or its limits are not read"
            remarks.add(kind, f"{text} of {owner}")
    for part in element:
        if part.tag in read and part.tag in table:
            name = part.get("name", part.get("reference"))
            inner = f"{part.tag} {name!r}" if name else f"<{part.tag}> of {owner}"
            remark_unread(part, table, remarks, inner)


def _plain(value: str) -> str:
    """Return a number or truth value in the notation of ``ELEMENTS``: 0, 1."""
    text = value.strip().lower()
    try:
        return f"{float(text):g}"
    except ValueError:
        return {"false": "0", "true": "1"}.get(text, text)


def _named(root: Element, kind: str) -> dict[str, Element]:
    elements: dict[str, Element] = {}
    for element in root.findall(kind):
        name = element.get("name")
        if not name or name in elements:
            fault = f"two {kind}s named {name!r}" if name else f"a {kind} without a name"
            raise InputError(f"it has {fault}")
        elements[name] = element
    return elements


def _part(element: Element, kind: str) -> Element:
    """Return the first child of a kind; an element without attributes if there is none."""
    part = element.find(kind)
    return Element(kind) if part is None else part


def number_from(label: str, text: str) -> float:
    """Return the number in ``text``, which may be infinite or NaN."""
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
    """Return an attribute, which must be a finite number or equal to its default."""
    label = f"{key} of {label}"
    value = number_from(label, element.get(key, repr(default)))
    return value if value == default else checks.number(label, value, at_least=at_least)


def numbers_from(label: str, text: str) -> list[float]:
    """Return the numbers in a text."""
    return [number_from(label, entry) for entry in text.split()]


def _vector(element: Element, key: str, label: str, default: str, count: int = 3) -> FloatArray:
    return checks.array(label, numbers_from(label, element.get(key, default)), (count,))


def _frame(element: Element, label: str) -> FloatArray:
    """Return the transform [4,4] of an element's <origin>; the identity without one."""
    origin = _part(element, "origin")
    if "quat_xyzw" in origin.attrib:
        if "rpy" in origin.attrib:
            raise InputError(f"{label} must have rpy or quat_xyzw, not both")
        x, y, z, w = _vector(origin, "quat_xyzw", f"quat_xyzw of the {label}", "", 4)
        if not (x or y or z or w):
            raise InputError(f"quat_xyzw of the {label} must be a quaternion, not zero")
        rotation = of_quaternion(np.array([w, x, y, z]))
    else:
        rotation = rotation_of(_vector(origin, "rpy", label, "0 0 0"))
    return without_rounding(transform_of(rotation, _vector(origin, "xyz", label, "0 0 0")))


class _Reader:
    """A reader of the links and joints of a file, with remarks on missing and ignored data."""

    def __init__(self, root: Element, folder: Path | None, remarks: Remarks) -> None:
        self.folder, self.remarks = folder, remarks
        # Red, green, blue and opacity of each material.
        self.colors: dict[str, tuple[float, ...]] = {}
        for material in root.findall("material"):
            try:
                if color := self._color(material):
                    self.colors[material.get("name", "")] = color
            except InputError as problem:
                remarks.add("materials that cannot be read are left out", str(problem))

    def link(self, element: Element, name: str) -> UrdfLink:
        """Return a link, without geometry that cannot be read."""
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
        if kind not in (*MOVING, *UNSUPPORTED, "fixed"):
            readable = ", ".join((*MOVING, *UNSUPPORTED))
            raise InputError(f"{label} is {kind}: only {readable} and fixed joints can be read")
        ends = [_part(element, role).get("link", "") for role in ("parent", "child")]
        frame = _frame(element, f"origin of {label}")
        if kind not in MOVING:
            return UrdfJoint(name, kind, *ends, frame=frame)
        extra, mimic = _part(element, EXTENSION), _part(element, "mimic")
        for key in extra.attrib:
            checks.one_of(f"<{EXTENSION}> of {label}", key, EXTRA_KEYS)
        dynamics, limit = _part(element, "dynamics"), _part(element, "limit")
        sizes = dict.fromkeys(RANGES, math.inf) | {
            "qd": self._bound(limit, "velocity", label),
            "tau": self._bound(limit, "effort", label),
            "qdd": self._acceleration(limit, label),
            "qddd": self._bound(limit, "jerk", label),
        }
        limits = {
            key: (
                _finite(extra, f"{key}_min", label, -size),
                _finite(extra, f"{key}_max", label, size),
            )
            for key, size in sizes.items()
        }
        limits["q"] = lower, upper = self._range(limit, kind, name)
        safety = _part(element, "safety_controller")
        soft_lower = _finite(safety, "soft_lower_limit", label, lower)
        soft_upper = _finite(safety, "soft_upper_limit", label, upper)
        if kind != "continuous" and (soft_lower > lower or soft_upper < upper):
            words = "soft limits, tighter than the limits of a joint, are left out"
            self.remarks.add(words, f"[{soft_lower:g}, {soft_upper:g}] of {label}")
        return UrdfJoint(
            name,
            kind,
            *ends,
            frame=frame,
            axis=self._axis(element, name),
            limits=limits,
            damping=_finite(dynamics, "damping", label, at_least=0.0),
            friction=_finite(dynamics, "friction", label, at_least=0.0),
            armature=_finite(extra, "armature", label, at_least=0.0),
            leader=None if element.find("mimic") is None else mimic.get("joint", ""),
            multiplier=_finite(mimic, "multiplier", f"the mimic of {label}", 1.0),
            offset=_finite(mimic, "offset", f"the mimic of {label}"),
        )

    def _axis(self, joint: Element, name: str) -> FloatArray:
        """Return the unit axis [3] of a moving joint in its own frame."""
        axis = _vector(_part(joint, "axis"), "xyz", f"axis of joint {name!r}", "1 0 0")
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            raise InputError(
                f"axis of joint {name!r} must be a unit vector, not {axis.tolist()} of length 0"
            )
        if abs(length - 1) > ROUNDED:
            item = f"of joint {name!r}, of length {length:.6g}"
            self.remarks.add("axes are scaled to unit vectors", item)
        return axis / length

    def _bound(self, limit: Element, key: str, label: str) -> float:
        """Return a bound of speed, effort or acceleration; infinite if missing or 0."""
        if number_from(f"{key} of {label}", limit.get(key, "inf")) == math.inf:
            return math.inf
        bound = _finite(limit, key, label, at_least=0.0)
        if bound == 0.0:
            kind = "limits of 0 are read as not stated: there is no such limit"
            self.remarks.add(kind, f"{key} of {label}")
        return bound or math.inf

    def _acceleration(self, limit: Element, label: str) -> float:
        """Return the smallest bound of acceleration and deceleration."""
        keys = [
            key for key in ("acceleration", "deceleration", ACCELERATION) if key in limit.attrib
        ]
        bounds = [self._bound(limit, key, label) for key in keys]
        if len({*bounds}) > 1:
            kind = "the smallest of several acceleration limits holds in both directions"
            self.remarks.add(kind, label)
        return min(bounds, default=math.inf)

    def _range(self, limit: Element, kind: str, name: str) -> tuple[float, float]:
        """Return the lower and upper position of a joint, rad or m."""
        if kind == "continuous":
            return -math.inf, math.inf
        if not limit.attrib.keys() & {"lower", "upper"}:
            words = "joints without lower and upper limit are read as unlimited"
            self.remarks.add(words, repr(name))
            return -math.inf, math.inf
        sides = []
        for side in ("lower", "upper"):
            label = f"{side} limit of joint {name!r}"
            sides.append(number_from(label, limit.get(side, "0")))  # the default of URDF
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
    """Data of an SRDF file for a robot.

    Attributes
    ----------
    tips : dict
        Last link of the chain of each group; groups without a chain are left out.
    states : tuple
        Names of states, each with positions by joint, rad or m.
    disabled : tuple
        Pairs of links that may touch, each in alphabetical order.
    """

    tips: dict[str, str]
    states: tuple[tuple[str, dict[str, float]], ...]
    disabled: tuple[tuple[str, str], ...]


def read_srdf(path: str | Path) -> SrdfFile:
    """Read an SRDF file.

    Raises
    ------
    InputError
        The file cannot be read or is no SRDF, a name is missing, or a value is no number.
    """
    name, remarks = Path(path).name, Remarks()
    with naming(f"{name}: "):
        content = _content(read_xml(bytes_of(path, "SRDF file"), remarks), remarks)
    remarks.warn(name)
    return content


def _content(root: Element, remarks: Remarks) -> SrdfFile:
    if root.tag != "robot":
        raise InputError(f"it is not an SRDF: its root is <{root.tag}>, not <robot>")
    remark_unread(root, SRDF, remarks, "the SRDF")
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
