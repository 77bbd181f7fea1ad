"""Public names; loaded when they are first asked for."""

from ._files import (
    SCHEMA as SCHEMA,
)
from ._motion import (
    JUMP_GAP as JUMP_GAP,
    SAMPLE_STEP as SAMPLE_STEP,
    Mark as Mark,
    Motion as Motion,
    mesh_of as mesh_of,
    sample_times as sample_times,
    torque_along as torque_along,
)
from ._polynomial import (
    PiecewisePolynomial as PiecewisePolynomial,
    State as State,
    quintic_between as quintic_between,
)
