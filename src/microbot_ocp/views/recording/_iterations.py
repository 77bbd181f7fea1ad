"""A solve as it converges: every iterate on the timeline ``iteration``.

:class:`IterationRecorder` is a progress function. Of a robot's motion it draws the tool's path, the
arm at some instants, and q, qd and tau over time; of any other problem its states and controls.
Cost and infeasibility become curves over the iterations of all solves in a row.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.comparison import Step
from microbot_ocp.ocp.solution import Iteration, PhaseSolution
from microbot_ocp.planning import MotionIteration
from microbot_ocp.views._scene import display_factor, display_unit, link_origins, reach
from microbot_ocp.views.recording._animated_arm import NEUTRAL_COLOR, SPEED_COLOR, VELOCITY_COLOR
from microbot_ocp.views.recording._blueprint import folded, plot_view, space_view, text_lines_view
from microbot_ocp.views.recording._curves import (
    PANEL_BOUNDS,
    Curve,
    draw_panel,
    prepare_panel,
    variable_curves,
)
from microbot_ocp.views.recording._limits import drawn_bounds
from microbot_ocp.views.recording._surroundings import draw_surroundings, find_eye
from microbot_ocp.views.recording._writer import MARKS, Writer, arm_path, file_writer, plot_path

ITERATION = "iteration"  # iterations of all solvers so far
ARM = "iterate"
APPLICATION = "microbot_ocp_iterations"  # a viewer keeps one layout for each
POSES = 12  # of the arm along the motion
EARLIER = 8  # iterations whose tool paths stay behind, faintly
SMALLEST = 1e-16  # infeasibility that is drawn for none
WIDE = 4  # more panels than this in a row: two columns
PER_INTERVAL = 5  # samples of a state or control
CONVERGENCE: dict[str, tuple[str, dict[str, Any]]] = {  # title and settings of the plot
    "cost": ("cost", {}),
    "infeasibility": (
        "infeasibility, power of ten",
        {"axis_y": rrb.ScalarAxis(range=(-16.5, 4.5))},  # Rerun labels -10 and 0
    ),
}


class IterationRecorder:
    """A progress function that writes the iterates of a solve.

    Parameters
    ----------
    writer : Writer
    every : int
        Of so many iterations one is drawn, and the last of every solve.
    """

    def __init__(self, writer: Writer, every: int = 1) -> None:
        self.writer, self.every = writer, every
        self.count = -1
        self._pending: Iteration | None = None
        self._shown: tuple[str, ...] = ()

    def __call__(self, event: Iteration | Step | str) -> None:
        """Progress of a solve, of several, or of a comparison."""
        iteration = event.iteration if isinstance(event, Step) else event
        if not isinstance(iteration, Iteration):
            self.finish()
            self._say(event.text if isinstance(event, Step) else str(event))
            return
        if self._pending is not None and iteration.number <= self._pending.number:
            self.finish()
        self.count += 1
        self._converge(iteration)
        self._pending = iteration
        if iteration.number % self.every == 0:
            self.finish()

    def finish(self) -> None:
        """Draw the last iterate, if it is not drawn yet."""
        if self._pending is not None:
            self._draw(self._pending)
            self._pending = None

    @property
    def _now(self) -> dict[str, FloatArray]:
        return {ITERATION: np.array([max(self.count, 0)])}

    def _say(self, text: str) -> None:
        row = rr.TextLog.columns(text=[text], level=["INFO"], color=[VELOCITY_COLOR])
        self.writer.columns(MARKS, self._now, row)

    def _converge(self, iteration: Iteration) -> None:
        power = np.log10(max(iteration.infeasibility, SMALLEST))
        for name, value in (("cost", iteration.cost), ("infeasibility", power)):
            if np.isfinite(value):
                row = rr.Scalars.columns(scalars=[value])
                self.writer.columns(f"convergence/{name}", self._now, row)

    def _draw(self, iteration: Iteration) -> None:
        robot_moves = isinstance(iteration, MotionIteration)
        curves = motion_curves(iteration) if robot_moves else phase_curves(iteration.phases)
        if self._shown != tuple(curves):
            self._shown = tuple(curves)
            self._prepare(iteration, curves)
        for name, curve in curves.items():
            draw_panel(self.writer, _path(name), self._now, curve)
        if robot_moves:
            self._draw_arm(iteration)

    def _prepare(self, iteration: Iteration, curves: Mapping[str, Curve]) -> None:
        for name in curves:
            prepare_panel(self.writer, _path(name))
        for name in CONVERGENCE:
            look = rr.SeriesLines(names=name, colors=SPEED_COLOR, widths=1.5)
            self.writer.static(f"convergence/{name}", look)
        if isinstance(iteration, MotionIteration):
            _prepare_arm(self.writer, iteration)
        self.writer.layout(_blueprint(iteration, curves))

    def _draw_arm(self, iteration: MotionIteration) -> None:
        t, state = iteration.motion()
        origins = link_origins(iteration.robot, state.q)
        nearest = np.abs(t[:, None] - np.linspace(0.0, t[-1], POSES)).argmin(axis=0)
        poses = origins[np.unique(nearest)].astype(np.float32)
        arms = rr.LineStrips3D.columns(strips=poses).partition([len(poses)])
        self.writer.columns(arm_path(ARM, "poses"), self._now, arms)
        path = origins[:, -1].astype(np.float32)[None]
        for name in (arm_path(ARM, "trail"), arm_path(ARM, "earlier")):
            self.writer.columns(name, self._now, rr.LineStrips3D.columns(strips=path))


@contextmanager
def record_iterations(path: str | Path, every: int = 1) -> Iterator[IterationRecorder]:
    """A progress function that writes the iterates into an ``.rrd``, whole or not at all.

    Parameters
    ----------
    path : path of the file
    every : int
        Of so many iterations one is drawn, and the last of every solve.

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


