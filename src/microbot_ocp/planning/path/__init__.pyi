"""Public names, loaded on first use."""

from ._blocked_path import (
    blocking_limit as blocking_limit,
)
from ._curve import (
    CurvePiece as CurvePiece,
    PathCurve as PathCurve,
    check_path as check_path,
    corners as corners,
    samples_along as samples_along,
    segments as segments,
    stops as stops,
    straight_path as straight_path,
    straight_through as straight_through,
)
from ._fast_timing import (
    PathTiming as PathTiming,
    sampled as sampled,
    time_path as time_path,
)
from ._limits import (
    LATER as LATER,
    largest_speeds as largest_speeds,
    limits_kept_by as limits_kept_by,
)
from ._phase_plane import (
    PathLimit as PathLimit,
    PhasePlane as PhasePlane,
    phase_plane as phase_plane,
)
from ._reachability import (
    SETTLED_CHANGE as SETTLED_CHANGE,
    CurveLimits as CurveLimits,
    Reached as Reached,
    harmonic as harmonic,
    path_grid as path_grid,
    reach as reach,
)
