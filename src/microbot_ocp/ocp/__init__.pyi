"""Public names, loaded on first use."""

from .arcs import (
    find_switches as find_switches,
)
from .diagnosis import (
    Explanation as Explanation,
    Relaxation as Relaxation,
    explain as explain,
)
from .problem import (
    OptimalControlProblem as OptimalControlProblem,
    Phase as Phase,
    numeric_function as numeric_function,
)
from .refinement import (
    Accuracy as Accuracy,
)
from .search import (
    solve as solve,
)
from .solution import (
    Attempt as Attempt,
    Iteration as Iteration,
    PhaseSolution as PhaseSolution,
    Solution as Solution,
    Status as Status,
)
from .solvers import (
    SOLVERS as SOLVERS,
    ParametricSolver as ParametricSolver,
    SolverSettings as SolverSettings,
    load_solution as load_solution,
    repeat as repeat,
    save_solution as save_solution,
    saved_with as saved_with,
)
from .starts import (
    default_guess as default_guess,
    guess_from as guess_from,
)
from .switching import (
    Junction as Junction,
    SwitchingTimes as SwitchingTimes,
    solve_switching_times as solve_switching_times,
)
from .transcription import (
    SCHEMES as SCHEMES,
    Collocation as Collocation,
    Guess as Guess,
    HermiteSimpson as HermiteSimpson,
    IntegratorShooting as IntegratorShooting,
    Scheme as Scheme,
    Shooting as Shooting,
    Transcription as Transcription,
    Trapezoidal as Trapezoidal,
)
from .verification import (
    OCPCertificate as OCPCertificate,
    Thresholds as Thresholds,
    verify as verify,
)
