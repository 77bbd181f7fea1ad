"""Public names; loaded when they are first asked for."""

from ._builders import (
    of_branches as of_branches,
    of_comparison as of_comparison,
    of_motion as of_motion,
    of_tracking as of_tracking,
)
from ._iterations import (
    APPLICATION as APPLICATION,
    ITERATION as ITERATION,
    IterationRecorder as IterationRecorder,
    phase_curves as phase_curves,
    record_iterations as record_iterations,
)
from ._palette import (
    SATURATED_COLOR as SATURATED_COLOR,
)
from ._panels import (
    HEIGHT as HEIGHT,
    WIDTH as WIDTH,
    rounded as rounded,
)
from ._paths import (
    BRANCH as BRANCH,
    PROGRESS as PROGRESS,
    TIME as TIME,
)
from ._recording import (
    Recording as Recording,
)
from ._rotations import (
    quaternions as quaternions,
)
from ._solution import (
    SolutionRecording as SolutionRecording,
    of_solution as of_solution,
)
from ._writer import (
    Writer as Writer,
    file_writer as file_writer,
)
