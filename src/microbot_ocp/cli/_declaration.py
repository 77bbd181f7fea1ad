"""Commands declared by functions: signatures and docstrings define the options.

``@command(...)`` turns a function that returns an :class:`Answer` into a command. The annotation of
a parameter defines its options: a plain type is one option of one word, a :class:`Kind` is any
other form. A parameter that is named like an option of :class:`Report` receives that option's
value. The help of an option is its entry in the numpydoc docstring of the command. If there is no
entry, it is the first sentence on the parameter in the docstring of the library function that the
command calls; ``**settings`` stands for options of that function, with its defaults.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from operator import attrgetter
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import typer

import microbot_ocp
from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.cli._report import Answer, Report
from microbot_ocp.execution import packaged_profiles
from microbot_ocp.limits import JOINT_QUANTITIES, MEMBER_KEYS, MEMBERS, JointLimits, changes_by_name
from microbot_ocp.robot import Robot, joint_scale, load_robot, packaged_robots, per_joint

Words = Mapping[str, Any]  # words of the command line by option name
REQUIRED = inspect.Parameter.empty


@dataclass(frozen=True)
class Kind:
    """Form of a parameter on the command line: here one option of one word.

    Attributes
    ----------
    of : type of the option for typer
    metavar : placeholder of the word in the help
    convert : function from the word to the value
    words : description of an allowed word, for a message
    name : name of the option
    text : help of the option
    default : value of an option that is left out
    choices : names for the completion of the last name in a list
    positional : True for an argument, False for an option
    """

    of: Any = str
    metavar: str | None = "NAME"
    convert: Callable[[Any], Any] | None = None
    words: str = ""
    name: str = ""
    text: str = ""
    default: Any = None
    choices: Callable[[], Sequence[str]] = tuple
    positional: bool = False

    def options(self) -> Iterator[inspect.Parameter]:
        """Yield every option of the parameter."""
        yield self.option()

    def value(self, words: Words, robot: Any) -> Any:
        """Return the value of the parameter, which may depend on the robot of the command."""
        return words[self.name]

    def option(self) -> inspect.Parameter:
        """Return the option or the argument for typer."""
        declare: Any = typer.Argument if self.positional else typer.Option
        declared = declare(
            ... if self.default is REQUIRED else self.default,
            *(() if self.positional else [_option(self.name)]),
            help=self.text,
            metavar=self.metavar,
            show_default=self.default not in (REQUIRED, None, np.inf),
            parser=self.convert and self._converted,
            autocompletion=None if self.choices is tuple else self._completions,
        )
        kind = inspect.Parameter.KEYWORD_ONLY
        return inspect.Parameter(self.name, kind, default=declared, annotation=self.of)

    def _converted(self, word: Any) -> Any:
        assert self.convert is not None
        try:
            return self.convert(word)
        except (ValueError, OverflowError):
            raise typer.BadParameter(f"it must be {self.words}, not {word!r}") from None

    def _completions(self, incomplete: str) -> list[str]:
        *before, last = incomplete.split(",")
        more = [name for name in self.choices() if name.startswith(last) and name not in before]
        return [",".join([*before, name]) for name in more]


@dataclass(frozen=True)
class Numbers(Kind):
    """Comma-separated numbers.

    Attributes
    ----------
    labels : names of the numbers; () for one number per joint, None for any count
    degrees : True for two options: NAME in rad and NAME-deg in degrees
    rows : True for two or more lists, separated by blanks or by a repeated option
    example : a valid word, for a message
    """

    metavar: str | None = "LIST"
    labels: tuple[str, ...] | None = ()
    degrees: bool = False
    rows: bool = False
    example: str = "LIST"

    def options(self) -> Iterator[inspect.Parameter]:
        """Yield one option, or two: in degrees and in radians."""
        if not self.degrees:
            yield self.option()
            return
        unit = re.findall(r"rad[^\s.]*(?: \([^)]*\))?", self.text)[0]
        text = self.text.replace(unit, unit.replace("rad", "deg"))
        either = replace(self, default=None)
        yield replace(either, name=f"{self.name}_deg", text=text).option()
        yield replace(either, text=f"Like {_option(self.name)}-deg, in {unit}.").option()

    def value(self, words: Words, robot: Any) -> Any:
        """Return an array [n] (rows: [m,n]) in SI units, or a list if the count is free."""
        option, word = _chosen(self.name, words)
        if word is None:
            if self.default is REQUIRED:
                raise InputError(f"give {option}-deg {self.example}, or {option} in rad")
            return self.default
        if self.labels is None:
            return _floats(option, word)
        texts = [word]
        if self.rows:
            points = " ".join(re.sub(r"\s*,\s*", ",", text) for text in word)
            texts = [text for text in re.split(r"[\s;]+", points) if text]
            if len(texts) < 2:
                raise InputError(f"{option} must give at least 2 points, not {len(texts)}")
        rows = [_floats(option, text, self.labels or robot.joint_names) for text in texts]
        values = checks.array(option, rows if self.rows else rows[0], (None,) * (1 + self.rows))
        if not option.endswith("-deg"):
            if self.degrees and not self.rows and "rad/" not in self.text:
                self._check_degrees(option, word, values, robot)
            return values
        return values * (np.pi / 180.0 if self.labels else joint_scale(robot))

    def _check_degrees(self, option: str, word: str, values: FloatArray, robot: Any) -> None:
        """Reject an orientation above one turn; warn of joint positions that look like degrees."""
        if self.labels:
            if np.abs(values).max() > 2 * np.pi:
                raise InputError(
                    f"{option} must be within a turn, in rad, not {word!r}; {option}-deg takes deg"
                )
        elif robot is not None:
            turning = np.array(robot.joint_types) == "revolute"
            outside = (values > robot.limits.q_max) | (values < robot.limits.q_min)
            far = turning & outside & (np.abs(values) > 2 * np.pi)
            if far.any() or checks.degrees_hint(values[turning]):
                checks.warn_user(
                    f"{option} is {word!r} rad, which looks like degrees: {option}-deg takes deg"
                )


class RobotFile(Kind):
    """Robot argument with the options for the last link and for xacro arguments."""

    def options(self) -> Iterator[inspect.Parameter]:
        """Yield the argument and its two options."""
        yield replace(SOURCE, default=self.default).option()
        yield TIP.option()
        yield XACRO.option()

    def value(self, words: Words, robot: Any) -> Robot:
        """Load the robot."""
        return load_robot(words["robot"], words["tip"], XACRO.value(words, robot))


class XacroArguments(Kind):
    """Arguments of a xacro file: one ``--xacro NAME:=VALUE`` per argument."""

    def value(self, words: Words, robot: Any) -> dict[str, str]:
        """Return the arguments by name."""
        pairs = [word.partition(":=") for word in words[self.name] or ()]
        for name, sign, value in pairs:
            if not (name and sign):
                raise InputError(f"--xacro must be NAME:=VALUE, not {name + sign + value!r}")
        return {name: value for name, _, value in pairs}


class LimitOptions(Kind):
    """Options for every limit: joint limits first, other limits after them."""

    def options(self) -> Iterator[inspect.Parameter]:
        """Yield the options; an angular limit also has an option in degrees."""
        for limit in self.limits():
            yield from limit.options()

    def limits(self) -> Iterator[Numbers]:
        """Yield every limit as numbers."""
        rows = [
            (f"{quantity.key}_{side}", quantity.name, quantity.either_unit)
            for quantity in JOINT_QUANTITIES.values()
            for side in (("min", "max") if quantity.key == "q" else ("max",))
        ]
        rows += [
            (key, member.replace("_", " "), MEMBERS[member](1.0).unit)
            for key, (member, _) in MEMBER_KEYS.items()
        ]
        for name, quantity, unit in rows:
            text = f"{'Least' if name.endswith('_min') else 'Largest'} {quantity}, {unit}."
            yield Numbers(name=name, text=text, labels=None, degrees=unit.startswith("rad"))

    def value(self, words: Words, robot: Any) -> JointLimits:
        """Return the robot's limits, changed by the options."""
        changes: dict[str, Any] = {}
        for limit in self.limits():
            values = limit.value(words, robot)
            if values is None:
                continue
            changes[limit.name] = value = values if len(values) > 1 else values[0]
            if limit.name not in MEMBER_KEYS:
                option, _ = _chosen(limit.name, words)
                scale = joint_scale(robot) if option.endswith("-deg") else 1.0
                changes[limit.name] = per_joint(robot, option, value) * scale
        with _named_by_options(changes, robot):
            return robot.with_limits(**changes_by_name(robot.limits.also, changes)).limits


