"""Figures, tables and recordings, each imported at its first use.

``plots`` needs matplotlib, ``recording`` needs rerun, ``tables`` needs rich.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
