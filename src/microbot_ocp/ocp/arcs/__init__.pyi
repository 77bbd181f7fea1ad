"""Public names; loaded when they are first asked for."""

from ._cutter import (
    distance as distance,
    hold as hold,
    place_junctions as place_junctions,
)
from ._switches import (
    Switch as Switch,
    find_switches as find_switches,
    move_to_switches as move_to_switches,
)
from ._switching_times import (
    Junction as Junction,
    SwitchingTimes as SwitchingTimes,
    solve_switching_times as solve_switching_times,
)
