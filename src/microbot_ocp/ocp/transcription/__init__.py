"""From a declared problem to a program on a mesh: schemes, kernels, layout, labels."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
