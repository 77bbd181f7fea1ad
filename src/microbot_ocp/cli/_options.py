"""Options that several commands share, and how their text becomes arrays.

Lists are numbers with commas between. ``--q`` is in radians, ``--q-deg`` in degrees; prismatic
joints are in metres in both.
"""

from __future__ import annotations

import functools
import inspect
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming
from microbot_ocp._base.writing import NotWritten, check_writable
from microbot_ocp.limits import JOINT_QUANTITIES, MEMBER_KEYS, MEMBERS, with_further
from microbot_ocp.robot import JointLimits, Robot, joint_scale, per_joint
from microbot_ocp.robot.files import packaged_robots


def robot_names(incomplete: str) -> list[str]:
    """Packaged robots whose names begin so, for completion."""
    return [name for name in packaged_robots() if name.startswith(incomplete)]


def option(
    *names: str,
    what: str,
    metavar: str | None = "LIST",
    completion: Callable[[str], list[str]] | None = None,
    parser: Callable[[str], Any] | None = None,
) -> Any:
    """A typer option whose value is text, or what a parser makes of it."""
    return typer.Option(
        *names,
        help=what,
        metavar=metavar,
        autocompletion=completion,
        parser=parser,
        show_default=False,
    )


def output_path(text: str | Path) -> Path:
    """Parser of a path to write to."""
    if not str(text):
        raise typer.BadParameter("it must be a path, not ''")
    return Path(text)


def time_limit(text: str | float) -> float:
    """Parser of the option of that name."""
    try:
        return checks.time_limit(float(text))
    except (ValueError, OverflowError):
        raise typer.BadParameter(f"it must be a time above 0 s, not {text!r}") from None


RobotName = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT",
        help="Packaged robot, or the path of a .toml or .urdf file.",
        autocompletion=robot_names,
        show_default=False,
    ),
]
Tip = Annotated[
    str | None, option("--tip", what="Last link of a URDF file's chain.", metavar="LINK")
]
MotionRobot = Annotated[
    str | None,
    option(
        "--robot",
        what="Robot of the motion, where the file names none.",
        metavar="ROBOT",
        completion=robot_names,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document.")]
Recording = Annotated[
    Path | None,
    option(
        "--rerun",
        what="Write a Rerun recording (.rrd) to this file.",
        metavar="FILE",
        parser=output_path,
    ),
]
Open = Annotated[
    bool, typer.Option("--open", help="Open the Rerun viewer, bound to 127.0.0.1; wait for it.")
]
Q = Annotated[str | None, option("--q", what="Joint positions, rad (prismatic: m).")]
QDeg = Annotated[str | None, option("--q-deg", what="Joint positions, deg (prismatic: m).")]
Via = Annotated[
    list[str] | None,
    option(
        "--via",
        what="The same in rad (prismatic: m).",
        metavar="POINTS",
    ),
]
ViaDeg = Annotated[
    list[str] | None,
    option(
        "--via-deg",
        what="Via points, deg (prismatic: m): '0,0,0 45,30,0', or the option once a point.",
        metavar="POINTS",
    ),
]
Live = Annotated[
    bool,
    typer.Option("--live", help="Watch the solvers in a Rerun viewer, bound to 127.0.0.1."),
]
LiveServe = Annotated[
    bool,
    typer.Option("--live-serve", help="The same in a browser on this machine; Ctrl-C ends it."),
]
LiveConnect = Annotated[
    str | None,
    option("--live-connect", what="The same in a viewer that is open.", metavar="HOST:PORT"),
]
Iterations = Annotated[
    Path | None,
    option(
        "--rerun-iterations",
        what="Write a recording of the solvers' iterations (.rrd) to this file.",
        metavar="FILE",
        parser=output_path,
    ),
]

AllowUncertified = Annotated[
    bool,
    typer.Option("--allow-uncertified", help="Exit code 0 also where a certificate is refused."),
]


def _time_limit(default: str) -> Any:
    return typer.Option(
        help=f"Stop the solvers after so much time, s; the best so far counts. {default}",
        show_default=False,
        metavar="S",
        parser=time_limit,
    )


TimeLimit = Annotated[float | None, _time_limit("Default none.")]
MotionTimeLimit = Annotated[
    float | None, _time_limit("Default 120 for a motion or the timing of a path, 600 for a cell.")
]
OutFolder = Annotated[
    Path | None,
    option(
        "--out",
        what="Folder for tables, figures, recording, motions.",
        metavar="FOLDER",
        parser=output_path,
    ),
]
OutMotion = Annotated[
    Path | None,
    option("--out", what="Write the motion to this .npz file.", metavar="FILE", parser=output_path),
]

ANGULAR = ("q", "qd", "qdd", "qddd")  # quantities that may be given in degrees


def _limit_options() -> dict[str, str]:
    """Every option of a limit with its help: positions, then the others, then further limits."""
    options = {}
    for quantity in JOINT_QUANTITIES.values():
        sides = {"min": "Least", "max": "Largest"} if quantity.key == "q" else {"max": "Largest"}
        for side, word in sides.items():
            name, unit = f"{quantity.key}_{side}", quantity.either_unit
            options[name] = f"{word} {quantity.name}, {unit}."
            if quantity.key in ANGULAR:
                degrees = unit.replace("rad", "deg")
                options[f"{name}_deg"] = f"The same in {degrees}."
    for key, (member, side) in MEMBER_KEYS.items():
        word = {"lower": "Least", "upper": "Largest"}[side]
        options[key] = f"{word} {member.replace('_', ' ')}, {MEMBERS[member](1.0).unit}."
    return options


LIMIT_OPTIONS = _limit_options()


def with_limit_options(command: Callable[..., int]) -> Callable[..., int]:
    """The command with an option for every limit; :func:`limits_of` reads them from its context."""
    signature = inspect.signature(command, eval_str=True)
    given = {
        name: inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[str | None, option(f"--{name.replace('_', '-')}", what=what)],
        )
        for name, what in LIMIT_OPTIONS.items()
    }

    @functools.wraps(command)
    def run(*arguments: Any, **options: Any) -> int:
        own = {name: value for name, value in options.items() if name not in LIMIT_OPTIONS}
        return command(*arguments, **own)

    parameters = [p.replace(kind=p.KEYWORD_ONLY) for p in signature.parameters.values()]
    place = next(i for i, p in enumerate(parameters) if p.name == "mesh")
    parameters[place:place] = given.values()
    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in parameters} | {"return": int}
    return run


