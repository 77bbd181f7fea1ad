"""Public names; loaded when they are first asked for."""

from ._best_split import (
    best_durations as best_durations,
    best_split as best_split,
    first_splits as first_splits,
)
from ._cubic import (
    cubic as cubic,
    cubic_through as cubic_through,
)
from ._joint_sweep import (
    joint_sweep as joint_sweep,
)
from ._lspb import (
    lspb as lspb,
    lspb_through as lspb_through,
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
from ._via_points import (
    ViaPoints as ViaPoints,
    via_points as via_points,
    via_velocities as via_velocities,
)
