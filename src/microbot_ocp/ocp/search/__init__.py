"""Solve a problem as it was declared, by a table of strategies.

Comes in: a problem or transcription, and perhaps a mesh, a guess, an accuracy. Goes out: a
:class:`Solution`, with the ledger of what was tried. Begin with :func:`solve` in ``_solve.py``, the
table and its loop; ``_other_starts.py`` looks for cheaper optima.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
