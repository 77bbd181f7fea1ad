"""Recording of a solver's convergence: every iterate on the timeline ``iteration``.

:class:`IterationRecorder` is a progress function. For a robot's motion it draws the tool path, the
arm at some times, and q, qd and tau over time; for any other problem states and controls. Cost and
infeasibility are curves over the iterations of all solvers in sequence.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp.ocp.solution import Iteration, PhaseSolution
from microbot_ocp.planning.free import MotionIteration
from microbot_ocp.tasks import Step
from microbot_ocp.views import _palette as palette, _scene as scene
from microbot_ocp.views._eye import find_eye
from microbot_ocp.views._style import LABEL_HEIGHT, LINE_RADIUS, LINE_WIDTH, SIDE_BY_SIDE
from microbot_ocp.views._variables import BoundedCurve, variable_curves
from microbot_ocp.views.recording import _blueprint as layout
from microbot_ocp.views.recording._space import draw_base
from microbot_ocp.views.recording._writer import (
    LIMIT_DASHES,
    LIMIT_WIDTH,
    MARKS,
    WORLD,
    Times,
    Writer,
    file_writer,
    plot_path,
)

PANEL_SIZE = (1.7, 1.0)  # width and height of the box of one curve of an iterate
ITERATION = "iteration"  # timeline: number of iterations of all solvers so far
ARM = f"{WORLD}/iterate"
APPLICATION = "microbot_ocp_iterations"  # a viewer keeps one layout per application
COST, INFEASIBILITY = "convergence/cost", "convergence/infeasibility"


class IterationRecorder:
    """Progress function that writes the iterates of a solver.

    Parameters
    ----------
    writer : Writer
    every : int
        Interval between drawn iterations; the last iterate of every solver is drawn, too.
    """

    def __init__(self, writer: Writer, every: int = 1) -> None:
        self.writer, self.every = writer, every
        self.count = -1
        self._pending: Iteration | None = None
        self._shown: tuple[str, ...] = ()

    def __call__(self, event: Iteration | Step | str) -> None:
        """Record a progress event of a solver, of several solvers, or of a comparison."""
        iteration = event.iteration if isinstance(event, Step) else event
        if not isinstance(iteration, Iteration):
            self.finish()
            text = event.text if isinstance(event, Step) else str(event)
            row = rr.TextLog.columns(text=[text], level=["INFO"], color=[palette.MOTION])
            self.writer.columns(MARKS, self._now, row)
            return
        if self._pending is not None and iteration.number <= self._pending.number:
            self.finish()
        self.count += 1
        self._converge(iteration)
        self._pending = iteration
        if iteration.number % self.every == 0:
            self.finish()

    def finish(self) -> None:
        """Draw the last iterate unless it is drawn already."""
        if self._pending is not None:
            self._draw(self._pending)
            self._pending = None

    @property
    def _now(self) -> dict[str, FloatArray]:
        return {ITERATION: np.array([max(self.count, 0)])}

    def _converge(self, iteration: Iteration) -> None:
        power = np.log10(max(iteration.infeasibility, np.finfo(float).eps))  # lower end of the axis
        for path, value in ((COST, iteration.cost), (INFEASIBILITY, power)):
            if np.isfinite(value):
                self.writer.columns(path, self._now, rr.Scalars.columns(scalars=[value]))

    def _draw(self, iteration: Iteration) -> None:
        robot_moves = isinstance(iteration, MotionIteration)
        curves = motion_curves(iteration) if robot_moves else phase_curves(iteration.phases)
        if self._shown != tuple(curves):
            self._shown = tuple(curves)
            self._prepare(iteration, curves)
        for name, curve in curves.items():
            _draw_panel(self.writer, _path(name), self._now, curve)
        if robot_moves:
            self._draw_arm(iteration)

    def _prepare(self, iteration: Iteration, curves: Mapping[str, BoundedCurve]) -> None:
        for name in curves:
            _prepare_panel(self.writer, _path(name))
        for path in (COST, INFEASIBILITY):
            name = path.removeprefix("convergence/")
            self.writer.static(
                path, rr.SeriesLines(names=name, colors=palette.SPEED, widths=LINE_WIDTH)
            )
        if isinstance(iteration, MotionIteration):
            _prepare_arm(self.writer, iteration)
        self.writer.stream.send_blueprint(_blueprint(iteration, curves))

    def _draw_arm(self, iteration: MotionIteration) -> None:
        """Draw the arm at twelve times, and the path of its tool."""
        t, state = iteration.motion()
        origins = scene.link_origins(iteration.robot, state.q).astype(np.float32)
        nearest = np.abs(t[:, None] - np.linspace(0.0, t[-1], 12)).argmin(axis=0)
        poses = origins[np.unique(nearest)]
        arms = rr.LineStrips3D.columns(strips=poses).partition([len(poses)])
        self.writer.columns(f"{ARM}/poses", self._now, arms)
        for name in ("trail", "earlier"):
            path = rr.LineStrips3D.columns(strips=origins[None, :, -1])
            self.writer.columns(f"{ARM}/{name}", self._now, path)


@contextmanager
def record_iterations(path: str | Path, every: int = 1) -> Iterator[IterationRecorder]:
    """Yield a progress function that writes the iterates to an ``.rrd``, completely or not at all.

    Parameters
    ----------
    path : path of the file
    every : int
        Interval between drawn iterations; the last iterate of every solver is drawn, too.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> import microbot_ocp as mo
    >>> via_q = np.radians([[0, 0, 0], [-90, 90, 90]])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with record_iterations(f"{folder}/solve.rrd", every=10) as progress:
    ...         motion = mo.time_optimal(
    ...             mo.load_robot("microbot"), via_q, mesh=20, starts=1, progress=progress
    ...         )
    """
    with file_writer(path, application=APPLICATION) as writer:
        recorder = IterationRecorder(writer, every)
        yield recorder
        recorder.finish()


def motion_curves(iteration: MotionIteration) -> dict[str, BoundedCurve]:
    """Return q, qd and tau of every joint, by "quantity/joint/unit", in drawn units."""
    robot = iteration.robot
    t, state = iteration.motion()
    values = {"q": state.q, "qd": state.qd}
    if robot.has_dynamics:
        values["tau"] = iteration.torque()
    return {
        f"{quantity}/{name}/{scene.display_unit(robot, quantity, joint)}": BoundedCurve(
            t,
            scene.display_factor(robot, quantity, joint) * table[:, joint],
            *scene.drawn_bounds(robot, robot.limits, quantity, joint),
        )
        for quantity, table in values.items()
        for joint, name in enumerate(robot.joint_names)
    }


def phase_curves(phases: tuple[PhaseSolution, ...]) -> dict[str, BoundedCurve]:
    """Return the components of states, controls and algebraic variables over all phases.

    Each interval has five samples strictly inside, because a control may jump between intervals.
    """
    inside, joined = np.linspace(ROUNDING, 1 - ROUNDING, 5), {}

    def times(phase: PhaseSolution) -> FloatArray:
        return (phase.t[:-1, None] + np.diff(phase.t)[:, None] * inside).ravel()

    for (name, k, unit), curves in variable_curves(phases, times).items():
        t, values = (np.concatenate([getattr(c, key) for c in curves]) for key in ("t", "values"))
        path = f"variables/{name}{'' if k is None else f' {k + 1}'}/{unit}"
        joined[path] = BoundedCurve(t, values, curves[-1].lower, curves[-1].upper)
    return joined


def _path(key: str) -> str:
    """Return the entity path of a panel from its key "group/name/unit"."""
    group, variable, _ = key.split("/", 2)
    return plot_path(group, variable)


def _prepare_arm(writer: Writer, iteration: MotionIteration) -> None:
    robot, size = iteration.robot, scene.reach(iteration.robot)
    names = [f"via {i + 1}" for i in range(len(iteration.via_q))]
    draw_base(writer, robot, scene.tool_places(robot, iteration.via_q), names)
    writer.strips(f"{ARM}/trail", LINE_RADIUS * size, palette.SPEED)
    writer.strips(f"{ARM}/earlier", LINE_RADIUS * size / 4, (*palette.SPEED[:3], 70))
    writer.strips(f"{ARM}/poses", LINE_RADIUS * size / 2, palette.NEUTRAL)


def _blueprint(iteration: Iteration, curves: Mapping[str, BoundedCurve]) -> rrb.Blueprint:
    """Return the layout: the arm (if any) at the left, curves at the right, convergence below."""
    (width, height), views = PANEL_SIZE, {}
    bounds = rrb.VisualBounds2D(x_range=(-0.42, width + 0.12), y_range=(-height - 0.1, 0.24))
    for key in curves:
        group, variable, unit = key.split("/", 2)
        title = f"{variable} {group if group != 'variables' else ''}".strip()
        name = f"{title} [{unit}]" if unit else title
        panel = rrb.Spatial2DView(origin=_path(key), name=name, visual_bounds=bounds)
        views.setdefault(group, []).append(panel)
    widest = max(map(len, views.values()))
    wide = widest > SIDE_BY_SIDE
    if isinstance(iteration, MotionIteration) and not wide:
        shown = rrb.Grid(*(v for row in views.values() for v in row), grid_columns=widest)
    elif len(views) == 1:
        shown = rrb.Grid(*next(iter(views.values())), grid_columns=3 if wide else 2)
    else:
        shown = rrb.Tabs(*(rrb.Grid(*v, grid_columns=2, name=g) for g, v in views.items()))
    powers = rrb.ScalarAxis(range=(-16.5, 4.5))  # Rerun labels -10 and 0
    plots = rrb.Horizontal(
        layout.plot_view("cost", origin=COST),
        layout.plot_view("infeasibility, power of ten", origin=INFEASIBILITY, axis_y=powers),
    )
    whole = rrb.Vertical(shown, plots, row_shares=[2, 1])
    if isinstance(iteration, MotionIteration):
        left = rrb.Vertical(_space(iteration), layout.marks_view("solves"), row_shares=[3, 1])
        whole = rrb.Horizontal(left, whole)
    return layout.folded(whole, timeline=ITERATION, play_state="following", fps=10.0)


def _space(iteration: MotionIteration) -> rrb.Spatial3DView:
    """Return the view of the arm in space, with faint tool paths of the last eight iterations."""
    robot, q = iteration.robot, np.vstack([iteration.via_q, iteration.motion()[1].q])
    places = scene.tool_places(robot, iteration.via_q)
    eye = find_eye(robot, q, places, LABEL_HEIGHT * scene.reach(robot))
    behind = rrb.VisibleTimeRanges([layout.behind_cursor(ITERATION, 8)])
    return layout.space_view(robot, eye, {f"{ARM}/earlier": behind})


def _prepare_panel(writer: Writer, path: str) -> None:
    """Log the box and the line styles of a panel. Negative radii are screen points."""
    width, height = PANEL_SIZE
    corners = [[0, 0], [0, -height], [width, -height], [width, 0], [0, 0]]
    box = rr.LineStrips2D([corners], radii=-0.5, colors=[palette.NEUTRAL])
    writer.static(f"{path}/box", box)
    for leaf, color, radius in (
        ("curve", palette.SPEED, -LIMIT_WIDTH),
        ("limits", palette.DULL, -LIMIT_WIDTH / 2),
    ):
        look = rr.LineStrips2D.from_fields(radii=[radius], colors=[color])
        writer.static(f"{path}/{leaf}", look)
    invisible = rr.Points2D.from_fields(radii=[-0.0], colors=[palette.DULL], show_labels=True)
    writer.static(f"{path}/axes", invisible)


def _draw_panel(writer: Writer, path: str, times: Times, curve: BoundedCurve) -> None:
    """Draw one curve with its limits and the ends of its axes, at times [1].

    A plot of Rerun shows one value per time, so a whole curve is drawn as a line in a box.
    """
    (low, high), (width, height) = scene.data_range(curve.values), PANEL_SIZE
    near = [limit for limit in (curve.lower, curve.upper) if scene.is_near(limit, low, high)]
    bottom, top = rounded(min([low, *near]), max([high, *near]))
    end = rounded(0.0, float(curve.t[-1]))[1]

    def place(t: FloatArray, values: FloatArray) -> FloatArray:
        return np.column_stack([width * t / end, -height * (values - bottom) / (top - bottom)])

    def draw_lines(leaf: str, lines: list[FloatArray]) -> None:
        strips = rr.LineStrips2D.columns(strips=[line.astype(np.float32) for line in lines])
        writer.columns(f"{path}/{leaf}", times, strips.partition([len(lines)]))

    shown = np.nan_to_num(curve.values, nan=bottom, posinf=top, neginf=bottom)
    draw_lines("curve", [place(curve.t, shown)])
    edges = np.linspace(0.0, end, 2 * LIMIT_DASHES).reshape(-1, 2)
    draw_lines("limits", [place(edge, np.full(2, limit)) for limit in near for edge in edges])
    labels = [f"{top:g}", f"{bottom:g}", "0", f"{end:g} s"]
    places = [[-0.2, -height - 0.08], [-0.2, -0.08], [0.0, 0.04], [width, 0.04]]
    rows = rr.Points2D.columns(positions=places, labels=labels).partition([len(labels)])
    writer.columns(f"{path}/axes", times, rows)


def rounded(low: float, high: float) -> tuple[float, float]:
    """Return a range with round ends that contains the given range."""
    size = high - low
    decade = 10.0 ** np.floor(np.log10(size / 4))
    step = next(decade * m for m in (1, 2, 5, 10) if size / (decade * m) <= 5)
    bottom, top = step * np.floor(low / step + ROUNDING), step * np.ceil(high / step - ROUNDING)
    return float(f"{bottom:.9g}") + 0.0, float(f"{top:.9g}") + 0.0  # no -0.0
