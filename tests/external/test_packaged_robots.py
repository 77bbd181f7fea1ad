"""Every packaged robot against pinocchio, MuJoCo and the figures of its sources.

Friction is ours alone: pinocchio knows none, MuJoCo only the viscous part, so the tests add
``viscous qd + coulomb tanh(qd / 0.01)`` by hand to what they compute. Rotor inertia is in theirs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np
import pytest
from benchmarks.mujoco_arms import mjcf, with_small_bodies

import microbot_ocp as mo
from helpers import batch, difference, random_states, sampled
from microbot_ocp.robot.files import robot_to_urdf

STATES = 1000
RELATIVE = 1e-9
SINGULAR = 1e6  # condition of M above which the last digits of an acceleration are nobody's

pin = pytest.importorskip("pinocchio")
mujoco = pytest.importorskip("mujoco")
from external.pinocchio_model import pinocchio_model  # noqa: E402

# Rotors on links that move are bodies of their own there: tests of rotors build them.
WITHOUT_ROTORS = [
    name
    for name in mo.packaged_robots()
    if all(link.rotor is None for link in mo.load_robot(name).links)
]


class Case(NamedTuple):
    robot: mo.Robot
    model: pin.Model
    data: pin.Data
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray

    @property
    def friction(self) -> np.ndarray:
        """Torque [N,n] of the joints' friction, from its documented formula."""
        return friction(self.robot, self.qd)

    @property
    def friction_slope(self) -> np.ndarray:
        """Derivative [N,n,n] of the friction by the speeds."""
        viscous, coulomb = coefficients(self.robot)
        return np.stack(
            [np.diag(viscous + coulomb / 0.01 / np.cosh(qd / 0.01) ** 2) for qd in self.qd]
        )


def coefficients(robot: mo.Robot) -> tuple[np.ndarray, np.ndarray]:
    viscous = np.array([link.viscous_friction for link in robot.links])
    return viscous, np.array([link.coulomb_friction for link in robot.links])


def friction(robot: mo.Robot, qd: np.ndarray) -> np.ndarray:
    viscous, coulomb = coefficients(robot)
    return viscous * qd + coulomb * np.tanh(qd / 0.01)


def symmetric(upper: np.ndarray) -> np.ndarray:
    return np.triu(upper) + np.triu(upper, 1).T


def slope(function: ca.Function, wrt: str) -> ca.Function:
    """The function's first derivative by one input, [rows, n]."""
    names = function.name_in()
    inputs = [ca.SX.sym(name, function.size1_in(name)) for name in names]
    found = ca.jacobian(function(*inputs), inputs[names.index(wrt)])
    return ca.Function("slope", inputs, [ca.densify(found)])


@pytest.fixture(scope="module", params=sampled(WITHOUT_ROTORS, 2))
def case(request: pytest.FixtureRequest) -> Case:
    robot = mo.load_robot(request.param)
    model = pinocchio_model(robot)
    q, qd, qdd = random_states(robot, STATES, seed=7)
    # some joints at rest or nearly so, where friction is all slope
    qd[:50] *= 1e-3
    return Case(robot, model, model.createData(), q, qd, qdd)


def test_inverse_dynamics_and_its_derivatives(case: Case) -> None:
    states = (case.q, case.qd, case.qdd)
    tau, by_q, by_qd, by_qdd = [], [], [], []
    for state in zip(*states, strict=True):
        tau.append(pin.rnea(case.model, case.data, *state).copy())
        slopes = pin.computeRNEADerivatives(case.model, case.data, *state)
        for found, into in zip(slopes, (by_q, by_qd, by_qdd), strict=True):
            into.append(found.copy())
    ours = mo.inverse_dynamics(case.robot)
    assert difference(batch(ours, *states), np.array(tau) + case.friction) < RELATIVE
    theirs = {
        "q": np.array(by_q),
        "qd": np.array(by_qd) + case.friction_slope,
        "qdd": np.array([symmetric(m) for m in by_qdd]),
    }
    for wrt, expected in theirs.items():
        assert difference(batch(slope(ours, wrt), *states), expected) < RELATIVE, wrt


