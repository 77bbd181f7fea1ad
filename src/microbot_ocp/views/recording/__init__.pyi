"""Public names; loaded when they are first asked for."""

from ._animated_arm import (
    SATURATED_COLOR as SATURATED_COLOR,
    AnimatedArm as AnimatedArm,
)
from ._arm import drawn_geometry as drawn_geometry
from ._builders import (
    of_branches as of_branches,
    of_comparison as of_comparison,
    of_motion as of_motion,
    of_tracking as of_tracking,
)
from ._cell import (
    PART_COLOR as PART_COLOR,
    TUBE_COLOR as TUBE_COLOR,
    CellRecording as CellRecording,
    ball_radius as ball_radius,
    of_cell as of_cell,
)
from ._curves import HEIGHT as HEIGHT, WIDTH as WIDTH, rounded as rounded
from ._iterations import (
    APPLICATION as APPLICATION,
    ITERATION as ITERATION,
    IterationRecorder as IterationRecorder,
    phase_curves as phase_curves,
    record_iterations as record_iterations,
)
from ._limits import signed_share as signed_share
from ._loads import arcs as arcs
from ._obstacles import OBSTACLE_COLOR as OBSTACLE_COLOR
from ._recording import Carried as Carried, Recording as Recording
from ._solution import SolutionRecording as SolutionRecording, of_solution as of_solution
from ._surroundings import Eye as Eye, grid_spacing as grid_spacing
from ._writer import (
    BRANCH as BRANCH,
    PROGRESS as PROGRESS,
    TIME as TIME,
    Writer as Writer,
    file_writer as file_writer,
    quaternions as quaternions,
)
