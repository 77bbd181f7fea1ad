"""The command line ``microbot-ocp``; docs/cli.md describes every command."""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
