"""Robots by name or by file: the ones that come with the package, TOML files and URDF files."""

from __future__ import annotations

from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from microbot_ocp._base.checks import InputError
from microbot_ocp._base.reading import text_of
from microbot_ocp.robot._model import Robot
from microbot_ocp.robot.files._toml import parse_robot, robot_to_toml
from microbot_ocp.robot.files._urdf_reader import read_urdf


def _packaged() -> Traversable:
    return resources.files("microbot_ocp.robot") / "packaged"


def packaged_robots() -> tuple[str, ...]:
    """Names of the robots that come with the package."""
    return tuple(sorted(f.name[:-5] for f in _packaged().iterdir() if f.name.endswith(".toml")))


def load_robot(source: str | Path, tip: str | None = None) -> Robot:
    """Load a packaged robot by name, or a robot file by path.

    Parameters
    ----------
    source : str or Path
        A name from :func:`packaged_robots`, or the path of a ``.toml``, ``.urdf`` or ``.xacro``
        file.
    tip : str, optional
        Of a URDF file: the link at the end of the chain, whose frame is the tool; needed where
        the file has several arms (see :func:`~microbot_ocp.robot.files.read_urdf`).

    Returns
    -------
    Robot

    Raises
    ------
    InputError
        Unknown name (lists what there is), missing file, malformed TOML or URDF, a key that is
        unknown, missing or of the wrong kind; a xacro file without the extra ``urdf``.

    Examples
    --------
    >>> load_robot("microbot").joint_names
    ('waist', 'shoulder', 'elbow')
    """
    name = str(source)
    if name not in packaged_robots() and _is_urdf(name):
        return read_urdf(name, tip)
    if tip is not None:
        raise InputError(f"tip is for URDF files, not for {name!r}")
    return parse_robot(*_toml_file(name))


def robot_text(source: str | Path, tip: str | None = None) -> str:
    """Text of a robot's TOML file, to be changed into another robot.

    Of a packaged robot and of a TOML file it is the file as it stands, with its comments and the
    sources of its figures; of a URDF file, what :func:`microbot_ocp.write_toml` makes of it.

    Parameters
    ----------
    source, tip
        As in :func:`load_robot`.

    Raises
    ------
    InputError
        As from :func:`load_robot`: what cannot be loaded is not copied.

    Examples
    --------
    >>> print(robot_text("microbot").splitlines()[1])
    name = "microbot"
    """
    robot = load_robot(source, tip)
    is_urdf = str(source) not in packaged_robots() and _is_urdf(str(source))
    return robot_to_toml(robot) if is_urdf else _toml_file(str(source))[0]


def _is_urdf(name: str) -> bool:
    return Path(name).suffix.lower() in (".urdf", ".xacro")


def _toml_file(name: str) -> tuple[str, str]:
    """Text of a packaged robot or of a TOML file, and what to call it in messages."""
    if name in packaged_robots():
        text = (_packaged() / f"{name}.toml").read_text("utf-8")
        return text, f"{name}.toml"
    path = Path(name)
    if path.suffix != ".toml":
        raise InputError(
            f"robot must be one of {', '.join(packaged_robots())}, or the path of a .toml or "
            f".urdf file, not {name!r}"
        )
    return text_of(path, "robot file"), path.name
