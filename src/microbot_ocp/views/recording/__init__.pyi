"""Public names, loaded on first use."""

from ._animated_arm import AnimatedArm as AnimatedArm
from ._builders import (
    of_branches as of_branches,
    of_cell as of_cell,
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
    rounded as rounded,
)
from ._limits import signed_share as signed_share
from ._loads import arcs as arcs
from ._recording import Recording as Recording
from ._solution import SolutionRecording as SolutionRecording, of_solution as of_solution
from ._sweep import of_sweep as of_sweep
from ._writer import (
    BRANCH as BRANCH,
    PROGRESS as PROGRESS,
    TIME as TIME,
    Writer as Writer,
    file_writer as file_writer,
    quaternions as quaternions,
)
