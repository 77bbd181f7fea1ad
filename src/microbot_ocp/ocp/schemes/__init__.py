"""Ways to step over an interval, one file each; a problem changes its scheme by one argument."""

from microbot_ocp.ocp.schemes.base import Scheme
from microbot_ocp.ocp.schemes.collocation import Collocation
from microbot_ocp.ocp.schemes.shooting import IntegratorShooting, Shooting
from microbot_ocp.ocp.schemes.trapezoidal import HermiteSimpson, Trapezoidal

SCHEMES: dict[str, Scheme] = {
    "shooting": Shooting(),
    "radau": Collocation("radau", 3),
    "gauss": Collocation("legendre", 3),
    "trapezoidal": Trapezoidal(),
    "hermite_simpson": HermiteSimpson(),
}

__all__ = [
    "SCHEMES",
    "Collocation",
    "HermiteSimpson",
    "IntegratorShooting",
    "Scheme",
    "Shooting",
    "Trapezoidal",
]
