"""Names of the schemes."""

from microbot_ocp.ocp.transcription.schemes._base import Scheme
from microbot_ocp.ocp.transcription.schemes._collocation import (
    Collocation,
    HermiteSimpson,
    Trapezoidal,
)
from microbot_ocp.ocp.transcription.schemes._shooting import Shooting

SCHEMES: dict[str, Scheme] = {
    "shooting": Shooting(),
    "radau": Collocation("radau", 3),
    "gauss": Collocation("legendre", 3),
    "trapezoidal": Trapezoidal(),
    "hermite_simpson": HermiteSimpson(),
}
