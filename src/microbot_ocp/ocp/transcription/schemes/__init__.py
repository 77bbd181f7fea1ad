"""Ways to step over an interval, one file each; a problem changes its scheme by one argument."""

from dataclasses import replace

from microbot_ocp._base.checks import InputError
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
    within_bounds as within_bounds,
)
from microbot_ocp.ocp.transcription.schemes._shooting import (
    IntegratorShooting as IntegratorShooting,
    Shooting,
)
from microbot_ocp.ocp.transcription.schemes._trapezoidal import HermiteSimpson, Trapezoidal

SCHEMES: dict[str, Scheme] = {
    "shooting": Shooting(),
    "radau": Collocation("radau", 3),
    "gauss": Collocation("legendre", 3),
    "trapezoidal": Trapezoidal(),
    "hermite_simpson": HermiteSimpson(),
}


def with_degree(scheme: Scheme, degree: int) -> Scheme:
    """Return the scheme with another degree.

    Raises
    ------
    InputError
        The scheme has no degree, or not this one.
    """
    if isinstance(scheme, Collocation):
        return replace(scheme, degree=degree)
    name = type(scheme).__name__
    raise InputError(f"a mesh with degrees needs collocation ('radau' or 'gauss'), not {name}")
