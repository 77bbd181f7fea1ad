"""Public names of the package; ``__init__.py`` loads them when they are asked for."""

from . import (
    limits as limits,
    ocp as ocp,
)
from ._base.checks import (
    InputError as InputError,
)
from ._base.codegen import (
    NotCompiled as NotCompiled,
    cache_folder as cache_folder,
    compiler as compiler,
)
from ._base.fast_calls import (
    fast_call as fast_call,
)
from ._base.showing import (
    register_view as register_view,
)
from ._base.status import (
    Status as Status,
)
from ._base.table import (
    Column as Column,
    Table as Table,
)
from ._base.writing import (
    NotWritten as NotWritten,
)
from .certificate import (
    Certificate as Certificate,
    certify as certify,
)
from .execution import (
    ControllerCommand as ControllerCommand,
    Profile as Profile,
    Ratings as Ratings,
    Reserve as Reserve,
    check as check,
    commanded as commanded,
    controller_profile as controller_profile,
    differing_plants as differing_plants,
    executed as executed,
    packaged_profiles as packaged_profiles,
    ratings as ratings,
    robust_limits as robust_limits,
    smallest_reserve as smallest_reserve,
)
from .inverse_kinematics import (
    IKPath as IKPath,
    IKSolution as IKSolution,
    solve_ik as solve_ik,
    solve_ik_all as solve_ik_all,
    solve_ik_batch as solve_ik_batch,
    solve_ik_each as solve_ik_each,
    solve_ik_path as solve_ik_path,
)
from .limits import (
    JointLimits as JointLimits,
    Limit as Limit,
    Limits as Limits,
)
from .motion import (
    Mark as Mark,
    Motion as Motion,
    PiecewisePolynomial as PiecewisePolynomial,
    Sensitivities as Sensitivities,
)
from .ocp import (
    OptimalControlProblem as OptimalControlProblem,
)
from .planning import (
    Circle as Circle,
    JointLine as JointLine,
    Line as Line,
    PathTiming as PathTiming,
    PathTimingSettings as PathTimingSettings,
    Payload as Payload,
    PhasePlane as PhasePlane,
    Stop as Stop,
    TimeOptimalSettings as TimeOptimalSettings,
    TimeOptimalSolver as TimeOptimalSolver,
    phase_plane as phase_plane,
    straight_path as straight_path,
    time_optimal as time_optimal,
    time_optimal_path as time_optimal_path,
    time_path as time_path,
)
from .robot import (
    Capsule as Capsule,
    ClosedForm as ClosedForm,
    Link as Link,
    Robot as Robot,
    RobotFileWarning as RobotFileWarning,
    Rotor as Rotor,
    Shape as Shape,
    bias_torque as bias_torque,
    closed_form as closed_form,
    coriolis_matrix as coriolis_matrix,
    energy as energy,
    fit_capsules as fit_capsules,
    forward_dynamics as forward_dynamics,
    forward_kinematics as forward_kinematics,
    frame_origins as frame_origins,
    gravity_torque as gravity_torque,
    inverse_dynamics as inverse_dynamics,
    jacobian as jacobian,
    link_capsules as link_capsules,
    load_robot as load_robot,
    mass_matrix as mass_matrix,
    mass_matrix_condition as mass_matrix_condition,
    packaged_robots as packaged_robots,
    read_mjcf as read_mjcf,
    read_urdf as read_urdf,
    velocity_propagation as velocity_propagation,
    write_toml as write_toml,
    write_urdf as write_urdf,
)
from .scene import (
    Box as Box,
    Clearance as Clearance,
    ConvexMesh as ConvexMesh,
    Cylinder as Cylinder,
    HalfSpace as HalfSpace,
    Scene as Scene,
    Sphere as Sphere,
    clearance as clearance,
    read_request as read_request,
    read_scene as read_scene,
)
from .simulation import (
    ComputedTorque as ComputedTorque,
    Controller as Controller,
    Feedforward as Feedforward,
    PDGravity as PDGravity,
    SensorNoise as SensorNoise,
    Simulation as Simulation,
    Tracking as Tracking,
    motion_from_formula as motion_from_formula,
    simulate as simulate,
    track as track,
)
from .sweeps import (
    Between as Between,
    Cases as Cases,
    OneOf as OneOf,
    Sweep as Sweep,
    load_sweep as load_sweep,
    sweep as sweep,
)
from .tasks import (
    METHODS as METHODS,
    Comparison as Comparison,
    Entry as Entry,
    compare as compare,
    load_comparison as load_comparison,
    time_effort_front as time_effort_front,
    time_torque_front as time_torque_front,
)
from .trajectories import (
    Scaled as Scaled,
    best_split as best_split,
    cubic as cubic,
    first_splits as first_splits,
    lspb as lspb,
    quintic as quintic,
    shortest_duration as shortest_duration,
    spline as spline,
)
from .views import (
    plots as plots,
)
from .views.notebook import (
    TimeOptimalSliders as TimeOptimalSliders,
    show as show,
)
