"""The layout of a cell: where the arm stands, how its tool is turned, where its stops are.

A cell and a few free quantities come in; out come the values that make its motion fastest, the
motion with its certificate, and the worth of every quantity. Begin at ``_design.py``; free
quantities are in ``_quantities.py``, slopes in ``_slopes.py``, the search in ``_search.py``.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
