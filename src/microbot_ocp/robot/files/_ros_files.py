"""Files that robot files refer to, by the packages of ROS: meshes, and what xacro files include.

Xacro files are expanded into URDF by the package ``xacro``.
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
EXPANSION_TIME = 10.0  # s, of wall time: expressions are programs, whose steps nothing counts


def find_mesh(reference: str, folder: Path | None, remarks: Remarks) -> str:
    """Return the path of the file that a URDF names; the reference itself, with a remark, if there
    is none.
    """
    reference = reference.strip()
    for path in _candidates(reference, folder):
        try:
            if path.is_file():
                return str(path)
        except (OSError, ValueError):  # a name that no file can have
            break
    if reference:
        remarks.add("mesh files are missing", repr(reference))
    return reference


def _candidates(reference: str, folder: Path | None) -> Iterator[Path]:
    scheme, _, place = reference.partition("://")
    if scheme in SCHEMES:
        name, _, rest = place.partition("/")
        yield from (package / rest for package in _package(name, folder))
        # a package that was renamed or unpacked without its folder
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
    path: str | Path, what: str, arguments: Mapping[str, str] | None = None
) -> str | bytes:
    """Return what a URDF file holds, or a xacro file once it is expanded.

    Raises
    ------
    InputError
        As :func:`bytes_of`; the package ``xacro`` is missing, or what it says is wrong.
    """
    data = bytes_of(path, what)
    xacro = Path(path).suffix.lower() == ".xacro"
    return _expanded(Path(path), arguments) if xacro else data


def _expanded(path: Path, arguments: Mapping[str, str] | None) -> str:
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
        place = next((path for path in _package(name, folder) if path.is_dir()), None)
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
        advice = ""
        if "ndefined substitution argument" in text:
            advice = "; give it as --xacro NAME:=VALUE, in Python load_robot(..., xacro_arguments=)"
        raise InputError(f"{path.name} cannot be expanded by xacro: {text}{advice}")
    return text