def test_mass_matrix_and_its_derivative(case: Case) -> None:
    """d(M v)/dq, v = qdd: what changes in the derivative of RNEA at rest when qdd is put in."""
    zero = np.zeros(case.robot.joint_count)
    matrices, slopes = [], []
    for q, v in zip(case.q, case.qdd, strict=True):
        matrices.append(symmetric(pin.crba(case.model, case.data, q)))
        with_v = pin.computeRNEADerivatives(case.model, case.data, q, zero, v)[0].copy()
        slopes.append(with_v - pin.computeRNEADerivatives(case.model, case.data, q, zero, zero)[0])
    ours = mo.mass_matrix(case.robot)
    assert difference(batch(ours, case.q), matrices) < RELATIVE
    q, v = ca.SX.sym("q", len(zero)), ca.SX.sym("v", len(zero))
    product = ca.Function("product", [q, v], [ca.densify(ca.jacobian(ours(q) @ v, q))])
    assert difference(batch(product, case.q, case.qdd), slopes) < RELATIVE


def test_coriolis_torque_and_its_derivatives(case: Case) -> None:
    zero = np.zeros(case.robot.joint_count)
    tau, by_q, by_qd = [], [], []
    for q, qd in zip(case.q, case.qd, strict=True):
        gravity = pin.computeGeneralizedGravity(case.model, case.data, q).copy()
        tau.append(pin.rnea(case.model, case.data, q, qd, zero) - gravity)
        at_rest = pin.computeGeneralizedGravityDerivatives(case.model, case.data, q).copy()
        slopes = pin.computeRNEADerivatives(case.model, case.data, q, qd, zero)
        by_q.append(slopes[0] - at_rest)
        by_qd.append(slopes[1].copy())
    q, qd = ca.SX.sym("q", len(zero)), ca.SX.sym("qd", len(zero))
    torque = mo.coriolis_matrix(case.robot)(q, qd) @ qd
    states = (case.q, case.qd)
    for expression, theirs in (
        (torque, tau),
        (ca.jacobian(torque, q), by_q),
        (ca.jacobian(torque, qd), by_qd),
    ):
        ours = ca.Function("ours", [q, qd], [ca.densify(expression)])
        assert difference(batch(ours, *states), theirs) < RELATIVE


def test_gravity_torque_and_its_derivative(case: Case) -> None:
    tau, by_q = [], []
    for q in case.q:
        tau.append(pin.computeGeneralizedGravity(case.model, case.data, q).copy())
        by_q.append(pin.computeGeneralizedGravityDerivatives(case.model, case.data, q).copy())
    ours = mo.gravity_torque(case.robot)
    assert difference(batch(ours, case.q), tau) < RELATIVE
    assert difference(batch(slope(ours, "q"), case.q), by_q) < RELATIVE


@pytest.mark.slow
def test_forward_dynamics_and_its_derivatives(case: Case) -> None:
    well = batch(mo.robot.mass_matrix_condition(case.robot), case.q)[:, 0] < SINGULAR
    assert well.mean() > 0.99
    q, qd, tau = case.q[well], case.qd[well], 10.0 * case.qdd[well]
    at_bodies = tau - case.friction[well]
    qdd, by_q, by_qd, by_tau = [], [], [], []
    for state in zip(q, qd, at_bodies, strict=True):
        qdd.append(pin.aba(case.model, case.data, *state).copy())
        slopes = pin.computeABADerivatives(case.model, case.data, *state)
        for found, into in zip(slopes, (by_q, by_qd, by_tau), strict=True):
            into.append(found.copy())
    inverse = np.array([symmetric(m) for m in by_tau])
    ours = mo.forward_dynamics(case.robot)
    assert difference(batch(ours, q, qd, tau), qdd) < RELATIVE
    theirs = {
        "q": np.array(by_q),
        "qd": np.array(by_qd) - inverse @ case.friction_slope[well],
        "tau": inverse,
    }
    for wrt, expected in theirs.items():
        assert difference(batch(slope(ours, wrt), q, qd, tau), expected) < RELATIVE, wrt


