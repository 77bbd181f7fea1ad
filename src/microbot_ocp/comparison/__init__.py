"""One task by every method under the same limits, and the certificate of every motion."""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
