"""Public names, loaded on first use."""

from ._chain import (
    SolveContext as SolveContext,
    not_started as not_started,
    run_chain as run_chain,
    transcribed as transcribed,
    with_cost_scale as with_cost_scale,
)
from ._ldl import (
    as_ipopt_knows as as_ipopt_knows,
    linear_solver_library as linear_solver_library,
)
from ._parametric import (
    ParametricSolver as ParametricSolver,
)
from ._persistence import (
    load_solution as load_solution,
    repeat as repeat,
    save_solution as save_solution,
    saved_with as saved_with,
)
from ._plugins import (
    LEAST_WARM_BARRIER as LEAST_WARM_BARRIER,
    SOLVERS as SOLVERS,
    SolverSettings as SolverSettings,
    create as create,
)
from ._run import (
    Runner as Runner,
    Solvers as Solvers,
    accepted as accepted,
    arguments_of as arguments_of,
    status_of as status_of,
)
