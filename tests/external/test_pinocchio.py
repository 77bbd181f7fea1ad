"""Kinematics and dynamics against pinocchio at 1,000 random states of several robots."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from helpers import RANDOM_CHAINS, any_robot, batch, difference, random_states

pin = pytest.importorskip("pinocchio")
from external.pinocchio_model import pinocchio_model  # noqa: E402

STATES = 1000
RELATIVE = 1e-11


class Case(NamedTuple):
    robot: mo.Robot
    model: pin.Model
    data: pin.Data
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray


@pytest.fixture(scope="module", params=["microbot", *RANDOM_CHAINS])
def case(request: pytest.FixtureRequest) -> Case:
    robot = any_robot(request.param)
    model = pinocchio_model(robot)
    return Case(robot, model, model.createData(), *random_states(robot, STATES, seed=99))


def test_tool_pose_is_the_one_of_pinocchio(case: Case) -> None:
    tool = case.model.getFrameId("tool")
    theirs = []
    for q in case.q:
        pin.framesForwardKinematics(case.model, case.data, q)
        theirs.append(case.data.oMf[tool].homogeneous.copy())
    assert difference(batch(mo.forward_kinematics(case.robot), case.q), theirs) < RELATIVE


@pytest.mark.parametrize("link", ["first", "last"])
def test_link_pose_is_the_one_of_pinocchio(case: Case, link: str) -> None:
    frame = 1 if link == "first" else case.robot.joint_count
    theirs = []
    for q in case.q:
        pin.forwardKinematics(case.model, case.data, q)
        theirs.append(case.data.oMi[frame].homogeneous.copy())
    assert difference(batch(mo.forward_kinematics(case.robot, frame), case.q), theirs) < RELATIVE


def test_jacobian_is_the_one_of_pinocchio(case: Case) -> None:
    tool = case.model.getFrameId("tool")
    aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    theirs = [
        pin.computeFrameJacobian(case.model, case.data, q, tool, aligned).copy() for q in case.q
    ]
    assert difference(batch(mo.jacobian(case.robot), case.q), theirs) < RELATIVE


def test_propagated_velocities_are_those_of_pinocchio(case: Case) -> None:
    tool = case.model.getFrameId("tool")
    theirs = []
    for q, qd in zip(case.q, case.qd, strict=True):
        pin.forwardKinematics(case.model, case.data, q, qd)
        links = [case.data.v[i + 1] for i in range(case.robot.joint_count)]
        spatial = [*links, pin.getFrameVelocity(case.model, case.data, tool)]
        theirs.append(np.array([np.concatenate([v.linear, v.angular]) for v in spatial]).T)
    count = case.robot.joint_count + 1
    propagate = mo.velocity_propagation(case.robot)
    q, qd = ca.SX.sym("q", count - 1), ca.SX.sym("qd", count - 1)
    stacked = ca.Function("stacked", [q, qd], [ca.vertcat(*propagate(q, qd))])
    assert difference(batch(stacked, case.q, case.qd), theirs) < RELATIVE


def test_inverse_dynamics_is_the_one_of_pinocchio(case: Case) -> None:
    theirs = [
        pin.rnea(case.model, case.data, *state).copy()
        for state in zip(case.q, case.qd, case.qdd, strict=True)
    ]
    ours = batch(mo.inverse_dynamics(case.robot), case.q, case.qd, case.qdd)
    assert difference(ours, theirs) < RELATIVE


def test_mass_matrix_is_the_one_of_pinocchio(case: Case) -> None:
    upper = [np.triu(pin.crba(case.model, case.data, q)) for q in case.q]
    theirs = [u + np.triu(u, 1).T for u in upper]
    assert difference(batch(mo.mass_matrix(case.robot), case.q), theirs) < RELATIVE


def test_coriolis_torque_is_the_one_of_pinocchio(case: Case) -> None:
    zero = np.zeros(case.robot.joint_count)
    theirs = [
        pin.rnea(case.model, case.data, q, qd, zero)
        - pin.computeGeneralizedGravity(case.model, case.data, q)
        for q, qd in zip(case.q, case.qd, strict=True)
    ]
    matrices = batch(mo.coriolis_matrix(case.robot), case.q, case.qd)
    assert difference(np.einsum("kij,kj->ki", matrices, case.qd), theirs) < RELATIVE


def test_gravity_torque_is_the_one_of_pinocchio(case: Case) -> None:
    theirs = [pin.computeGeneralizedGravity(case.model, case.data, q).copy() for q in case.q]
    assert difference(batch(mo.gravity_torque(case.robot), case.q), theirs) < RELATIVE


def test_bias_torque_is_the_one_of_pinocchio(case: Case) -> None:
    theirs = [
        pin.nonLinearEffects(case.model, case.data, q, qd).copy()
        for q, qd in zip(case.q, case.qd, strict=True)
    ]
    assert difference(batch(mo.bias_torque(case.robot), case.q, case.qd), theirs) < RELATIVE


def test_forward_dynamics_is_the_one_of_pinocchio(case: Case) -> None:
    tau = 10.0 * case.qdd
    condition = batch(mo.robot.mass_matrix_condition(case.robot), case.q)[:, 0]
    well = condition < 1e4  # elsewhere the last digits are nobody's
    assert well.mean() > 0.9
    theirs = [
        pin.aba(case.model, case.data, *state).copy()
        for state in zip(case.q[well], case.qd[well], tau[well], strict=True)
    ]
    ours = batch(mo.forward_dynamics(case.robot), case.q[well], case.qd[well], tau[well])
    assert difference(ours, theirs) < RELATIVE


def test_energy_is_the_one_of_pinocchio_and_of_the_rotors(case: Case) -> None:
    rotors = np.array([link.armature for link in case.robot.links])
    model = case.model.copy()
    model.armature = np.zeros(len(rotors))
    theirs = []
    for q, qd in zip(case.q, case.qd, strict=True):
        kinetic = pin.computeKineticEnergy(model, case.data, q, qd) + 0.5 * rotors @ qd**2
        theirs.append([kinetic, pin.computePotentialEnergy(model, case.data, q)])
    ours = np.column_stack([np.array(e)[0] for e in mo.energy(case.robot)(case.q.T, case.qd.T)])
    assert difference(ours, np.array(theirs)) < RELATIVE


@pytest.mark.parametrize("wrt", ["q", "qd", "qdd"])
def test_derivatives_of_inverse_dynamics_are_those_of_pinocchio(case: Case, wrt: str) -> None:
    few = slice(0, 200)
    states = [case.q[few], case.qd[few], case.qdd[few]]
    x = dict(zip(("q", "qd", "qdd"), (ca.SX.sym(s, case.q.shape[1]) for s in "xyz"), strict=True))
    tau = mo.inverse_dynamics(case.robot)(*x.values())
    slope = ca.Function("slope", list(x.values()), [ca.densify(ca.jacobian(tau, x[wrt]))])
    theirs = []
    for state in zip(*states, strict=True):
        by_q, by_qd, by_qdd = pin.computeRNEADerivatives(case.model, case.data, *state)
        upper = np.triu(by_qdd)
        found = {"q": by_q, "qd": by_qd, "qdd": upper + np.triu(upper, 1).T}
        theirs.append(found[wrt].copy())
    assert difference(batch(slope, *states), theirs) < RELATIVE
