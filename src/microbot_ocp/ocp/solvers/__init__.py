"""Solve a program: fatrop, IPOPT or the SQP method, in turn until one converges.

Comes in: a problem or transcription, a mesh, a guess and :class:`SolverSettings`. Goes out: a
:class:`Solution`, converged or not. Begin with :func:`solve` in ``_chain.py``; ``_run.py`` runs one
solver, ``_plugins.py`` has their options, ``_status.py`` and ``_acceptance.py`` judge the point,
``_parametric.py`` solves with changed data, ``_persistence.py`` saves and loads.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
