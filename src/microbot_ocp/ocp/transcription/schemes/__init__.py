"""Ways to step over an interval; a problem changes its scheme by one argument."""

from microbot_ocp.ocp.transcription.schemes._base import (
    Interval as Interval,
    IntervalStep as IntervalStep,
    Scheme,
    StageVariable as StageVariable,
    lagrange as lagrange,
    pointwise as pointwise,
)
from microbot_ocp.ocp.transcription.schemes._collocation import (
    Collocation,
    HermiteSimpson,
    Trapezoidal,
    within_bounds as within_bounds,
)
from microbot_ocp.ocp.transcription.schemes._shooting import (
    IntegratorShooting as IntegratorShooting,
    Shooting,
)

SCHEMES: dict[str, Scheme] = {
    "shooting": Shooting(),
    "radau": Collocation("radau", 3),
    "gauss": Collocation("legendre", 3),
    "trapezoidal": Trapezoidal(),
    "hermite_simpson": HermiteSimpson(),
}
