"""Public names; loaded when they are first asked for."""

from ._cubic import (
    cubic as cubic,
    via_points as via_points,
    via_velocities as via_velocities,
)
from ._lspb import (
    lspb as lspb,
)
from ._quintic import (
    quintic as quintic,
)
from ._shortest_duration import (
    Scaled as Scaled,
    shortest_duration as shortest_duration,
)
from ._spline import (
    spline as spline,
)
