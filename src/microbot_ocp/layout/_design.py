"""The best layout of a cell: its start, the fastest motion, the worth of every quantity."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError, naming
from microbot_ocp._base.reading import text_of
from microbot_ocp._base.schema import parsed
from microbot_ocp._base.showing import DrawnAxes, GivenAxes, view_for
from microbot_ocp._base.table import Column, Table
from microbot_ocp._base.toml_text import toml_text
from microbot_ocp._base.writing import made_folder, write_whole
from microbot_ocp.layout._quantities import Quantity, cell_with, quantities_of
from microbot_ocp.layout._search import DesignSettings, LayoutSearch, Node, Solved, solved_with
from microbot_ocp.layout._slopes import slopes
from microbot_ocp.ocp.solution import StepProgress, quiet
from microbot_ocp.planning.task import Stop, task_of, with_changes
from microbot_ocp.robot import Robot
from microbot_ocp.robot.files import is_robot_name
from microbot_ocp.scene import Scene, with_arm_capsules
from microbot_ocp.tasks import Cell, CellFile, read_cell

DIFFERENCE = 0.02  # step of the differences, as a share of a range: far above the effect of a mesh
AGREE = 0.01  # relative difference of slopes that agree
KINK = 0.1  # relative change of the slope across a kink
APART = 0.3  # rad or m between joint positions at the same stop in two branches
IDLE = "no effect on this cell"
NOISE = 2e-5  # share of the period by which two solves on different meshes differ
# A displacement or a turn whose worth is stated, by the unit.
SAID = {"m": (0.01, "10 mm"), "rad": (np.radians(1.0), "1 deg"), "": (0.01, "1 %")}


@dataclass(frozen=True)
class Worth:
    """Slope of the period by one quantity at the end of a design.

    Attributes
    ----------
    quantity : Quantity
    slope : float
        Slope from the multipliers, s per unit; NaN without multipliers.
    difference : float
        Central difference of two solves, s per unit; one-sided where one has no motion.
    flag : str
        Reason for which slope and difference may differ; empty if they agree to 1 %.
    at_bound : bool
        True if the value is a bound.
    """

    quantity: Quantity
    slope: float
    difference: float
    flag: str
    at_bound: bool

    @property
    def idle(self) -> bool:
        """True if the quantity has no effect, so that it keeps its value."""
        return self.flag == IDLE

    @property
    def sentence(self) -> str:
        """Sentence such as "base.y: 10 mm less is worth 7 ms"."""
        if self.idle:
            return f"{self.quantity.name}: {IDLE}"
        slope = self.slope if np.isfinite(self.slope) else self.difference
        size, text = SAID[self.quantity.unit]
        way = "less" if slope > 0.0 else "more"
        return f"{self.quantity.name}: {text} {way} is worth {1e3 * abs(slope) * size:.3g} ms"


@dataclass(frozen=True, eq=False)
class Design:
    """A cell with the best values of its free quantities.

    Attributes
    ----------
    quantities : tuple of Quantity, d
    values : array [d]
        Best values, in the units of the quantities.
    before : Cell or None
        Certified motion of the given cell; None where there is none.
    refusal : str
        Reason for that.
    after : Cell
        Certified motion of the cell with the best values.
    cell : CellFile
        Cell with the best values.
    worth : tuple of Worth, d
    nodes : tuple of Node
        Map of quick looks, the given cell first.
    solved : tuple of Solved
        Whole solves in their order.
    """

    quantities: tuple[Quantity, ...]
    values: FloatArray
    before: Cell | None
    refusal: str
    after: Cell
    cell: CellFile
    worth: tuple[Worth, ...]
    nodes: tuple[Node, ...]
    solved: tuple[Solved, ...]

    @property
    def period_before(self) -> float:
        """Duration of the motion of the given cell, s; NaN without one."""
        return np.nan if self.before is None else self.before.motion.duration

    @property
    def period(self) -> float:
        """Duration of the motion with the best values, s."""
        return self.after.motion.duration

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        rows = zip(self.quantities, self.values.tolist(), self.worth, strict=True)
        keys = ("slope", "difference", "flag", "at_bound")
        return {
            "period_before": self.period_before,
            "period": self.period,
            "certified": self.after.certificate.ok,
            "refusal": self.refusal,
            "quantities": [
                {"name": q.name, "unit": q.unit, "before": q.start, "after": v}
                | {key: getattr(w, key) for key in keys}
                for q, v, w in rows
            ],
            "looks": len(self.nodes),
            "solves": len(self.solved),
            "after": self.after.as_dict(),
        }

    def table(self) -> Table:
        """Return one row per quantity: its values before and after, and its worth at the end."""
        columns = [
            Column("quantity", left=True),
            Column("before", show=".4f"),
            Column("after", show=".4f"),
            Column("unit", left=True),
            Column("slope", "ms/unit", ".4g"),
            Column("difference", "ms/unit", ".4g"),
            Column("remark", left=True),
        ]
        rows = [
            [
                w.quantity.name,
                w.quantity.start,
                value,
                w.quantity.unit,
                1e3 * w.slope,
                1e3 * w.difference,
                "; ".join(filter(None, [w.at_bound * "at its bound", w.flag])),
            ]
            for w, value in zip(self.worth, self.values.tolist(), strict=True)
        ]
        saved = 100.0 * (1.0 - self.period / self.period_before)
        period = f"period {self.period:.4f} s"
        if self.before is None:
            period += f"; the given cell has none: {self.refusal}"
        else:
            period += f" in place of {self.period_before:.4f} s, {saved:.3g} % less"
        count = f"{len(self.nodes)} quick looks, {len(self.solved)} solves"
        notes = [period, *(worth.sentence for worth in self.worth), count]
        return Table(columns, rows, notes=notes)

    def save(self, path: str | Path) -> Path:
        """Write the cell file with the new numbers; comments of the old one are lost.

        Raises
        ------
        InputError
            The task was not read from a file, or its scene was given beside it.
        """
        cell, target = self.cell, Path(path)
        if cell.source is None:
            raise InputError("the task was not read from a cell file: take design.cell")
        data = parsed(text_of(cell.source, "task file"))
        names = [row.get("name", f"stop {k + 1}") for k, row in enumerate(data["stop"])]
        for quantity in self.quantities:
            if quantity.kind == "stops":
                row = data["stop"][names.index(quantity.target)]
                stop = next(s for s in cell.stops if s.name == quantity.target)
                row["position"] = list(stop.position)
                if quantity.axis == "yaw":
                    row.pop("rpy", None)
                    row.pop("rpy_deg", None)
                    row["orientation"] = [list(r) for r in stop.orientation]
        mounting = {k: v for k, v in vars(cell.mounting).items() if v}
        data = {**data, "mounting": mounting} if mounting else data
        folder = cell.source.resolve().parent
        for key in ("robot", "scene"):
            name = data.get(key)
            if isinstance(name, str) and not (key == "robot" and is_robot_name(name)):
                data[key] = os.path.relpath(folder / name, target.resolve().parent)
        scene = data.get("scene")
        if isinstance(scene, Mapping) and target.resolve().parent != folder:
            _relink(scene, folder, target.resolve().parent)
        return write_whole(target, toml_text(data))

    def plot(self, axes: GivenAxes | None = None) -> DrawnAxes:
        """Plot the map of quick looks with the solves, from the start to the end."""
        return view_for(self, "plot")(self, axes)

    def to_rerun(self, folder: str | Path) -> list[Path]:
        """Write recordings of the motions, ``before.rrd`` and ``after.rrd``, into a folder."""
        target = made_folder(folder)
        pairs = (("before.rrd", self.before), ("after.rrd", self.after))
        return [cell.to_rerun(target / name) for name, cell in pairs if cell is not None]


def _relink(table: Any, before: Path, after: Path) -> None:
    """Rewrite names of files in the table of a scene, relative to another folder."""
    for key in ("urdf", "file"):
        if isinstance(table.get(key), str):
            table[key] = os.path.relpath(before / table[key], after)
    for row in table.get("obstacle", ()):
        _relink(row, before, after)


def design(
    robot: Robot | None,
    task: CellFile | str | Path | Sequence[Stop],
    free: Any,
    bounds: Mapping[str, Any] | None = None,
    *,
    scene: Scene | None = None,
    settings: DesignSettings | None = None,
    progress: StepProgress | None = None,
    segments: Sequence[Any] | None = None,
    cycle: bool = False,
    order: str = "given",
    **changes: Any,
) -> Design:
    """Find where an arm, the turn of its tool and its stops make the period shortest.

    Quantities are values in the frame of the task: the stops and obstacles of a cell stay, the base
    moves. Branches and free orders are chosen anew at every solve, and the result is never slower
    than the given cell. It may be a local optimum.

    Parameters
    ----------
    robot : Robot, optional
        Arm of the cell; None for the one that the cell names.
    task : CellFile, path of a cell file, or sequence of Stop
        Stops that have names, or are "stop 1" and so on.
    free : mapping or sequence of names
        Free quantities: ``{"base": ("x", "y", "z", "yaw"), "tool": ("yaw",),
        "stops": {"place": ("x", "yaw")}, "gear ratio": ("elbow",)}``, or dotted names such as
        "base.x" and "stops.place.yaw".
    bounds : mapping, optional
        Range of each, m or rad, ``{"base.x": (-0.2, 0.2)}``; default a quarter of the reach and a
        quarter turn to both sides of the present value, and half to double a gear ratio.
    scene : Scene, optional
        Obstacles, instead of the scene of the cell.
    settings : DesignSettings, optional
        Numbers of quick looks and solves.
    progress : callable, optional
        Function that receives a line of text at every solve.
    segments, cycle, order, **changes
        Parameters of :func:`microbot_ocp.time_optimal`, where ``task`` is a sequence of stops.

    Returns
    -------
    Design

    Raises
    ------
    InputError
        An unknown name, bounds without the present value; no placement within the bounds reaches
        all stops, or obstacles forbid each that does; a quantity without effect.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("planar_2r")
    >>> stops = [mo.Stop(position=[0.6, y, 0.0]) for y in (0.3, -0.3)]
    >>> quick = mo.layout.DesignSettings(nodes=4, solves=2, starts=0)
    >>> free, bounds = "base.x", {"base.x": (-0.1, 0.1)}
    >>> found = mo.design(robot, stops, free, bounds, mesh=20, settings=quick)
    >>> found.period < found.period_before
    True
    """
    given = {"segments": segments, "cycle": cycle, "order": order, **changes}
    cell = _cell(robot, task, scene, given)
    with naming(f"{cell.origin}: " if cell.source else ""):
        task_of(cell.robot, cell.stops, cell.limits, segments=cell.segments, cycle=cell.cycle)
        quantities = quantities_of(cell, free, bounds)
        search = LayoutSearch(cell, quantities, settings or DesignSettings(), progress or quiet)
        search.draw_map()
        search.hold_without_effect()
    search.run()
    best, start = search.best, search.solved[0]
    if best.cell is None:
        reasons = "; ".join(dict.fromkeys(s.refusal for s in search.solved[:3]))
        raise InputError(
            f"no motion was found within the bounds, of {len(search.solved)} solves: {reasons}"
        )
    return Design(
        quantities,
        best.values,
        start.cell,
        start.refusal,
        best.cell,
        cell_with(cell, quantities, best.values),
        _worth(search),
        tuple(search.nodes),
        tuple(search.solved),
    )


def _cell(robot: Robot | None, task: Any, scene: Scene | None, given: dict[str, Any]) -> CellFile:
    """Return the cell of a task, with another robot or scene where these are given."""
    if isinstance(task, str | Path):
        task = read_cell(task)
    if isinstance(task, CellFile):
        for key, value in given.items():
            if value not in (None, False, "given"):
                raise InputError(f"{key} is part of a cell: give it there")
        if task.front is not None or task.duration is not None:
            raise InputError("a design is for the shortest period: no front and no duration")
        cell = task
        if robot is not None and robot != cell.robot:
            if cell.limits.as_dict() != cell.robot.limits.as_dict():
                raise InputError("the cell has limits for another robot: give robot None")
            cell = replace(cell, robot=cell.mounting.on(robot), limits=robot.limits)
    else:
        if robot is None:
            raise InputError("robot must be given with a sequence of stops")
        if not isinstance(task, Sequence) or not all(isinstance(stop, Stop) for stop in task):
            raise InputError(f"task must be a cell or a sequence of mo.Stop, not {task!r}")
        stops = tuple(stop.named(f"stop {k + 1}") for k, stop in enumerate(task))
        cell = CellFile("task", robot, stops, robot.limits)
        more = {key: given.pop(key) for key in ("segments", "cycle", "order")}
        more["segments"] = None if more["segments"] is None else tuple(more["segments"])
        cell = replace(cell, settings=with_changes(cell.settings, given), **more)
    cell = cell if scene is None else replace(cell, scene=scene)
    # Capsules are fitted once and move with the arm.
    return cell if cell.scene is None else replace(cell, robot=with_arm_capsules(cell.robot))


def _worth(search: LayoutSearch) -> tuple[Worth, ...]:
    """Return the slopes at the end, each beside a difference of solves."""
    cell, quantities, best = search.cell, search.quantities, search.best
    assert best.cell is not None
    by_multipliers = slopes(cell, quantities, best.values, best.cell.motion)
    bounded = search.at_bounds(best.values)
    rows = []
    for k, quantity in enumerate(quantities):
        slope = np.nan if by_multipliers is None else float(by_multipliers[k])
        step = DIFFERENCE * (quantity.upper - quantity.lower)
        if quantity.kind == "gear ratio":
            step = min(step, DIFFERENCE * best.values[k])
        sides = []
        for side in (-step, step):
            moved = best.values.copy()
            moved[k] += side
            sides.append(solved_with(cell, quantities, moved))
        below, above = (side.period for side in sides)
        ends = [(best.period - below) / step, (above - best.period) / step]
        finite = [end for end in ends if np.isfinite(end)]
        difference = float(np.mean(finite)) if finite else np.nan
        flag = IDLE if search.held[k] else _flag(slope, ends, step, best, sides)
        rows.append(Worth(quantity, slope, difference, flag, bool(bounded[k])))
    return tuple(rows)


def _flag(slope: float, ends: list[float], step: float, best: Solved, sides: list[Solved]) -> str:
    """Return why a slope and a difference may differ; empty if they agree."""
    if not np.isfinite(slope):
        return "no multipliers"
    if not all(map(np.isfinite, ends)):
        return "no motion beside it"
    if any(_changes(side, best) for side in sides):
        return "branch or order changes beside it"
    scale = max(abs(slope), *map(abs, ends))
    if 2.0 * scale * step * AGREE < NOISE * best.period:
        return "too small to be checked"
    if abs(ends[1] - ends[0]) > KINK * scale:
        return "bent beside it"
    return "" if abs(np.mean(ends) - slope) <= AGREE * scale else "differs from the slope"


def _changes(one: Solved, other: Solved) -> bool:
    """Return True if the order or the branches at the stops of two motions differ."""
    assert one.cell is not None
    assert other.cell is not None
    motions = one.cell.motion, other.cell.motion
    orders = [motion.provenance.get("order") for motion in motions]
    poses = [motion.sample([mark.time for mark in motion.marks]).q for motion in motions]
    return orders[0] != orders[1] or float(np.abs(poses[0] - poses[1]).max()) > APART
