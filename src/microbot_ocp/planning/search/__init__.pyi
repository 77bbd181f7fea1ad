"""Public names, loaded on first use."""

from ._among_obstacles import LegPlanner as LegPlanner
from ._branches import least_duration as least_duration
from ._estimate import rested_duration as rested_duration
from ._fronts import motions_of_front as motions_of_front
from ._legs import ProvedPath as ProvedPath, at_least as at_least
from ._prepared import TimeOptimalSolver as TimeOptimalSolver
from ._result import FREE as FREE
from ._settings import TimeOptimalSettings as TimeOptimalSettings
from ._stop_motion import (
    Part as Part,
    Place as Place,
    motion_along as motion_along,
    over_stretches as over_stretches,
    parts_of as parts_of,
    places_along as places_along,
    scenes_of as scenes_of,
    stretches as stretches,
    tool_poses as tool_poses,
)
from ._through_stops import (
    SolveRequest as SolveRequest,
    fastest_through as fastest_through,
    in_order as in_order,
)
from ._time_optimal import time_optimal as time_optimal
