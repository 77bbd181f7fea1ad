"""Robots from MJCF files, by MuJoCo's own parser and compiler.

What MuJoCo compiles (classes, defaults, includes, inertias of geoms, angles in degrees) is taken
from its model, as links and joints like those of a URDF; the chain is then read as that of a URDF.
Format: https://mujoco.readthedocs.io/en/stable/XMLreference.html.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming
from microbot_ocp._base.needed import needed
from microbot_ocp._base.reading import bytes_of
from microbot_ocp.robot._model import Robot
from microbot_ocp.robot._shapes import Shape
from microbot_ocp.robot._transforms import of_quaternion, transform_of, without_dust
from microbot_ocp.robot.files._urdf_file import Inertial, UrdfFile, UrdfJoint, UrdfLink
from microbot_ocp.robot.files._urdf_reader import PARALLEL, joint_motion, robot_of
from microbot_ocp.robot.files._xml import Remarks

KINDS = {"FREE": "floating", "BALL": "spherical", "SLIDE": "prismatic", "HINGE": "revolute"}
SOLIDS = {"SPHERE": "sphere", "CAPSULE": "capsule", "CYLINDER": "cylinder", "BOX": "box"}


def load_mjcf(
    path: str | Path, tip: str | None = None, *, parallel_tolerance: float = PARALLEL
) -> Robot:
    """Read the chain from the world to one body or site of a MuJoCo file.

    Joint names, positive directions and zero positions are those of the file, and the base frame is
    that of the world. Armature, damping and dry friction of a joint are taken as they stand, the
    torque limits from force ranges of its actuators and its own; MJCF has no limits of velocities
    or accelerations: give them by :meth:`~microbot_ocp.Robot.with_limits`.

    Parameters
    ----------
    path : str or Path
        An MJCF file, such as those of MuJoCo Menagerie; read by the package ``mujoco``, which is
        the extra ``mjcf``.
    tip : str, optional
        Body or site at the end of the chain, whose frame is the tool's; needed where the file has
        several arms. Joints that are not on the way to it are held at zero.
    parallel_tolerance : float
        As in :func:`load_urdf`.

    Returns
    -------
    Robot

    Raises
    ------
    InputError
        A file that MuJoCo cannot read, with what it says; no moving joint; several arms without
        ``tip``; the extra ``mjcf`` is missing.

    Warns
    -----
    RobotFileWarning
        What a serial chain has no place for: springs, compensated gravity, free bodies; and damping
        that alone takes more than a joint's torque at 1 rad/s, as is usual where it stands for a
        controller's.

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
    checks.number("parallel_tolerance", parallel_tolerance, "rad", at_least=0.0, at_most=0.1)
    mujoco = needed("mujoco", "reading MJCF files needs", "mjcf")
    bytes_of(path, "robot file")  # what cannot be read is said as of other files
    origin, remarks = Path(path).name, Remarks()
    with naming(f"{origin}: "):
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as problem:
            reason = " ".join(str(problem).split())
            raise InputError(f"MuJoCo cannot read it: {reason}") from None
        content = _Model(mujoco, model, Path(path).absolute().parent, remarks).file()
        robot = robot_of(content, remarks, tip, parallel_tolerance)
    remarks.warn(origin)
    return robot