@contextmanager
def _named_by_options(limits: Mapping[str, Any], robot: Robot) -> Iterator[None]:
    """Rename limits to their options and joint numbers to joint names in error messages.

    A message on a limit without an option gets the prefix "limits: ".
    """
    try:
        yield
    except InputError as problem:
        text = re.sub(
            r"\bof joint (\d+)", lambda k: f"of {robot.joint_names[int(k[1]) - 1]}", str(problem)
        )
        name = text.split(" ")[0]
        text = text.replace(name, _option(name), 1) if name in limits else f"limits: {text}"
        raise InputError(text) from None


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _chosen(name: str, words: Words) -> tuple[str, Any]:
    """Return the option (NAME in rad or NAME-deg, not both) and its word, None if left out."""
    given = {_option(k): words[k] for k in (name, f"{name}_deg") if words.get(k) not in (None, [])}
    if len(given) > 1:
        raise InputError(f"give {' or '.join(given)}, not both")
    return next(iter(given.items()), (_option(name), None))


def _floats(option: str, word: str, labels: Sequence[str] = ()) -> list[float]:
    """Parse comma-separated numbers, one per label if labels are given."""
    try:
        values = [float(part) for part in word.split(",")]
    except ValueError:
        raise InputError(f"{option} must be comma-separated numbers, not {word!r}") from None
    if labels and len(values) != len(labels):
        numbers = f"{len(labels)} number{'s' * (len(labels) != 1)} ({', '.join(labels)})"
        raise InputError(f"{option} must be {numbers}, not {len(values)}: {word!r}")
    return values


