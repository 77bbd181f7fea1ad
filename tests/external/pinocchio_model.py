"""A robot of ours as a pinocchio model, by way of pinocchio's own joints and placements."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import microbot_ocp as mo
from microbot_ocp.robot import dh_transform


def pinocchio_model(robot: mo.Robot) -> pin.Model:
    """Joint i+1 of the model is joint i of the robot; the operational frame "tool" is its tool.

    In Craig's modified DH the turn and the slide of a row lie along the joint's own Z, so the
    placement of joint i is the row at q = 0.
    """
    model = pin.Model()
    model.name = robot.name
    model.gravity.linear = robot.gravity
    parent = 0
    for joint in range(robot.joint_count):
        revolute = robot.joint_types[joint] == "revolute"
        row = (robot.alpha[joint], robot.a[joint], robot.d[joint], robot.theta_offset[joint])
        parent = model.addJoint(
            parent,
            pin.JointModelRZ() if revolute else pin.JointModelPZ(),
            pin.SE3(dh_transform(*row)),
            robot.joint_names[joint],
        )
        link = robot.links[joint]
        body = pin.Inertia(link.mass, link.center_of_mass, link.inertia)
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    model.armature = np.array([link.armature for link in robot.links])
    model.addFrame(pin.Frame("tool", parent, 0, pin.SE3(robot.tool), pin.FrameType.OP_FRAME))
    return model
