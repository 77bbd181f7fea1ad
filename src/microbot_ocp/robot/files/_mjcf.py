"""Robots from MJCF files, by MuJoCo's own parser and compiler.

Links and joints in the form of a URDF are taken from the compiled model, in which MuJoCo has
resolved classes, defaults, includes, inertias of geoms and angles in degrees. The reader for URDF
makes the chain from them. Format: https://mujoco.readthedocs.io/en/stable/XMLreference.html.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming
from microbot_ocp._base.needed import needed
from microbot_ocp._base.reading import bytes_of
from microbot_ocp.robot._model import Robot
from microbot_ocp.robot._shapes import Shape
from microbot_ocp.robot._transforms import PARALLEL, of_quaternion, transform_of, without_rounding
from microbot_ocp.robot.files._urdf_file import Inertial, UrdfFile, UrdfJoint, UrdfLink
from microbot_ocp.robot.files._urdf_reader import MOST_TURNED, joint_motion, robot_of
from microbot_ocp.robot.files._xml import Remarks

KINDS = {"FREE": "floating", "BALL": "spherical", "SLIDE": "prismatic", "HINGE": "revolute"}
SOLIDS = {"SPHERE": "sphere", "CAPSULE": "capsule", "CYLINDER": "cylinder", "BOX": "box"}


def load_mjcf(
    path: str | Path, tip: str | None = None, *, parallel_tolerance: float = PARALLEL
) -> Robot:
    """Read the chain from the world to one body or site of a MuJoCo file.

    Joint names, positive directions and zero positions are those of the file, and the base frame is
    the world frame. Armature, damping and dry friction of a joint are unchanged. Torque limits come
    from force ranges of the joint and its actuators. MJCF has no limits of velocity or
    acceleration: give them by :meth:`~microbot_ocp.Robot.with_limits`. A joint follows another if
    an equality of joints or fixed tendons ties them by a factor and an offset; a joint that is tied
    to a constant is fixed. The actuators of all coupled joints act on the one that leads them.

    Parameters
    ----------
    path : str or Path
        MJCF file, such as those of MuJoCo Menagerie; needs the package ``mujoco`` of the extra
        ``mjcf``.
    tip : str, optional
        Body or site at the end of the chain, whose frame is the tool frame; necessary if the file
        has several arms. Joints outside of the chain are fixed at zero.
    parallel_tolerance : float
        Tolerance for parallel axes, rad; see :func:`load_urdf`.

    Returns
    -------
    Robot
        Chain from the base to the tip, with masses and limits.

    Raises
    ------
    InputError
        MuJoCo cannot read the file, for the reason in the message; there is no moving joint, or
        there are several arms but no ``tip``; joints of the arm are tied by a polynomial of a
        higher degree; the extra ``mjcf`` is missing.

    Warns
    -----
    RobotFileWarning
        Elements that affect the joint torques but have no equivalent in a serial chain, by name:
        springs of joints and tendons, gravity compensation, equalities that close loops, fluids,
        and actuators that do not act on a joint. Damping that exceeds a joint's torque limit at
        1 rad/s, as usual if it models a controller.

    Examples
    --------
    >>> import tempfile
    >>> text = '''<mujoco><worldbody><body name="bar"><joint name="hinge" range="-90 90"/>
    ... <geom type="capsule" fromto="0 0 0 0 0 -1" size="0.05"/></body></worldbody></mujoco>'''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "bar.xml"
    ...     _ = file.write_text(text)
    ...     robot = load_mjcf(file)
    >>> robot.joint_names, robot.limits.q_max.round(4).tolist()
    (('hinge',), [1.5708])
    """
    checks.number(
        "parallel_tolerance", parallel_tolerance, "rad", at_least=0.0, at_most=MOST_TURNED
    )
    mujoco = needed("mujoco", "reading MJCF files needs", "mjcf")
    bytes_of(path, "robot file")  # errors of reading are equal for all robot files
    origin, remarks = Path(path).name, Remarks()
    with naming(f"{origin}: "):
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as problem:
            reason = " ".join(str(problem).split())
            raise InputError(f"MuJoCo cannot read it: {reason}") from None
        reader = _Model(mujoco, model, Path(path).absolute().parent, remarks)
        robot = robot_of(reader.file(), remarks, tip, parallel_tolerance)
        from microbot_ocp.robot.files._mjcf_forces import Forces  # imports CasADi

        forces = Forces(mujoco, model, robot, reader.joint_names, reader.held())
        forces.remark(remarks)
    remarks.warn(origin)
    return robot


class _Model:
    """A compiled model, converted to links and joints."""

    def __init__(self, mujoco: Any, model: Any, folder: Path, remarks: Remarks) -> None:
        self.mujoco, self.model, self.folder, self.remarks = mujoco, model, folder, remarks
        enum = mujoco.mjtObj
        self.bodies = self._names(enum.mjOBJ_BODY, model.nbody, "body")
        self.joint_names = self._names(enum.mjOBJ_JOINT, model.njnt, "joint")
        self.followed = self._followed()
        self.links: dict[str, UrdfLink] = {}
        self.joints: dict[str, UrdfJoint] = {}

    def _names(self, kind: Any, count: int, word: str) -> list[str]:
        return [
            self.mujoco.mj_id2name(self.model, int(kind), k) or f"{word} {k}" for k in range(count)
        ]

    def _kind(self, enum: str, value: int) -> str:
        """Return the name of a constant of MuJoCo without its prefix: HINGE of mjJNT_HINGE."""
        return getattr(self.mujoco, enum)(value).name.partition("_")[2]

    def _on(self, *parts: str) -> bool:
        """Return True if none of these parts of the physics is switched off."""
        bits = [int(getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{part}")) for part in parts]
        return not any(self.model.opt.disableflags & bit for bit in bits)

    def file(self) -> UrdfFile:
        model = self.model
        for body, name in enumerate(self.bodies):
            frame = _pose(model.body_ipos[body], model.body_iquat[body])
            inertia = np.diag(model.body_inertia[body])
            inertial = Inertial(float(model.body_mass[body]), inertia, frame)
            self.links[name] = UrdfLink(inertial, tuple(self._shapes(body)))
            if body:
                self._join(body)
        for site in range(model.nsite):
            name = self.mujoco.mj_id2name(model, int(self.mujoco.mjtObj.mjOBJ_SITE), site)
            if name and name not in self.links:
                self.links[name] = UrdfLink()
                frame = _pose(model.site_pos[site], model.site_quat[site])
                self._fix(self.bodies[model.site_bodyid[site]], name, frame)
        gravity = model.opt.gravity.tolist() if self._on("GRAVITY") else [0.0] * 3
        name = bytes(model.names).split(b"\0")[0].decode() or "robot"
        return UrdfFile(name, self.links, self.joints, gravity, "")

    def _fix(self, parent: str, child: str, frame: FloatArray) -> None:
        name = f"to {child}"
        self.joints[name] = UrdfJoint(name, "fixed", parent, child, frame)

    def _join(self, body: int) -> None:
        """Add the joints of a body in sequence, each at its own anchor, as MuJoCo applies them."""
        model, name = self.model, self.bodies[body]
        parent = self.bodies[model.body_parentid[body]]
        frame = _pose(model.body_pos[body], model.body_quat[body])
        first = int(model.body_jntadr[body])
        numbers = range(first, first + int(model.body_jntnum[body]))
        for number in numbers:
            kind = KINDS[self._kind("mjtJoint", model.jnt_type[number])]
            anchor = np.eye(4)
            if kind == "revolute":
                anchor[:3, 3] = model.jnt_pos[number]
            back: FloatArray = np.array(np.linalg.inv(anchor), dtype=float)
            ends = number == numbers[-1] and np.array_equal(anchor, back)
            child = name if ends else f"{name} after {self.joint_names[number]}"
            joint = self._joint(number, kind, parent, child, frame @ anchor)
            self.joints[joint.name] = joint
            if not ends:
                self.links[child] = UrdfLink()
            parent, frame = child, back
        if parent != name:
            self._fix(parent, name, frame)

    def _joint(
        self, number: int, kind: str, parent: str, child: str, frame: FloatArray
    ) -> UrdfJoint:
        model, name = self.model, self.joint_names[number]
        if kind in ("floating", "spherical"):
            return UrdfJoint(name, kind, parent, child, frame)
        dof = int(model.jnt_dofadr[number])
        limited = model.jnt_limited[number] and self._on("LIMIT", "CONSTRAINT")
        lower, upper = model.jnt_range[number].tolist() if limited else (-math.inf, math.inf)
        axis = np.array(model.jnt_axis[number])
        least, most = self._forces(number)
        damping = float(np.ravel(model.dof_damping[dof])[0]) + self._of_actuators(number, "damping")
        damping = damping if self._on("DAMPER") else 0.0
        armature = float(model.dof_armature[dof]) + self._of_actuators(number, "armature")
        rubs = self._on("FRICTIONLOSS", "CONSTRAINT")
        if kind == "revolute" and damping > max(most, -least):
            self.remarks.add(
                "damping above the torque limit of a joint at 1 rad/s is kept; if it models a "
                "controller, set viscous_friction of the links",
                f"{name!r} ({damping:g} N m s/rad of {most:g} N m)",
            )
        leader, factor, offset = self.followed.get(number, (number, 1.0, 0.0))
        joint = UrdfJoint(
            name, kind, parent, child, frame, axis,
            limits={"q": (lower, upper), "tau": (least, most)},
            damping=damping,
            friction=float(model.dof_frictionloss[dof]) if rubs else 0.0,
            armature=armature,
            leader=None if leader in (None, number) else self.joint_names[leader],
            multiplier=factor,
            offset=offset,
        )  # fmt: skip
        # MuJoCo gives a body's pose at the reference position of the joint.
        joint = replace(joint, frame=frame @ joint_motion(joint, -self._reference(number)))
        if leader is None:  # tied to a constant position
            frame = joint.frame @ joint_motion(joint, offset)
            return UrdfJoint(name, "fixed", parent, child, frame)
        return joint

    def _reference(self, number: int) -> float:
        return float(self.model.qpos0[self.model.jnt_qposadr[number]])

    def _followed(self) -> dict[int, tuple[int | None, float, float]]:
        """Return the leader (or None), factor and offset of each joint that an equality ties."""
        model, tied = self.model, dict[int, tuple[int | None, float, float]]()
        for k in np.flatnonzero(model.eq_active0).tolist():
            kind = self._kind("mjtEq", model.eq_type[k])
            constant, slope, *curved = model.eq_data[k][:5]
            holds = self._on("EQUALITY", "CONSTRAINT") and not any(curved)
            if kind not in ("JOINT", "TENDON") or not holds:
                continue
            terms, total = self._terms(kind, int(model.eq_obj1id[k]))
            if (other := int(model.eq_obj2id[k])) >= 0:
                others, rest = self._terms(kind, other)
                total -= slope * rest
                for joint, factor in others.items():
                    terms[joint] = terms.get(joint, 0.0) - slope * factor
            # The equality says: the sum of terms times positions equals the total.
            total += constant
            joints = [joint for joint, factor in terms.items() if factor]
            first = next((joint for joint in joints if joint not in tied), None)
            if first is None or len(joints) > 2:
                continue
            joints.remove(first)
            leader = head = joints[0] if joints else None
            while head in tied:
                head = tied[head][0]
            if head == first:  # a second equality of tied joints
                continue
            factor = -terms[leader] / terms[first] if leader is not None else 1.0
            tied[first] = leader, float(factor), float(total / terms[first])
        return tied

    def _terms(self, kind: str, number: int) -> tuple[dict[int, float], float]:
        """Return factors of the joints on a side of an equality, and its reference length."""
        model = self.model
        if kind == "JOINT":
            return {number: 1.0}, self._reference(number)
        first = int(model.tendon_adr[number])
        wraps = range(first, first + int(model.tendon_num[number]))
        if any(self._kind("mjtWrap", model.wrap_type[k]) != "JOINT" for k in wraps):
            return {}, 0.0
        terms = {int(model.wrap_objid[k]): float(model.wrap_prm[k]) for k in wraps}
        return terms, float(model.tendon_length0[number])

    def held(self) -> dict[int, float]:
        """Return positions of joints by number, rad or m, if all leading joints are at zero."""

        def place(joint: int) -> float:
            leader, factor, offset = self.followed.get(joint, (None, 0.0, 0.0))
            return offset if leader is None else factor * place(leader) + offset

        kinds = map(partial(self._kind, "mjtJoint"), self.model.jnt_type)
        return {k: place(k) for k, kind in enumerate(kinds) if kind in ("SLIDE", "HINGE")}

    def _drives(self, number: int) -> Iterator[tuple[int, float]]:
        """Yield a joint and all joints that follow it, with the factors of their speeds."""
        yield number, 1.0
        for joint, (leader, factor, _) in self.followed.items():
            if leader == number:
                yield from ((k, factor * further) for k, further in self._drives(joint))

    def _forces(self, number: int) -> tuple[float, float]:
        """Return the smallest and largest torque of the actuators of a joint and its followers.

        A side without a limit is infinite.
        """
        model, ranges, alone = self.model, list[FloatArray](), (-math.inf, math.inf)
        for joint, factor in self._drives(number):
            least, most = -math.inf, math.inf
            if model.jnt_actfrclimited[joint]:
                least, most = model.jnt_actfrcrange[joint].tolist()
            if own := [np.sort(gear * limits) for _, gear, limits in self._actuators(joint)]:
                ranges.append(np.sort(factor * np.clip(np.sum(own, axis=0), least, most)))
            elif joint == number:
                alone = least, most
        least, most = np.sum(ranges, axis=0).tolist() if ranges else alone
        return least, most

    def _actuators(self, joint: int) -> Iterator[tuple[int, float, FloatArray]]:
        """Yield number, gear and force limits [2] of each actuator that acts on a joint."""
        model = self.model
        for k in range(model.nu):
            direct = self._kind("mjtTrn", model.actuator_trntype[k]) in ("JOINT", "JOINTINPARENT")
            gear, limits = float(model.actuator_gear[k, 0]), np.array([-np.inf, np.inf])
            controlled = model.actuator_gainprm[k].any()
            if not (direct and gear and controlled) or model.actuator_trnid[k, 0] != joint:
                continue
            gain = self._kind("mjtGain", model.actuator_gaintype[k])
            bias = self._kind("mjtBias", model.actuator_biastype[k])
            if model.actuator_forcelimited[k]:
                limits = model.actuator_forcerange[k]
            elif model.actuator_ctrllimited[k] and (gain, bias) == ("FIXED", "NONE"):  # a motor
                limits = model.actuator_ctrlrange[k] * model.actuator_gainprm[k, 0]
            yield k, gear, limits

    def _of_actuators(self, joint: int, name: str) -> float:
        """Return the armature or damping that the actuators of a joint add to its own."""
        values = getattr(self.model, f"actuator_{name}", np.zeros(self.model.nu))
        return float(sum(gear**2 * values[k] for k, gear, _ in self._actuators(joint)))

    def _shapes(self, body: int) -> Iterator[Shape]:
        model = self.model
        first = int(model.body_geomadr[body])
        for k in range(first, first + int(model.body_geomnum[body])):
            kind = self._kind("mjtGeom", model.geom_type[k])
            pose, size, path = _pose(model.geom_pos[k], model.geom_quat[k]), model.geom_size[k], ""
            if kind == "MESH":
                mesh = int(model.geom_dataid[k])
                shift = _pose(model.mesh_pos[mesh], model.mesh_quat[mesh])
                pose, size = pose @ np.linalg.inv(shift), model.mesh_scale[mesh]
                text = bytes(model.paths)[model.mesh_pathadr[mesh] :].split(b"\0")[0].decode()
                path = str(self.folder / text)
                if not text:
                    self.remarks.add("meshes without a file are left out", self.bodies[body])
                    continue
            elif kind in SOLIDS:
                half = {"SPHERE": [1.0], "BOX": [2.0, 2.0, 2.0]}.get(kind, [1.0, 2.0])
                size = size[: len(half)] * half
            else:
                self.remarks.add("geoms of other kinds than solids and meshes are left out", kind)
                continue
            material = int(model.geom_matid[k])
            color = model.geom_rgba[k] if material < 0 else model.mat_rgba[material]
            collides = model.geom_contype[k] or model.geom_conaffinity[k]
            role, link = "collision" if collides else "visual", self.bodies[body]
            solid, color = SOLIDS.get(kind, "mesh"), tuple(color.tolist())
            yield Shape(0, pose, solid, np.array(size), role, link, path, color)


def _pose(position: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Return the transform [4,4] of a position and a quaternion, scalar first."""
    return without_rounding(transform_of(of_quaternion(quaternion), position))
