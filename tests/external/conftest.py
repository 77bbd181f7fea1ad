"""Tests that are left out on systems for which a peer has no package."""

from importlib.util import find_spec

collect_ignore_glob = []
if find_spec("pinocchio") is None:  # Windows
    collect_ignore_glob.append("*.py")
if find_spec("toppra") is None:  # Windows, macOS
    collect_ignore_glob.append("*toppra*")
