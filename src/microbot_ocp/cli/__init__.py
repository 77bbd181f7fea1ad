"""The command line ``microbot-ocp``; docs/cli.md describes every command."""

import lazy_loader

# lazy_loader directly: _base.border loads numpy, and signal handlers are installed before that.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
