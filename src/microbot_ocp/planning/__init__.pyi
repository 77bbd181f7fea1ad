"""Public names, loaded on first use."""

from .free import (
    MotionIteration as MotionIteration,
)
from .path import (
    PathLimit as PathLimit,
    PathTiming as PathTiming,
    PhasePlane as PhasePlane,
    check_path as check_path,
    corners as corners,
    phase_plane as phase_plane,
    straight_path as straight_path,
    straight_through as straight_through,
    time_path as time_path,
)
from .search import (
    FREE as FREE,
    Part as Part,
    Place as Place,
    ProvedPath as ProvedPath,
    TimeOptimalSettings as TimeOptimalSettings,
    TimeOptimalSolver as TimeOptimalSolver,
    fastest_through as fastest_through,
    in_order as in_order,
    least_duration as least_duration,
    legs_between as legs_between,
    motion_along as motion_along,
    motions_of_front as motions_of_front,
    over_stretches as over_stretches,
    parts_of as parts_of,
    places_along as places_along,
    rested_duration as rested_duration,
    scenes_of as scenes_of,
    stretches as stretches,
    time_optimal as time_optimal,
    timed_paths as timed_paths,
    tool_poses as tool_poses,
)
from .task import (
    TIME_LIMIT as TIME_LIMIT,
    Circle as Circle,
    Corner as Corner,
    JointLine as JointLine,
    Line as Line,
    Payload as Payload,
    Segment as Segment,
    Stop as Stop,
    Task as Task,
    check_limits as check_limits,
    check_via as check_via,
    checked_box as checked_box,
    is_task as is_task,
    limits_digest as limits_digest,
    reach_of as reach_of,
    robust_limits as robust_limits,
    task_of as task_of,
    with_changes as with_changes,
)
from .timing import (
    PathTimingSettings as PathTimingSettings,
    best_timing as best_timing,
    time_optimal_path as time_optimal_path,
)
