"""Forces of a MuJoCo model that a serial chain does not have, found by MuJoCo's inverse dynamics.

An element is reported by name if the torques of the arm's joints change once it is switched off.
Without all such elements, MuJoCo's torques must agree with those of the robot.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.fast_calls import deferred_call
from microbot_ocp.robot._dynamics import COULOMB_SMOOTHING, inverse_dynamics
from microbot_ocp.robot._model import Robot
from microbot_ocp.robot.files._xml import Remarks

STATES = 2  # random states; a force that vanishes at one of them acts at the other
TENDON = "stiffness stiffnesspoly damping dampingpoly armature frictionloss limited"
# Kind of element, arrays of the model with its forces, and start of the remark.
FORCES = (
    ("JOINT", ("jnt_stiffness", "jnt_stiffnesspoly"), "springs of joints are left out"),
    ("DOF", ("dof_dampingpoly",), "damping that is not proportional to the speed is left out"),
    (
        "TENDON",
        tuple(f"tendon_{name}" for name in TENDON.split()),
        "springs, damping, friction, inertia and limits of tendons are left out",
    ),
    (
        "ACTUATOR",
        ("actuator_armature", "actuator_damping"),
        "inertia and damping of actuators that do not act on a joint are left out",
    ),
    ("BODY", ("body_gravcomp",), "compensation of gravity is left out: bodies have their weight"),
    ("EQUALITY", ("eq_active0",), "equalities are left out: they close loops or hold joints"),
)


class Forces:
    """Inverse dynamics of a model in which only the joints of an arm move."""

    def __init__(
        self, mujoco: Any, model: Any, robot: Robot, names: list[str], held: Mapping[int, float]
    ) -> None:
        """Prepare a model; ``held`` has positions, rad or m, of the fixed joints by number."""
        self.mujoco, self.model, self.robot = mujoco, copy.copy(model), robot
        for name in ("CONTACT", "ACTUATION"):
            self.model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))
        # The comparison excludes friction, which is smoothed here; limits of tendons always act.
        self.model.dof_frictionloss[:], self.model.jnt_limited[:] = 0.0, 0
        self.model.tendon_range[:] = 1e3  # m; a shorter tendon is at its lower limit
        self.data = mujoco.MjData(self.model)
        joints = [names.index(name) for name in robot.chain.joint_names]
        self.places, self.columns = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self.held = model.qpos0.copy()
        for joint, place in held.items():
            self.held[model.jnt_qposadr[joint]] = place
        shape = (3, STATES, robot.joint_count)
        self.states = np.random.default_rng(0).uniform(-1.0, 1.0, shape)

    def torques(self) -> FloatArray:
        """Return torques [K,n] of the arm's joints."""
        q, *rates = self.states
        matrix, data, rows = self.robot.transmission, self.data, []
        for place, speed, change in zip(self.robot.chain_positions(q), *rates, strict=True):
            self.mujoco.mj_resetData(self.model, data)
            data.qpos[:] = self.held
            data.qpos[self.places] = place
            data.qvel[self.columns], data.qacc[self.columns] = matrix @ speed, matrix @ change
            self.mujoco.mj_inverse(self.model, data)
            rows.append(data.qfrc_inverse[self.columns] @ matrix)
        return np.array(rows)

    def remark(self, remarks: Remarks) -> None:
        """Add remarks on all elements whose forces on the arm are ignored."""
        for kind, names, words in FORCES:
            arrays = [getattr(self.model, name) for name in names if hasattr(self.model, name)]
            acting = self._acting(kind, arrays)
            for number in acting:
                name = self._name(kind, number)
                if kind == "EQUALITY" and self.model.eq_data[number, 2:5].any():
                    self._refuse_curved(number, name)
                remarks.add(words, name)
            for array in arrays:
                array[acting] = 0
        before = self.torques()
        self.model.opt.density = self.model.opt.viscosity = 0.0
        after = self.torques()
        if self._differ(before, after):
            remarks.add("forces of air or water around the arm are left out")
        rubbing = np.tanh(self.states[1] / COULOMB_SMOOTHING)
        ours = deferred_call(inverse_dynamics(self.robot))(*self.states)
        ours = ours - self.robot.friction_of("coulomb_friction") * rubbing
        if self._differ(ours, after):
            worst = float(np.abs(ours - after).max() / np.abs(after).max())
            remarks.add(
                "MuJoCo's torques differ because of forces that are not read, such as those of "
                "plugins and flexible bodies",
                f"by {100 * worst:.2g} %",
            )
        self._remark_actuators(remarks)

    def _acting(self, kind: str, parts: list[Any]) -> list[int]:
        """Return numbers of the elements that change the torques of the arm and are not read."""
        given = sorted({int(k) for part in parts for k in np.nonzero(part)[0]})
        given = [k for k in given if kind != "ACTUATOR" or not self._direct(k)]
        return [k for k in given if self._acts(parts, [k])] if self._acts(parts, given) else []

    def _acts(self, parts: list[Any], rows: list[int]) -> bool:
        before, kept = self.torques(), [part[rows].copy() for part in parts]
        for part in parts:
            part[rows] = 0
        after = self.torques()
        for part, values in zip(parts, kept, strict=True):
            part[rows] = values
        return self._differ(before, after)

    def _differ(self, ours: FloatArray, theirs: FloatArray) -> bool:
        return bool(np.abs(ours - theirs).max() > ROUNDING * max(1.0, np.abs(theirs).max()))

    def _name(self, kind: str, number: int) -> str:
        if kind == "DOF":
            kind, number = "JOINT", int(self.model.dof_jntid[number])
        of = getattr(self.mujoco.mjtObj, f"mjOBJ_{kind}")
        name = self.mujoco.mj_id2name(self.model, int(of), number)
        return repr(name) if name else f"{kind.lower()} {number}"

    def _direct(self, actuator: int) -> bool:
        """Return True if an actuator acts on a joint."""
        kind = self.mujoco.mjtTrn(self.model.actuator_trntype[actuator]).name
        return kind in ("mjTRN_JOINT", "mjTRN_JOINTINPARENT")

    def _refuse_curved(self, number: int, name: str) -> None:
        if self.mujoco.mjtEq(self.model.eq_type[number]).name in ("mjEQ_JOINT", "mjEQ_TENDON"):
            raise InputError(
                f"equality {name} ties joints of the arm by a polynomial of a degree above 1: only "
                "a factor and an offset can be read"
            )

    def _remark_actuators(self, remarks: Remarks) -> None:
        """Add remarks on actuators that are not read: no joint to act on, or no control input."""
        mujoco, model, data = self.mujoco, self.model, self.data
        mujoco.mj_forward(model, data)
        moments = np.zeros((model.nu, model.nv))
        lines = data.moment_rownnz, data.moment_rowadr, data.moment_colind
        if model.nu and model.nv:
            mujoco.mju_sparse2dense(moments, data.actuator_moment.ravel(), *lines)
        for number in np.flatnonzero(moments[:, self.columns].any(axis=1)).tolist():
            if model.actuator_biasprm[number].any() and not model.actuator_gainprm[number].any():
                words = "actuators that no control changes are left out: they act as springs"
                remarks.add(words, self._name("ACTUATOR", number))
            elif not self._direct(number):
                words = "limits of actuators that act by tendons, sites or cranks are left out"
                remarks.add(words, self._name("ACTUATOR", number))
