"""Motions for other programs: CSV, ROS trajectories, MATLAB, Parquet, MuJoCo keyframes; films.

Every data format has the time, and the position, velocity, acceleration and torque of every joint,
in SI units.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.needed import needed
from microbot_ocp._base.showing import view_for
from microbot_ocp._base.writing import digest, whole_file, write_whole
from microbot_ocp.robot import Robot

QUANTITIES = {"q": "rad", "qd": "rad/s", "qdd": "rad/s^2", "tau": "N m"}
# Names in ROS.
FIELDS = {"positions": "q", "velocities": "qd", "accelerations": "qdd", "effort": "tau"}
NANOSECONDS = 1_000_000_000
MOST_SECONDS = 2**31  # largest time in ROS
ESCAPED = {ord(letter): f"%{ord(letter):02X}" for letter in "%;@"}  # separators of marks in a row


class Columns(NamedTuple):
    """Content of a file: times [N], values [N,n] by quantity, and names and units of the joints.

    ``marks`` are times, s, and names of events; None for a file without marks.
    """

    label: str
    t: FloatArray
    values: Mapping[str, FloatArray]
    joints: tuple[str, ...]
    units: Mapping[str, tuple[str, ...]]
    marks: tuple[tuple[float, str], ...] | None = None

    @classmethod
    def of(
        cls,
        samples: Any,
        robot: Robot | None,
        keys: Iterable[str] = tuple(QUANTITIES),
        marks: Any = None,
    ) -> Columns:
        """Return the columns of a motion; without a robot joints are numbered and revolute."""
        count = samples.q.shape[1]
        if robot is None:
            joints = tuple(f"joint_{j + 1}" for j in range(count))
            units = {key: (unit,) * count for key, unit in QUANTITIES.items()}
        else:
            checks.joints("motion", count, robot)
            joints = robot.joint_names
            units = {key: tuple(robot.unit(key, j) for j in range(count)) for key in keys}
        values = {key: getattr(samples, key) for key in keys}
        return cls(samples.label, samples.t, values, joints, units, marks)

    def table(self) -> tuple[list[str], FloatArray]:
        """Return heads, such as "qd elbow [rad/s]", and values [N, 1 + 4 n]."""
        heads = ["t [s]"]
        for key in self.values:
            heads += [
                f"{key} {joint} [{unit}]"
                for joint, unit in zip(self.joints, self.units[key], strict=True)
            ]
        return heads, np.column_stack([self.t, *self.values.values()])


def export(
    motion: Any, path: str | Path, rate: float | None, robot: Robot | None, theme: str, scene: Any
) -> Path:
    """Write a motion; see :meth:`microbot_ocp.Motion.export`."""
    target = Path(path)
    checks.one_of("ending of path", target.suffix, (*EXPORT_FORMATS, *FILM_FORMATS))
    if target.suffix in FILM_FORMATS:
        if robot is None:
            raise InputError(f"a {target.suffix} film needs the robot: give robot=...")
        return view_for(motion, "animation")(robot, motion, target, rate, theme=theme, scene=scene)
    _check_size(motion, rate, target.suffix)
    sampled = motion if rate is None else motion.resample(rate, robot)
    return write_columns(target, Columns.of(sampled, robot))


def write_columns(path: str | Path, columns: Columns) -> Path:
    """Write columns in the format of the path's suffix."""
    target = Path(path)
    checks.one_of("ending of path", target.suffix, EXPORT_FORMATS)
    with whole_file(target) as partial:
        EXPORT_FORMATS[target.suffix](partial, columns)
    if target.suffix == ".json":
        _write_marks(target, columns.marks or ())
    return target


def marks_path(path: str | Path) -> Path:
    """Return the path of the marks beside a ROS message, which has no field for marks."""
    return Path(path).with_suffix(".marks.json")


def _write_marks(path: Path, marks: Sequence[tuple[float, str]]) -> None:
    """Write the marks of a message beside it; without marks, delete those of an earlier message."""
    if not path.is_file():  # standard output has no neighbour
        return
    if not marks:
        marks_path(path).unlink(missing_ok=True)
        return
    stamps = [(name, _stamp(round(time * NANOSECONDS))) for time, name in marks]
    rows = [{"name": name, "time_from_start": stamp} for name, stamp in stamps]
    write_whole(marks_path(path), json.dumps({"of": digest(path), "marks": rows}) + "\n")


