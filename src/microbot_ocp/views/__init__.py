"""Figures, tables and recordings, each imported at its first use.

``plots`` needs matplotlib, ``recording`` needs rerun, ``tables`` needs rich.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
