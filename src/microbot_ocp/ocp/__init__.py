"""Optimal-control problems on any CasADi dynamics: declare, solve, verify, explain.

Comes in: a declared problem. Goes out: a solution, its certificate, or an explanation why there is
none. Begin with :class:`OptimalControlProblem` and :func:`solve`.

====================================  ==============================================================
declare                               :class:`OptimalControlProblem`, whose :class:`Phase` s hold
                                      the physics
transcribe                            :class:`Transcription` with one of the :data:`SCHEMES`:
                                      :class:`Shooting`, :class:`IntegratorShooting`,
                                      :class:`Collocation`, :class:`Trapezoidal`,
                                      :class:`HermiteSimpson`
solve                                 :func:`solve` with :class:`SolverSettings` from a
                                      :class:`Guess` a phase or from an earlier :class:`Solution`;
                                      :class:`Iteration` is what a progress function gets
solve to an accuracy                  the same with ``accuracy``, a number or an :class:`Accuracy`
solve for switching times             :func:`solve_switching_times`: one phase of free length an arc
solve again with other data           :class:`ParametricSolver`: limits, conditions, parameters
the result                            :class:`Solution` with its :class:`Status`, every
                                      :class:`Attempt`, and one :class:`PhaseSolution` per phase
verify it                             :func:`verify` makes an :class:`OCPCertificate`
no solution                           :func:`explain` names the limits that conflict
keep it                               :func:`save_solution`, :func:`load_solution`; :func:`repeat`
                                      solves again as it was solved
====================================  ==============================================================
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
