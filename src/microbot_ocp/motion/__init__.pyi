"""Public names, loaded on first use."""

from ._export import (
    EXPORT_FORMATS as EXPORT_FORMATS,
    FIELDS as FIELDS,
    FILM_FORMATS as FILM_FORMATS,
    NANOSECONDS as NANOSECONDS,
    Columns as Columns,
    marks_path as marks_path,
    write_columns as write_columns,
)
from ._motion import (
    SAMPLE_STEP as SAMPLE_STEP,
    SCHEMA as SCHEMA,
    TORQUE_EXCESS as TORQUE_EXCESS,
    Mark as Mark,
    Motion as Motion,
    Outcome as Outcome,
    other_arm as other_arm,
    pieces_of as pieces_of,
    polynomial_of as polynomial_of,
    sample_times as sample_times,
    torque_along as torque_along,
    unresolved as unresolved,
)
from ._polynomial import (
    PiecewisePolynomial as PiecewisePolynomial,
    State as State,
    quintic_between as quintic_between,
)
from ._sampling import (
    JUMP_GAP as JUMP_GAP,
    dense_times as dense_times,
    history_of as history_of,
    jump_gaps as jump_gaps,
    mesh_of as mesh_of,
    nearest_samples as nearest_samples,
    numbered as numbered,
    quadrature as quadrature,
    with_parts as with_parts,
)
from ._sensitivities import (
    DurationLine as DurationLine,
    Sensitivities as Sensitivities,
)
