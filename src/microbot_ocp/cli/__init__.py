"""The command line ``microbot-ocp``; docs/cli.md describes every command."""

import lazy_loader

# not by way of the border, which loads numpy: signals are taken before that
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
