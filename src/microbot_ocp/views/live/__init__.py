"""Solves watched while they run: progress lines, live plots, a live Rerun viewer."""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
