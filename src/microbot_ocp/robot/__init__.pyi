"""Public names, loaded on first use."""

from ._capsules import (
    LinkHull as LinkHull,
    fit_capsules as fit_capsules,
    link_capsules as link_capsules,
    link_hull as link_hull,
)
from ._closed_form import (
    ClosedForm as ClosedForm,
    closed_form as closed_form,
)
from ._dynamics import (
    COULOMB_SMOOTHING as COULOMB_SMOOTHING,
    MotionState as MotionState,
    bias_torque as bias_torque,
    coriolis_matrix as coriolis_matrix,
    energy as energy,
    forward_dynamics as forward_dynamics,
    gravity_torque as gravity_torque,
    inverse_dynamics as inverse_dynamics,
    mass_matrix as mass_matrix,
    mass_matrix_condition as mass_matrix_condition,
    solve_symmetric as solve_symmetric,
    torque_and_rate as torque_and_rate,
)
from ._joints import (
    drive_advice as drive_advice,
    joint_scale as joint_scale,
    largest_reach as largest_reach,
    per_joint as per_joint,
    rest_pose as rest_pose,
    stretched_out as stretched_out,
)
from ._kinematics import (
    forward_kinematics as forward_kinematics,
    frame_origins as frame_origins,
    jacobian as jacobian,
    link_poses as link_poses,
    velocity_propagation as velocity_propagation,
)
from ._links import (
    Link as Link,
    Rotor as Rotor,
)
from ._model import (
    JointLimits as JointLimits,
    Limits as Limits,
    Robot as Robot,
)
from ._mounting import (
    Mounting as Mounting,
    geared_limits as geared_limits,
)
from ._shapes import (
    Capsule as Capsule,
    Shape as Shape,
    TriangleMesh as TriangleMesh,
    read_mesh as read_mesh,
)
from ._torque_derivatives import (
    has_torque_derivatives as has_torque_derivatives,
    torque_derivatives as torque_derivatives,
)
from ._transforms import (
    checked_rotations as checked_rotations,
    dh_transform as dh_transform,
    fixed_angles as fixed_angles,
    nearest_rotation as nearest_rotation,
    of_quaternion as of_quaternion,
    rigid_transform as rigid_transform,
    rotation_of as rotation_of,
    transform_of as transform_of,
)
from .files import (
    RobotFileWarning as RobotFileWarning,
    load_mjcf as load_mjcf,
    load_robot as load_robot,
    load_urdf as load_urdf,
    packaged_robots as packaged_robots,
    save_robot as save_robot,
)
