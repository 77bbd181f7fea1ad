"""Public names; loaded when they are first asked for."""

from ._app import (
    main as main,
)
from ._entry import (
    entry as entry,
)
from ._poses import (
    fixed_angles as fixed_angles,
)
from ._robots import (
    joint_sweep as joint_sweep,
    largest_reach as largest_reach,
)
