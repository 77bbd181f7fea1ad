"""Detection of the times at which controls switch and limits become active or inactive.

Input: a solution on a mesh. Output: :class:`Switch` es, arcs, or a mesh with points at the
switches. ``_detector.py`` detects switches and arcs, ``_mesh_points.py`` moves mesh points.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
