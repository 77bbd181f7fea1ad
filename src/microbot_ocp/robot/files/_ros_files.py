"""Files that robot files refer to by packages of ROS: meshes, and files included by xacro.

The package ``xacro`` expands xacro files into URDF.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from microbot_ocp._base.checks import InputError
from microbot_ocp._base.child_process import Died, OutOfTime, can_fork, in_child
from microbot_ocp._base.needed import needed
from microbot_ocp._base.reading import MOST_BYTES, bytes_of
from microbot_ocp.robot.files._xml import Remarks

SCHEMES = ("package", "model")
EXPANSION_TIME = 10.0  # s of wall time; xacro expressions are programs that may not end


def find_mesh(reference: str, folder: Path | None, remarks: Remarks) -> str:
    """Return the path of a mesh file; the reference itself, with a remark, if it is missing."""
    reference = reference.strip()
    for path in _candidates(reference, folder):
        try:
            if path.is_file():
                return str(path)
        except (OSError, ValueError):  # an impossible file name
            break
    if reference:
        remarks.add("mesh files are missing", repr(reference))
    return reference


def _candidates(reference: str, folder: Path | None) -> Iterator[Path]:
    scheme, _, place = reference.partition("://")
    if scheme in SCHEMES:
        name, _, rest = place.partition("/")
        yield from (package / rest for package in _package(name, folder))
        # The package may have been renamed, or unpacked without its folder.
        yield from (above / rest for above in _above(folder))
    elif reference.startswith("file:"):
        yield Path(unquote(reference.removeprefix("file:").removeprefix("//")))
    else:
        yield (folder or Path()) / reference


def _package(name: str, folder: Path | None) -> Iterator[Path]:
    for above in _above(folder):
        if above.name == name:
            yield above
        yield above / name
    for root in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep):
        if root:
            yield from (Path(root) / name, *([Path(root)] if Path(root).name == name else []))


def _above(folder: Path | None) -> tuple[Path, ...]:
    return () if folder is None else (folder.resolve(), *folder.resolve().parents)


def urdf_content(
    path: str | Path, label: str, arguments: Mapping[str, str] | None = None
) -> str | bytes:
    """Return the content of a URDF file, or of an expanded xacro file.

    Raises
    ------
    InputError
        Errors of :func:`bytes_of` and of the package ``xacro``, or the package is missing.
    """
    data = bytes_of(path, label)
    xacro = Path(path).suffix.lower() == ".xacro"
    return _expanded(Path(path), arguments) if xacro else data


def _expanded(path: Path, arguments: Mapping[str, str] | None) -> str:
    """Return the URDF text of a xacro file.

    ``$(find package)`` searches around the file and on ROS_PACKAGE_PATH; a package that is not
    found is assumed to be the one that contains the file, which may have been renamed.

    Raises
    ------
    InputError
        The package ``xacro`` is missing, or reports an error in the file.
    """
    xacro = needed("xacro", "reading xacro files needs", "urdf")
    substitution_args = needed("xacro.substitution_args", "reading xacro files needs", "urdf")
    folder, missing = path.absolute().parent, []

    def find(name: str) -> str:
        place = next((path for path in _package(name, folder) if path.is_dir()), None)
        if place is None:
            missing.append(name)
        return str(place or folder.parent)

    def work(_: object = None) -> tuple[bool, str]:
        """Return True and the text, or False and the error."""
        substitution_args._eval_find = find
        try:
            document: Any = xacro.process_file(str(path), mappings=dict(arguments or {}))
            return True, document.toxml()
        except Exception as problem:  # xacro raises many kinds of errors
            cause = problem
            while isinstance(inner := getattr(cause, "exc", None), Exception):
                cause = inner
            if isinstance(cause, MemoryError):
                return False, f"it takes more than {MOST_BYTES:,} bytes"
            advice = f" (package {missing[-1]!r} is not on ROS_PACKAGE_PATH)" if missing else ""
            return False, " ".join(f"{problem}{advice}".split())

    before = substitution_args._eval_find
    try:
        # Expressions are programs, which may not end.
        until = time.perf_counter() + EXPANSION_TIME
        good, text = in_child(work, until, most_bytes=MOST_BYTES) if can_fork() else work()
    except OutOfTime:
        good, text = False, f"it takes more than {EXPANSION_TIME:g} s"
    except Died:
        good, text = False, f"it takes more than {MOST_BYTES:,} bytes"
    finally:
        substitution_args._eval_find = before
    if not good:
        advice = ""
        if "ndefined substitution argument" in text:
            advice = "; give it as --xacro NAME:=VALUE, in Python load_robot(..., xacro_arguments=)"
        raise InputError(f"{path.name} cannot be expanded by xacro: {text}{advice}")
    return text
