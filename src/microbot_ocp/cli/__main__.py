"""``python -m microbot_ocp.cli`` is ``microbot-ocp``."""

import sys

from microbot_ocp.cli import entry

sys.exit(entry())
