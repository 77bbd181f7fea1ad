"""Public names, loaded on first use."""

from ._expressions import (
    Expressions as Expressions,
    PythonFunction as PythonFunction,
    as_scalars as as_scalars,
    numeric_function as numeric_function,
    operations as operations,
)
from ._items import (
    CONSTANTS as CONSTANTS,
    LIMITS as LIMITS,
    VARIABLES as VARIABLES,
    Parameter as Parameter,
    PathConstraint as PathConstraint,
    PhaseLink as PhaseLink,
    PointConstraint as PointConstraint,
    Range as Range,
    Variable as Variable,
    duration_bounds as duration_bounds,
    ordered as ordered,
)
from ._phase import (
    Phase as Phase,
)
from ._problem import (
    OptimalControlProblem as OptimalControlProblem,
    control_equations as control_equations,
    node_variables as node_variables,
    parts_of as parts_of,
    tied_controls as tied_controls,
    with_items as with_items,
    with_phases as with_phases,
    with_shapes as with_shapes,
    with_values as with_values,
)
