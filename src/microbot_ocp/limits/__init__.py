"""All limits of a robot as one family, and the engine that evaluates, measures and locates them."""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
