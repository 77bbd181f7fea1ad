"""Public names, each imported at its first access."""

from . import notebook as notebook, plots as plots
from ._studio import Studio as Studio, studio as studio