def _path(word: str | Path) -> Path:
    if not str(word):
        raise ValueError
    return Path(word)


FILE = Kind(of=Path, metavar="FILE", positional=True)
SOURCE = Kind(
    metavar="ROBOT",
    name="robot",
    text="Packaged robot, robot_descriptions:NAME, or a .toml, .urdf, .xacro or MuJoCo .xml file.",
    default=REQUIRED,
    choices=packaged_robots,
    positional=True,
)
TIP = Kind(metavar="LINK", name="tip", text="Last link of the chain in a URDF or MuJoCo file.")
XACRO = XacroArguments(
    of=list[str], metavar="NAME:=VALUE", name="xacro", text="Argument of a .xacro file, once each."
)
OTHER_ROBOT = Kind(
    metavar="ROBOT", text="Robot of the motion, where the file names none.", choices=packaged_robots
)
PROFILE = Kind(
    metavar="PROFILE",
    text="Profile of the controller: panda, fr3, ur_servoj, hold@250 or ros2_jtc_cubic@500 (or "
    "_linear, _quintic) with the rate in Hz, or a .toml file.",
    choices=packaged_profiles,
)
ARM = RobotFile()
LIMITS = LimitOptions()
JOINTS = Numbers(degrees=True)
VIA = Numbers(
    of=list[str],
    metavar="POINTS",
    name="via",
    text="Via points, rad (prismatic: m): '0,0,0 45,30,0', or the option once a point.",
    degrees=True,
    rows=True,
    example="'0,0,0 -90,90,90'",
)
PLAIN: dict[str, Kind] = {  # keys are names of types, or of parameters
    "bool": Kind(of=bool, metavar=None),
    "int": Kind(metavar="N", convert=int, words="a whole number"),
    "float": Kind(metavar="NUMBER", convert=float, words="a number"),
    "str": Kind(),
    "Path": Kind(metavar="FILE", convert=_path, words="a path"),
    "profile": PROFILE,
    "time_limit": Kind(
        metavar="S", convert=lambda word: checks.time_limit(float(word)), words="a time above 0 s"
    ),
}