def motion_curves(iteration: MotionIteration) -> dict[str, Curve]:
    """q, qd and tau of every joint, by "quantity/joint", in the units in which they are drawn."""
    robot = iteration.robot
    t, state = iteration.motion()
    values = {"q": state.q, "qd": state.qd}
    if robot.has_dynamics:
        values["tau"] = iteration.torque()
    curves = {}
    for quantity, table in values.items():
        for joint, name in enumerate(robot.joint_names):
            shown = display_factor(robot, quantity, joint) * table[:, joint]
            bounds = drawn_bounds(robot, quantity, joint)
            key = f"{quantity}/{name}/{display_unit(robot, quantity, joint)}"
            curves[key] = Curve(t, shown, *bounds)
    return curves


def phase_curves(phases: tuple[PhaseSolution, ...]) -> dict[str, Curve]:
    """Every component of every state, control and algebraic variable over the phases in a row."""
    parts: dict[str, list[Curve]] = {}
    start = 0.0
    inside = np.linspace(1e-9, 1 - 1e-9, PER_INTERVAL)  # a control may jump between two intervals
    for phase in phases:
        t = (phase.t[:-1, None] + np.diff(phase.t)[:, None] * inside).ravel()
        for variable, k, curve in variable_curves(phase, t, start):
            number = f" {k + 1}" if variable.size > 1 else ""
            key = f"variables/{variable.name}{number}/{variable.unit}"
            parts.setdefault(key, []).append(curve)
        start += phase.duration
    return {
        key: Curve(
            np.concatenate([curve.t for curve in curves]),
            np.concatenate([curve.values for curve in curves]),
            curves[-1].lower,
            curves[-1].upper,
        )
        for key, curves in parts.items()
    }


def _path(key: str) -> str:
    """Where a panel is in the tree, from "group/name/unit"."""
    group, variable, _ = key.split("/", 2)
    return plot_path(group, variable)


def _via_places(iteration: MotionIteration) -> FloatArray:
    return link_origins(iteration.robot, iteration.via_q)[:, -1]


def _prepare_arm(writer: Writer, iteration: MotionIteration) -> None:
    robot, size = iteration.robot, reach(iteration.robot)
    names = [f"via {i + 1}" for i in range(len(iteration.via_q))]
    draw_surroundings(writer, robot, _via_places(iteration), names, None)
    for path, color, radius in (
        (arm_path(ARM, "trail"), SPEED_COLOR, 0.006),
        (arm_path(ARM, "earlier"), (*SPEED_COLOR[:3], 70), 0.0015),
        (arm_path(ARM, "poses"), NEUTRAL_COLOR, 0.0025),
    ):
        look = rr.LineStrips3D.from_fields(radii=[radius * size], colors=[color])
        writer.static(path, look)


def _blueprint(iteration: Iteration, curves: Mapping[str, Curve]) -> rrb.Blueprint:
    """The arm to the left where there is one, the curves to the right, convergence below."""
    views: dict[str, list[rrb.Spatial2DView]] = {}
    for key in curves:
        group, variable, unit = key.split("/", 2)
        title = f"{variable} {group if group != 'variables' else ''}".strip()
        panel = rrb.Spatial2DView(
            origin=_path(key),
            name=f"{title} [{unit}]" if unit else title,
            visual_bounds=rrb.VisualBounds2D(x_range=PANEL_BOUNDS[0], y_range=PANEL_BOUNDS[1]),
        )
        views.setdefault(group, []).append(panel)
    widest = max(len(row) for row in views.values())
    if isinstance(iteration, MotionIteration) and widest <= WIDE:
        shown = rrb.Grid(*(v for row in views.values() for v in row), grid_columns=widest)
    elif len(views) == 1:
        shown = rrb.Grid(*next(iter(views.values())), grid_columns=3 if widest > WIDE else 2)
    else:
        shown = rrb.Tabs(*(rrb.Grid(*v, grid_columns=2, name=g) for g, v in views.items()))
    convergence = rrb.Horizontal(
        *(
            plot_view(title, origin=f"convergence/{name}", **settings)
            for name, (title, settings) in CONVERGENCE.items()
        )
    )
    if isinstance(iteration, MotionIteration):
        left = rrb.Vertical(_space(iteration), text_lines_view("solves"), row_shares=[2.6, 1.0])
        right = rrb.Vertical(shown, convergence, row_shares=[2.6, 1.0])
        whole = rrb.Horizontal(left, right, column_shares=[1.0, 1.15])
    else:
        whole = rrb.Vertical(shown, convergence, row_shares=[2.2, 1.0])
    return folded(whole, timeline=ITERATION, play_state="following", fps=10.0)


def _space(iteration: MotionIteration) -> rrb.Spatial3DView:
    robot = iteration.robot
    q = np.vstack([iteration.via_q, iteration.motion()[1].q])
    behind = rrb.VisibleTimeRange(
        ITERATION,
        start=rrb.TimeRangeBoundary.cursor_relative(seq=-EARLIER),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    return space_view(
        robot,
        find_eye(robot, q, _via_places(iteration), 0.06 * reach(robot)),
        {arm_path(ARM, "earlier"): rrb.VisibleTimeRanges([behind])},
    )
