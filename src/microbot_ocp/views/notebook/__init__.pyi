"""Public names; loaded when they are first asked for."""

from ._embedded import show as show
from ._sliders import TimeOptimalSliders as TimeOptimalSliders
