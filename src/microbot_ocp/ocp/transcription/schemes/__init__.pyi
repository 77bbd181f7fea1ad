"""Public names, loaded on first use."""

from ._base import (
    Interval as Interval,
    IntervalStep as IntervalStep,
    Scheme as Scheme,
    StageVariable as StageVariable,
    lagrange as lagrange,
    pointwise as pointwise,
)
from ._collocation import (
    Collocation as Collocation,
    HermiteSimpson as HermiteSimpson,
    Trapezoidal as Trapezoidal,
    within_bounds as within_bounds,
)
from ._schemes import (
    SCHEMES as SCHEMES,
)
from ._shooting import (
    IntegratorShooting as IntegratorShooting,
    Shooting as Shooting,
)
