"""Public names, loaded on first use."""

from ._accuracy import (
    PASSING as PASSING,
    Accuracy as Accuracy,
    History as History,
    RefinementStep as RefinementStep,
)
from ._judged import (
    BARRIER_NEAR_BOUNDS as BARRIER_NEAR_BOUNDS,
    CONVERGED as CONVERGED,
    UNREACHED_SAVING as UNREACHED_SAVING,
    improvable as improvable,
    improved as improved,
    judged as judged,
    named as named,
)
from ._refiner import (
    FORESIGHT as FORESIGHT,
    WORSE as WORSE,
    Refiner as Refiner,
    split as split,
)
