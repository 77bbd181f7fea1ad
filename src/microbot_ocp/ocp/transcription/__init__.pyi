"""Public names; loaded when they are first asked for."""

from ._assembly import (
    Program as Program,
    assemble as assemble,
    phase_bounds as phase_bounds,
    phase_constants as phase_constants,
)
from ._kernels import (
    Kernels as Kernels,
    build_kernels as build_kernels,
    joined as joined,
)
from ._labels import (
    DURATION as DURATION,
    Entry as Entry,
    RowLabel as RowLabel,
    VariableLabel as VariableLabel,
    inner_variables as inner_variables,
    row_labels as row_labels,
    stage_rows as stage_rows,
    variable_labels as variable_labels,
)
from ._layout import (
    PhaseLayout as PhaseLayout,
    StageGroup as StageGroup,
    StageKind as StageKind,
)
from ._mesh import (
    IntArray as IntArray,
    Mesh as Mesh,
    Meshes as Meshes,
    MeshLike as MeshLike,
    mesh_of as mesh_of,
)
from ._transcription import (
    Guess as Guess,
    GuessValue as GuessValue,
    Transcription as Transcription,
)
from .schemes import (
    SCHEMES as SCHEMES,
    Collocation as Collocation,
    HermiteSimpson as HermiteSimpson,
    IntegratorShooting as IntegratorShooting,
    Scheme as Scheme,
    Shooting as Shooting,
    Trapezoidal as Trapezoidal,
)
