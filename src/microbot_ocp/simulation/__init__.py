"""The arm in motion: open loop from torques, closed loop under a controller.

Every simulation is one call of one integrator on the whole grid.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
