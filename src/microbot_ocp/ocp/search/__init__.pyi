"""Public names, each imported at its first access."""

from ._solve import (
    STRATEGIES as STRATEGIES,
    solve as solve,
)