class _Model:
    """A compiled model as links and joints."""

    def __init__(self, mujoco: Any, model: Any, folder: Path, remarks: Remarks) -> None:
        self.mujoco, self.model, self.folder, self.remarks = mujoco, model, folder, remarks
        enum = mujoco.mjtObj
        self.bodies = self._names(enum.mjOBJ_BODY, model.nbody, "body")
        self.joint_names = self._names(enum.mjOBJ_JOINT, model.njnt, "joint")
        self.links: dict[str, UrdfLink] = {}
        self.joints: dict[str, UrdfJoint] = {}

    def _names(self, kind: Any, count: int, word: str) -> list[str]:
        return [
            self.mujoco.mj_id2name(self.model, int(kind), k) or f"{word} {k}" for k in range(count)
        ]

    def _kind(self, enum: str, value: int) -> str:
        """Return the name of a constant of MuJoCo: HINGE of mjJNT_HINGE."""
        return getattr(self.mujoco, enum)(value).name.partition("_")[2]

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
        if np.any(model.body_gravcomp):
            self.remarks.add("compensation of gravity is left out: bodies have their weight")
        if model.opt.density or model.opt.viscosity:
            self.remarks.add("forces of the air or water around it are left out")
        off = model.opt.disableflags & self.mujoco.mjtDisableBit.mjDSBL_GRAVITY
        gravity = [0.0] * 3 if off else model.opt.gravity.tolist()
        name = bytes(model.names).split(b"\0")[0].decode() or "robot"
        return UrdfFile(name, self.links, self.joints, gravity, "")

    def _fix(self, parent: str, child: str, frame: FloatArray) -> None:
        name = f"to {child}"
        self.joints[name] = UrdfJoint(name, "fixed", parent, child, frame)

    def _join(self, body: int) -> None:
        """Add the joints of a body, one after another about their anchors, as MuJoCo has them."""
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
        limited = model.jnt_limited[number]
        lower, upper = model.jnt_range[number].tolist() if limited else (-math.inf, math.inf)
        axis = np.array(model.jnt_axis[number])
        least, most = self._forces(number)
        damping = float(np.ravel(model.dof_damping[dof])[0])
        if np.any(model.jnt_stiffness[number]):
            self.remarks.add("springs of joints are left out", repr(name))
        if kind == "revolute" and damping > max(most, -least):
            self.remarks.add(
                "damping that takes more than the torque of a joint at 1 rad/s is taken as it "
                "stands; where it stands for a controller's, set viscous_friction of the links",
                f"{name!r} ({damping:g} N m s/rad of {most:g} N m)",
            )
        leader, factor, offset = self._leader(number)
        joint = UrdfJoint(
            name, kind, parent, child, frame, axis, lower, upper,
            damping=damping,
            friction=float(model.dof_frictionloss[dof]),
            leader=leader,
            multiplier=factor,
            offset=offset,
            extra={
                "armature": repr(float(model.dof_armature[dof])),
                "tau_min": repr(least),
                "tau_max": repr(most),
            },
        )  # fmt: skip
        # the file's pose is that at the reference
        return replace(joint, frame=frame @ joint_motion(joint, -self._reference(number)))

    def _reference(self, number: int) -> float:
        return float(self.model.qpos0[self.model.jnt_qposadr[number]])

    def _leader(self, number: int) -> tuple[str | None, float, float]:
        """Return joint that another follows by an equality, with the factor and the offset."""
        model = self.model
        for k in range(model.neq):
            same = self._kind("mjtEq", model.eq_type[k]) == "JOINT" and model.eq_active0[k]
            other = int(model.eq_obj2id[k])
            if same and model.eq_obj1id[k] == number and other >= 0:
                constant, factor = model.eq_data[k][:2].tolist()
                shift = self._reference(number) - factor * self._reference(other)
                return self.joint_names[other], factor, constant + shift
        return None, 1.0, 0.0

    def _forces(self, number: int) -> tuple[float, float]:
        """Give least and greatest torque of the actuators of a joint; infinite without a limit."""
        model, ranges = self.model, []
        for k in range(model.nu):
            direct = self._kind("mjtTrn", model.actuator_trntype[k]) == "JOINT"
            if not direct or model.actuator_trnid[k, 0] != number:
                continue
            gear, limits = model.actuator_gear[k, 0], np.array([-np.inf, np.inf])
            gain = self._kind("mjtGain", model.actuator_gaintype[k])
            bias = self._kind("mjtBias", model.actuator_biastype[k])
            if model.actuator_forcelimited[k]:
                limits = model.actuator_forcerange[k]
            elif model.actuator_ctrllimited[k] and (gain, bias) == ("FIXED", "NONE"):  # a motor
                limits = model.actuator_ctrlrange[k] * model.actuator_gainprm[k, 0]
            if gear:
                ranges.append(np.sort(gear * limits))
        least, most = np.sum(ranges, axis=0).tolist() if ranges else (-math.inf, math.inf)
        if model.jnt_actfrclimited[number]:
            lower, upper = model.jnt_actfrcrange[number].tolist()
            least, most = max(least, lower), min(most, upper)
        return least, most

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
    return without_dust(transform_of(of_quaternion(quaternion), position))
