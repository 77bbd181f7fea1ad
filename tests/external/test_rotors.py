"""Gear rotors against pinocchio's tree with a body and a joint for every rotor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import microbot_ocp as mo
from external.pinocchio_model import pinocchio_model
from helpers import batch, difference, random_robot, random_states
from robot.test_rotors import with_rotors

pin = pytest.importorskip("pinocchio")


@pytest.mark.parametrize("name", ["rr", "rprr", "rrrrrr", "rrrprrr"])
def test_torques_are_those_of_a_tree_with_rotors_as_bodies(name):
    robot = with_rotors(random_robot(name))
    bare = robot.with_links([replace(link, rotor=None) for link in robot.links])
    model = pinocchio_model(bare)
    armature, links = list(model.armature), list(robot.links)
    gears = np.eye(robot.joint_count)
    for joint, rotor, carrier in robot.rotors:
        at = links[carrier - 1].center_of_mass if carrier else np.zeros(3)
        spin = rotor.inertia * np.outer(rotor.axis, rotor.axis)
        axle = pin.JointModelRevoluteUnaligned(rotor.axis)
        own = model.addJoint(carrier, axle, pin.SE3(np.eye(3), at), f"rotor {joint}")
        model.appendBodyToJoint(own, pin.Inertia(0.0, np.zeros(3), spin), pin.SE3.Identity())
        gears = np.vstack([gears, rotor.gear_ratio * np.eye(robot.joint_count)[joint]])
        armature.append(0.0)
        if carrier:  # what it weighs at rest is part of our link
            link = links[carrier - 1]
            links[carrier - 1] = replace(link, inertia=link.inertia + spin, allow_unphysical=True)
    # rotors come after their carriers in pinocchio's order
    order = [model.joints[model.getJointId(joint)].idx_v for joint in robot.joint_names]
    order += [model.joints[model.getJointId(f"rotor {j}")].idx_v for j, _, _ in robot.rotors]
    motion = np.zeros_like(gears)
    motion[order] = gears
    model.armature = np.array(armature)[np.argsort(order)]
    data = model.createData()
    states = random_states(robot, 20)
    theirs = [
        motion.T @ pin.rnea(model, data, motion @ q, motion @ qd, motion @ qdd)
        for q, qd, qdd in zip(*states, strict=True)
    ]
    ours = batch(mo.inverse_dynamics(robot.with_links(links)), *states)
    assert difference(ours, theirs) < 1e-10
