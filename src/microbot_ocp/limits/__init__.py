"""The family of limits and the one engine that evaluates, measures and locates them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
