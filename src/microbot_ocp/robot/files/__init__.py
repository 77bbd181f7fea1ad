"""Packaged robots, one TOML file each, and the readers and writers of robot files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
