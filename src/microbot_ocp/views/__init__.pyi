"""Public names; loaded when they are first asked for."""

from . import plots as plots
