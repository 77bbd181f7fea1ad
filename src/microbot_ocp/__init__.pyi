"""Public names of the package; ``__init__.py`` loads them when they are asked for."""

from microbot_ocp import (
    ocp as ocp,
)
from microbot_ocp.baselines import (
    Scaled as Scaled,
    cubic as cubic,
    lspb as lspb,
    quintic as quintic,
    shortest_duration as shortest_duration,
    spline as spline,
)
from microbot_ocp.certificate import (
    Certificate as Certificate,
    certify as certify,
)
from microbot_ocp.checks import (
    InputError as InputError,
)
from microbot_ocp.comparison import (
    METHODS as METHODS,
    Comparison as Comparison,
    Entry as Entry,
    compare as compare,
)
from microbot_ocp.control import (
    ComputedTorque as ComputedTorque,
    Controller as Controller,
    Feedforward as Feedforward,
    PDGravity as PDGravity,
    SensorNoise as SensorNoise,
)
from microbot_ocp.dynamics import (
    bias_torque as bias_torque,
    coriolis_matrix as coriolis_matrix,
    energy as energy,
    forward_dynamics as forward_dynamics,
    gravity_torque as gravity_torque,
    inverse_dynamics as inverse_dynamics,
    mass_matrix as mass_matrix,
    mass_matrix_condition as mass_matrix_condition,
)
from microbot_ocp.fast import (
    fast_call as fast_call,
)
from microbot_ocp.inverse_kinematics import (
    IKPath as IKPath,
    IKSolution as IKSolution,
    IKStatus as IKStatus,
    solve_ik as solve_ik,
    solve_ik_all as solve_ik_all,
    solve_ik_batch as solve_ik_batch,
    solve_ik_path as solve_ik_path,
)
from microbot_ocp.kinematics import (
    forward_kinematics as forward_kinematics,
    frame_origins as frame_origins,
    jacobian as jacobian,
    velocity_propagation as velocity_propagation,
)
from microbot_ocp.motion import (
    Mark as Mark,
    Motion as Motion,
    PiecewisePolynomial as PiecewisePolynomial,
)
from microbot_ocp.ocp.problem import (
    OptimalControlProblem as OptimalControlProblem,
)
from microbot_ocp.robot import (
    JointLimits as JointLimits,
    Limits as Limits,
    Link as Link,
    Robot as Robot,
)
from microbot_ocp.robots import (
    load_robot as load_robot,
    packaged_robots as packaged_robots,
    read_urdf as read_urdf,
    write_toml as write_toml,
    write_urdf as write_urdf,
)
from microbot_ocp.simulation import (
    Simulation as Simulation,
    Tracking as Tracking,
    motion_from_formula as motion_from_formula,
    simulate as simulate,
    track as track,
)
from microbot_ocp.time_optimal.free import (
    TimeOptimalSettings as TimeOptimalSettings,
    time_optimal as time_optimal,
)
from microbot_ocp.time_optimal.path import (
    PathTimingSettings as PathTimingSettings,
    straight_path as straight_path,
    time_optimal_path as time_optimal_path,
)
from microbot_ocp.time_optimal.phase_plane import (
    PhasePlane as PhasePlane,
    phase_plane as phase_plane,
)
from microbot_ocp.time_optimal.prepared import (
    TimeOptimalSolver as TimeOptimalSolver,
)
from microbot_ocp.views import (
    plots as plots,
)
from microbot_ocp.views.embedded import (
    show as show,
)
from microbot_ocp.views.sliders import (
    TimeOptimalSliders as TimeOptimalSliders,
)
