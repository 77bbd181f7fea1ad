"""Optimal-control problems on any CasADi dynamics: declare, solve, check, explain.

====================================  ==============================================================
declare                               :class:`OptimalControlProblem`, whose :class:`Phase` s hold
                                      the physics
transcribe                            :class:`Transcription` with one of the :data:`SCHEMES`:
                                      :class:`Shooting`, :class:`IntegratorShooting`,
                                      :class:`Collocation`, :class:`Trapezoidal`,
                                      :class:`HermiteSimpson`; a :class:`Mesh` chooses the degree
                                      of collocation interval by interval
solve                                 :func:`solve` with :class:`SolverSettings` from a
                                      :class:`Guess` a phase or from an earlier :class:`Solution`;
                                      :class:`Iteration` is what a progress function gets
solve to an accuracy                  :func:`solve_refined` on meshes that it chooses
solve again with other numbers        :class:`ParametricSolver`
look at the result                    :class:`Solution` with its :class:`Status`, every
                                      :class:`Attempt`, and a :class:`PhaseSolution` a phase
check it                              :func:`verify` makes an :class:`OCPCertificate`
no solution                           :func:`explain` names the limits that contradict each other
keep it                               :func:`save_solution`, :func:`load_solution`; :func:`repeat`
                                      solves again as it was solved
====================================  ==============================================================
"""

from microbot_ocp.checks import InputError
from microbot_ocp.ocp.adaptive import Refined, RefinementStatus, solve_refined
from microbot_ocp.ocp.diagnosis import Explanation, Relaxation, explain
from microbot_ocp.ocp.mesh import Mesh
from microbot_ocp.ocp.parametric import ParametricSolver
from microbot_ocp.ocp.persistence import load_solution, repeat, save_solution, saved_with
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase
from microbot_ocp.ocp.progress import Iteration
from microbot_ocp.ocp.schemes import (
    SCHEMES,
    Collocation,
    HermiteSimpson,
    IntegratorShooting,
    Scheme,
    Shooting,
    Trapezoidal,
)
from microbot_ocp.ocp.solution import Attempt, PhaseSolution, Solution, Status
from microbot_ocp.ocp.solvers import SOLVERS, SolverSettings, solve
from microbot_ocp.ocp.start import default_guess, guess_from
from microbot_ocp.ocp.switches import find_switches
from microbot_ocp.ocp.transcription import Guess, Transcription
from microbot_ocp.ocp.verification import OCPCertificate, Thresholds, verify

__all__ = [
    "SCHEMES",
    "SOLVERS",
    "Attempt",
    "Collocation",
    "Explanation",
    "Guess",
    "HermiteSimpson",
    "InputError",
    "IntegratorShooting",
    "Iteration",
    "Mesh",
    "OCPCertificate",
    "OptimalControlProblem",
    "ParametricSolver",
    "Phase",
    "PhaseSolution",
    "Refined",
    "RefinementStatus",
    "Relaxation",
    "Scheme",
    "Shooting",
    "Solution",
    "SolverSettings",
    "Status",
    "Thresholds",
    "Transcription",
    "Trapezoidal",
    "default_guess",
    "explain",
    "find_switches",
    "guess_from",
    "load_solution",
    "repeat",
    "save_solution",
    "saved_with",
    "solve",
    "solve_refined",
    "verify",
]
