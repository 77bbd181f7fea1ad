"""Xacro files expanded into URDF, by the package ``xacro``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from microbot_ocp._base.checks import InputError
from microbot_ocp.robot.files._mesh_files import package_folder


def expanded(path: Path) -> str:
    """URDF text of a xacro file; ``$(find package)`` looks around the file and on ROS_PACKAGE_PATH.

    Raises
    ------
    InputError
        The package ``xacro`` is missing, or what it says is wrong with the file.
    """
    try:
        import xacro
        from xacro import substitution_args
    except ImportError:
        raise InputError(
            "reading xacro files needs the extra 'urdf': pip install 'microbot_ocp[urdf]'"
        ) from None

    def find(name: str) -> str:
        found = package_folder(name, path.absolute().parent)
        if found is None:
            raise InputError(f"package {name!r} is found neither around it nor on ROS_PACKAGE_PATH")
        return str(found)

    before = substitution_args._eval_find
    substitution_args._eval_find = find
    try:
        document: Any = xacro.process_file(str(path))
        return document.toxml()
    except Exception as problem:  # it raises whatever happens to go wrong inside
        raise InputError(f"{path.name} cannot be expanded by xacro: {problem}") from None
    finally:
        substitution_args._eval_find = before
