"""Public names; loaded when they are first asked for."""

from ._solve import (
    solve as solve,
)
