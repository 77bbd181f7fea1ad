"""Public names, loaded on first use."""

from ._answer import (
    Junction as Junction,
    SwitchingTimes as SwitchingTimes,
)
from ._switching_times import (
    solve_switching_times as solve_switching_times,
)
