"""Public names, loaded on first use."""

from ._path_timing import (
    PathTimingSettings as PathTimingSettings,
    best_timing as best_timing,
    time_optimal_path as time_optimal_path,
)
