"""A CasADi optimal-control workbench for serial manipulators.

The public names stand in ``__init__.pyi``; each is loaded when it is first asked for.
"""

import os
import signal
import sys

if os.path.basename(sys.argv[0] if sys.argv else "").startswith("microbot-ocp"):
    # the program is loading: Ctrl-C ends it without a traceback, until it listens itself
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))

from microbot_ocp._base import border
from microbot_ocp.views import _registered as _registered  # results find their views there

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
