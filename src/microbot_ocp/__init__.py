"""A CasADi optimal-control workbench for serial manipulators."""

from microbot_ocp.baselines import Scaled, cubic, lspb, quintic, shortest_duration, spline
from microbot_ocp.certificate import Certificate, certify
from microbot_ocp.checks import InputError
from microbot_ocp.comparison import METHODS, Comparison, Entry, compare
from microbot_ocp.control import ComputedTorque, Controller, Feedforward, PDGravity, SensorNoise
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
from microbot_ocp.fast import fast_call
from microbot_ocp.inverse_kinematics import (
    IKPath,
    IKSolution,
    IKStatus,
    solve_ik,
    solve_ik_all,
    solve_ik_batch,
    solve_ik_path,
)
from microbot_ocp.kinematics import (
    forward_kinematics,
    frame_origins,
    jacobian,
    velocity_propagation,
)
from microbot_ocp.motion import Mark, Motion, PiecewisePolynomial
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.robot import JointLimits, Limits, Link, Robot
from microbot_ocp.robots import load_robot, packaged_robots, read_urdf, write_toml, write_urdf
from microbot_ocp.simulation import Simulation, Tracking, motion_from_formula, simulate, track
from microbot_ocp.time_optimal.free import TimeOptimalSettings, time_optimal
from microbot_ocp.time_optimal.path import PathTimingSettings, straight_path, time_optimal_path

__all__ = [
    "METHODS",
    "Certificate",
    "Comparison",
    "ComputedTorque",
    "Controller",
    "Entry",
    "Feedforward",
    "IKPath",
    "IKSolution",
    "IKStatus",
    "InputError",
    "JointLimits",
    "Limits",
    "Link",
    "Mark",
    "Motion",
    "OptimalControlProblem",
    "PDGravity",
    "PathTimingSettings",
    "PiecewisePolynomial",
    "Robot",
    "Scaled",
    "SensorNoise",
    "Simulation",
    "TimeOptimalSettings",
    "Tracking",
    "bias_torque",
    "certify",
    "compare",
    "coriolis_matrix",
    "cubic",
    "energy",
    "fast_call",
    "forward_dynamics",
    "forward_kinematics",
    "frame_origins",
    "gravity_torque",
    "inverse_dynamics",
    "jacobian",
    "load_robot",
    "lspb",
    "mass_matrix",
    "mass_matrix_condition",
    "motion_from_formula",
    "packaged_robots",
    "quintic",
    "read_urdf",
    "shortest_duration",
    "simulate",
    "solve_ik",
    "solve_ik_all",
    "solve_ik_batch",
    "solve_ik_path",
    "spline",
    "straight_path",
    "time_optimal",
    "time_optimal_path",
    "track",
    "velocity_propagation",
    "write_toml",
    "write_urdf",
]
