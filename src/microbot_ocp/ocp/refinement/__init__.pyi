"""Public names, loaded on first use."""

from ._accuracy import (
    PASSING as PASSING,
    Accuracy as Accuracy,
    History as History,
    RefinementStep as RefinementStep,
)
from ._judged import (
    CONVERGED as CONVERGED,
    COST as COST,
    IMPROVEMENT as IMPROVEMENT,
    improvable as improvable,
    improved as improved,
    judged as judged,
    named as named,
)
from ._refiner import (
    WORSE as WORSE,
    Refiner as Refiner,
    RefinerSettings as RefinerSettings,
    split as split,
)
