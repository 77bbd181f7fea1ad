"""A robot as data, its files, and its kinematics and dynamics as CasADi functions."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
