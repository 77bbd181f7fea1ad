"""Gear rotors against Lagrange's equations of their kinetic energy, and the Manutec r3."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from helpers import RANDOM_CHAINS, batch, difference, random_robot, random_states, refused


def with_rotors(robot: mo.Robot, seed: int = 3) -> mo.Robot:
    """A rotor for every joint, each on a link of its own choice, also beyond its joint."""
    rng = np.random.default_rng(seed)
    carriers = [None, *rng.integers(0, robot.joint_count + 1, robot.joint_count - 1).tolist()]
    links = [
        replace(
            link,
            rotor=mo.robot.Rotor(
                rng.uniform(1e-3, 1e-2), rng.uniform(-100.0, 100.0), rng.normal(size=3), carrier
            ),
        )
        for link, carrier in zip(robot.links, carriers, strict=True)
    ]
    return robot.with_links(links)


def by_lagrange(robot: mo.Robot) -> ca.Function:
    """What the rotors add to the torques: d/dt dT/dqd - dT/dq of the kinetic energy they add."""
    q, qd, qdd = (ca.SX.sym(name, robot.joint_count) for name in ("q", "qd", "qdd"))
    _, omega = mo.velocity_propagation(robot)(q, qd)
    energy = ca.SX(0)
    for joint, rotor, carrier in robot.rotors:
        turning = ca.dot(rotor.axis, omega[:, carrier - 1]) if carrier else 0.0
        whole = turning + rotor.gear_ratio * qd[joint]
        energy += 0.5 * rotor.inertia * (whole**2 - turning**2)
    momentum = ca.gradient(energy, qd)
    rate = ca.jtimes(momentum, ca.vertcat(q, qd), ca.vertcat(qd, qdd))
    return ca.Function("tau", [q, qd, qdd], [ca.densify(rate - ca.gradient(energy, q))])


@pytest.mark.parametrize("name", RANDOM_CHAINS)
def test_the_torque_is_that_of_lagrange(name):
    bare = random_robot(name)
    robot = with_rotors(bare)
    states = random_states(robot, 50)
    ours = batch(mo.inverse_dynamics(robot), *states)
    exact = batch(mo.inverse_dynamics(bare), *states) + batch(by_lagrange(robot), *states)
    assert difference(ours, exact) < 1e-12


@pytest.mark.parametrize("name", RANDOM_CHAINS)
def test_mass_matrix_energy_and_forward_dynamics_agree_with_it(name):
    robot = with_rotors(random_robot(name))
    q, qd, qdd = random_states(robot, 30)
    mass, tau = batch(mo.mass_matrix(robot), q), batch(mo.inverse_dynamics(robot), q, qd, qdd)
    mass = mass.reshape(len(q), robot.joint_count, robot.joint_count)
    bias = batch(mo.bias_torque(robot), q, qd)
    assert difference(np.einsum("kij,kj->ki", mass, qdd) + bias, tau) < 1e-12
    np.testing.assert_allclose(mass, mass.transpose(0, 2, 1), atol=1e-12)
    assert np.linalg.eigvalsh(mass).min() > 0
    coriolis = batch(mo.coriolis_matrix(robot), q, qd).reshape(mass.shape)
    gravity = batch(mo.gravity_torque(robot), q)
    assert difference(np.einsum("kij,kj->ki", coriolis, qd) + gravity, bias) < 1e-11
    assert difference(batch(mo.forward_dynamics(robot), q, qd, tau), qdd) < 1e-8


def test_a_rotor_on_the_base_is_armature():
    bare = random_robot("rrrrrr")
    links = list(bare.links)
    links[0] = replace(links[0], rotor=mo.robot.Rotor(2e-3, 50.0, [1.0, 2.0, 3.0]))
    armature = list(bare.links)
    armature[0] = replace(armature[0], armature=armature[0].armature + 2e-3 * 50.0**2)
    states = random_states(bare, 10)
    ours = batch(mo.inverse_dynamics(bare.with_links(links)), *states)
    assert difference(ours, batch(mo.inverse_dynamics(bare.with_links(armature)), *states)) < 1e-13


def test_files_keep_rotors(tmp_path):
    robot = with_rotors(random_robot("rprr"))
    mo.save_robot(robot, tmp_path / "arm.toml")
    again = mo.load_robot(tmp_path / "arm.toml")
    assert again == robot
    assert again != random_robot("rprr")
    assert [carrier for _, _, carrier in again.rotors] == [c for _, _, c in robot.rotors]
    with refused("robot 'rprr'", "rotors", "URDF"):
        mo.save_robot(robot, tmp_path / "arm.urdf")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: mo.robot.Rotor(-1.0, 10.0), ("inertia", "rotor", "0 kg m^2", "-1.0")),
        (lambda: mo.robot.Rotor(1e-3, 0.0), ("gear_ratio", "rotor", "0")),
        (
            lambda: mo.robot.Rotor(1e-3, 10.0, [0.0, 0.0, 0.0]),
            ("axis", "rotor", "direction", "[0, 0, 0]"),
        ),
        (lambda: mo.robot.Rotor(1e-3, 10.0, carrier=-1), ("carrier", "rotor", "link", "not -1")),
        (lambda: mo.Link(1.0, rotor=3.0), ("rotor", "Rotor", "3.0")),
        (
            lambda: random_robot("rr").with_links(
                [mo.Link(1.0, rotor=mo.robot.Rotor(1e-3, 10.0, carrier=3)), mo.Link(1.0)]
            ),
            ("carrier", "rotor", "0 (the base) to 2", "not 3"),
        ),
    ],
)
def test_bad_rotors_are_refused(make, message):
    with refused(*message):
        make()


def test_the_manutec_has_its_armatures_and_its_coupling():
    """Otter and Tuerk: 14.3325, 57.33 and 4.68 kg m^2, and 0.078 between joints 2 and 3."""
    robot = mo.load_robot("manutec_r3")
    bare = robot.with_links([replace(link, rotor=None) for link in robot.links])
    q = random_states(robot, 10)[0]
    added = batch(mo.mass_matrix(robot), q) - batch(mo.mass_matrix(bare), q)
    exact = np.array([[14.3325, 0.0, 0.0], [0.0, 57.33, 0.078], [0.0, 0.078, 4.68]])
    np.testing.assert_allclose(added, np.tile(exact, (10, 1, 1)), atol=1e-12)
