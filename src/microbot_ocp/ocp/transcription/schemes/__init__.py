"""Discretisation schemes of an interval; one argument of a transcription chooses the scheme.

Input: the symbols of one interval. Output: the step over it. Begin with ``_base.py``, which defines
the protocol of a scheme; ``_schemes.py`` lists the schemes by name.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
