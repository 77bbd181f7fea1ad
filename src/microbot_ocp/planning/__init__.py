"""Time-optimal motions: free through via points, and the best timing of a given path."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
