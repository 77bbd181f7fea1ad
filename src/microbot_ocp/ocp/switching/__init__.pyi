"""Public names; loaded when they are first asked for."""

from ._answer import (
    Junction as Junction,
    SwitchingTimes as SwitchingTimes,
)
from ._switching_times import (
    solve_switching_times as solve_switching_times,
)
