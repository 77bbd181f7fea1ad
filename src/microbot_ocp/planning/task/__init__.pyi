"""Public names, loaded on first use."""

from ._checks import (
    CELL_TIME_LIMIT as CELL_TIME_LIMIT,
    CHECKS_PER_INTERVAL as CHECKS_PER_INTERVAL,
    GAP as GAP,
    LDL as LDL,
    ROUGH_TOLERANCE as ROUGH_TOLERANCE,
    TIME_LIMIT as TIME_LIMIT,
    bounds_in_program as bounds_in_program,
    check_limits as check_limits,
    check_pace as check_pace,
    check_positions as check_positions,
    check_rest as check_rest,
    check_via as check_via,
    declare_limits as declare_limits,
    derivatives_for as derivatives_for,
    fastest_tool as fastest_tool,
    finite_scale as finite_scale,
    length_text as length_text,
    locked_joints as locked_joints,
    rate_switches as rate_switches,
    reach_of as reach_of,
    too_near as too_near,
    torques_of as torques_of,
    with_changes as with_changes,
    with_locked_joints_held as with_locked_joints_held,
)
from ._ending import (
    largest as largest,
    limits_digest as limits_digest,
    multipliers_of as multipliers_of,
    one_remark as one_remark,
    place_in_task as place_in_task,
    provenance_of as provenance_of,
    verdict as verdict,
    with_drives_noted as with_drives_noted,
)
from ._friction import (
    COARSE_SMOOTHING as COARSE_SMOOTHING,
    DRY as DRY,
    SMOOTHING as SMOOTHING,
    VISCOUS as VISCOUS,
    WINDOW as WINDOW,
    WINDOW_REACH as WINDOW_REACH,
    dry_friction as dry_friction,
    friction_rate as friction_rate,
    frictionless as frictionless,
    has_windows as has_windows,
    rates_at_reversals as rates_at_reversals,
    reversals as reversals,
    rounded as rounded,
    torque_at_drives as torque_at_drives,
    windowed_torques as windowed_torques,
    with_windows as with_windows,
    without_dry_friction as without_dry_friction,
)
from ._robust import (
    checked_box as checked_box,
    robust_limits as robust_limits,
)
from ._scale import (
    JERK_SMOOTHING as JERK_SMOOTHING,
    TYPICAL_SPEED as TYPICAL_SPEED,
    TaskScale as TaskScale,
    single_joint_rates as single_joint_rates,
)
from ._segments import (
    Circle as Circle,
    Corner as Corner,
    JointLine as JointLine,
    Line as Line,
    Segment as Segment,
)
from ._stops import (
    EXACT_TOLERANCE as EXACT_TOLERANCE,
    Bounds as Bounds,
    Conditions as Conditions,
    EndConditions as EndConditions,
    Payload as Payload,
    Row as Row,
    Stop as Stop,
)
from ._task import (
    EMPTY as EMPTY,
    Task as Task,
    check_held as check_held,
    is_task as is_task,
    task_of as task_of,
    with_torques as with_torques,
)
