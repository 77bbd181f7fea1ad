"""Public names, loaded on first use."""

from ._mesh_error import (
    Refinement as Refinement,
    Round as Round,
    divide as divide,
    divide_phase as divide_phase,
    refined as refined,
    state_errors as state_errors,
)
