"""Tasks of stops in TOML files: ``[[stop]]``, ``[[segment]]``, ``cycle``, ``[scene]``.

The schema is in docs/task_file.md; errors are those of a task of via points.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError, naming, plain
from microbot_ocp._base.showing import view_for
from microbot_ocp._base.toml_file import check_keys, check_schema, table_from, table_of
from microbot_ocp._base.writing import made_folder, write_whole
from microbot_ocp.certificate import Certificate, certify
from microbot_ocp.motion import Motion
from microbot_ocp.ocp.solution import StepProgress, quiet
from microbot_ocp.planning import (
    Circle,
    JointLine,
    Line,
    Payload,
    Segment,
    Stop,
    Task,
    TimeOptimalSettings,
    in_order,
    task_of,
    time_optimal,
)
from microbot_ocp.robot import Capsule, JointLimits, Robot, joint_scale, rotation_of
from microbot_ocp.scene import Scene, read_scene, with_arm_capsules
from microbot_ocp.tasks._front import (
    SHARES,
    SLACKS,
    Front,
    time_effort_front,
    time_torque_front,
)
from microbot_ocp.tasks._task_file import (
    KEYS,
    SCHEMA,
    limits_from,
    robot_from,
    settings_from,
)

TOP = (
    *("schema", "robot", "tip", "outputs", "stop", "segment", "cycle", "order", "duration"),
    *("limits", "settings", "scene", "capsule", "front"),
)
STOP = (
    *("name", "q", "q_deg", "position", "orientation", "rpy", "rpy_deg", "tolerance"),
    *("tolerance_deg", "orientation_tolerance", "orientation_tolerance_deg", "free_turn"),
    *("velocity", "dwell", "payload", "blend"),
)
CAPSULE = ("link", "start", "end", "radius", "name")
FRONTS = {"effort": "slacks", "torque": "shares"}  # what each kind is asked by
PAYLOAD = ("mass", "center_of_mass", "inertia", "shape")
KINDS: dict[str, Any] = {"line": Line, "circle": Circle, "joint line": JointLine}
LARGEST_ANGLE = 2 * np.pi  # rad: beyond it degrees were meant
CELL_OUTPUTS = ("json", "motion", "figure", "recording")  # what is written by default
FILMS = ("gif", "mp4")


@dataclass(frozen=True, eq=False)
class CellFile:
    """A task of stops as a file states it, checked and in SI units.

    Attributes
    ----------
    origin : str
        Name of the file, for messages.
    robot : Robot
        With its own limits.
    stops : tuple of Stop
    segments : tuple of segments, or None
        None where every way is free.
    cycle : bool
    order : "given" or "free"
    duration : float or None, s
    limits : JointLimits
    settings : TimeOptimalSettings
    outputs : tuple of str
    scene : Scene or None
        Obstacles of the table ``[scene]``.
    front : tuple of str and tuple of float, optional
        "effort" or "torque", and the slacks or shares of the table ``[front]``.
    """

    origin: str
    robot: Robot
    stops: tuple[Stop, ...]
    segments: tuple[Segment, ...] | None
    cycle: bool
    order: str
    duration: float | None
    limits: JointLimits
    settings: TimeOptimalSettings
    outputs: tuple[str, ...]
    scene: Scene | None = None
    front: tuple[str, tuple[float, ...]] | None = None

    def solve(self, progress: StepProgress = quiet) -> Cell:
        """Find and certify the motion, or the motions of a front.

        Raises
        ------
        InputError
            A stop out of reach, a tool line that no branch follows.
        """
        if self.front is not None:
            return self._solve_front(progress)
        with naming(f"{self.origin}: "):
            motion = time_optimal(
                self.robot,
                self.stops,
                self.limits,
                segments=self.segments,
                cycle=self.cycle,
                order=self.order,
                duration=self.duration,
                scene=self.scene,
                settings=self.settings,
                progress=progress,
            )
        progress(f"certify: {motion.duration:.4f} s")
        return self.certified(motion)

    def _solve_front(self, progress: StepProgress) -> Cell:
        assert self.front is not None
        kind, values = self.front
        find: Any = time_effort_front if kind == "effort" else time_torque_front
        with naming(f"{self.origin}: "):
            front: Front = find(
                self.robot,
                self.stops,
                self.limits,
                segments=self.segments,
                cycle=self.cycle,
                scene=self.scene,
                settings=self.settings,
                progress=progress,
                **{FRONTS[kind]: values},
            )
        fastest = front.points[0]
        return replace(self._cell(fastest.motion, fastest.certificate), front=front)

    def certified(self, motion: Motion) -> Cell:
        """A motion of this task, such as a saved one, with its certificate.

        Raises
        ------
        InputError
            A motion of another task.
        """
        stops, segments = self._in_order_of(motion)
        certificate = certify(
            self.robot,
            motion,
            self.limits,
            via_q=stops,
            segments=segments,
            cycle=self.cycle,
            scene=self.scene,
        )
        return self._cell(motion, certificate)

    def _in_order_of(self, motion: Motion) -> tuple[tuple[Stop, ...], tuple[Segment, ...] | None]:
        """Stops and segments in the order in which a motion has them."""
        order = motion.provenance.get("order", range(len(self.stops)))
        return tuple(self.stops[k] for k in order), in_order(self.segments, order)

    def _cell(self, motion: Motion, certificate: Certificate) -> Cell:
        stops, segments = self._in_order_of(motion)
        return Cell(
            robot=self.robot.with_limits(self.limits),
            stops=stops,
            segments=segments,
            cycle=self.cycle,
            motion=replace(motion, provenance={**motion.provenance, "robot": self.robot.name}),
            certificate=certificate,
            scene=self.scene,
        )


@dataclass(frozen=True, eq=False)
class Cell:
    """A motion through stops with its certificate.

    Attributes
    ----------
    robot : Robot
        With the limits of the task.
    stops : tuple of Stop
        In the order in which they are reached.
    segments : tuple of segments, or None
    cycle : bool
    motion : Motion
    certificate : Certificate
    scene : Scene, optional
        What is around the arm.
    front : Front, optional
        The motions that a front was asked for, of which ``motion`` is the fastest.
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
        """Plain values for JSON."""
        told = self.motion.provenance
        return {
            "robot": self.robot.name,
            "limits": self.robot.limits.as_dict(),
            "cycle": self.cycle,
            "solved": self.motion.solved,
            "status": str(self.motion.status),
            "advice": told.get("advice", ""),
            "duration": self.motion.duration,
            "marks": [{"time": m.time, "name": m.name} for m in self.motion.marks],
            "branches": told.get("branches", []),
            "certificate": self.certificate.as_dict(),
            **({} if self.front is None else {"front": self.front.as_dict()}),
        }

    def save(self, folder: str | Path, outputs: Sequence[str] = CELL_OUTPUTS) -> list[Path]:
        """Write ``cell.json``, ``motion.npz``, ``motion.png``, ``cell.rrd``, films into a folder.

        Of a front also ``front.png`` and the other motions, ``motion_2.npz`` and so on.

        Parameters
        ----------
        folder : str or Path
        outputs : sequence of str
            Some of "json", "motion", "figure", "recording", "gif", "mp4".

        Raises
        ------
        InputError
            Another output.
        """
        target = made_folder(folder)
        written = []
        for name in outputs:
            checks.one_of("output", name, (*CELL_OUTPUTS, *FILMS))
            if name == "json":
                text = json.dumps(plain(self.as_dict()), indent=2, ensure_ascii=False) + "\n"
                written.append(write_whole(target / "cell.json", text))
            elif name == "motion":
                written.append(self.motion.save(target / "motion.npz"))
                for number, point in enumerate(self.front.points[1:] if self.front else (), 2):
                    written.append(point.motion.save(target / f"motion_{number}.npz"))
            elif name == "figure":
                written.append(self.motion.plot(self.robot).savefig(target / "motion.png"))
                if self.front is not None:
                    written.append(self.front.plot().savefig(target / "front.png"))
            elif name == "recording":
                written.append(self.to_rerun(target / "cell.rrd"))
            else:
                written.append(self.export(target / f"cell.{name}"))
        return written

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
            As of ``write_animation``, whose errors are raised.
        """
        return view_for(self, "animation")(self, path, rate, theme=theme, **options)


def is_cell_file(path: str | Path) -> bool:
    """Whether a task file has stops in the place of via points."""
    return "stop" in table_from(path, "task")


def read_cell(path: str | Path) -> CellFile:
    """Read a task of stops from a TOML file.

    Parameters
    ----------
    path : str or Path
        Paths of robots inside the file are relative to its folder.

    Raises
    ------
    InputError
        A file that cannot be read, a key that is unknown, missing or of the wrong kind.

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
    data = table_from(source, "task")
    with naming(f"{source.name}: "):
        return _cell(data, source.name, source.parent)


