"""Xacro files expanded into URDF, by the package ``xacro``."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from microbot_ocp._base.checks import InputError
from microbot_ocp._base.child_process import Died, OutOfTime, can_fork, in_child
from microbot_ocp._base.needed import needed
from microbot_ocp._base.reading import MOST_BYTES, bytes_of
from microbot_ocp.robot.files._mesh_files import package_folder

EXPANSION_TIME = 10.0  # s, of wall time: expressions are programs, whose steps nothing counts


def urdf_content(
    path: str | Path, what: str, arguments: Mapping[str, str] | None = None
) -> str | bytes:
    """Return what a URDF file holds, or a xacro file once it is expanded.

    Raises
    ------
    InputError
        As :func:`bytes_of` and :func:`expanded`.
    """
    data = bytes_of(path, what)
    xacro = Path(path).suffix.lower() == ".xacro"
    return expanded(Path(path), arguments) if xacro else data


def expanded(path: Path, arguments: Mapping[str, str] | None = None) -> str:
    """Return URDF text of a xacro file.

    ``$(find package)`` looks around the file and on ROS_PACKAGE_PATH; a package that is in neither
    is taken for the one that the file is in, which may have been renamed.

    Raises
    ------
    InputError
        The package ``xacro`` is missing, or what it says is wrong with the file.
    """
    xacro = needed("xacro", "reading xacro files needs", "urdf")
    substitution_args = needed("xacro.substitution_args", "reading xacro files needs", "urdf")
    folder, missing = path.absolute().parent, []

    def find(name: str) -> str:
        place = package_folder(name, folder)
        if place is None:
            missing.append(name)
        return str(place or folder.parent)

    def work(_: object = None) -> tuple[bool, str]:
        """Return whether it went well, and the text or what is wrong."""
        substitution_args._eval_find = find
        try:
            document: Any = xacro.process_file(str(path), mappings=dict(arguments or {}))
            return True, document.toxml()
        except Exception as problem:  # it raises whatever happens to go wrong inside
            cause = problem
            while isinstance(inner := getattr(cause, "exc", None), Exception):
                cause = inner
            if isinstance(cause, MemoryError):
                return False, f"it takes more than {MOST_BYTES:,} bytes"
            advice = f" (package {missing[-1]!r} is not on ROS_PACKAGE_PATH)" if missing else ""
            return False, " ".join(f"{problem}{advice}".split())

    before = substitution_args._eval_find
    try:
        # expressions are programs, which may go on for ever
        until = time.perf_counter() + EXPANSION_TIME
        good, text = in_child(work, until, most_bytes=MOST_BYTES) if can_fork() else work()
    except OutOfTime:
        good, text = False, f"it takes more than {EXPANSION_TIME:g} s"
    except Died:
        good, text = False, f"it takes more than {MOST_BYTES:,} bytes"
    finally:
        substitution_args._eval_find = before
    if not good:
        raise InputError(f"{path.name} cannot be expanded by xacro: {text}")
    return text
