"""Public names, each imported at its first access."""

from ._embedded import show as show
from ._sliders import TimeOptimalSliders as TimeOptimalSliders