def _cell(data: Mapping[str, Any], origin: str, folder: Path) -> CellFile:
    check_keys(data, TOP)
    check_schema(data, SCHEMA)
    robot = _with_capsules(robot_from(data, folder), _tables(data, "capsule"))
    rows = _tables(data, "stop")
    stops = [_stop(robot, row, f"stop {k + 1}") for k, row in enumerate(rows)]
    cycle = data.get("cycle", False)
    if not isinstance(cycle, bool):
        raise InputError(f"cycle must be true or false, not {cycle!r}")
    order = data.get("order", "given")
    if order not in ("given", "free"):
        raise InputError(f'order must be "given" or "free", not {order!r}')
    duration = data.get("duration")
    if duration is not None:
        checks.number("duration", duration, "s", above=0.0)
    front = _front(data)
    if front is not None and (duration is not None or order != "given"):
        raise InputError("[front] does not go with a duration or a free order of the stops")
    outputs = data.get("outputs", list(CELL_OUTPUTS))
    if not isinstance(outputs, list) or not set(outputs) <= {*CELL_OUTPUTS, *FILMS}:
        known = ", ".join((*CELL_OUTPUTS, *FILMS))
        raise InputError(f"outputs must be some of {known}, not {outputs!r}")
    settings = settings_from(table_of(data, "settings", KEYS["settings"]))
    for key in ("grid", "blend"):
        if key in settings:
            raise InputError(f"settings.{key} is of tasks of via points, not of stops")
    return CellFile(
        origin=origin,
        robot=robot,
        stops=tuple(stops),
        segments=_segments(data, stops, cycle),
        cycle=cycle,
        order=order,
        duration=duration,
        limits=limits_from(robot, table_of(data, "limits", KEYS["limits"])),
        settings=TimeOptimalSettings(**settings),
        outputs=tuple(outputs),
        scene=_scene(data, folder),
        front=front,
    )


