"""Notebook widgets: the Rerun viewer, and sliders that solve a task again.

Tables of results are in :mod:`microbot_ocp.views.tables`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
