"""Solution of a problem as declared, by a table of strategies.

Input: a problem or transcription, and optionally a mesh, a guess, an accuracy. Output: a
:class:`Solution` with the ledger of its strategies. Begin with :func:`solve` in ``_solve.py``, the
table and its loop; ``_other_starts.py`` searches for cheaper optima.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
