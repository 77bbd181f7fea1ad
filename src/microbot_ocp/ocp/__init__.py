"""Optimal-control problems on any CasADi dynamics: declare, solve, verify, explain.

Input: a declared problem. Output: a solution, its certificate, or an explanation why there is no
solution. Begin with :class:`OptimalControlProblem` and :func:`solve`.

====================================  ==============================================================
declare                               :class:`OptimalControlProblem`, whose :class:`Phase` s hold
                                      the physics
transcribe                            :class:`Transcription` with one of the :data:`SCHEMES`:
                                      :class:`Shooting`, :class:`IntegratorShooting`,
                                      :class:`Collocation`, :class:`Trapezoidal`,
                                      :class:`HermiteSimpson`
solve                                 :func:`solve` with :class:`SolverSettings` from a
                                      :class:`Guess` per phase or from an earlier
                                      :class:`Solution`; progress functions receive an
                                      :class:`Iteration`
solve to an accuracy                  :func:`solve` with ``accuracy``, a number or an
                                      :class:`Accuracy`
solve for switching times             :func:`solve_switching_times`: one phase of free length per
                                      arc
solve again with other data           :class:`ParametricSolver`: limits, conditions, parameters
the result                            :class:`Solution` with its :class:`Status`, every
                                      :class:`Attempt`, and one :class:`PhaseSolution` per phase
verify a solution                     :func:`verify` returns an :class:`OCPCertificate`
find a contradiction                  :func:`explain` names the limits that conflict
save and repeat a solution            :func:`save_solution`, :func:`load_solution`; :func:`repeat`
                                      solves again with the stored settings
====================================  ==============================================================
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
