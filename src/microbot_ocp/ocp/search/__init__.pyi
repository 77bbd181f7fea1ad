"""Public names; loaded when they are first asked for."""

from ._solve import (
    STRATEGIES as STRATEGIES,
    solve as solve,
)