@dataclass(frozen=True, eq=False)
class Command:
    """Command of the program.

    Attributes
    ----------
    function : function that returns the answer
    library : public functions that the command calls, each with the names of its ``**settings``
    writes : endings of the file of ``--out``, "" for a folder; empty for a command without files
    folder : default folder of ``--out``; empty if there is no default
    recorded : True if the answer has a recording
    solves : True if the command solves and certifies, so that progress and refusal have options
    """

    function: Callable[..., Answer]
    library: Mapping[str, str]
    writes: tuple[str, ...] = ()
    folder: str = ""
    recorded: bool = False
    solves: bool = False

    @property
    def help(self) -> str:
        """Text of the docstring before its sections."""
        return _sections(self.function)[""]

    @property
    def example(self) -> str:
        """Example of a call."""
        return _sections(self.function)["Examples"].removeprefix("$ ")

    @cached_property
    def shared(self) -> list[Any]:
        """Fields of :class:`Report` that this command has as options."""
        enabled = {"out": bool(self.writes), "json": True}
        enabled |= dict.fromkeys(("rerun", "open"), self.recorded)
        return [f for f in fields(Report) if f.init and enabled.get(f.name, self.solves)]

    @cached_property
    def kinds(self) -> dict[str, Kind]:
        """Forms of all parameters: of the function, of the library functions, of the report."""
        hints = get_type_hints(self.function, include_extras=True)
        parameters = inspect.signature(self.function).parameters
        declared = {name: (hints[name], p.default) for name, p in parameters.items()}
        sentences: dict[str, str] = {}
        for public, names in self.library.items():
            source = attrgetter(public)(microbot_ocp)
            sentences |= {name: _sentence(text) for name, (_, text) in documented(source).items()}
            settings = inspect.signature(source).parameters
            declared |= {n: (settings[n].annotation, settings[n].default) for n in names.split()}
        declared |= {option.name: (option.type, option.default) for option in self.shared}
        if self.folder:
            declared["out"] = (declared["out"][0], Path(self.folder))
        texts = documented(Report) | documented(self.function)
        kinds = {}
        for name, (hint, default) in declared.items():
            if name not in ("progress", "settings"):
                kind = _kind(name, hint)
                metavar, text = texts.get(name, ("", kind.text or sentences.get(name, "")))
                more = {"metavar": metavar or kind.metavar, "text": text, "default": default}
                kinds[name] = replace(kind, name=kind.name or name, **more)
        return kinds

    @property
    def callback(self) -> Callable[..., int]:
        """Function for typer, with a signature of all options."""

        def callback(**words: Any) -> int:
            return self.run(words)

        options = [option for kind in self.kinds.values() for option in kind.options()]
        callback.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
        return callback

    def run(self, words: Words) -> int:
        """Run the command and report its answer; return the exit code."""
        report = Report(**{option.name: words[option.name] for option in self.shared})
        accepted = inspect.signature(self.function).parameters
        arguments: dict[str, Any] = {}
        for name, kind in self.kinds.items():
            if name in accepted or name not in vars(report):
                arguments[name] = kind.value(words, arguments.get("robot"))
        report.check(self.writes)
        return report.give(partial(self._find, **arguments), long="progress" in accepted)

    def _find(self, **arguments: Any) -> Answer:
        """Call the function; rename its parameters to their options in error messages."""
        try:
            return self.function(**arguments)
        except InputError as problem:
            text = str(problem)
            for name, kind in self.kinds.items():
                if kind.positional or _option(kind.name) in text:
                    continue
                text = re.sub(rf"^{name}\b(?=\W? (must|has|is)\b)", _option(kind.name), text)
            if type(problem) is not InputError or text == str(problem):
                raise
            raise InputError(text) from None


def command(
    library: Mapping[str, str] | None = None, **more: Any
) -> Callable[[Callable[..., Answer]], Command]:
    """Return a decorator that builds a :class:`Command` with these attributes."""
    return lambda function: Command(function, library or {}, **more)


def documented(source: Any) -> dict[str, tuple[str, str]]:
    """Read the metavar (may be empty) and the text of every parameter in a numpydoc docstring."""
    sections, texts = _sections(source), {}
    listed = sections.get("Parameters") or sections.get("Attributes", "")
    entry = re.compile(r"^(\w+(?:, \w+)*)(?: : ([^\n]*))?((?:\n +[^\n]*)*)", re.MULTILINE)
    for names, kind, body in entry.findall(listed):
        metavar = kind if re.fullmatch(r"[A-Z:]+", kind) else ""
        typed = "Parameters" in sections or re.fullmatch(r"[A-Z:]+|\w+(, optional)?", kind)
        text = " ".join((body if typed else f"{kind} {body}").split())
        texts |= dict.fromkeys(names.split(", "), (metavar, text))
    return texts


def _sections(source: Any) -> dict[str, str]:
    """Split a numpydoc docstring into sections by title; the text before them has the title ""."""
    parts = re.split(r"\n\n(\w+)\n-+\n", inspect.getdoc(source) or "")
    return {"": parts[0], **dict(zip(parts[1::2], parts[2::2], strict=True))}


def _sentence(text: str) -> str:
    """Return the first sentence of a docstring entry without its markup."""
    first = re.split(r"\.\s", text)[0].rstrip(".")
    return re.sub(r"(?::\w+:)?`+~?([^`]*)`+", r"\1", first[:1].upper() + first[1:]) + "."


def _kind(name: str, hint: Any) -> Kind:
    """Return the kind in the annotation of a parameter, or the kind of its plain type."""
    for extra in get_args(hint)[1:]:
        if isinstance(extra, Kind):
            return extra
    types = re.findall(r"bool|int|float|Path|str", str(hint))
    return PLAIN[name if name in PLAIN else types[0]]