def test_tool_pose_jacobian_and_its_derivative(case: Case) -> None:
    """The Jacobian's derivative along the motion, d J / dt = sum over k of dJ/dq_k qd_k."""
    tool, aligned = case.model.getFrameId("tool"), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    poses, jacobians, changes = [], [], []
    for q, qd in zip(case.q, case.qd, strict=True):
        pin.computeJointJacobiansTimeVariation(case.model, case.data, q, qd)
        pin.framesForwardKinematics(case.model, case.data, q)
        poses.append(case.data.oMf[tool].homogeneous.copy())
        jacobians.append(pin.computeFrameJacobian(case.model, case.data, q, tool, aligned).copy())
        pin.forwardKinematics(case.model, case.data, q, qd, 0.0 * qd)
        drift = pin.getFrameClassicalAcceleration(case.model, case.data, tool, aligned)
        changes.append(np.concatenate([drift.linear, drift.angular]))
    ours = mo.jacobian(case.robot)
    assert difference(batch(mo.forward_kinematics(case.robot), case.q), poses) < RELATIVE
    assert difference(batch(ours, case.q), jacobians) < RELATIVE
    q, qd = ca.SX.sym("q", case.q.shape[1]), ca.SX.sym("qd", case.q.shape[1])
    change = ca.Function("change", [q, qd], [ca.jtimes(ours(q), q, qd) @ qd])
    assert difference(batch(change, case.q, case.qd), changes) < RELATIVE


@pytest.fixture(scope="module", params=sampled(WITHOUT_ROTORS, 2))
def rigid(request: pytest.FixtureRequest) -> mo.Robot:
    return with_small_bodies(mo.load_robot(request.param))


def test_forward_dynamics_is_the_one_of_mujoco(rigid: mo.Robot) -> None:
    model = mujoco.MjModel.from_xml_string(mjcf(rigid))
    data = mujoco.MjData(model)
    q, qd, qdd = random_states(rigid, STATES, seed=8)
    tau = 10.0 * qdd
    _, coulomb = coefficients(rigid)
    theirs = []
    applied = tau - coulomb * np.tanh(qd / 0.01)
    for data.qpos[:], data.qvel[:], data.qfrc_applied[:] in zip(q, qd, applied, strict=True):
        mujoco.mj_forward(model, data)
        theirs.append(data.qacc.copy())
    assert difference(batch(mo.forward_dynamics(rigid), q, qd, tau), theirs) < RELATIVE


@pytest.mark.parametrize("name", ["panda", "puma560", "stanford", "ur5e"])
def test_written_urdf_is_what_mujoco_reads(name: str) -> None:
    """Bodies, joints and damping; it takes no rotor inertia and no gravity from a URDF."""
    robot = mo.load_robot(name)
    model = mujoco.MjModel.from_xml_string(robot_to_urdf(robot))
    model.opt.gravity[:] = robot.gravity
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT  # dry friction and limits
    model.dof_armature[:] = [link.armature for link in robot.links]
    data = mujoco.MjData(model)
    q, qd, qdd = random_states(robot, 100, seed=10)
    theirs = []
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(q, qd, qdd, strict=True):
        mujoco.mj_inverse(model, data)
        theirs.append(data.qfrc_inverse.copy())
    _, coulomb = coefficients(robot)
    ours = batch(mo.inverse_dynamics(robot), q, qd, qdd) - coulomb * np.tanh(qd / 0.01)
    assert difference(ours, theirs) < RELATIVE
    assert model.jnt_range[:, 1] == pytest.approx(robot.limits.q_max)


