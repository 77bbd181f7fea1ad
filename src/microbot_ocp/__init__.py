"""A CasADi optimal-control workbench for serial manipulators."""

from microbot_ocp.checks import InputError
from microbot_ocp.dynamics import (
    bias_torque,
    coriolis_matrix,
    energy,
    forward_dynamics,
    gravity_torque,
    inverse_dynamics,
    mass_matrix,
    mass_matrix_condition,
)
from microbot_ocp.kinematics import (
    forward_kinematics,
    frame_origins,
    jacobian,
    velocity_propagation,
)
from microbot_ocp.robot import JointLimits, Limits, Link, Robot
from microbot_ocp.robots import load_robot, packaged_robots

__all__ = [
    "InputError",
    "JointLimits",
    "Limits",
    "Link",
    "Robot",
    "bias_torque",
    "coriolis_matrix",
    "energy",
    "forward_dynamics",
    "forward_kinematics",
    "frame_origins",
    "gravity_torque",
    "inverse_dynamics",
    "jacobian",
    "load_robot",
    "mass_matrix",
    "mass_matrix_condition",
    "packaged_robots",
    "velocity_propagation",
]
