"""Public names; loaded when they are first asked for."""

from ._motion import (
    JUMP_GAP as JUMP_GAP,
    SAMPLE_STEP as SAMPLE_STEP,
    SCHEMA as SCHEMA,
    Mark as Mark,
    Motion as Motion,
    PiecewisePolynomial as PiecewisePolynomial,
    State as State,
    mesh_of as mesh_of,
    quintic_between as quintic_between,
    sample_times as sample_times,
    torque_along as torque_along,
)
