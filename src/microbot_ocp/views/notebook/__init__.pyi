"""Public names, loaded on first use."""

from ._embedded import show as show
from ._sliders import TimeOptimalSliders as TimeOptimalSliders
