"""Public names; loaded when they are first asked for."""

from ._accuracy import (
    Accuracy as Accuracy,
)
from ._context import (
    SolveContext as SolveContext,
)
from ._degrees import (
    Degrees as Degrees,
    decay_rates as decay_rates,
    degrees_on as degrees_on,
    refine_hp as refine_hp,
)
from ._history import (
    History as History,
    RefinementStep as RefinementStep,
)
from ._improvement import (
    improvable as improvable,
    improved as improved,
)
from ._judged import (
    PASSING as PASSING,
    judged as judged,
)
from ._refiner import (
    WORSE as WORSE,
    Refiner as Refiner,
    split as split,
)