def _front(data: Mapping[str, Any]) -> tuple[str, tuple[float, ...]] | None:
    """The kind of the table [front] and by what its motions are asked."""
    if "front" not in data:
        return None
    table = table_of(data, "front", ("kind", *FRONTS.values()))
    kind = table.get("kind")
    if kind not in list(FRONTS):
        raise InputError(f"kind of [front] must be one of {', '.join(FRONTS)}, not {kind!r}")
    key = FRONTS[kind]
    for other in set(FRONTS.values()) - {key}:
        if other in table:
            raise InputError(f"[front] of {kind} is asked by {key}, not by {other}")
    usual = SLACKS if kind == "effort" else SHARES
    values = checks.array(f"{key} of [front]", table.get(key, usual), (None,))
    return kind, tuple(values.tolist())


def _with_capsules(robot: Robot, rows: Sequence[Mapping[str, Any]]) -> Robot:
    """The robot with the capsules of [[capsule]] in the place of those of the same links."""
    if not rows:
        return robot
    links = [link.name for link in robot.links] or robot.joint_names  # none without masses
    names = ["base", *links]
    own: dict[int, list[Capsule]] = {}
    for number, row in enumerate(rows, start=1):
        where = f"in capsule {number}"
        check_keys(row, CAPSULE, where)
        for key in ("link", "start", "end", "radius"):
            if key not in row:
                raise InputError(f"{where}: {key} is missing")
        checks.one_of(f"link {where}", row["link"], names)
        with naming(f"{where}: "):
            capsule = Capsule(**{key: value for key, value in row.items() if key != "link"})
        own.setdefault(names.index(row["link"]), []).append(capsule)
    usual = with_arm_capsules(robot).capsules
    kept = {frame: [c for f, c in usual if f == frame] for frame, _ in usual if frame not in own}
    return robot.with_capsules({**kept, **own})


