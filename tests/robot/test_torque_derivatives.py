"""Derivatives of the torques by their own formulas against automatic differentiation."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp.robot import torque_and_rate, torque_derivatives


def with_friction(robot):
    random = np.random.default_rng(3)
    links = [
        replace(
            link,
            armature=random.uniform(),
            viscous_friction=random.uniform(),
            coulomb_friction=0.01 * random.uniform(),
        )
        for link in robot.links
    ]
    return robot.with_links(links)


def derivatives(robot, **options):
    found = torque_derivatives(robot, **options)
    assert found is not None
    return found


def automatic(function, weights):
    inputs = [ca.SX.sym("i", function.size1_in(k)) for k in range(function.n_in())]
    values, stacked = ca.vertcat(*function.call(inputs)), ca.vertcat(*inputs)
    hessian, gradient = ca.hessian(ca.dot(ca.DM(weights), values), stacked)
    return ca.Function("f", inputs, [values, ca.jacobian(values, stacked), gradient, hessian])


@pytest.mark.parametrize("rates", [False, True])
@pytest.mark.parametrize("name", ["stanford", pytest.param("puma560", marks=pytest.mark.thorough)])
def test_they_are_those_of_the_inverse_dynamics(name, rates):
    robot = with_friction(mo.load_robot(name))
    function = torque_and_rate(robot) if rates else mo.inverse_dynamics(robot)
    random = np.random.default_rng(1)
    state = [random.normal(size=6) for _ in range(function.n_in())]
    weights = random.normal(size=6 * function.n_out())
    first, second = derivatives(robot, rates=rates)
    found = [*first(*state), *second(*state, weights)]
    for ours, theirs in zip(found, automatic(function, weights)(*state), strict=True):
        assert np.allclose(np.array(ours), np.array(theirs), rtol=1e-12, atol=1e-10)


def test_a_payload_is_an_argument():
    robot = with_friction(mo.load_robot("puma560"))
    random = np.random.default_rng(2)
    state, weights = [random.normal(size=6) for _ in range(3)], random.normal(size=6)
    first, second = derivatives(robot, payload=True)
    own, own_second = derivatives(robot.with_payload(2.5))
    values, jacobian = first(*state, 2.5)
    gradient, hessian = second(*state, 2.5, weights)
    pairs = zip(
        [values, jacobian[:, :18], gradient[:18], hessian[:18, :18]],
        [*own(*state), *own_second(*state, weights)],
        strict=True,
    )
    for ours, theirs in pairs:
        assert np.allclose(np.array(ours), np.array(theirs), rtol=1e-12, atol=1e-10)
    assert hessian[:, 18].nnz() == 0


def test_short_chains_leave_it_to_automatic_differentiation():
    assert torque_derivatives(mo.load_robot("microbot")) is None
