"""Public names; loaded when they are first asked for."""

from ._problem import (
    OptimalControlProblem as OptimalControlProblem,
    PathConstraint as PathConstraint,
    Phase as Phase,
    PhaseLink as PhaseLink,
    Variable as Variable,
    node_variables as node_variables,
)
