"""Public names; loaded when they are first asked for."""

from ._limits import (
    AccelerationLimits as AccelerationLimits,
    BreakingState as BreakingState,
    acceleration_limits as acceleration_limits,
)
from ._map import (
    AccelerationMap as AccelerationMap,
    acceleration_map as acceleration_map,
)
