"""Public names; loaded when they are first asked for."""

from ._problem import (
    Link as Link,
    OptimalControlProblem as OptimalControlProblem,
    PathConstraint as PathConstraint,
    Phase as Phase,
    Variable as Variable,
    node_variables as node_variables,
)
