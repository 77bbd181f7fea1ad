"""Public names; loaded when they are first asked for."""

from ._adaptive import (
    Refined as Refined,
    divide as divide,
    resampled as resampled,
    solve_refined as solve_refined,
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
from ._refiner import (
    WORSE as WORSE,
    Refiner as Refiner,
    split as split,
)
