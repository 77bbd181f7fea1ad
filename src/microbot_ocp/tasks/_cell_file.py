"""Tasks of stops in TOML files: ``[[stop]]``, ``[[segment]]``, ``cycle``, ``[scene]``.

The schema is in docs/task_file.md.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, InputError, naming, plain
from microbot_ocp._base.schema import (
    ANGLE,
    ANY,
    NEEDED,
    TEXT,
    Key,
    check_schema,
    keys_of,
    read_kind,
    read_table,
    table_from,
)
from microbot_ocp._base.showing import DrawnAxes, view_for
from microbot_ocp._base.writing import made_folder, write_whole
from microbot_ocp.certificate import Certificate, certify
from microbot_ocp.motion import Motion
from microbot_ocp.ocp.solution import StepProgress, quiet
from microbot_ocp.planning.search import TimeOptimalSettings, in_order, time_optimal
from microbot_ocp.planning.task import (
    Circle,
    JointLine,
    Line,
    Payload,
    Segment,
    Stop,
    Task,
    task_of,
)
from microbot_ocp.robot import (
    Capsule,
    JointLimits,
    Mounting,
    Robot,
    geared_limits,
    joint_scale,
    per_joint,
    rotation_of,
)
from microbot_ocp.scene import Scene, load_scene, read_request, with_arm_capsules
from microbot_ocp.tasks._front import SHARES, SLACKS, Front, time_effort_front, time_torque_front
from microbot_ocp.tasks._task_file import (
    CELL,
    CELL_OUTPUTS,
    ON_REQUEST,
    SCHEMA,
    limits_from,
    robot_from,
    settings_from,
)

STOP = keys_of(Stop, name=TEXT, q=ANGLE, tolerance=ANGLE, orientation_tolerance=ANGLE, rpy=ANGLE)
CAPSULE = keys_of(Capsule, link=NEEDED)
# Function, key of its values and default values for each kind of front.
FRONTS: dict[str, tuple[Callable[..., Front], str, Sequence[float]]] = {
    "effort": (time_effort_front, "slacks", SLACKS),
    "torque": (time_torque_front, "shares", SHARES),
}
FRONT = {kind: {key: ANY} for kind, (_, key, _) in FRONTS.items()}
PAYLOAD = keys_of(Payload)
MOUNTING = keys_of(Mounting, yaw=ANGLE, tool_yaw=ANGLE)
KINDS: dict[str, Any] = {"line": Line, "circle": Circle, "joint line": JointLine}
LARGEST_ANGLE = 2 * np.pi  # rad; larger values are probably degrees


@dataclass(frozen=True, eq=False)
class CellFile:
    """Checked task of stops from a file, in SI units.

    Attributes
    ----------
    origin : str
        Name of the file, for messages.
    robot : Robot
        Robot with its own limits.
    stops : tuple of Stop
    limits : JointLimits
        Limits of the task.
    segments : tuple of segments, or None
        None if the path between all stops is free.
    cycle : bool
    order : "given" or "free"
    duration : float or None, s
    settings : TimeOptimalSettings
    outputs : tuple of str
    scene : Scene or None
        Obstacles of the table ``[scene]``.
    front : tuple of str and tuple of float, optional
        "effort" or "torque", and the slacks or shares of the table ``[front]``.
    mounting : Mounting
        Mounting of the table ``[mounting]``, which the robot has.
    source : Path, optional
        File that the task was read from.
    """

    origin: str
    robot: Robot
    stops: tuple[Stop, ...]
    limits: JointLimits
    segments: tuple[Segment, ...] | None = None
    cycle: bool = False
    order: str = "given"
    duration: float | None = None
    settings: TimeOptimalSettings = field(default_factory=TimeOptimalSettings)
    outputs: tuple[str, ...] = CELL_OUTPUTS
    scene: Scene | None = None
    front: tuple[str, tuple[float, ...]] | None = None
    mounting: Mounting = field(default_factory=Mounting)
    source: Path | None = None

    def mounted(self, mounting: Mounting) -> CellFile:
        """Return the task with the arm mounted otherwise.

        Raises
        ------
        InputError
            Gear ratios of joints that the robot does not have.
        """
        robot, before = mounting.on(self.robot, self.mounting), self.mounting
        factors = mounting.factors(robot) / before.factors(robot)
        limits = self.limits if np.all(factors == 1.0) else geared_limits(self.limits, factors)
        return replace(self, robot=robot, limits=limits, mounting=mounting)

    def solve(self, progress: StepProgress = quiet) -> Cell:
        """Find and certify the motion, or the motions of a front.

        Raises
        ------
        InputError
            A stop out of reach, a tool line that no branch follows.
        """
        task = self.robot, self.stops, self.limits
        given = {key: getattr(self, key) for key in ("segments", "cycle", "scene", "settings")}
        with naming(f"{self.origin}: "):
            if self.front is not None:
                kind, values = self.front
                find, key, _ = FRONTS[kind]
                front = find(*task, **given, progress=progress, **{key: values})
                fastest = front.points[0]
                return replace(self.certified(fastest.motion, fastest.certificate), front=front)
            motion = time_optimal(
                *task, **given, order=self.order, duration=self.duration, progress=progress
            )
        progress(f"certify: {motion.duration:.4f} s")
        return self.certified(motion)

    def certified(self, motion: Motion, certificate: Certificate | None = None) -> Cell:
        """Return a motion of this task with its certificate; by default the motion is certified.

        Raises
        ------
        InputError
            A motion of another task.
        """
        order = motion.provenance.get("order", range(len(self.stops)))
        stops, segments = tuple(self.stops[k] for k in order), in_order(self.segments, order)
        task: Any = {"segments": segments, "cycle": self.cycle, "scene": self.scene}
        if certificate is None:
            certificate = certify(self.robot, motion, self.limits, via_q=stops, **task)
        motion = replace(motion, provenance={**motion.provenance, "robot": self.robot.name})
        robot = self.robot.with_limits(self.limits)
        return Cell(robot=robot, stops=stops, motion=motion, certificate=certificate, **task)


@dataclass(frozen=True, eq=False)
class Cell:
    """Motion through stops with its certificate.

    Attributes
    ----------
    robot : Robot
        Robot with the limits of the task.
    stops : tuple of Stop
        Stops in the order of the motion.
    segments : tuple of segments, or None
    cycle : bool
    motion : Motion
    certificate : Certificate
    scene : Scene, optional
        Obstacles around the arm.
    front : Front, optional
        Front of time against effort or torque; ``motion`` is its fastest motion.
    """

    robot: Robot
    stops: tuple[Stop, ...]
    segments: tuple[Segment, ...] | None
    cycle: bool
    motion: Motion
    certificate: Certificate
    scene: Scene | None = None
    front: Front | None = None

    @property
    def task(self) -> Task:
        """Stops and segments, checked, with the limits of every segment."""
        arm = self.robot if self.scene is None else with_arm_capsules(self.robot)
        return task_of(arm, self.stops, segments=self.segments, cycle=self.cycle)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        provenance = self.motion.provenance
        return {
            "robot": self.robot.name,
            "limits": self.robot.limits.as_dict(),
            "cycle": self.cycle,
            "solved": self.motion.solved,
            "status": str(self.motion.status),
            "advice": self.motion.advice,
            "duration": self.motion.duration,
            "marks": [{"time": m.time, "name": m.name} for m in self.motion.marks],
            "branches": provenance.get("branches", []),
            "certificate": self.certificate.as_dict(),
            **({} if self.front is None else {"front": self.front.as_dict()}),
        }

    def save(self, folder: str | Path, outputs: Sequence[str] = CELL_OUTPUTS) -> list[Path]:
        """Write ``cell.json``, ``motion.npz``, ``motion.png``, ``cell.rrd``, films into a folder.

        A front adds ``front.png`` and the other motions, ``motion_2.npz`` and so on.

        Parameters
        ----------
        folder : str or Path
        outputs : sequence of str
            Some of "json", "motion", "figure", "recording", "report", "gif", "mp4".

        Raises
        ------
        InputError
            An unknown output.
        """
        target = made_folder(folder)
        written = []
        for name in outputs:
            checks.one_of("output", name, (*CELL_OUTPUTS, *ON_REQUEST))
            if name == "json":
                text = json.dumps(plain(self.as_dict()), indent=2, ensure_ascii=False) + "\n"
                written.append(write_whole(target / "cell.json", text))
            elif name == "motion":
                written.append(self.motion.save(target / "motion.npz"))
                for number, point in enumerate(self.front.points[1:] if self.front else (), 2):
                    written.append(point.motion.save(target / f"motion_{number}.npz"))
            elif name == "figure":
                written.append(self.plot().savefig(target / "motion.png"))
                if self.front is not None:
                    written.append(self.front.plot().savefig(target / "front.png"))
            elif name == "recording":
                written.append(self.to_rerun(target / "cell.rrd"))
            elif name == "report":
                written.append(self.report(target / "report.html"))
            else:
                written.append(self.export(target / f"cell.{name}"))
        return written

    def report(self, path: str | Path) -> Path:
        """Write a report in one ``.html`` file: times, a film, curves, the certificate in words."""
        return view_for(self, "html_report")(self, path)

    def plot(self) -> DrawnAxes:
        """Plot position, velocity, torque and the use of every limit, with rests and payloads."""
        return view_for(self, "plot")(self)

    def to_rerun(self, path: str | Path) -> Path:
        """Write a Rerun recording (``.rrd``) of the arm with stops, tool lines, parts and scene."""
        return view_for(self, "rerun")(self).save(path)

    def export(
        self, path: str | Path, rate: float | None = None, theme: str = "light", **options: Any
    ) -> Path:
        """Write a film (``.gif``, ``.mp4``) of the arm with parts, tubes, obstacles and clearance.

        Parameters
        ----------
        path, rate, theme, **options
            Parameters of ``write_animation``, whose errors are raised.
        """
        return view_for(self, "animation")(self, path, rate, theme=theme, **options)


def is_cell_file(path: str | Path) -> bool:
    """Return whether a task file has stops instead of via points."""
    with table_from(path, "task") as data:
        return "stop" in data


def read_cell(path: str | Path) -> CellFile:
    """Read a task of stops from a TOML file.

    Parameters
    ----------
    path : str or Path
        Task file; paths of robots inside the file are relative to its folder.

    Raises
    ------
    InputError
        A file that cannot be read, a key that is unknown or missing, a value of the wrong type.

    Examples
    --------
    >>> import tempfile
    >>> text = '''
    ... schema = 1
    ... robot = "microbot"
    ... [[stop]]
    ... name = "home"
    ... q_deg = [0, 0, 0]
    ... [[stop]]
    ... name = "place"
    ... position = [3.0, -1.0, 4.5]
    ... payload = { mass = 2.0 }
    ... [[segment]]
    ... after = "home"
    ... kind = "line"
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "cell.toml"
    ...     _ = file.write_text(text)
    ...     cell = read_cell(file)
    >>> [stop.name for stop in cell.stops], cell.segments
    (['home', 'place'], (Line(tolerance=0.001, orientation_tolerance=0.01),))
    """
    source = Path(path)
    with table_from(source, "task") as data:
        given = read_table(data, CELL)
        check_schema(data, SCHEMA)
        robot = _with_capsules(robot_from(data, source.parent), given.get("capsule", []))
        rows = given.get("stop", [])
        stops = tuple(_stop(robot, row, f"stop {k + 1}") for k, row in enumerate(rows))
        if "duration" in given:
            checks.number("duration", given["duration"], "s", above=0.0)
        front = _front(given["front"]) if "front" in given else None
        if front is not None and ("duration" in given or given.get("order") == "free"):
            raise InputError("[front] allows neither duration nor order = 'free'")
        settings = settings_from(given.get("settings", {}))
        for key in ("grid", "blend"):
            if key in settings:
                raise InputError(f"settings.{key} is for tasks of via points, not of stops")
        cell = CellFile(
            source.name,
            robot,
            stops,
            limits_from(robot, given.get("limits", {})),
            segments=_segments(given.get("segment", []), stops, given.get("cycle", False)),
            settings=TimeOptimalSettings(**settings),
            outputs=tuple(given.get("outputs", CELL_OUTPUTS)),
            scene=_scene(given.get("scene"), source.parent, robot),
            front=front,
            source=source,
            **{key: given[key] for key in ("cycle", "order", "duration") if key in given},
        )
        return cell.mounted(_mounting(given.get("mounting", {})))


def request_cell(path: str | Path, robot: Robot, scene: Scene | None) -> CellFile:
    """Return the task of a MoveIt motion plan request in YAML.

    Raises
    ------
    InputError
        Errors of :func:`~microbot_ocp.scene.load_request`, except those on limits: the task keeps
        the limits.
    """
    request = read_request(path, robot)
    stops = tuple(
        Stop(q=q, name=name) for name, q in zip(("start", "goal"), request.q, strict=True)
    )
    settings = TimeOptimalSettings(time_limit=request.time_limit)
    return CellFile(
        Path(path).name, robot, stops, request.robot.limits, settings=settings, scene=scene
    )


def _front(table: Mapping[str, Any]) -> tuple[str, tuple[float, ...]]:
    """Return the kind of the table [front] and its slacks or shares."""
    kind, given = read_kind(table, FRONT, "of [front]")
    _, key, default = FRONTS[kind]
    values = checks.array(f"{key} of [front]", given.get(key, default), (None,))
    return kind, tuple(values.tolist())


def _mounting(table: Mapping[str, Any]) -> Mounting:
    """Return the mounting of the table [mounting]."""

    def in_radians(_: str, name: str, value: Any, in_degrees: bool) -> Any:
        return float(np.radians(checks.number(name, value))) if in_degrees else value

    with naming("[mounting]: "):
        return Mounting(**read_table(table, MOUNTING, "of it", "{}", in_radians))


def _with_capsules(robot: Robot, rows: Sequence[Mapping[str, Any]]) -> Robot:
    """Return the robot with the capsules of [[capsule]], which replace the capsules of a link."""
    if not rows:
        return robot
    links = [link.name for link in robot.links] or robot.chain.joint_names  # links need masses
    names = ["base", *links]
    capsules: dict[int, list[Capsule]] = {}
    for number, row in enumerate(rows, start=1):
        with naming(f"in capsule {number}: "):
            given = read_table(row, CAPSULE, "of it", "{}")
            link = checks.one_of("link", given.pop("link"), names)
            capsules.setdefault(names.index(link), []).append(Capsule(**given))
    default = with_arm_capsules(robot).capsules
    remaining = {
        frame: [c for f, c in default if f == frame]
        for frame, _ in default
        if frame not in capsules
    }
    return robot.with_capsules({**remaining, **capsules})


def _scene(table: Any, folder: Path, robot: Robot) -> Scene | None:
    """Return the scene of the table [scene], or of the file that scene names."""
    if table is None or isinstance(table, str):
        return None if table is None else load_scene(folder / table, robot=robot)
    if not isinstance(table, dict):
        raise InputError(f"scene must be a table, [scene], or the name of a file, not {table!r}")
    return load_scene(table, folder, "[scene]")


def _stop(robot: Robot, row: Mapping[str, Any], default: str) -> Stop:
    name = row.get("name", default)
    where = f"in stop {name!r}"

    def in_radians(key: str, name: str, value: Any, in_degrees: bool) -> Any:
        if not in_degrees:
            return value
        if key == "tolerance" and "position" in row:
            raise InputError(f"{where}: tolerance of a position is in m, so not tolerance_deg")
        if key == "q":
            return checks.array(name, value, (robot.joint_count,)) * joint_scale(robot)
        if key == "tolerance":
            return per_joint(robot, name, value) * joint_scale(robot)
        if key == "rpy":
            return np.radians(checks.array(name, value, (3,)))
        return float(np.radians(checks.number(name, value)))

    given = read_table(row, STOP, where, convert=in_radians)
    if "rpy" in given:
        if "orientation" in given:
            raise InputError(f"{where}: give an orientation or rpy, not both")
        angles = checks.array(f"rpy {where}", given.pop("rpy"), (3,), "rad")
        if np.abs(angles).max() > LARGEST_ANGLE + ROUNDING:
            raise InputError(f"{where}: rpy is in rad, not {angles.tolist()}; or give rpy_deg")
        given["orientation"] = rotation_of(angles)
    payload = given.get("payload")
    if isinstance(payload, dict):
        load = read_table(payload, PAYLOAD, f"in the payload of stop {name!r}")
        with naming(f"{where}: "):
            given["payload"] = Payload(**load)
    elif payload is not None and isinstance(payload, bool | str | list):
        raise InputError(f"{where}: payload must be a mass or a table, not {payload!r}")
    return Stop(**{**given, "name": name})


def _segments(
    rows: Sequence[Mapping[str, Any]], stops: Sequence[Stop], cycle: bool
) -> tuple[Segment, ...] | None:
    if not rows:
        return None
    begins = [stop.name for stop in stops][: len(stops) - (not cycle)]
    segments: list[Segment] = [None] * len(begins)
    after = Key(choices=begins, needed=True)
    kinds = {word: keys_of(kind, after=after) for word, kind in KINDS.items()}
    for row in rows:
        where = f"in the segment after {checks.shown(row.get('after'))}"
        word, given = read_kind(row, kinds, where)
        stop = begins.index(given.pop("after"))
        if segments[stop] is not None:
            raise InputError(f"two segments begin at stop {begins[stop]!r}")
        with naming(f"{where}: "):
            segments[stop] = KINDS[word](**given)
    return tuple(segments)
