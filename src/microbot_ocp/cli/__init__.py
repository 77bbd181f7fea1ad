"""The command line ``microbot-ocp``; docs/cli.md tells what each command does."""

from microbot_ocp.cli.app import entry, main

__all__ = ["entry", "main"]
