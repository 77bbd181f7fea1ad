"""Solvers of staged programs: fatrop, IPOPT and an SQP method, with a fallback chain."""

from microbot_ocp.ocp.solvers.chain import run_chain, solve, transcribed, with_cost_scale
from microbot_ocp.ocp.solvers.run import Made
from microbot_ocp.ocp.solvers.settings import SOLVERS, SolverSettings
from microbot_ocp.ocp.start import default_guess

__all__ = [
    "SOLVERS",
    "Made",
    "SolverSettings",
    "default_guess",
    "run_chain",
    "solve",
    "transcribed",
    "with_cost_scale",
]