def numbers(name: str, text: str, count: int, what: str = "") -> FloatArray:
    """Array [count] from numbers with commas between; ``what`` names them in a message."""
    values = _floats(name, text)
    if len(values) != count:
        named = f" ({what})" if what else ""
        raise InputError(
            f"{name} must be {count} number{'s' * (count != 1)}{named}, not {len(values)}: {text!r}"
        )
    return checks.array(name, values, (count,))


def _floats(name: str, text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{name} must be numbers with commas between, not {text!r}") from None


def one_number(text: str | float) -> float:
    """Parser of an option that is one number."""
    try:
        return float(text)
    except ValueError:
        raise typer.BadParameter(f"it must be a number, not {text!r}") from None


def whole_number(text: str | int) -> int:
    """Parser of an option that is a whole number."""
    try:
        return int(text)
    except ValueError:
        raise typer.BadParameter(f"it must be a whole number, not {text!r}") from None


def joint_values(robot: Robot, name: str, radians: str | None, degrees: str | None) -> FloatArray:
    """Joint values [n] in SI units from exactly one of ``--name`` and ``--name-deg``."""
    found = optional_joint_values(robot, name, radians, degrees)
    if found is None:
        raise InputError(f"give --{name} (rad) or --{name}-deg")
    return found


def optional_joint_values(
    robot: Robot, name: str, radians: str | None, degrees: str | None
) -> FloatArray | None:
    """The same; None where neither is given."""
    if radians is not None and degrees is not None:
        raise InputError(f"give --{name} or --{name}-deg, not both")
    joints = ", ".join(robot.joint_names)
    if degrees is not None:
        return numbers(f"--{name}-deg", degrees, robot.joint_count, joints) * joint_scale(robot)
    if radians is not None:
        return numbers(f"--{name}", radians, robot.joint_count, joints)
    return None


def via_points(
    robot: Robot, radians: Sequence[str] | None, degrees: Sequence[str] | None
) -> FloatArray:
    """Via points [m,n] in SI units from exactly one of ``--via`` and ``--via-deg``."""
    if bool(radians) == bool(degrees):
        raise InputError(
            "give --via or --via-deg, not both"
            if radians
            else "give via points: --via-deg '0,0,0 -90,90,90', or --via in rad"
        )
    name = "--via-deg" if degrees else "--via"
    given = [re.sub(r"\s*,\s*", ",", text) for text in degrees or radians or ()]
    texts = [point for text in given for point in re.split(r"[\s;]+", text)]
    joints = ", ".join(robot.joint_names)
    rows = [numbers(name, text, robot.joint_count, joints) for text in texts if text]
    if len(rows) < 2:
        raise InputError(f"{name} must give at least 2 points, not {len(rows)}")
    values = checks.array(name, [row.tolist() for row in rows], (None, robot.joint_count))
    return values * joint_scale(robot) if degrees else values


def limits_of(robot: Robot, given: Mapping[str, Any]) -> JointLimits:
    """The robot's limits with those of the command line in their place."""
    changes: dict[str, Any] = {}
    further: dict[str, Any] = {}
    for key in LIMIT_OPTIONS:
        text = given.get(key)
        if text is None:
            continue
        name = f"--{key.replace('_', '-')}"
        values = _floats(name, text)
        if key in MEMBER_KEYS:
            further[key] = values if len(values) > 1 else values[0]
            continue
        plain = key.removesuffix("_deg")
        if plain in changes:
            raise InputError(f"give --{plain.replace('_', '-')} or {name}, not both")
        array = per_joint(robot, name, values if len(values) > 1 else values[0])
        changes[plain] = array * joint_scale(robot) if key != plain else array
    with naming("limits: "):
        changed = robot.with_limits(**changes)
        return changed.with_limits(also=with_further(changed.limits.also, further)).limits


def writable(path: Path | None, ending: str | tuple[str, ...], name: str) -> Path | None:
    """A file to write, checked before any work: its ending and its folder."""
    if path is None:
        return None
    endings = (ending,) if isinstance(ending, str) else ending
    if path.suffix not in endings:
        raise InputError(f"{name} must end in {' or '.join(endings)}, not {str(path)!r}")
    try:
        check_writable(path)
    except NotWritten as problem:
        sentence = f"{name} cannot be written to {problem.path!r}: {problem.reason}"
        raise InputError(sentence) from None
    return path


def output_folder(path: Path | None) -> Path | None:
    """A folder to write into, made when the work is done; checked before."""
    if path is not None:
        if path.is_symlink() and not path.exists():
            raise InputError(f"--out is a link that leads nowhere: {str(path)!r}")
        existing = next(p for p in (path, *path.absolute().parents) if p.exists())
        if not existing.is_dir():
            raise InputError(f"--out must be a folder, but {str(existing)!r} is a file")
        if not os.access(existing, os.W_OK):
            raise InputError(f"--out cannot be written to {str(path)!r}: permission denied")
    return path
