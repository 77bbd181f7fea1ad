"""The node: one robot, two services."""

from __future__ import annotations

from functools import partial

import rclpy
from microbot_ocp_msgs.srv import Check, Plan
from rclpy.node import Node

import microbot_ocp as mo
from microbot_ocp_ros import services


def main() -> None:
    rclpy.init()
    node = Node("microbot_ocp")
    source = node.declare_parameter("robot", "microbot").value
    tip = node.declare_parameter("tip", "").value
    robot = mo.load_robot(source, tip or None)
    node.create_service(Plan, "plan", partial(services.plan, robot))
    node.create_service(Check, "check", partial(services.check, robot))
    rclpy.spin(node)
