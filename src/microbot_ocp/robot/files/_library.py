"""Robots by name or file: packaged ones, TOML, URDF and MJCF files, `robot_descriptions`."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module, resources
from importlib.resources.abc import Traversable
from pathlib import Path
from pkgutil import iter_modules

from microbot_ocp._base.checks import InputError, did_you_mean, shown, similar
from microbot_ocp._base.needed import needed
from microbot_ocp._base.reading import text_of
from microbot_ocp._base.writing import write_whole
from microbot_ocp.robot._model import Robot
from microbot_ocp.robot.files._mjcf import load_mjcf
from microbot_ocp.robot.files._toml import parse_robot, robot_to_toml
from microbot_ocp.robot.files._urdf_reader import load_urdf
from microbot_ocp.robot.files._urdf_writer import robot_to_urdf

DESCRIPTIONS = "robot_descriptions:"
WRITERS = {".toml": robot_to_toml, ".urdf": robot_to_urdf}
READERS = {".urdf": load_urdf, ".xacro": load_urdf, ".xml": load_mjcf}


def _packaged() -> Traversable:
    return resources.files("microbot_ocp.robot") / "packaged"


def packaged_robots() -> tuple[str, ...]:
    """Return names of the robots that come with the package."""
    return tuple(sorted(f.name[:-5] for f in _packaged().iterdir() if f.name.endswith(".toml")))


def is_robot_name(source: str) -> bool:
    """Return True for the name of a robot, packaged or of ``robot_descriptions``, not a path."""
    return source.startswith(DESCRIPTIONS) or source in packaged_robots()


def load_robot(
    source: str | Path,
    tip: str | None = None,
    xacro_arguments: Mapping[str, str] | None = None,
) -> Robot:
    """Load a packaged robot by name, or a robot file by path.

    Parameters
    ----------
    source : str or Path
        Name from :func:`packaged_robots`, path of a ``.toml``, ``.urdf``, ``.xacro`` or MJCF
        ``.xml`` file, or ``robot_descriptions:NAME`` with a name of the package
        `robot_descriptions <https://github.com/robot-descriptions/robot_descriptions.py>`_ (extra
        ``descriptions``), which fetches the files at the first use of a name.
    tip : str, optional
        Link at the end of the chain of a URDF or MJCF file, whose frame is the tool frame;
        necessary if the file has several arms (see
        :func:`~microbot_ocp.robot.files.load_urdf`).
    xacro_arguments : mapping of str to str, optional
        Arguments of a ``.xacro`` file, such as ``{"ur_type": "ur10e"}``.

    Returns
    -------
    Robot
        Robot of the file or name, with its limits.

    Raises
    ------
    InputError
        Unknown name (the message lists known ones), missing file, malformed TOML or URDF, a key
        that is unknown, missing or of a wrong type, or a missing extra.

    Examples
    --------
    >>> load_robot("microbot").joint_names
    ('waist', 'shoulder', 'elbow')
    """
    name = str(source)
    if xacro_arguments:
        if not name.lower().endswith(".xacro"):
            raise InputError(f"xacro_arguments are for .xacro files, not for {name!r}")
        return load_urdf(name, tip, xacro_arguments=xacro_arguments)
    if name.startswith(DESCRIPTIONS):
        return _described(name.removeprefix(DESCRIPTIONS), tip)
    reader = None if name in packaged_robots() else READERS.get(Path(name).suffix.lower())
    if reader is not None:
        return reader(name, tip)
    if tip is not None:
        raise InputError(f"tip is for URDF and MJCF files, not for {name!r}")
    return parse_robot(*_toml_file(name))


def save_robot(robot: Robot, path: str | Path) -> None:
    """Write a robot to a file for :func:`load_robot`: TOML, without any loss, or URDF.

    Parameters
    ----------
    robot : Robot
    path : str or Path
        File with the suffix ``.toml`` or ``.urdf``, which is replaced.

    Raises
    ------
    InputError
        The suffix is unknown, the file cannot be written, or the robot has rotors on its links,
        which URDF cannot express.

    Examples
    --------
    >>> import tempfile
    >>> import microbot_ocp as mo
    >>> panda = mo.load_robot("panda")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     mo.save_robot(panda, f"{folder}/copy.toml")
    ...     mo.load_robot(f"{folder}/copy.toml") == panda
    True
    """
    text_for = WRITERS.get(Path(path).suffix)
    if text_for is None:
        raise InputError(f"path must end in {' or '.join(WRITERS)}, not {str(path)!r}")
    write_whole(path, text_for(robot))


def _described(name: str, tip: str | None) -> Robot:
    """Return a robot by its name in the package ``robot_descriptions``."""
    package = needed("robot_descriptions", "robots by these names need", "descriptions")
    modules = {module.name for module in iter_modules(package.__path__)}
    names = sorted(module for module in modules if module.endswith("_description"))
    if name not in names:
        near = [other for other in names if name and other.startswith(name)]
        raise InputError(f"robot_descriptions has no {shown(name)}{similar(name, near or names)}")
    try:
        files = import_module(f"robot_descriptions.{name}")
    except Exception as problem:  # cloning a repository over a network may raise anything
        reason = " ".join(str(problem).split())
        raise InputError(f"robot_descriptions cannot fetch {name!r}: {reason}") from problem
    if urdf := getattr(files, "URDF_PATH", None):
        return load_urdf(urdf, tip)
    if xacro := getattr(files, "XACRO_PATH", None):
        return load_urdf(xacro, tip, xacro_arguments=getattr(files, "XACRO_ARGS", None))
    return load_mjcf(files.MJCF_PATH, tip)


def robot_text(
    source: str | Path,
    tip: str | None = None,
    xacro_arguments: Mapping[str, str] | None = None,
) -> str:
    """Return the text of a robot's TOML file, from which another robot can be written.

    For a packaged robot or a TOML file it is the file itself, with its comments and sources; for
    other files it is the output of :func:`microbot_ocp.save_robot`.

    Parameters
    ----------
    source, tip, xacro_arguments
        Arguments of :func:`load_robot`.

    Raises
    ------
    InputError
        Errors of :func:`load_robot`.

    Examples
    --------
    >>> print(robot_text("microbot").splitlines()[1])
    name = "microbot"
    """
    robot = load_robot(source, tip, xacro_arguments)
    name = str(source)
    in_toml = name in packaged_robots() or name.lower().endswith(".toml")
    return _toml_file(name)[0] if in_toml else robot_to_toml(robot)


def _toml_file(name: str) -> tuple[str, str]:
    """Return the text of a packaged robot or of a TOML file, and its name for messages."""
    if name in packaged_robots():
        return (_packaged() / f"{name}.toml").read_text("utf-8"), f"{name}.toml"
    path = Path(name)
    if path.suffix != ".toml":
        raise InputError(
            f"robot must be one of {', '.join(packaged_robots())}, or the path of a .toml, .urdf, "
            f".xacro or .xml file, not {name!r}{did_you_mean(name, packaged_robots())}"
        )
    return text_of(path, "robot file"), path.name
