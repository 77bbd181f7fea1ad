"""Public names, each imported at its first access."""

from ._answer import (
    Junction as Junction,
    SwitchingTimes as SwitchingTimes,
)
from ._switching_times import (
    solve_switching_times as solve_switching_times,
)
