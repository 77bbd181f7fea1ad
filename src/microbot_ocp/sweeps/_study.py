"""Definition of a study: robot, cases, methods, settings, and the columns of its results.

:func:`read_study` reads a study from a TOML file; docs/how-to/sweeps.md has the schema.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import casadi as ca

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming, shown
from microbot_ocp._base.digest import digest_of
from microbot_ocp._base.schema import (
    ANY,
    FLAG,
    NEEDED,
    TABLE,
    Key,
    check_schema,
    keys_of,
    read_kind,
    read_table,
    table_from,
)
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import Motion
from microbot_ocp.planning import PathTimingSettings, TimeOptimalSettings
from microbot_ocp.planning.task import check_limits, check_via
from microbot_ocp.robot import Robot
from microbot_ocp.sweeps._cases import Between, Cases, CaseSource, OneOf
from microbot_ocp.sweeps._quantities import NoTask, check_name, robot_with, task_of
from microbot_ocp.tasks import COMMON, METHODS, robot_from

SCHEMA = 1  # version of study files
POINTS = ("start", "goal")
AXES = ("x", "y", "z")
BY_SOLVER = "time_optimal"
OwnMethod = Callable[[Robot, FloatArray], Motion]

STUDY = {
    **COMMON,
    "methods": ANY,
    "time_limit": ANY,
    "motions": FLAG,
    "cases": Key(dict, needed=True),
    "quantities": TABLE,
    "settings": TABLE,
}
CASES = {
    "random": {"count": NEEDED, "seed": ANY},
    "grid": {},
    "table": {"file": Key(str, needed=True)},
}
RANGE = {"from": NEEDED, "to": NEEDED, "steps": ANY}


@dataclass(frozen=True)
class CaseSettings:
    """Settings of the methods; see :class:`Study`."""

    prepared: bool = True
    mesh: int = 60
    starts: int = 1
    grid: int = 400
    seed: int = 0

    def __post_init__(self) -> None:
        if not isinstance(self.prepared, bool):
            raise InputError(f"prepared must be true or false, not {self.prepared!r}")
        TimeOptimalSettings(mesh=self.mesh, starts=self.starts, seed=self.seed)
        PathTimingSettings(grid=self.grid)


MOST_CASES_TRIED = 200  # cases tried to find via points for a prepared solver
LARGEST_CHUNK = 200  # largest number of cases in a chunk
DESIRED_CHUNKS = 500  # desired number of chunks of a study


@dataclass(frozen=True, eq=False)
class Study:
    """Study: robot, cases, methods and settings.

    Parameters
    ----------
    robot : Robot
    cases : Cases
    methods : sequence of str, or mapping from a name to a function, optional
        Keys of :data:`~microbot_ocp.tasks.METHODS`, except methods that need given times; by
        default "cubic", "cubic_path" and "time_optimal". A function takes the robot of the case
        (with its payload) and the via points [m,n] and returns a motion.
    settings : mapping
        ``prepared`` (True): one solver is built and takes the numbers of each case as inputs, and
        paths are timed by reachability on a grid; with False :func:`~microbot_ocp.compare` solves
        each case. ``mesh`` (60), ``starts`` (1; more starts find better local optima in
        proportionally more time) and ``seed`` for the free motion, ``grid`` (400) for paths.
    time_limit : float
        Wall time of one case, s; a longer case is ended.
    motions : bool
        Keep the motions, too.
    origin : str
        Path of the study file; empty without a file.

    Raises
    ------
    InputError
        Any bad argument, before any case is solved.
    """

    robot: Robot
    cases: Cases
    methods: Sequence[str] | Mapping[str, OwnMethod | None] = (
        "cubic",
        "cubic_path",
        "time_optimal",
    )
    settings: Mapping[str, Any] = field(default_factory=dict)
    time_limit: float = 60.0
    motions: bool = False
    origin: str = ""

    def __post_init__(self) -> None:
        put = object.__setattr__
        if not isinstance(self.cases, Cases):
            raise InputError(f"cases must be Cases, such as Cases.random(100), not {self.cases!r}")
        put(self, "methods", _checked_methods(self.methods))
        for name in self.settings:
            checks.one_of("settings", name, [f.name for f in fields(CaseSettings)])
        with naming("settings."):
            put(self, "settings", asdict(CaseSettings(**self.settings)))
        limit = checks.number("time_limit", self.time_limit, "s", above=0.0)
        put(self, "time_limit", limit)
        _ = self.source, self.schema, self.digest

    @cached_property
    def source(self) -> CaseSource:
        """Cases by index."""
        return self.cases.of(self.robot)

    @cached_property
    def reference_robot(self) -> Robot:
        """Robot with every kind of limit that occurs in a case."""
        robot = robot_with(self.robot, self.source.reference())
        check_limits(robot, None)
        return robot

    @cached_property
    def limit_columns(self) -> tuple[tuple[str, int, str], ...]:
        """Key, component and column name of every limit except position limits."""
        columns = []
        for member in LimitFamily.of(self.reference_robot):
            for k, label in enumerate(member.labels):
                if member.key != "q" and member.limited[k]:
                    parts = (re.sub(r"\W+", "_", part) for part in (member.key, label) if part)
                    columns.append((member.key, k, "_".join(parts)))
        return tuple(columns)

    @cached_property
    def schema(self) -> tuple[tuple[str, str], ...]:
        """Name and type (int, float, bool, text) of every column of the data set."""
        columns = [("case", "int"), *((name, "float") for name in self.source.columns)]
        inputs = set(self.source.columns)
        for point in POINTS:
            poses = [f"{point}_q_{k + 1}" for k in range(self.robot.joint_count)]
            columns += [(n, "float") for n in poses if n not in inputs]
            columns += [(f"{point}_{axis}", "float") for axis in AXES]
        limits = [name for _, _, name in self.limit_columns]
        return (*columns, *outcome_columns(self.methods, limits))

    @property
    def chunk(self) -> int:
        """Number of cases per chunk, which one worker solves and one file holds."""
        return min(max(self.source.count // DESIRED_CHUNKS, 1), LARGEST_CHUNK)

    @cached_property
    def digest(self) -> str:
        """Digest of all data that determine the results."""
        keys = ("methods", "settings", "time_limit", "motions")
        settings = {key: getattr(self, key) for key in keys}
        return digest_of(
            robot=self.robot, cases=self.source.content, **settings, versions=versions()
        )

    def plan(self) -> Plan:
        """Return the study for the workers, with one reference case instead of all cases."""
        prepared = []
        for values in self.source.robots() if self.prepares else ():
            via = self._via_points_at_rest(robot_with(self.reference_robot, values))
            if via is not None:
                prepared.append((values, via))
        return Plan(replace(self, cases=Cases.grid(**self.source.reference())), tuple(prepared))

    @property
    def prepares(self) -> bool:
        """True if free motions come from prepared solvers."""
        method = self.methods.get(BY_SOLVER, True)  # type: ignore[union-attr]
        return bool(self.settings["prepared"]) and method is None and self.robot.has_dynamics

    def _via_points_at_rest(self, robot: Robot) -> FloatArray | None:
        """Return the via points of the first case that the robot can hold at rest, or None."""
        family = LimitFamily.of(robot)
        for row in self.source.rows(0, min(MOST_CASES_TRIED, self.source.count)):
            with contextlib.suppress(InputError, NoTask):
                via = task_of(self.robot, self.source.poses, self.source.values(row)).via_q
                return check_via(family, via)
        return None


@dataclass(frozen=True, eq=False)
class Plan:
    """Study without its cases, for the workers.

    Attributes
    ----------
    study : Study
        Study of one reference case, which has every kind of limit.
    prepared : tuple of (values, via points)
        Masses, friction and gravity of each prepared solver, with via points to build it for.
    version : str
        Versions of the software that wrote the plan.
    """

    study: Study
    prepared: tuple[tuple[Mapping[str, FloatArray], FloatArray], ...]
    version: str = field(default_factory=lambda: versions())


def outcome_columns(methods: Iterable[str], limits: Sequence[str]) -> list[tuple[str, str]]:
    """Return name and type of the result columns."""
    columns = [("status", "text"), ("reason", "text")]
    for method in methods:
        columns += [
            (f"{method}_status", "text"),
            (f"{method}_duration", "float"),
            (f"{method}_certified", "bool"),
            (f"{method}_limit", "text"),
            *((f"{method}_at_{name}", "float") for name in limits),
            (f"{method}_solve_time", "float"),
        ]
    return [*columns, ("case_time", "float"), ("compiled", "bool"), ("seed", "int"),
            ("version", "text")]  # fmt: skip


def versions() -> str:
    """Return the versions of this package and of CasADi."""
    return f"microbot_ocp {version('microbot_ocp')}, casadi {ca.CasadiMeta.version()}"


def _checked_methods(given: Any) -> dict[str, OwnMethod | None]:
    if isinstance(given, str):
        given = [given]
    named = given if isinstance(given, Mapping) else dict.fromkeys(given)
    if not named:
        raise InputError("methods must have at least one name")
    for name, function in named.items():
        if function is None:
            allowed = [key for key, method in METHODS.items() if not method.timed]
            checks.one_of("methods", name, allowed)
        elif not callable(function) or not isinstance(name, str) or not re.fullmatch(r"\w+", name):
            raise InputError(f"methods must map names to functions, not {name!r} to {function!r}")
    return dict(named)


def read_study(path: str | Path) -> Study:
    """Read a study from a TOML file.

    Parameters
    ----------
    path : str or Path
        Study file; paths of robots and tables inside the file are relative to its folder.

    Returns
    -------
    Study
        Robot, cases, methods and settings of the file.

    Raises
    ------
    InputError
        A file that cannot be read, a key that is unknown or missing, a value of the wrong type.
    """
    source = Path(path)
    with table_from(source, "study") as data:
        given = read_table(data, STUDY)
        check_schema(data, SCHEMA)
        methods = given.get("methods", [])
        if not isinstance(methods, list) or not all(isinstance(name, str) for name in methods):
            raise InputError(f"methods must be a list of names, not {shown(methods)}")
        named = given.get("quantities", {})
        quantities = {name: _quantity(name, value) for name, value in named.items()}
        cases = _cases(given["cases"], quantities, source.parent)
        robot = robot_from(data, source.parent)
        cases.of(robot)
        settings = read_table(
            given.get("settings", {}), keys_of(CaseSettings), "in table [settings]"
        )
        more = {key: given[key] for key in ("methods", "motions", "time_limit") if key in given}
        return Study(robot, cases, settings=settings, origin=str(source), **more)


def _cases(table: Mapping[str, Any], quantities: dict[str, Any], folder: Path) -> Cases:
    kind, given = read_kind(table, CASES, "in table [cases]", "cases.{}")
    if kind == "table":
        return Cases.table(folder / given["file"], **quantities)
    with naming("cases."):
        return getattr(Cases, kind)(**given, **quantities)


def _quantity(name: str, given: Any) -> Any:
    """Return a constant, a range (``{from, to, steps}``) or discrete values (``{one_of}``)."""
    check_name(name)
    if not isinstance(given, dict):
        return given
    if set(given) == {"one_of"}:
        return OneOf(given["one_of"])
    where = f"quantities.{name}"
    ends = read_table(given, RANGE, f"of {where}, which is a range or has one_of", f"{where}.{{}}")
    return Between(ends["from"], ends["to"], ends.get("steps"))