@pytest.mark.slow
def test_half_a_second_of_motion_is_that_of_mujoco(rigid: mo.Robot) -> None:
    """From a random start under half the torque that holds it, with all its friction.

    MuJoCo takes Runge-Kutta steps of 0.05 ms; ours is integrated to 1e-12 by steps of its own.
    """
    count, step, steps = rigid.joint_count, 5e-5, 10_000
    _, coulomb = coefficients(rigid)
    start = np.random.default_rng(9).uniform(-1.0, 1.0, count)
    tau = 0.5 * np.array(mo.gravity_torque(rigid)(start)).ravel()

    model = mujoco.MjModel.from_xml_string(mjcf(rigid))
    model.opt.timestep, model.opt.integrator = step, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qpos[:], data.qfrc_applied[:] = start, tau

    def add_coulomb(_: object, now: mujoco.MjData) -> None:
        now.qfrc_passive[:] -= coulomb * np.tanh(now.qvel / 0.01)

    if coulomb.any():
        mujoco.set_mjcb_passive(add_coulomb)
    try:
        mujoco.mj_step(model, data, steps)
    finally:
        mujoco.set_mjcb_passive(None)

    x = ca.SX.sym("x", 2 * count)
    rate = ca.vertcat(x[count:], mo.forward_dynamics(rigid)(x[:count], x[count:], tau))
    problem = {"x": x, "ode": rate}
    grid = np.linspace(0.0, step * steps, 201)
    options = {"abstol": 1e-12, "reltol": 1e-12, "max_num_steps": 200_000}
    ours = ca.integrator("ours", "cvodes", problem, 0.0, grid, options)
    end = np.array(ours(x0=np.concatenate([start, np.zeros(count)]))["xf"])[:, -1]
    assert np.abs(end[:count] - start).max() > 0.1  # it did move
    assert difference(end[None], np.concatenate([data.qpos, data.qvel])[None]) < 1e-7


# --------------------------------------------------------------------------------------------------
# The Puma 560 of roboticstoolbox-python 1.5.0 (P. Corke; pip, with numpy 2.4.6): figures of its
# models.DH.Puma560, which brings too much along to be installed for this test. `gravload` and
# `inertia` at qn are those printed in Corke, Robotics, Vision and Control, section on arm dynamics.
# Poses: qz zero, qr ready, qs stretched, qn nominal. Speeds and accelerations are chosen here.

