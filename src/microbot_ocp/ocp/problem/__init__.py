"""The declared problem: phases with states, controls, dynamics, costs and constraints."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
