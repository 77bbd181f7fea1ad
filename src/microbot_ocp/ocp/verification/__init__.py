"""Certificate of an optimal-control solution: re-simulation, dense limits, optimality conditions.

Nothing here trusts the solver or the derivatives that it was given. The dynamics are integrated
again, the limits are looked at between the mesh points, and the conditions of Karush, Kuhn and
Tucker are formed anew from the declared problem.
"""

from microbot_ocp.ocp.verification.certificate import (
    Arc,
    Costates,
    Hamiltonian,
    LimitUse,
    OCPCertificate,
    Optimality,
    Residual,
    ResimulationCheck,
    Thresholds,
)
from microbot_ocp.ocp.verification.certification import verify

__all__ = [
    "Arc",
    "Costates",
    "Hamiltonian",
    "LimitUse",
    "OCPCertificate",
    "Optimality",
    "Residual",
    "ResimulationCheck",
    "Thresholds",
    "verify",
]
