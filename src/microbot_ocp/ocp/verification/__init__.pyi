"""Public names, loaded on first use."""

from ._certificate import (
    Arc as Arc,
    Costates as Costates,
    CostCheck as CostCheck,
    Hamiltonian as Hamiltonian,
    OCPCertificate as OCPCertificate,
    OCPLimitUse as OCPLimitUse,
    Optimality as Optimality,
    Residual as Residual,
    ResimulationCheck as ResimulationCheck,
    Thresholds as Thresholds,
)
from ._conditions import (
    differentiate as differentiate,
    lagrangian_gradient as lagrangian_gradient,
)
from ._hamiltonian import (
    better_controls as better_controls,
    costates_of as costates_of,
)
from ._judgement import (
    Judgement as Judgement,
    judge as judge,
    verify as verify,
)
from ._limits import (
    dense_phase as dense_phase,
    limit_uses as limit_uses,
    relative_excess as relative_excess,
    runs as runs,
    worst_along as worst_along,
)
from ._recomputation import (
    Recomputation as Recomputation,
    scaled_rows as scaled_rows,
)
from ._reintegration import (
    each_interval as each_interval,
    interval_errors as interval_errors,
    mesh_states as mesh_states,
    point_values as point_values,
)
