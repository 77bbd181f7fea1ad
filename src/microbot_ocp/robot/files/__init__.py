"""Packaged robots, one TOML file each, and the readers and writers of robot files."""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
