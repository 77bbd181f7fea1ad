"""Public names; loaded when they are first asked for."""

from ._among_obstacles import (
    TimedPath as TimedPath,
    legs_between as legs_between,
    timed_paths as timed_paths,
)
from ._branches import (
    least_duration as least_duration,
)
from ._fast_timing import (
    PathTiming as PathTiming,
    time_path as time_path,
)
from ._free import (
    fastest_motion as fastest_motion,
    motions_of_front as motions_of_front,
    time_optimal as time_optimal,
)
from ._free_search import (
    TimeOptimalSettings as TimeOptimalSettings,
)
from ._orders import (
    in_order as in_order,
)
from ._parts import (
    Part as Part,
    Place as Place,
    parts_of as parts_of,
    places_along as places_along,
    scenes_of as scenes_of,
    tool_poses as tool_poses,
)
from ._path_timing import (
    PathTimingSettings as PathTimingSettings,
    best_timing as best_timing,
    time_optimal_path as time_optimal_path,
)
from ._paths import (
    check_path as check_path,
    corners as corners,
    straight_path as straight_path,
    straight_through as straight_through,
)
from ._phase_plane import (
    PathLimit as PathLimit,
    PhasePlane as PhasePlane,
    phase_plane as phase_plane,
)
from ._prepared import (
    TimeOptimalSolver as TimeOptimalSolver,
)
from ._progress import (
    MotionIteration as MotionIteration,
)
from ._segments import (
    Circle as Circle,
    JointLine as JointLine,
    Line as Line,
    Segment as Segment,
)
from ._stop_search import (
    stretches as stretches,
)
from ._stop_task import (
    Task as Task,
    is_task as is_task,
    task_of as task_of,
)
from ._stops import (
    Payload as Payload,
    Stop as Stop,
)
from ._task import (
    check_limits as check_limits,
    check_via as check_via,
    reach_of as reach_of,
    with_changes as with_changes,
)
