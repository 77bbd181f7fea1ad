"""Solve a problem by a table of strategies, each by fatrop, IPOPT or the SQP method.

Comes in: a problem or transcription, a mesh, a guess and :class:`SolverSettings`. Goes out: a
:class:`Solution`, converged or not, with the ledger of what was tried. Begin with :func:`solve` in
``_solve.py``, the table and its loop; ``_chain.py`` runs solvers in turn, ``_run.py`` one of them,
``_plugins.py`` has their options, ``_status.py`` and ``_acceptance.py`` judge the point,
``_parametric.py`` solves with changed data, ``_persistence.py`` saves and loads.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
