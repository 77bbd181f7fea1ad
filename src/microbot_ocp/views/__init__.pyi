"""Public names, loaded on first use."""

from . import notebook as notebook, plots as plots
from ._studio import Studio as Studio, studio as studio
