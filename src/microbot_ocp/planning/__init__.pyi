"""Public names; loaded when they are first asked for."""

from ._free import (
    TimeOptimalSettings as TimeOptimalSettings,
    time_optimal as time_optimal,
)
from ._path import (
    PathTimingSettings as PathTimingSettings,
    corners as corners,
    stops as stops,
    straight_path as straight_path,
    time_optimal_path as time_optimal_path,
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
from ._reachability import (
    path_grid as path_grid,
    time_path as time_path,
)
from ._task import (
    check_limits as check_limits,
    check_via as check_via,
)