def _scene(data: Mapping[str, Any], folder: Path) -> Scene | None:
    """The table [scene], or the file that it names."""
    table = data.get("scene")
    if table is None:
        return None
    if isinstance(table, str):
        return read_scene(folder / table)
    if not isinstance(table, dict):
        raise InputError(f"scene must be a table, [scene], or the name of a file, not {table!r}")
    return read_scene(table, folder, "[scene]")


def _tables(data: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    rows = data.get(name, [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"{name} must be tables, [[{name}]], not {rows!r}")
    return rows


def _stop(robot: Robot, row: Mapping[str, Any], usual: str) -> Stop:
    name = row.get("name", usual)
    where = f"in stop {name!r}"
    check_keys(row, STOP, where)
    given = dict(row)
    for key in ("orientation_tolerance", "rpy", "q", "tolerance"):
        in_degrees = given.pop(f"{key}_deg", None)
        if in_degrees is None:
            continue
        if key in given:
            raise InputError(f"{where}: give {key} or {key}_deg, not both")
        if key == "tolerance" and "position" in given:
            raise InputError(f"{where}: tolerance_deg is of a joint pose; of a position it is in m")
        shape: tuple[int | None, ...] = {"rpy": (3,), "q": (robot.joint_count,)}.get(key, ())
        named = f"{key}_deg {where}"
        values = (
            checks.array(named, in_degrees, shape) if shape else checks.numbers(named, in_degrees)
        )
        if key == "tolerance" and values.ndim == 0:
            values = np.full(robot.joint_count, values)
        scale = joint_scale(robot) if key in ("q", "tolerance") else np.radians(1.0)
        given[key] = values * scale
        if np.ndim(given[key]) == 0:
            given[key] = float(given[key])
    if "rpy" in given:
        if "orientation" in given:
            raise InputError(f"{where}: give an orientation or rpy, not both")
        angles = checks.array(f"rpy {where}", given.pop("rpy"), (3,), "rad")
        if np.abs(angles).max() > LARGEST_ANGLE + 1e-9:
            raise InputError(f"{where}: rpy is in rad, not {angles.tolist()}; or give rpy_deg")
        given["orientation"] = rotation_of(angles)
    payload = given.get("payload")
    if isinstance(payload, dict):
        check_keys(payload, PAYLOAD, f"in the payload of stop {name!r}")
        if "mass" not in payload:
            raise InputError(f"{where}: mass of the payload is missing")
        with naming(f"{where}: "):
            given["payload"] = Payload(**payload)
    elif payload is not None and isinstance(payload, bool | str | list):
        raise InputError(f"{where}: payload must be a mass or a table, not {payload!r}")
    return Stop(**{**given, "name": name})


def _segments(
    data: Mapping[str, Any], stops: Sequence[Stop], cycle: bool
) -> tuple[Segment, ...] | None:
    rows = _tables(data, "segment")
    if not rows:
        return None
    names = [stop.name for stop in stops]
    made: list[Segment] = [None] * (len(stops) - (not cycle))
    begins = names[: len(made)]
    for row in rows:
        after, word = row.get("after"), row.get("kind")
        if after not in begins:
            found = f"not {checks.shown(after)}" if "after" in row else "but it is missing"
            raise InputError(
                "after of a segment must be the name of the stop where it begins, one of "
                f"{', '.join(begins)}, {found}"
            )
        where = f"in the segment after {after!r}"
        if word not in list(KINDS):
            found = f"not {checks.shown(word)}" if "kind" in row else "but it is missing"
            raise InputError(f"{where}: kind must be one of {', '.join(KINDS)}, {found}")
        kind = KINDS[word]
        keys = {f.name: f for f in fields(kind)}
        check_keys(row, ("after", "kind", *keys), where)
        for key, field in keys.items():
            if field.default is MISSING and key not in row:
                raise InputError(f"{where}: {key} is missing, which a {word} needs")
        if made[begins.index(after)] is not None:
            raise InputError(f"two segments begin at stop {after!r}")
        with naming(f"{where}: "):
            made[begins.index(after)] = kind(**{key: row[key] for key in keys if key in row})
    return tuple(made)
