"""Robots from URDF files (extra ``urdf``: read by yourdfpy).

A URDF places its joints freely; a :class:`~microbot_ocp.robot.Robot` has modified-DH rows. Reading
turns the chain from the root to one end into rows (see ``placement.py``), with a constant base
transform before them and the tool after, and expresses the masses in the new link frames. Links
that do not move against each other become one body.

URDF knows no rotor inertia, no limits of acceleration or torque rate, no one-sided limits and no
gravity. Writing puts these in elements ``<microbot_ocp>``, which other readers pass over.
"""

from __future__ import annotations

import io
import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.robot._limits import Limits
from microbot_ocp.robot._links import Link
from microbot_ocp.robot._model import Robot
from microbot_ocp.robot.files._placement import dh_rows

PARALLEL = 1e-8  # rad: what rounding to nine digits leaves between axes meant to be parallel
EXTENSION = "microbot_ocp"
MOVING = ("revolute", "continuous", "prismatic")
# What a joint's extension element may hold: rotor inertia, and limits that <limit> has no room for.
RANGES = ("qd", "qdd", "tau", "taud")
EXTRA_KEYS = ("armature", *(f"{quantity}_{side}" for quantity in RANGES for side in ("min", "max")))


@dataclass
class _Body:
    """Mass, first moment and inertia about the root's origin; bodies add up."""

    mass: float = 0.0
    first: FloatArray = field(default_factory=lambda: np.zeros(3))
    parts: list[tuple[float, FloatArray, FloatArray]] = field(default_factory=list)

    def add(self, link: Link, frame: FloatArray) -> None:
        """Add a link whose figures stand in ``frame`` [4,4] of the root."""
        rotation = frame[:3, :3]
        center = rotation @ link.center_of_mass + frame[:3, 3]
        self.mass += link.mass
        self.first = self.first + link.mass * center
        self.parts.append((link.mass, center, rotation @ link.inertia @ rotation.T))

    def as_link(self, frame: FloatArray, **joint: Any) -> Link:
        """The same body in the link frame ``frame`` [4,4] of the root."""
        center = self.first / self.mass
        about_center = np.zeros((3, 3))
        for mass, place, inertia in self.parts:
            arm = place - center
            about_center += inertia + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        rotation = frame[:3, :3]
        turned = rotation.T @ about_center @ rotation
        return Link(
            mass=self.mass,
            center_of_mass=rotation.T @ (center - frame[:3, 3]),
            inertia=(turned + turned.T) / 2,
            **joint,
        )


def read_urdf(
    path: str | Path, tip: str | None = None, *, parallel_tolerance: float = PARALLEL
) -> Robot:
    """Read the chain from the root of a URDF file to one of its links.

    Joint names, positive directions and zero positions are those of the file; the base frame is the
    frame of its root link, the tool frame that of the link ``tip``. Damping and friction of a joint
    become its viscous and Coulomb friction. Gravity is (0, 0, -9.81) m/s^2 unless the file carries
    another.

    Parameters
    ----------
    path : str or Path
        A ``.urdf`` file (expand xacro first); meshes are not read.
    tip : str, optional
        Link at the end of the chain. Joints that are not on the way to it are locked where they
        are nearest to zero, and what they carry is carried along. Without it the file must be one
        chain with one end.
    parallel_tolerance : float
        Axes of neighbouring joints whose angle is below this count as parallel, rad. Poses are
        then wrong by up to this angle; a larger one takes files whose angles are rounded hard.

    Returns
    -------
    Robot
        Without masses if no moving link of the file has any.

    Raises
    ------
    InputError
        A file that cannot be read or is no URDF; a mimic, planar or floating joint; branches or
        several ends without ``tip``; duplicate names, links without a way from the root; a mass
        not above zero, an inertia that no body has, an axis that is not a unit vector, limits with
        lower above upper, anything not finite; the extra ``urdf`` missing.
    """
    name = str(path)
    try:
        data = Path(name).read_bytes()
    except OSError as problem:
        raise InputError(f"robot file {name!r} cannot be read: {problem}") from None
    return parse_urdf(data, Path(name).name, tip, parallel_tolerance=parallel_tolerance)