def _check_size(motion: Any, rate: float | None, suffix: str) -> None:
    """Raise InputError for a file that would take more than some seconds to write."""
    count = motion.t.size
    if rate is not None:
        count = motion.duration * checks.number("rate", rate, "Hz", above=0.0)
    most = MOST_NUMBERS.get(suffix, MOST_IN_TEXT) // (1 + len(QUANTITIES) * motion.joint_count)
    checks.size(f"the number of samples in a {suffix} file", count, most)
    if suffix == ".json" and motion.duration >= MOST_SECONDS:
        raise InputError(f"a trajectory of ROS has less than 2^31 s, not {motion.duration:g} s")


def _write_csv(path: Path, columns: Columns) -> None:
    heads, values = columns.table()
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        rows = values.tolist()
        if columns.marks is not None:
            heads.append("mark")
            marks = [""] * len(rows)
            for time, name in columns.marks:  # the first row that is not before the mark
                row = min(int(np.searchsorted(columns.t, time - ROUNDING)), len(rows) - 1)
                name = name.translate(ESCAPED)
                text = name if abs(columns.t[row] - time) < ROUNDING else f"{name} @ {time!r}"
                marks[row] = "; ".join(filter(None, [marks[row], text]))
            rows = [[*row, mark] for row, mark in zip(rows, marks, strict=True)]
        writer.writerow(heads)
        writer.writerows(rows)


def _write_trajectory(path: Path, columns: Columns) -> None:
    """Write a ``trajectory_msgs/JointTrajectory`` of ROS as JSON."""
    names = {name: key for name, key in FIELDS.items() if key in columns.values}
    whole = np.rint(columns.t * NANOSECONDS).astype(np.int64)
    # A controller needs increasing times: only the later of two samples at a jump is written.
    apart = np.append(np.diff(whole) > 10_000, True)
    points = [
        {
            **{name: columns.values[key][i].tolist() for name, key in names.items()},
            "time_from_start": _stamp(int(whole[i])),
        }
        for i in np.flatnonzero(apart)
    ]
    document = {
        "header": {"stamp": _stamp(0), "frame_id": ""},
        "joint_names": list(columns.joints),
        "points": points,
    }
    path.write_text(json.dumps(document) + "\n", "utf-8")


def _stamp(nanoseconds: int) -> dict[str, int]:
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return {"sec": seconds, "nanosec": rest}


def _write_matlab(path: Path, columns: Columns) -> None:
    savemat = needed("scipy.io", "this format needs", "export").savemat
    units = {f"{key}_unit": list(columns.units[key]) for key in columns.values}
    named = {"joint_names": list(columns.joints), "label": columns.label}
    if columns.marks is not None:
        named |= {"marks": json.dumps(columns.marks)}
    savemat(path, {"t": columns.t[:, None], **columns.values, **units, **named}, appendmat=False)


def _write_parquet(path: Path, columns: Columns) -> None:
    arrow, parquet = (
        needed(module, "this format needs", "export") for module in ("pyarrow", "pyarrow.parquet")
    )
    heads, values = columns.table()
    table = arrow.table(dict(zip(heads, values.T, strict=True)))
    metadata = {"label": columns.label}
    if columns.marks is not None:
        metadata["marks"] = json.dumps(columns.marks)
    parquet.write_table(table.replace_schema_metadata(metadata), path)


def _write_keyframes(path: Path, columns: Columns) -> None:
    """Write MuJoCo keyframes, one per sample, for a model with the joints of the arm."""
    root = ElementTree.Element("mujoco")
    frame = ElementTree.SubElement(root, "keyframe")
    for i, t in enumerate(columns.t.tolist()):
        named = {"qpos": "q", "qvel": "qd"}
        row = {k: columns.values[v][i] for k, v in named.items() if v in columns.values}
        texts = {key: " ".join(map(repr, values.tolist())) for key, values in row.items()}
        ElementTree.SubElement(frame, "key", {"name": str(i), "time": repr(t), **texts})
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8")


MOST_IN_TEXT = 3_000_000  # numbers in a text file
MOST_NUMBERS = {".mat": 20_000_000, ".parquet": 20_000_000}
FILM_FORMATS = (".gif", ".mp4")  # drawn by the views
EXPORT_FORMATS: dict[str, Callable[[Path, Columns], None]] = {
    ".csv": _write_csv,
    ".json": _write_trajectory,
    ".mat": _write_matlab,
    ".parquet": _write_parquet,
    ".xml": _write_keyframes,
}
