"""A CasADi optimal-control workbench for serial manipulators.

``__init__.pyi`` lists the public names, each of which is imported at its first access.
"""

import os
import signal
import sys

if os.path.basename(sys.argv[0] if sys.argv else "").startswith("microbot-ocp"):
    # Ctrl-C ends the program without a traceback until its own handler is installed.
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)

# Results look their views up there; its functions are public, so the face goes first.
from microbot_ocp.views import _registered as _registered  # noqa: E402
