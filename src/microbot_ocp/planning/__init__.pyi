"""Public names, loaded on first use."""

from .free import (
    MotionIteration as MotionIteration,
)
from .path import (
    PathTiming as PathTiming,
    PhasePlane as PhasePlane,
    phase_plane as phase_plane,
    straight_path as straight_path,
    time_path as time_path,
)
from .search import (
    TimeOptimalSettings as TimeOptimalSettings,
    TimeOptimalSolver as TimeOptimalSolver,
    time_optimal as time_optimal,
)
from .task import (
    Circle as Circle,
    JointLine as JointLine,
    Line as Line,
    Payload as Payload,
    Stop as Stop,
    robust_limits as robust_limits,
)
from .timing import (
    PathTimingSettings as PathTimingSettings,
    time_optimal_path as time_optimal_path,
)
