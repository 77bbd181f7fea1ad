"""Time-optimal motions: free through via points, and the best timing of a given path."""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
