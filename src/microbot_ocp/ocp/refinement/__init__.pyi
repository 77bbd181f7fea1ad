"""Public names; loaded when they are first asked for."""

from ._adaptive import (
    Refined as Refined,
    resampled as resampled,
    solve_refined as solve_refined,
)
from ._arcs import (
    distance as distance,
    hold as hold,
    place_junctions as place_junctions,
)
from ._degrees import (
    Degrees as Degrees,
    decay_rates as decay_rates,
    degrees_on as degrees_on,
    refine_hp as refine_hp,
)
from ._history import (
    RefinementStep as RefinementStep,
)
from ._mesh_error import (
    divide as divide,
    state_errors as state_errors,
)
from ._refiner import (
    WORSE as WORSE,
    Refiner as Refiner,
    split as split,
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
