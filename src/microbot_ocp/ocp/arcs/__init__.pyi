"""Public names; loaded when they are first asked for."""

from ._answer import (
    Junction as Junction,
    SwitchingTimes as SwitchingTimes,
)
from ._detector import (
    Switch as Switch,
    find_switches as find_switches,
)
from ._mesh_points import (
    distance as distance,
    hold as hold,
    move_to_switches as move_to_switches,
    place_junctions as place_junctions,
)
from ._switching_times import (
    solve_switching_times as solve_switching_times,
)