def parse_urdf(
    text: str | bytes,
    origin: str = "robot",
    tip: str | None = None,
    *,
    parallel_tolerance: float = PARALLEL,
) -> Robot:
    """Robot from the text of a URDF file; ``origin`` names it in error messages."""
    checks.number("parallel_tolerance", parallel_tolerance, "rad", at_least=0.0, at_most=0.1)
    data = text.encode() if isinstance(text, str) else text
    xml = _parse_xml(data, origin)
    model = _parse_model(data, origin)
    try:
        return _Tree(model, xml).robot(tip, parallel_tolerance)
    except InputError as problem:
        raise InputError(f"{origin}: {problem}") from None


def _parse_xml(data: bytes, origin: str) -> ElementTree.Element:
    """The file as XML; for what the parser of URDF passes over or fills in by itself."""
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as problem:
        raise InputError(f"{origin} is not valid XML: {problem}") from None
    if root.tag != "robot":
        raise InputError(f"{origin} is not a URDF: its root is <{root.tag}>, not <robot>")
    if not root.get("name"):
        raise InputError(f"{origin}: its <robot> has no name")
    for kind in ("link", "joint"):
        seen: set[str | None] = set()
        for element in root.findall(kind):
            name = element.get("name")
            if not name or name in seen:
                what = f"two {kind}s named {name!r}" if name else f"a {kind} without a name"
                raise InputError(f"{origin} has {what}")
            seen.add(name)
    for link in root.findall("link"):
        for tag, wanted in (
            ("mass", ("value",)),
            ("inertia", ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
        ):
            for inertial in link.findall("inertial"):
                element = inertial.find(tag)
                given = {} if element is None else element.attrib
                missing = [key for key in wanted if key not in given]
                if missing:
                    raise InputError(
                        f"{origin}: {tag} of link {link.get('name')!r} lacks {', '.join(missing)}"
                    )
    return root


def _parse_model(data: bytes, origin: str) -> Any:
    """The robot as yourdfpy reads it."""
    try:
        import yourdfpy
    except ImportError:
        raise InputError(
            "reading URDF files needs the extra 'urdf': pip install 'microbot_ocp[urdf]'"
        ) from None
    logger = logging.getLogger("yourdfpy")
    before = logger.level
    logger.setLevel(logging.CRITICAL)  # what it has to say is said by the error below
    try:
        with np.errstate(all="ignore"):  # NaN is refused later, by name
            return yourdfpy.URDF.load(
                io.BytesIO(data), build_scene_graph=False, load_meshes=False
            ).robot
    except Exception as problem:  # it raises whatever happens to go wrong inside
        raise InputError(f"{origin} is not a URDF that can be read: {problem!r}") from None
    finally:
        logger.setLevel(before)


class _Tree:
    """Links and joints of a URDF, checked to be a tree."""

    def __init__(self, model: Any, xml: ElementTree.Element) -> None:
        self.name = model.name
        self.links = {link.name: link for link in model.links}
        self.joints = {joint.name: joint for joint in model.joints}
        self.extras = {joint.get("name"): joint.find(EXTENSION) for joint in xml.findall("joint")}
        extra = xml.find(EXTENSION)
        self.about: dict[str, str] = {} if extra is None else dict(extra.attrib)
        self.above: dict[str, Any] = {}  # link -> joint that carries it
        self.below: dict[str, list[Any]] = {name: [] for name in self.links}
        for joint in self.joints.values():
            for role in ("parent", "child"):
                if getattr(joint, role) not in self.links:
                    raise InputError(
                        f"{role} of joint {joint.name!r} must be a link of the file, not "
                        f"{getattr(joint, role)!r}"
                    )
            if joint.child in self.above:
                raise InputError(
                    f"link {joint.child!r} hangs on two joints, {self.above[joint.child].name!r} "
                    f"and {joint.name!r}: the file is not a chain"
                )
            self._check_type(joint)
            self.above[joint.child] = joint
            self.below[joint.parent].append(joint)
        roots = [name for name in self.links if name not in self.above]
        if len(roots) != 1:
            raise InputError(f"there must be one root link, not {roots}: the file is not one chain")
        self.root = roots[0]
        if len(list(self._carried(self.root))) != len(self.links):
            raise InputError("some links hang on each other in a ring: the file is not a chain")

    @staticmethod
    def _check_type(joint: Any) -> None:
        if joint.type not in (*MOVING, "fixed"):
            raise InputError(
                f"joint {joint.name!r} is {joint.type}: only revolute, continuous, prismatic and "
                "fixed joints can be read"
            )

    def _carried(self, link: str) -> Iterator[str]:
        """The link and all links outward of it."""
        waiting = [link]
        while waiting:
            name = waiting.pop()
            yield name
            waiting += [joint.child for joint in self.below[name]]

    def _way(self, tip: str) -> list[Any]:
        """Joints from the root to the link ``tip``."""
        way = []
        while tip != self.root:
            way.append(self.above[tip])
            tip = way[-1].parent
        return way[::-1]

    def _only_tip(self) -> str:
        """The end of a file that is one chain with one end."""
        for joint in self.joints.values():
            if joint.mimic is not None:
                raise InputError(
                    f"joint {joint.name!r} mimics {joint.mimic.joint!r}: choose a tip that leaves "
                    "it out"
                )
        last = self.root
        while arms := [joint for joint in self.below[last] if self._moves_outward(joint)]:
            if len(arms) > 1:
                names = ", ".join(repr(joint.name) for joint in arms)
                raise InputError(
                    f"the file branches at link {last!r} into joints {names}: choose an end by tip"
                )
            last = arms[0].child
        ends = [name for name in self._carried(last) if not self.below[name]]
        if len(ends) != 1:
            names = ", ".join(map(repr, sorted(ends)))
            raise InputError(f"the chain has the ends {names}: choose one by tip")
        return ends[0]

    def _moves_outward(self, joint: Any) -> bool:
        """Whether the joint or any joint outward of it moves."""
        outward = (j for name in self._carried(joint.child) for j in self.below[name])
        return any(j.type in MOVING for j in (joint, *outward))

    def robot(self, tip: str | None, parallel_tolerance: float) -> Robot:
        """The chain from the root to ``tip``, or to the only end there is."""
        if tip is None:
            tip = self._only_tip()
        elif tip not in self.links:
            raise InputError(f"tip must be a link of the file, one of {', '.join(self.links)}")
        way = self._way(tip)
        moving = [joint for joint in way if joint.type in MOVING]
        for joint in moving:
            if joint.mimic is not None:
                raise InputError(f"joint {joint.name!r} mimics {joint.mimic.joint!r}")
        if not moving:
            raise InputError(f"no joint moves between {self.root!r} and {tip!r}")
        chain = {joint.name for joint in moving}
        frames = self._frames(chain)
        axes = np.array([frames[j.child][:3, :3] @ _axis(j) for j in moving])
        points = np.array([frames[j.child][:3, 3] for j in moving])
        rows = dh_rows(points, axes, [j.name for j in moving], parallel_tolerance)
        tool = np.array(np.linalg.solve(rows.frames[-1], frames[tip]), dtype=float)
        return Robot.from_dh(
            rows.alpha,
            rows.a,
            rows.d,
            rows.theta,
            joint_type=["prismatic" if j.type == "prismatic" else "revolute" for j in moving],
            links=self._links(moving, frames, rows.frames),
            limits=self._limits(moving),
            gravity=self._gravity(),
            tool=_cleaned(tool),
            name=self.name,
            joint_names=[j.name for j in moving],
            description=self.about.get("description", ""),
            base=rows.base,
        )

    def _frames(self, chain: set[str]) -> dict[str, FloatArray]:
        """Frames [4,4] of all links in the root's, chain at zero, other joints locked."""
        frames = {self.root: np.eye(4)}
        for name in self._carried(self.root):
            for joint in self.below[name]:
                frame = frames[name] @ _origin(f"origin of joint {joint.name!r}", joint.origin)
                if joint.type in MOVING and joint.name not in chain:
                    frame = frame @ _joint_motion(joint, self._locked(joint, chain))
                frames[joint.child] = frame
        return frames

    def _locked(self, joint: Any, chain: set[str]) -> float:
        """Position nearest to zero that the limits of a joint off the chain allow."""
        if joint.mimic is not None:
            label = f"of the mimic of joint {joint.name!r}"
            leader = self.joints.get(joint.mimic.joint)
            if leader is None or leader.mimic is not None or leader.type not in MOVING:
                raise InputError(f"joint {label} must be a moving joint, not {joint.mimic.joint!r}")
            if leader.name in chain:
                raise InputError(
                    f"joint {joint.name!r} mimics {leader.name!r}, which moves on the way to the "
                    "tip"
                )
            factor = 1.0 if joint.mimic.multiplier is None else joint.mimic.multiplier
            offset = 0.0 if joint.mimic.offset is None else joint.mimic.offset
            factor = checks.number(f"multiplier {label}", factor)
            return factor * self._locked(leader, chain) + checks.number(f"offset {label}", offset)
        lower, upper = _range(joint)
        return min(max(0.0, lower), upper)

    def _links(
        self, moving: list[Any], frames: dict[str, FloatArray], placed: list[FloatArray]
    ) -> list[Link]:
        """One link a joint, of all that moves with it; none if nothing has a mass."""
        bodies = {joint.name: _Body() for joint in moving}
        carrier: dict[str, str | None] = {self.root: None}
        for name in self._carried(self.root):
            for joint in self.below[name]:
                carrier[joint.child] = joint.name if joint.name in bodies else carrier[name]
            own = _inertial(self.links[name])
            body = carrier[name]
            if own is not None and body is not None:
                bodies[body].add(own[0], frames[name] @ own[1])
        if not any(body.mass for body in bodies.values()):
            return []
        links = []
        for joint, frame in zip(moving, placed, strict=True):
            body = bodies[joint.name]
            if not body.mass:
                raise InputError(
                    f"mass of what joint {joint.name!r} moves, up to the next joint, is missing: "
                    "give all or none"
                )
            links.append(body.as_link(frame, name=joint.child, **self._at_joint(joint)))
        return links

    def _at_joint(self, joint: Any) -> dict[str, float]:
        """Friction and rotor inertia of a joint."""
        dynamics, extra = joint.dynamics, self._extra(joint)
        given = {
            "viscous_friction": (getattr(dynamics, "damping", None), "damping"),
            "coulomb_friction": (getattr(dynamics, "friction", None), "friction"),
            "armature": (extra.get("armature"), "armature"),
        }
        return {
            key: _number(f"{word} of joint {joint.name!r}", text, at_least=0.0)
            for key, (text, word) in given.items()
            if text is not None
        }

    def _extra(self, joint: Any) -> dict[str, str]:
        element = self.extras.get(joint.name)
        attributes = {} if element is None else dict(element.attrib)
        for key in attributes:
            checks.one_of(f"<{EXTENSION}> of joint {joint.name!r}", key, EXTRA_KEYS)
        return attributes

    def _limits(self, moving: list[Any]) -> Limits:
        columns: dict[str, list[float]] = {key: [] for key in ("q_min", "q_max", *EXTRA_KEYS[1:])}
        for joint in moving:
            lower, upper = _range(joint)
            columns["q_min"].append(lower)
            columns["q_max"].append(upper)
            limit, extra = joint.limit, self._extra(joint)
            for quantity, key in (("qd", "velocity"), ("tau", "effort")):
                value = getattr(limit, key, None)
                if value not in (None, math.inf):
                    label = f"{key} of joint {joint.name!r}"
                    bound = repr(checks.number(label, value, at_least=0.0))
                    extra.setdefault(f"{quantity}_max", bound)
                    extra.setdefault(f"{quantity}_min", f"-{bound}")
            for quantity in RANGES:
                for side, free in (("min", -math.inf), ("max", math.inf)):
                    key = f"{quantity}_{side}"
                    label = f"{key} of joint {joint.name!r}"
                    text = extra.get(key)
                    value = free if text in (None, str(free)) else _number(label, text)
                    columns[key].append(value)
        pairs = {
            f"{quantity}_max": (columns[f"{quantity}_min"], columns[f"{quantity}_max"])
            for quantity in RANGES
        }
        return Limits(q_min=columns["q_min"], q_max=columns["q_max"], **pairs)

    def _gravity(self) -> list[float]:
        for key in self.about:
            checks.one_of(f"<{EXTENSION}>", key, ("gravity", "description"))
        text = self.about.get("gravity", "0 0 -9.81")
        return [_number("gravity", entry) for entry in text.split()]


def _number(name: str, text: Any, *, at_least: float | None = None) -> float:
    try:
        value = float(text)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be a number, not {text!r}") from None
    return checks.number(name, value, at_least=at_least)


def _axis(joint: Any) -> FloatArray:
    """Unit axis [3] of a moving joint in its own frame."""
    axis = checks.array(f"axis of joint {joint.name!r}", joint.axis, (3,))
    length = float(np.linalg.norm(axis))
    # A unit vector written with four digits is within 1e-4 of one.
    if abs(length - 1) > 1e-3:
        raise InputError(
            f"axis of joint {joint.name!r} must be a unit vector, not {axis.tolist()} of length "
            f"{length:.6g}"
        )
    return axis / length


def _origin(name: str, matrix: FloatArray | None) -> FloatArray:
    if matrix is None:
        return np.eye(4)
    return _cleaned(checks.array(name, matrix, (4, 4)))


def _cleaned(matrix: FloatArray) -> FloatArray:
    """The transform without the dust of right angles: entries below 1e-15 become zero."""
    return np.where(np.abs(matrix) < 1e-15, 0.0, matrix)


def _joint_motion(joint: Any, position: float) -> FloatArray:
    """Transform [4,4] of a joint by ``position``, rad or m."""
    axis, motion = _axis(joint), np.eye(4)
    if joint.type == "prismatic":
        motion[:3, 3] = position * axis
    else:
        skew = np.cross(np.eye(3), axis)  # times a vector: axis x vector
        motion[:3, :3] += np.sin(position) * skew + (1 - np.cos(position)) * skew @ skew
    return motion


def _range(joint: Any) -> tuple[float, float]:
    """Lower and upper position of a joint, rad or m."""
    if joint.type == "continuous":
        return -math.inf, math.inf
    limit = joint.limit
    if limit is None or (limit.lower is None and limit.upper is None):
        raise InputError(f"limit of joint {joint.name!r} is missing: give lower and upper")
    # URDF takes one side that is not given as zero.
    lower, upper = (0.0 if side is None else side for side in (limit.lower, limit.upper))
    for side, value in (("lower", lower), ("upper", upper)):
        if math.isnan(value):
            raise InputError(f"{side} limit of joint {joint.name!r} must be a number, not nan")
    if lower > upper:
        raise InputError(
            f"lower limit of joint {joint.name!r} must be at most its upper limit of {upper:g}, "
            f"not {lower:g}"
        )
    return lower, upper


def _inertial(link: Any) -> tuple[Link, FloatArray] | None:
    """A link's own mass properties about its centre of mass, and their frame [4,4] in the link."""
    inertial = link.inertial
    if inertial is None:
        return None
    body = Link(inertial.mass, np.zeros(3), inertial.inertia, name=link.name)
    return body, _origin(f"inertial origin of link {link.name!r}", inertial.origin)
