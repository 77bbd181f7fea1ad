"""Entry of ``python -m microbot_ocp``, which runs ``microbot-ocp``."""

import sys

from microbot_ocp.cli import entry

if __name__ == "__main__":
    sys.exit(entry())
