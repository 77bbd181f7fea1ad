"""Public names, loaded on first use."""

from ._check import (
    check as check,
)
from ._command import (
    ControllerCommand as ControllerCommand,
    commanded as commanded,
    exported as exported,
)
from ._curve import (
    executed as executed,
)
from ._override import (
    overridden as overridden,
)
from ._profile import (
    Profile as Profile,
    load_profile as load_profile,
    packaged_profiles as packaged_profiles,
)
from ._ratings import (
    Ratings as Ratings,
    ratings as ratings,
)
from ._reserve import (
    Reserve as Reserve,
    Trial as Trial,
    check_trials as check_trials,
    differing_plants as differing_plants,
    robust_limits as robust_limits,
    smallest_reserve as smallest_reserve,
)
from ._rows import (
    CommandRows as CommandRows,
    read_rows as read_rows,
)
