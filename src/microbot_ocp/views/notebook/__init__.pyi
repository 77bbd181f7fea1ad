"""Public names; loaded when they are first asked for."""

from ._embedded import (
    show as show,
)
from ._sliders import (
    TimeOptimalSliders as TimeOptimalSliders,
)
from ._symbolic import (
    Expression as Expression,
    Matrix as Matrix,
    matrix_text as matrix_text,
    product as product,
    symbolic_row as symbolic_row,
    symbolic_velocities as symbolic_velocities,
)
