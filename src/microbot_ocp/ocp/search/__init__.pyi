"""Public names, loaded on first use."""

from ._solve import (
    STRATEGIES as STRATEGIES,
    solve as solve,
)
