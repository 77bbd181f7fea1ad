"""Public names; loaded when they are first asked for."""

from . import (
    notebook as notebook,
    plots as plots,
)
