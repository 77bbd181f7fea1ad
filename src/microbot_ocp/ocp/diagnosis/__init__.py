"""Reasons why a solve did not converge, in the names and units of the declaration.

Input: a program and a point, or a problem. Output: an error about values that are not finite, the
advice of a failed solve, or an :class:`Explanation` of limits that conflict. Begin with
:func:`explain` in ``_explain.py``; ``_advice.py`` and ``_finiteness.py`` are called by every solve.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
