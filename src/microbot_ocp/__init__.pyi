"""Public names of the package, each imported at its first access."""

from . import (
    acceleration as acceleration,
    execution as execution,
    inverse_kinematics as inverse_kinematics,
    layout as layout,
    limits as limits,
    motion as motion,
    ocp as ocp,
    planning as planning,
    robot as robot,
    scene as scene,
    simulation as simulation,
    sweeps as sweeps,
    tasks as tasks,
    trajectories as trajectories,
    views as views,
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
from .acceleration import (
    AccelerationLimits as AccelerationLimits,
    acceleration_limits as acceleration_limits,
)
from .certificate import (
    Certificate as Certificate,
    certify as certify,
)
from .execution import (
    check as check,
    executed as executed,
    smallest_reserve as smallest_reserve,
)
from .inverse_kinematics import (
    follow_ik as follow_ik,
    solve_ik as solve_ik,
    solve_ik_all as solve_ik_all,
)
from .layout import (
    Design as Design,
    design as design,
)
from .limits import (
    Limit as Limit,
    Limits as Limits,
)
from .motion import (
    Motion as Motion,
)
from .ocp import (
    OptimalControlProblem as OptimalControlProblem,
)
from .planning import (
    Circle as Circle,
    JointLine as JointLine,
    Line as Line,
    Payload as Payload,
    Stop as Stop,
    TimeOptimalSolver as TimeOptimalSolver,
    straight_path as straight_path,
    time_optimal as time_optimal,
    time_optimal_path as time_optimal_path,
)
from .robot import (
    Capsule as Capsule,
    Link as Link,
    Robot as Robot,
    bias_torque as bias_torque,
    coriolis_matrix as coriolis_matrix,
    energy as energy,
    fit_capsules as fit_capsules,
    forward_dynamics as forward_dynamics,
    forward_kinematics as forward_kinematics,
    gravity_torque as gravity_torque,
    inverse_dynamics as inverse_dynamics,
    jacobian as jacobian,
    load_robot as load_robot,
    mass_matrix as mass_matrix,
    packaged_robots as packaged_robots,
    save_robot as save_robot,
    velocity_propagation as velocity_propagation,
)
from .scene import (
    Box as Box,
    Cylinder as Cylinder,
    HalfSpace as HalfSpace,
    Scene as Scene,
    Sphere as Sphere,
    clearance as clearance,
    load_scene as load_scene,
)
from .simulation import (
    ComputedTorque as ComputedTorque,
    Feedforward as Feedforward,
    PDGravity as PDGravity,
    simulate as simulate,
    track as track,
)
from .sweeps import (
    Between as Between,
    OneOf as OneOf,
    load_sweep as load_sweep,
    sweep as sweep,
)
from .tasks import (
    Comparison as Comparison,
    compare as compare,
    load_comparison as load_comparison,
)
from .trajectories import (
    best_cubic as best_cubic,
    best_lspb as best_lspb,
    best_split as best_split,
    cubic as cubic,
    lspb as lspb,
    quintic as quintic,
    shortest_duration as shortest_duration,
    spline as spline,
)
from .views import (
    plots as plots,
)
from .views.notebook import (
    show as show,
)
