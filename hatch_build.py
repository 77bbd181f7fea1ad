"""Adds to a wheel the C libraries that are the same for all robots.

They are compiled where CasADi and a C compiler are at hand: ``python -m build --no-isolation``, as
``make wheel`` calls it. Elsewhere the wheel has none, and the package compiles them when they are
first needed.
"""

from __future__ import annotations

import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CommonLibraries(BuildHookInterface):
    """Compiles the libraries, and names the platform in the tag of the wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        sys.path.insert(0, str(Path(self.root) / "src"))
        try:
            from microbot_ocp._base.fast_calls import rows_library
            from microbot_ocp.ocp.solvers._ldl import LIBRARIES
            from microbot_ocp.planning.free._flat_loops import WINDOWS
        except ImportError:  # CasADi is missing
            return
        if version == "editable":
            return
        common = [*LIBRARIES.values(), WINDOWS, rows_library(True), rows_library(False)]
        self.folder = tempfile.TemporaryDirectory()
        built = [library.compile_for_wheel(Path(self.folder.name)) for library in common]
        if None in built:
            return
        for path in filter(None, built):
            build_data["force_include"][str(path)] = f"microbot_ocp/compiled/{path.name}"
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data |= {"pure_python": False, "tag": f"py3-none-{platform}"}

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        if hasattr(self, "folder"):
            self.folder.cleanup()