PUMA_SPEED = np.array([1.0, -0.5, 0.8, -1.2, 0.9, 1.5])
PUMA_ACCELERATION = np.array([2.0, -3.0, 1.0, 4.0, -2.0, 5.0])
QN = np.array([0.0, np.pi / 4, -np.pi, 0.0, np.pi / 4, 0.0])
PUMA_POSES = {  # pose: q, fkine(q).t, gravload(q), nofriction().rne(q, qd, qdd)
    "qz": (
        np.zeros(6),
        [0.4521, -0.15005, 1.10363],
        [0.0, 37.48366665, 0.24892875, 0.0, 0.0, 0.0],
        [
            *(7.875113617652, 24.62200773468, 0.281675985038),
            *(0.7732025044947, -0.345714473554, 0.97076252834),
        ],
    ),
    "qr": (
        np.array([0.0, np.pi / 2, -np.pi / 2, 0.0, 0.0, 0.0]),
        [0.0203, -0.15005, 1.53543],
        [0.0, -0.77523525, 0.24892875, 0.0, 0.0, 0.0],
        [
            *(7.034002891586, -17.2996915884, -1.329201952712),
            *(0.7732025044947, -0.350999705554, 0.97076252834),
        ],
    ),
    "qs": (
        np.array([0.0, 0.0, -np.pi / 2, 0.0, 0.0, 0.0]),
        [0.8636, -0.15005, 0.65153],
        [0.0, 46.006938, 8.7722001, 0.0, 0.0282528, 0.0],
        [
            *(9.980150958094, 31.0728542311, 7.447919804788),
            *(0.7708405044947, -0.321473081554, 0.97073052834),
        ],
    ),
    "qn": (
        QN,
        [0.5963031485746, -0.15005, 0.6574757323419],
        [0.0, 31.63988037836, 6.035138023011, 0.0, 0.0282528, 0.0],
        [
            *(9.702462226396, 18.5022329813, 5.658536764592),
            *(0.7642962353789, -0.3200625654795, 0.9707040301003),
        ],
    ),
}
# rne(qn, qd, qdd): with the viscous friction alone, with Coulomb friction set to the mean of its
# two directions, and with the two as they are
PUMA_VISCOUS = [
    *(15.50428399435, 13.75379866039, 8.842877556889),
    *(0.2703219597423, 0.06449215336239, 1.29443891001),
]
PUMA_MEAN_COULOMB = [
    *(41.48789049435, 3.134021160385, 15.20707410689),
    *(-0.7979894602577, 0.9189373933624, 1.84887869001),
]
PUMA_TWO_SIDED = [
    *(40.23566849435, 6.098933660385, 15.93210915689),
    *(-1.014693200258, 0.7304991333624, 1.59811547001),
]
PUMA_INERTIA = {  # inertia(qn), entries above 1e-12
    (0, 0): 3.659375412153,
    (0, 1): -0.4043612460415,
    (0, 2): 0.1006136477798,
    (0, 3): -0.002516955828031,
    (1, 1): 4.413741933636,
    (1, 2): 0.3508906649564,
    (1, 4): 0.002359513067895,
    (2, 2): 0.937841575215,
    (2, 4): 0.00148016638852,
    (3, 3): 0.1925317061237,
    (3, 5): 2.828427124746e-05,
    (4, 4): 0.171348451657,
    (5, 5): 0.194104505668,
}


@pytest.fixture(scope="module")
def puma() -> mo.Robot:
    return mo.load_robot("puma560")


def without(robot: mo.Robot, *kinds: str) -> mo.Robot:
    return robot.with_links([replace(link, **dict.fromkeys(kinds, 0.0)) for link in robot.links])


def torque(robot: mo.Robot, q: np.ndarray) -> np.ndarray:
    return np.array(mo.inverse_dynamics(robot)(q, PUMA_SPEED, PUMA_ACCELERATION)).ravel()


@pytest.mark.parametrize("pose", PUMA_POSES)
def test_puma_torques_at_the_published_poses(puma: mo.Robot, pose: str) -> None:
    q, position, held, moving = PUMA_POSES[pose]
    tool = np.array(mo.forward_kinematics(puma)(q))[:3, 3]
    assert tool == pytest.approx(position, abs=1e-12)
    assert np.array(mo.gravity_torque(puma)(q)).ravel() == pytest.approx(held, abs=1e-10)
    frictionless = without(puma, "viscous_friction", "coulomb_friction")
    assert torque(frictionless, q) == pytest.approx(moving, rel=1e-11, abs=1e-11)


def test_puma_friction_is_referred_to_the_joints(puma: mo.Robot) -> None:
    viscous = torque(without(puma, "coulomb_friction"), QN)
    assert viscous == pytest.approx(PUMA_VISCOUS, rel=1e-11)
    # tanh is 1 to the last digit at these speeds
    assert torque(puma, QN) == pytest.approx(PUMA_MEAN_COULOMB, rel=1e-11)
    # the mean of the two directions is off by half of what they differ
    off = np.abs(torque(puma, QN) - PUMA_TWO_SIDED)
    assert off == pytest.approx(
        [1.252222, 2.9649125, 0.72503505, 0.21670374, 0.18843826, 0.25076322]
    )


def test_puma_mass_matrix_has_the_motors_in_it(puma: mo.Robot) -> None:
    expected = np.zeros((6, 6))
    for (i, j), value in PUMA_INERTIA.items():
        expected[i, j] = expected[j, i] = value
    assert np.array(mo.mass_matrix(puma)(QN)) == pytest.approx(expected, rel=1e-11, abs=1e-13)
