"""Robots from URDF files.

A URDF places its joints freely; a :class:`~microbot_ocp.robot.Robot` has modified-DH rows. The
reader converts the chain from the root to one end into rows (see ``_placement.py``), with a
constant base transform before and the tool after them, and expresses masses and geometry in the new
link frames. Links without a joint between them become one body.

URDF has no rotor inertia, no limits of acceleration or torque rate, no one-sided limits and no
gravity. The writer puts them into elements ``<microbot_ocp>``, which other readers ignore.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Set
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming
from microbot_ocp.limits import Limits
from microbot_ocp.robot._coupling import Mimic
from microbot_ocp.robot._links import Link, Part, combined, inertia_fault
from microbot_ocp.robot._model import Robot
from microbot_ocp.robot._shapes import Shape
from microbot_ocp.robot._transforms import PARALLEL, without_rounding
from microbot_ocp.robot.files._placement import dh_rows
from microbot_ocp.robot.files._ros_files import urdf_content
from microbot_ocp.robot.files._urdf_file import (
    RANGES,
    UNSUPPORTED,
    SrdfFile,
    UrdfFile,
    UrdfJoint,
    read_srdf,
    urdf_file,
)
from microbot_ocp.robot.files._xml import Remarks, read_xml

MOST_TURNED = 0.1  # largest angle between axes that may be made parallel, rad
USUAL_TOOL = "tool0"  # name of the tool frame in ROS-Industrial's convention
LIST_WIDTH = 70  # characters of a list of names in a message
# Each link has the number of the joint that moves it, and its frame.
Places = dict[str, tuple[int, FloatArray]]


def load_urdf(
    path: str | Path,
    tip: str | None = None,
    *,
    srdf: str | Path | None = None,
    parallel_tolerance: float = PARALLEL,
    xacro_arguments: Mapping[str, str] | None = None,
) -> Robot:
    """Read the chain from the root of a URDF file to one of its links.

    Joint names, positive directions and zero positions are those of the file; the base frame is the
    frame of its root link, the tool frame that of the link ``tip``. Damping and friction of a joint
    become its viscous and Coulomb friction. Gravity is (0, 0, -9.81) m/s^2 unless the file has
    another. Geometry is in ``robot.shapes``; mesh files are not opened.

    Parameters
    ----------
    path : str or Path
        File ``.urdf`` or ``.xacro`` (extra ``urdf``; xacro expressions run for 10 s at most).
    tip : str, optional
        Link at the end of the chain, or a group with a chain in the SRDF file. By default the file
        must be one arm; if it ends in several frames, the tool is ``tool0`` or the last moving
        link, with a warning, and a gripper whose fingers mimic each other is ignored. If all
        chains of an SRDF file end at one link, that link is the default. Joints outside of the
        chain are fixed at zero, with the links that they carry; so are planar and floating joints,
        with a warning. Joints of the chain that mimic another move with it under the limits of
        both; only the effort limit of the leading joint counts.
    srdf : str or Path, optional
        SRDF file of MoveIt; default a file of equal name in the folder, if there is one. Pairs of
        links with disabled collisions become ``robot.disabled_pairs``, states of all joints of
        the chain ``robot.named_poses``.
    parallel_tolerance : float
        Angle below which axes of neighbouring joints count as parallel, rad. It bounds the error
        of poses; a larger tolerance gives simple rows for a file with strongly rounded angles.
    xacro_arguments : mapping of str to str, optional
        Values of the arguments that a xacro file declares, such as ``{"ur_type": "ur10e"}``.

    Returns
    -------
    Robot
        Robot, without masses if no moving link has any.

    Raises
    ------
    InputError
        The file cannot be read or is no URDF; there is no moving joint, or there are several arms
        but no ``tip`` (the message lists possible tips); duplicate names, links that are not
        connected to the root; a negative mass, an axis of length zero, a lower limit above the
        upper one, or a value that is not finite.

    Warns
    -----
    RobotFileWarning
        Data that a strict reader would refuse or treat differently: inertias that no rigid body
        has (kept), joints without limits, missing meshes, joints of the chain that are fixed.
    """
    name = str(path)
    data = urdf_content(name, "robot file", xacro_arguments)
    short = Path(name).name
    folder, about = Path(name).absolute().parent, None
    beside = Path(name).with_suffix(".srdf")
    if srdf is not None or beside.is_file():
        about = read_srdf(beside if srdf is None else srdf)
    return parse_urdf(
        data, short, tip, parallel_tolerance=parallel_tolerance, folder=folder, about=about
    )


def parse_urdf(
    text: str | bytes,
    origin: str = "robot",
    tip: str | None = None,
    *,
    parallel_tolerance: float = PARALLEL,
    folder: Path | None = None,
    about: SrdfFile | None = None,
) -> Robot:
    """Return the robot from the text of a URDF file.

    ``origin`` names the file in messages, ``folder`` is the start of mesh searches, and ``about``
    is the content of an SRDF file.
    """
    checks.number(
        "parallel_tolerance", parallel_tolerance, "rad", at_least=0.0, at_most=MOST_TURNED
    )
    remarks = Remarks()
    with naming(f"{origin}: "):
        file = urdf_file(read_xml(text, remarks), origin, folder, remarks)
        if about is not None:
            ends = set(about.tips.values())
            usual = ends.pop() if len(ends) == 1 else None
            tip = usual if tip is None else about.tips.get(tip, tip)
        robot = robot_of(file, remarks, tip, parallel_tolerance)
        if about is not None:
            robot = _with_semantics(robot, about, file.links.keys(), remarks)
    remarks.warn(origin)
    return robot


def _with_semantics(robot: Robot, about: SrdfFile, links: Set[str], remarks: Remarks) -> Robot:
    """Return the robot with data of an SRDF file."""
    names = robot.joint_names
    for name in sorted(set(sum(about.disabled, ())) - links):
        remarks.add("pairs of links that only the SRDF has are left out", repr(name))
    poses: dict[str, FloatArray] = {}
    for name, state in about.states:
        if state.keys() >= set(names):
            poses.setdefault(name, np.array([state[joint] for joint in names]))
    pairs = tuple(pair for pair in about.disabled if links >= set(pair))
    return replace(robot, disabled_pairs=pairs, named_poses=poses)


def robot_of(file: UrdfFile, remarks: Remarks, tip: str | None, parallel_tolerance: float) -> Robot:
    """Return the arm of a file from its root to ``tip``."""
    with np.errstate(all="ignore"):  # an overflow raises InputError with the name of the value
        return _Tree(file, remarks).robot(tip, parallel_tolerance)


def read_urdf_shapes(path: str | Path) -> tuple[Shape, ...]:
    """Return collision geometry of a URDF file of fixed joints, in the frame of its root link.

    Raises
    ------
    InputError
        The file cannot be read or is no URDF, a joint moves, or a link is not connected to the
        root.
    """
    file, remarks = Path(path), Remarks()
    data = urdf_content(file, "scene file")
    with naming(f"{file.name}: "):
        content = read_xml(data, remarks)
        tree = _Tree(urdf_file(content, file.name, file.absolute().parent, remarks), remarks)
        for joint in tree.joints.values():
            if joint.moves:
                raise InputError(f"joint {joint.name!r} moves, but a scene has no moving joints")
    remarks.warn(file.name)
    return tuple(
        replace(shape, frame=0, pose=frame @ shape.pose)
        for name, (_, frame) in tree.places([]).items()
        for shape in tree.links[name].shapes
        if shape.role == "collision"
    )


class _Tree:
    """The tree of links and joints of a URDF."""

    def __init__(self, file: UrdfFile, remarks: Remarks) -> None:
        self.file, self.remarks = file, remarks
        self.links, self.joints = file.links, file.joints
        self.above: dict[str, UrdfJoint] = {}  # joint that carries each link
        self.below: dict[str, list[UrdfJoint]] = {name: [] for name in self.links}
        for joint in self.joints.values():
            for role, end in (("parent", joint.parent), ("child", joint.child)):
                if end not in self.links:
                    raise InputError(
                        f"{role} of joint {joint.name!r} must be a link of the file, not {end!r}"
                    )
            if joint.child in self.above:
                raise InputError(
                    f"link {joint.child!r} hangs on two joints, {self.above[joint.child].name!r} "
                    f"and {joint.name!r}: the file is not a chain"
                )
            self.above[joint.child] = joint
            self.below[joint.parent].append(joint)
        self.roots = [name for name in self.links if name not in self.above]
        self.order = list(self._outward(*self.roots))
        if len(self.order) != len(self.links):
            raise InputError("some links hang on each other in a ring: the file is not a chain")

    @property
    def root(self) -> str:
        """The link that carries all others."""
        if len(self.roots) != 1:
            names = _abbreviated([repr(name) for name in self.roots])
            raise InputError(f"there must be one root link, not {names}: the file is not one chain")
        return self.roots[0]

    def _outward(self, *links: str) -> Iterator[str]:
        """Yield the links and all links that they carry, each after its carrier."""
        waiting = list(links)
        while waiting:
            name = waiting.pop()
            yield name
            waiting += [joint.child for joint in self.below[name]]

    def _way(self, tip: str) -> list[UrdfJoint]:
        """Return joints from the root to the link ``tip``."""
        way = []
        while tip != self.root:
            way.append(self.above[tip])
            tip = way[-1].parent
        return way[::-1]

    def _leader(self, joint: UrdfJoint) -> tuple[str, float, float]:
        """Return the leading joint of a mimicking one, the factor, and the position at zero.

        A joint leads itself if its leader is missing or the joint itself.
        """
        factor, offset, at, passed = 1.0, 0.0, joint, {joint.name}
        while at.leader is not None:
            following = self.joints.get(at.leader)
            if following is None or not following.moves or following.name in passed:
                self.remarks.add(
                    "joints that mimic no other moving joint of the file move on their own",
                    f"{joint.name!r} (mimics {at.leader!r})",
                )
                return joint.name, 1.0, 0.0
            factor, offset = factor * at.multiplier, offset + factor * at.offset
            at = following
            passed.add(at.name)
        return at.name, factor, offset

    def _moving(self, way: list[UrdfJoint]) -> list[UrdfJoint]:
        """Return the moving joints of a chain, except those that mimic by a factor of zero."""
        return [joint for joint in way if joint.moves and self._leader(joint)[1]]

    def _coordinates(self, way: list[UrdfJoint]) -> dict[str, UrdfJoint]:
        """Return, by leading joint, the joint of a chain that moves the group.

        It is the leader itself, or the first of the group in the chain.
        """
        chosen: dict[str, UrdfJoint] = {}
        for joint in self._moving(way):
            head = self._leader(joint)[0]
            if head not in chosen or joint.name == head:
                chosen[head] = joint
        return chosen

    def _tips(self) -> str:
        """Return ends of the file for messages, those with the longest chains first."""
        ends = [name for name in self.links if not self.below[name]]
        counts = {name: len(self._coordinates(self._way(name))) for name in ends}
        longest = sorted(counts.items(), key=lambda pair: -pair[1])
        return _abbreviated([f"{name!r} ({count})" for name, count in longest if count])

    def _only_tip(self) -> str:
        """Return the end of a file with a single arm."""
        moving = {self.root: False}  # True if any joint outward of a link moves
        for name in reversed(self.order):
            moving[name] = any(j.moves or moving[j.child] for j in self.below[name])
        last = self.root
        while arms := [j for j in self.below[last] if j.moves or moving[j.child]]:
            if len(arms) > 1:
                if self._is_gripper(last):
                    break
                names = _abbreviated([repr(joint.name) for joint in arms])
                here = len(self._coordinates(self._way(last)))
                before = f"{last!r} ({here}) without them, " if here else ""
                raise InputError(
                    f"the file branches at link {last!r} into joints {names}: choose an end by "
                    f"tip (joints): {before}{self._tips()}"
                )
            last = arms[0].child
        ends = sorted(name for name in self._outward(last) if not self.below[name])
        if len(ends) == 1:
            return ends[0]
        tip = USUAL_TOOL if USUAL_TOOL in ends else last
        others = _abbreviated([repr(name) for name in ends if name != tip])
        self.remarks.add(f"the tool frame is that of {tip!r}; others can be chosen by tip", others)
        return tip

    def _is_gripper(self, link: str) -> bool:
        """Return True if all moving joints outward of a moving link mimic one joint."""
        outward = [j for name in self._outward(link) for j in self.below[name] if j.moves]
        return (
            any(joint.moves for joint in self._way(link))
            and len({self._leader(joint)[0] for joint in outward}) == 1
        )

    def robot(self, tip: str | None, parallel_tolerance: float) -> Robot:
        """Return the chain from the root to ``tip``, by default the only end."""
        if not any(joint.moves for joint in self.joints.values()):
            raise InputError("the file has no moving joint, so there is no arm to read")
        tip = self._only_tip() if tip is None else tip
        if not isinstance(tip, str) or tip not in self.links:
            near = get_close_matches(str(tip), self.links, 3)
            advice = f" (near it: {', '.join(map(repr, near))})" if near else ""
            raise InputError(
                f"tip must be a link of the file, not {tip!r}{advice}; ends that can be it, with "
                f"their number of joints: {self._tips()}"
            )
        way = self._way(tip)
        moving = self._moving(way)
        if not moving:
            raise InputError(
                f"no joint moves between {self.root!r} and {tip!r}; ends that can be the tip, with "
                f"their number of joints: {self._tips()}"
            )
        self._remark_held(way, moving)
        places = self.places(moving)
        frames = [places[joint.child][1] for joint in moving]
        axes = [frame[:3, :3] @ joint.axis for frame, joint in zip(frames, moving, strict=True)]
        points = np.array([frame[:3, 3] for frame in frames])
        rows = dh_rows(points, np.array(axes), parallel_tolerance)
        placed = [np.eye(4), *rows.frames]
        try:
            tool = _relative_to(placed[-1], places[tip][1])
        except np.linalg.LinAlgError:  # axes or positions of about 1e300
            raise InputError(
                f"the joints up to {tip!r} have no frames: numbers too large"
            ) from None
        shapes: list[Shape] = []
        seen: dict[str, tuple[int, FloatArray]] = {}
        for name in self.order:
            number, frame = places[name]
            seen[name] = number, (pose := _relative_to(placed[number], frame))
            given = self.links[name].shapes
            shapes += [replace(shape, frame=number, pose=pose @ shape.pose) for shape in given]
        robot = Robot.from_dh(
            *rows[:4],
            joint_type=["prismatic" if j.type == "prismatic" else "revolute" for j in moving],
            links=self._links(moving, places, rows.frames),
            limits=_limits([self._within_leader(joint, moving) for joint in moving]),
            mimic=self._mimic(way),
            gravity=self.file.gravity,
            tool=tool,
            name=self.file.name,
            joint_names=[j.name for j in moving],
            description=self.file.description,
            base=rows.base,
            beta=rows.beta,
            shapes=shapes,
            convention="modified",
        )
        return replace(robot, frames=seen)

    def _mimic(self, way: list[UrdfJoint]) -> Mimic:
        """Return the joints of a chain that follow others in it, with factor and offset."""
        mimic: dict[str, tuple[str, float, float]] = {}
        chosen = self._coordinates(way)
        for joint in self._moving(way):
            head, factor, offset = self._leader(joint)
            first = chosen[head]
            if first is not joint:
                _, unit, zero = self._leader(first)
                ratio = factor / unit
                mimic[joint.name] = first.name, ratio, offset - ratio * zero
        return mimic

    def _within_leader(self, joint: UrdfJoint, moving: list[UrdfJoint]) -> UrdfJoint:
        """Return a joint limited as its leader, too, if the leader is outside of the chain."""
        name, factor, offset = self._leader(joint)
        head = self.joints[name]
        if head in moving:
            return joint
        limits = dict(joint.limits)
        for key in ("q", "qd", "qdd", "qddd"):
            shift = offset if key == "q" else 0.0
            least, most = sorted(factor * end + shift for end in head.limit(key))
            lower, upper = joint.limit(key)
            limits[key] = max(lower, least), min(upper, most)
        least, most = sorted(end / factor for end in head.limit("tau"))
        return replace(joint, limits=limits | {"tau": (least, most)})

    def _remark_held(self, way: list[UrdfJoint], moving: list[UrdfJoint]) -> None:
        """Add remarks on joints that a serial chain cannot follow."""
        heads = {self._leader(joint)[0] for joint in moving}
        for joint in self.joints.values():
            if joint in moving:
                continue
            if joint in way and joint.type in UNSUPPORTED:
                self.remarks.add(
                    "planar and floating joints on the way to the tip are held at zero",
                    f"{joint.name!r} ({joint.type})",
                )
            elif joint.moves and self._leader(joint)[0] in heads:
                self.remarks.add(
                    "joints that mimic one of the chain, or that it mimics, are held still",
                    f"{joint.name!r} at {self._leader(joint)[2]:g}",
                )

    def places(self, chain: list[UrdfJoint]) -> Places:
        """Return, for all links, the number of the joint that moves them, and their root frame.

        Numbers of the joints of a chain begin at 1; 0 means fixed. The chain is at zero.
        """
        numbers = {joint.name: number for number, joint in enumerate(chain, 1)}
        placement = {name: (0, np.eye(4)) for name in self.roots}
        for name in self.order:
            number, frame = placement[name]
            for joint in self.below[name]:
                place = frame @ joint.frame
                if joint.moves and joint.name not in numbers:
                    place = place @ joint_motion(joint, self._leader(joint)[2])
                placement[joint.child] = numbers.get(joint.name, number), place
        return placement

    def _links(
        self, moving: list[UrdfJoint], places: Places, placed: list[FloatArray]
    ) -> list[Link]:
        """Return one link per joint, of all that moves with it; an empty list without masses."""
        bodies: list[list[Part]] = [[] for _ in range(len(moving) + 1)]
        for name in self.order:
            number, place = places[name]
            if inertial := self.links[name].inertial:
                frame = place @ inertial.frame
                inertia = frame[:3, :3] @ inertial.inertia @ frame[:3, :3].T
                bodies[number].append((inertial.mass, frame[:3, 3], inertia))
                if fault := inertia_fault(inertial.inertia):
                    rest = "are taken as they stand" if number else "do not move here"
                    self.remarks.add(f"inertias that no rigid body has {rest}", f"{name!r} {fault}")
        if not any(mass or inertia.any() for body in bodies[1:] for mass, _, inertia in body):
            return []
        links = []
        for parts, joint, frame in zip(bodies[1:], moving, placed, strict=True):
            rotation, origin = frame[:3, :3], frame[:3, 3]
            total, center, about_center = combined(parts, origin)
            turned = rotation.T @ about_center @ rotation
            inertia = (turned + turned.T) / 2
            body = total, rotation.T @ (center - origin), inertia
            drive = joint.armature, joint.damping, joint.friction
            links.append(Link(*body, *drive, joint.child, inertia_fault(inertia) is not None))
        return links


def _relative_to(frame: FloatArray, other: FloatArray) -> FloatArray:
    """Return another frame [4,4] in the coordinates of a frame [4,4]."""
    return without_rounding(np.array(np.linalg.solve(frame, other), dtype=float))


def _abbreviated(texts: list[str]) -> str:
    """Return as many texts as fit into a message, at least one."""
    ends = itertools.accumulate(len(text) + 2 for text in texts)
    fitting = max(sum(end <= LIST_WIDTH for end in ends), 1)
    rest = len(texts) - fitting
    return ", ".join([*texts[:fitting], f"{rest} more"] if rest > 0 else texts)


def _limits(moving: list[UrdfJoint]) -> Limits:
    columns = {
        key: tuple(map(list, zip(*(joint.limit(key) for joint in moving), strict=True)))
        for key in ("q", *RANGES)
    }
    for joint, lower, upper in zip(moving, *columns["q"], strict=True):
        if lower > upper:
            raise InputError(
                f"lower limit of joint {joint.name!r} must be at most its upper limit of "
                f"{upper:g}, not {lower:g}"
            )
    q_min, q_max = columns.pop("q")
    bounds: Any = {f"{key}_max": sides for key, sides in columns.items()}
    return Limits(q_min=q_min, q_max=q_max, **bounds)


def joint_motion(joint: UrdfJoint, position: float) -> FloatArray:
    """Return the transform [4,4] of a joint at ``position``, rad or m."""
    motion = np.eye(4)
    if joint.type == "prismatic":
        motion[:3, 3] = position * joint.axis
    else:
        skew = np.cross(np.eye(3), joint.axis)  # rows: skew @ v = axis x v
        motion[:3, :3] += np.sin(position) * skew + (1 - np.cos(position)) * skew @ skew
    return motion
