"""Where the mesh files are that a robot file names."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

from microbot_ocp.robot.files._remarks import Remarks

SCHEMES = ("package://", "model://")


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


def package_folder(name: str, folder: Path | None) -> Path | None:
    """Return the folder of a ROS package: around ``folder``, or on ROS_PACKAGE_PATH."""
    return next((path for path in _package(name, folder) if path.is_dir()), None)


def _candidates(reference: str, folder: Path | None) -> Iterator[Path]:
    for scheme in SCHEMES:
        if reference.startswith(scheme):
            name, _, rest = reference.removeprefix(scheme).partition("/")
            yield from (package / rest for package in _package(name, folder))
            # a package that was renamed or unpacked without its folder
            yield from (above / rest for above in _above(folder))
            return
    if reference.startswith("file:"):
        yield Path(unquote(reference.removeprefix("file:").removeprefix("//")))
    elif folder is not None:
        yield folder / reference
    else:
        yield Path(reference)


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
