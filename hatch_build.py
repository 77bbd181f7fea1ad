"""Adds to a wheel the C libraries that are the same for all robots.

They are compiled where CasADi and a C compiler are at hand: ``python -m build --no-isolation``, as
``make wheel`` calls it. Elsewhere the wheel has none, and the package compiles them when they are
first needed.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

# Oldest system of a wheel for macOS; Python's own tag may name both kinds of processors.
MACOS = {"Darwin-arm64": "macosx_11_0_arm64", "Darwin-x86_64": None}


class CommonLibraries(BuildHookInterface):
    """Compiles the libraries, and names the platform in the tag of the wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        usual = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        tag = MACOS.get(f"{platform.system()}-{platform.machine()}", usual)
        if version == "editable" or tag is None:
            return
        sys.path.insert(0, str(Path(self.root) / "src"))
        try:
            from microbot_ocp._base.fast_calls import rows_library
            from microbot_ocp.ocp.solvers._ldl import LIBRARIES
            from microbot_ocp.planning.free._flat_loops import WINDOWS
        except ImportError:  # CasADi is missing
            return
        common = [*LIBRARIES.values(), WINDOWS, rows_library(True), rows_library(False)]
        os.environ.setdefault("MACOSX_DEPLOYMENT_TARGET", "11.0")
        self.folder = tempfile.TemporaryDirectory()
        try:
            built = [library.compile_for_wheel(Path(self.folder.name)) for library in common]
        except (OSError, subprocess.SubprocessError, RuntimeError) as problem:
            self.app.display_warning(f"a wheel without compiled libraries: {problem}")
            return
        for path in built:
            build_data["force_include"][str(path)] = f"microbot_ocp/compiled/{path.name}"
        build_data |= {"pure_python": False, "tag": f"py3-none-{tag}"}

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        if hasattr(self, "folder"):
            self.folder.cleanup()
