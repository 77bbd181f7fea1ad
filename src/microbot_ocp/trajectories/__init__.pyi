"""Public names, loaded on first use."""

from ._best_split import (
    best_split as best_split,
    first_splits as first_splits,
)
from ._best_through import (
    BLEND as BLEND,
    Segments as Segments,
    best_cubic as best_cubic,
    best_lspb as best_lspb,
    fastest as fastest,
    fastest_path as fastest_path,
    textbook as textbook,
)
from ._joint_sweep import (
    joint_sweep as joint_sweep,
)
from ._shortest_duration import (
    Scaled as Scaled,
    shortest_duration as shortest_duration,
)
from ._through_points import (
    ViaPoints as ViaPoints,
    cubic as cubic,
    cubic_through as cubic_through,
    lspb as lspb,
    quintic as quintic,
    spline as spline,
    via_points as via_points,
    via_velocities as via_velocities,
)
