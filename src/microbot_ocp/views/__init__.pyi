"""Public names; loaded when they are first asked for."""

from . import notebook as notebook, plots as plots
from ._studio import Studio as Studio, studio as studio
