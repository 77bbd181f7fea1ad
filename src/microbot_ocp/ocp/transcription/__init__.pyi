"""Public names, loaded on first use."""

from ._assembly import (
    KernelCalls as KernelCalls,
    Program as Program,
    assemble as assemble,
    staged as staged,
)
from ._kernels import (
    Kernel as Kernel,
    kernels_of as kernels_of,
    with_derivatives as with_derivatives,
)
from ._layout import (
    Bounds as Bounds,
    PhaseLayout as PhaseLayout,
    PointGroup as PointGroup,
    StageKind as StageKind,
    bounds_of as bounds_of,
    fill_transitions as fill_transitions,
    fill_values as fill_values,
    labels_of as labels_of,
    stage_kind as stage_kind,
)
from ._table import (
    DURATION as DURATION,
    EQUATIONS as EQUATIONS,
    Block as Block,
    IntArray as IntArray,
    Label as Label,
    TableEntry as TableEntry,
)
from ._transcription import (
    AnyProblem as AnyProblem,
    Guess as Guess,
    Guesses as Guesses,
    GuessValue as GuessValue,
    Meshes as Meshes,
    MeshLike as MeshLike,
    Transcription as Transcription,
    guess_table as guess_table,
    interpolate as interpolate,
    mesh_of as mesh_of,
    sampled as sampled,
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
