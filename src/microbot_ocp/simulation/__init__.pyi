"""Public names, loaded on first use."""

from ._controllers import (
    ComputedTorque as ComputedTorque,
    Controller as Controller,
    Feedforward as Feedforward,
    PDGravity as PDGravity,
    SensorNoise as SensorNoise,
)
from ._integration import (
    COARSEST as COARSEST,
    INTEGRATORS as INTEGRATORS,
)
from ._loops import (
    simulate as simulate,
    track as track,
)
from ._result import (
    Simulation as Simulation,
    Tracking as Tracking,
)
from ._signals import (
    interpolated as interpolated,
    lagrange_weights as lagrange_weights,
    motion_from_formula as motion_from_formula,
)
