"""Public names; loaded when they are first asked for."""

from ._mesh_error import (
    DIVISION as DIVISION,
    divide as divide,
    divide_phase as divide_phase,
    state_errors as state_errors,
)
from ._refined import (
    Refinement as Refinement,
    Round as Round,
    refined as refined,
)
