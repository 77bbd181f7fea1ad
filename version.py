"""The version of this checkout, for the build: that of the last tag, such as v0.2.0.

hatchling runs it (``tool.hatch.version`` of ``pyproject.toml``). Commits after a tag are
development versions of the next release, as are those of a clone without tags. Sources outside a
checkout have the version that their ``PKG-INFO`` says, or else :data:`FIRST`.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

FIRST = "0.1.0"  # the release that comes before any tag
ROOT = Path(__file__).resolve().parent


def version(root: Path = ROOT) -> str:
    """Version by PEP 440."""
    packed = root / "PKG-INFO"
    if packed.is_file():
        found = re.search(r"^Version: (\S+)$", packed.read_text("utf-8"), re.MULTILINE)
        return found[1] if found else FIRST
    top = _git(root, "rev-parse", "--show-toplevel")
    if not top or Path(top).resolve() != root.resolve():
        return FIRST
    described = _git(root, "describe", "--tags", "--long", "--match", "v[0-9]*")
    found = re.fullmatch(r"v(\d+(?:\.\d+)*)-(\d+)-(g[0-9a-f]+)", described)
    if found:
        tag, distance, commit = found.groups()
        if distance == "0":
            return tag
        *before, last = tag.split(".")
        return f"{'.'.join([*before, str(int(last) + 1)])}.dev{distance}+{commit}"
    count = _git(root, "rev-list", "--count", "HEAD")
    commit = _git(root, "rev-parse", "--short", "HEAD")
    return f"{FIRST}.dev{count}+g{commit}" if count and commit else FIRST


def _git(root: Path, *arguments: str) -> str:
    """What git says; nothing where it is missing or refuses."""
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=root, capture_output=True, text=True, check=True, timeout=20
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
