"""Every field of the messages that are read has a verdict, and the page shows the same."""

from __future__ import annotations

import pytest

import make_messages
from microbot_ocp import InputError
from microbot_ocp._base.messages import MESSAGES, check_message, kind_of

# Fields of moveit_msgs, trajectory_msgs, control_msgs, sensor_msgs, shape_msgs, octomap_msgs,
# geometry_msgs and std_msgs, of ROS 1 and 2 together.
DEFINITIONS = {
    "MotionPlanRequest": "workspace_parameters start_state goal_constraints path_constraints "
    "trajectory_constraints reference_trajectories pipeline_id planner_id group_name "
    "num_planning_attempts allowed_planning_time max_velocity_scaling_factor "
    "max_acceleration_scaling_factor cartesian_speed_limited_link max_cartesian_speed "
    "cartesian_speed_end_effector_link",
    "RobotState": "joint_state multi_dof_joint_state attached_collision_objects is_diff",
    "JointState": "header name position velocity effort",
    "MultiDOFJointState": "header joint_names transforms twist wrench",
    "Constraints": "name joint_constraints position_constraints orientation_constraints "
    "visibility_constraints",
    "JointConstraint": "joint_name position tolerance_above tolerance_below weight",
    "OrientationConstraint": "header orientation link_name absolute_x_axis_tolerance "
    "absolute_y_axis_tolerance absolute_z_axis_tolerance parameterization weight",
    "Header": "seq stamp frame_id",
    "PlanningScene": "name robot_state robot_model_name fixed_frame_transforms "
    "allowed_collision_matrix link_padding link_scale object_colors world is_diff",
    "TransformStamped": "header child_frame_id transform",
    "Transform": "translation rotation",
    "Pose": "position orientation",
    "Point": "x y z",
    "Quaternion": "x y z w",
    "AllowedCollisionMatrix": "entry_names entry_values default_entry_names default_entry_values",
    "AllowedCollisionEntry": "enabled",
    "LinkPadding": "link_name padding",
    "LinkScale": "link_name scale",
    "PlanningSceneWorld": "collision_objects octomap",
    "OctomapWithPose": "header origin octomap",
    "Octomap": "header binary id resolution data",
    "CollisionObject": "header pose id type primitives primitive_poses meshes mesh_poses planes "
    "plane_poses subframe_names subframe_poses operation",
    "SolidPrimitive": "type dimensions polygon",
    "JointTrajectory": "header joint_names points",
    "JointTrajectoryPoint": "positions velocities accelerations effort time_from_start",
    "RobotTrajectory": "joint_trajectory multi_dof_joint_trajectory",
    "MultiDOFJointTrajectory": "header joint_names points",
    "DisplayTrajectory": "model_id trajectory trajectory_start",
    "MotionPlanResponse": "trajectory_start group_name trajectory planning_time error_code",
    "GetMotionPlanResponse": "motion_plan_response",
    "MoveGroupResult": "error_code trajectory_start planned_trajectory executed_trajectory "
    "planning_time",
    "GetCartesianPathResponse": "start_state solution fraction error_code",
    "MoveItErrorCodes": "val message source",
    "ExecuteTrajectoryGoal": "trajectory controller_names",
    "FollowJointTrajectoryGoal": "trajectory multi_dof_trajectory path_tolerance "
    "component_path_tolerance goal_tolerance component_goal_tolerance goal_time_tolerance",
    "FollowJointTrajectoryActionGoal": "header goal_id goal",
}


@pytest.mark.parametrize("kind", MESSAGES)
def test_every_field_of_a_message_has_a_verdict(kind: str) -> None:
    fields = MESSAGES[kind]
    assert sorted(fields) == sorted(DEFINITIONS[kind.split(" ")[0]].split())
    for field in fields.values():
        assert field.verdict == "kept" or field.why
        assert not field.of or field.of in MESSAGES


def test_every_message_is_in_the_table() -> None:
    assert {kind.split(" ")[0] for kind in MESSAGES} == set(DEFINITIONS)


def test_the_page_is_made_of_the_table() -> None:
    assert make_messages.PAGE.read_text("utf-8") == make_messages.page()


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (kind, name)
        for kind, fields in MESSAGES.items()
        for name, field in fields.items()
        if field.verdict == "refused"
    ],
)
def test_what_is_refused_is_refused_by_its_path_and_only_where_it_speaks(
    kind: str, name: str
) -> None:
    nothing = [None, 0, 0.0, False, "", [], {}, [0.0, 0.0], {"header": {"frame_id": ""}}]
    for value in (*nothing, MESSAGES[kind][name].neutral, [{"rotation": {"w": 1.0, "x": 0.0}}]):
        check_message({name: value}, kind)
    for value in (5.5, [0.0, 5.5], {"any": {"depth": [5.5]}}, "a name"):
        with pytest.raises(InputError, match=f"^inside.{name} is "):
            check_message({name: value}, kind, "inside.")


@pytest.mark.parametrize("kind", MESSAGES)
def test_an_unknown_field_is_refused_by_its_path_at_any_depth(kind: str) -> None:
    """From every message that holds another, in a list or by itself."""
    for outer, fields in MESSAGES.items():
        for name, field in fields.items():
            if field.of == kind:
                with pytest.raises(InputError, match=rf"^{name}\[1\]\.naem "):
                    check_message({name: [{}, {"naem": 1}]}, outer)
                with pytest.raises(InputError, match=rf"^{name}\.naem "):
                    check_message({name: {"naem": 0}}, outer)


def test_a_message_is_known_by_its_keys() -> None:
    kinds = ("JointTrajectory", "RobotTrajectory", "DisplayTrajectory", "FollowJointTrajectoryGoal")
    assert kind_of({"joint_trajectory": {}}, kinds) == "RobotTrajectory"
    assert kind_of({"trajectory": {}, "goal_tolerance": []}, kinds) == "FollowJointTrajectoryGoal"
