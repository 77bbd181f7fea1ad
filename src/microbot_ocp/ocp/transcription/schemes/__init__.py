"""Ways to step over an interval; a problem changes its scheme by one argument.

Comes in: the symbols of one interval. Goes out: the step over it. Begin with ``_base.py``, which
says what a scheme is; ``_schemes.py`` has their names.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
