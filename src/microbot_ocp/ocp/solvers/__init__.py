"""Solution of a program on a mesh by fatrop, IPOPT or the SQP method, in turn.

Input: a problem or transcription, a mesh, a guess and :class:`SolverSettings`. Output: a
:class:`Solution`, converged or not. Begin with :meth:`SolveContext.solve` in
``_chain.py``, which runs solvers in turn; ``_run.py`` runs one of them and judges its result,
``_plugins.py`` has their options, ``_parametric.py`` solves with changed data, ``_persistence.py``
saves and loads.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
