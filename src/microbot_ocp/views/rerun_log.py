"""One Rerun recording of a comparison: every motion on one timeline, ready to play."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from microbot_ocp.certificate import Certificate
from microbot_ocp.checks import FloatArray
from microbot_ocp.comparison import Comparison, Entry
from microbot_ocp.motion import JUMP_GAP, Motion
from microbot_ocp.robot import Robot
from microbot_ocp.views import scene
from microbot_ocp.views.style import EntryStyle, entry_styles
from microbot_ocp.views.tables import comparison_markdown

TIMELINE = "sim_time"
POSE_RATE = 200.0  # Hz: smoother than any screen
CURVE_STEP = 2e-3  # s between kept samples of a curve, at least
CURVE_POINTS = 1000  # kept samples of a curve, about: more than a screen is wide
BRIGHTER = 0.25  # share of white in colours, which are chosen for paper, on a dark screen
GHOST_ALPHA = 110
DASHES = 40  # of a limit's line, over the whole timeline
LIMIT_COLOR = (165, 165, 165, 255)
BASE_COLOR = (120, 120, 125, 255)
VIA_COLOR = (245, 245, 245, 255)
EYE_DISTANCE = 0.84  # times the diagonal of everything that moves
WIDE_ROBOT = 4  # more joints than this: one tab a quantity


class Look(NamedTuple):
    """How one arm is drawn: its style, link radius (m), opacity, and height of its label (m)."""

    style: EntryStyle
    radius: float
    alpha: int
    label_height: float


def write_recording(comparison: Comparison, path: str | Path) -> Path:
    """Write every motion into one ``.rrd`` with its layout; it starts playing when opened.

    Parameters
    ----------
    comparison : Comparison
    path : str or Path
        File to write, whole or not at all.

    Returns
    -------
    Path

    Notes
    -----
    Timeline ``sim_time``, s. Entities: ``/world/<name>/link_k`` (pose of link frame k in the base
    frame; link_0 is the base), ``/world/<name>/tool`` and ``/trail``,
    ``/plots/<q, qd or tau>/<joint>/<name>`` (q in deg for revolute joints),
    ``/marks/<name>``, ``/comparison``. A motion that ends early stays at its last pose.
    """
    target = Path(path)
    partial = target.with_name(target.name + ".part")
    recording = rr.RecordingStream("microbot_ocp")
    try:
        recording.save(partial, default_blueprint=_blueprint(comparison))
        _log_surroundings(recording, comparison)
        for look, motion in _looks(comparison):
            _log_arm(recording, comparison, look, motion)
            _log_curves(recording, comparison.robot, look.style, motion)
            _log_marks(recording, look.style, motion)
        _log_limits(recording, comparison)
        recording.flush()
    finally:
        recording.disconnect()  # writes the footer, without which the file is not valid
    return partial.replace(target)


def write_motion_recording(
    robot: Robot, motion: Motion, path: str | Path, certificate: Certificate | None = None
) -> Path:
    """Write one motion into an ``.rrd`` as :func:`write_recording` does, with the robot's limits.

    Its ends, and the marks named "via ...", are the via points; the entity is ``/world/motion``.
    """
    inner = [m.time for m in motion.marks if m.name.startswith("via")]
    times = [0.0, *sorted(t for t in inner if 0.0 < t < motion.duration), motion.duration]
    status = str(motion.provenance.get("status", "solved")).replace("_", " ")
    nothing = float("nan")
    entry = Entry(
        "motion",
        motion.label,
        motion,
        certificate,
        status,
        motion.note,
        solve_time=nothing,
        torque_squared=nothing,
        work=nothing,
        details={},
    )
    alone = Comparison(robot, motion.sample(times).q, robot.limits, (entry,), "motion")
    return write_recording(alone, path)


def joint_path(robot: Robot, quantity: str, joint: int, leaf: str = "") -> str:
    """Entity path of the curves of a joint (0-based), or of one of them."""
    parts = ["plots", quantity, robot.joint_names[joint], *([leaf] if leaf else [])]
    return rr.new_entity_path(parts)


def _looks(comparison: Comparison) -> list[tuple[Look, Motion]]:
    styles = entry_styles(comparison)
    size = scene.reach(comparison.robot)
    looks = []
    for place, (entry, motion) in enumerate(scene.solved_entries(comparison)):
        style = styles[entry.name]
        # another radius for every ghost: surfaces at one place would flicker
        ghost_radius = size * (0.0165 - 0.0011 * min(place, 8))
        look = Look(
            style=style,
            radius=0.021 * size if style.highlighted else ghost_radius,
            alpha=255 if style.highlighted else GHOST_ALPHA,
            label_height=size * (0.06 if style.highlighted else 0.12 + 0.055 * place),
        )
        looks.append((look, motion))
    return looks


def _static(
    recording: rr.RecordingStream,
    path: str,
    *what: rr.AsComponents | Iterable[rr.DescribedComponentBatch],
) -> None:
    recording.log(path, *what, static=True, strict=True)


def _columns(
    recording: rr.RecordingStream, path: str, t: FloatArray, columns: Iterable[rr.ComponentColumn]
) -> None:
    index = rr.TimeColumn(TIMELINE, duration=t)
    recording.send_columns(path, indexes=[index], columns=columns, strict=True)


def _log_surroundings(recording: rr.RecordingStream, comparison: Comparison) -> None:
    """What does not move: axes, base, via points, the table."""
    robot = comparison.robot
    size = scene.reach(robot)
    _static(recording, "world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    half = [[0.07 * size, 0.07 * size, 0.008 * size]]
    plate = rr.Boxes3D(half_sizes=half, colors=[BASE_COLOR], fill_mode="solid")
    _static(recording, "world/base", plate)
    places = scene.link_origins(robot, comparison.via_q)[:, -1]
    spheres = rr.Points3D(
        places,
        radii=0.022 * size,
        colors=[VIA_COLOR],
        labels=[f"via {k}" for k in range(1, len(places) + 1)],
        show_labels=True,
    )
    _static(recording, "world/via_points", spheres)
    words = comparison_markdown(comparison) + _far_limits(comparison)
    _static(recording, "comparison", rr.TextDocument(words, media_type="text/markdown"))


def _far_limits(comparison: Comparison) -> str:
    """Markdown item on the limits that are not drawn; empty where all are."""
    robot = comparison.robot
    told = []
    for quantity in scene.QUANTITIES:
        for joint, name in enumerate(robot.joint_names):
            far = scene.axis_limits(comparison, quantity, joint).far
            if far:
                told.append(f"{quantity} of {name}: {far}")
    return f"- Too far off to be drawn: {'; '.join(told)}.\n" if told else ""


def _log_arm(
    recording: rr.RecordingStream, comparison: Comparison, look: Look, motion: Motion
) -> None:
    """Links, joints, tool, label and trail of one arm."""
    robot = comparison.robot
    resampled = motion.resample(POSE_RATE)
    t, q = resampled.t, resampled.q
    end = scene.longest_duration(comparison)
    if end > t[-1]:  # stay in the last pose to the end of the timeline
        t, q = np.append(t, end), np.vstack([q, q[-1:]])
    root = f"world/{look.style.name}"
    origins = scene.link_origins(robot, q)
    _log_link(recording, f"{root}/link_0", look, t, origins[:, 1] - origins[:, 0])
    for frame in range(1, robot.joint_count + 1):
        path = f"{root}/link_{frame}"
        rotations = scene.link_rotations(robot, q, frame)
        pose = rr.Transform3D.columns(
            translation=origins[:, frame], quaternion=_quaternions(rotations)
        )
        _columns(recording, path, t, pose)
        step = origins[:, frame + 1] - origins[:, frame]
        _log_link(recording, path, look, t, np.einsum("nij,ni->nj", rotations, step))
        joint = rr.Points3D([[0, 0, 0]], radii=1.4 * look.radius, colors=[_color(look)])
        _static(recording, f"{path}/joint", joint)
    tool = origins[:, -1]
    _columns(recording, f"{root}/tool", t, rr.Transform3D.columns(translation=tool))
    _log_tool(recording, f"{root}/tool", look)
    _log_trail(recording, f"{root}/trail", look, t, tool)


def _log_link(
    recording: rr.RecordingStream, path: str, look: Look, t: FloatArray, vectors: FloatArray
) -> None:
    """Capsule from the frame's origin along ``vectors`` [N,3] in that frame, to the next origin."""
    lengths = np.linalg.norm(vectors, axis=1)
    if lengths.max() < 1e-6:
        return
    fixed = np.ptp(vectors, axis=0).max() < 1e-9 * max(1.0, lengths.max())
    shape = rr.Capsules3D.from_fields(
        lengths=lengths[:1] if fixed else None,
        quaternions=_along_z(vectors[:1]) if fixed else None,
        radii=[look.radius],
        colors=[_color(look)],
        fill_mode="solid",
    )
    _static(recording, path, shape)
    if not fixed:  # a prismatic joint stretches it
        stretched = rr.Capsules3D.columns(lengths=lengths, quaternions=_along_z(vectors))
        _columns(recording, path, t, stretched)


def _log_tool(recording: rr.RecordingStream, path: str, look: Look) -> None:
    ball = rr.Points3D([[0, 0, 0]], radii=1.4 * look.radius, colors=[_color(look)])
    _static(recording, f"{path}/ball", ball)
    # all arms meet at their ends, so every label hangs at its own height
    label = rr.Points3D(
        [[0, 0, look.label_height]],
        radii=1e-3 * look.radius,
        colors=[_screen_color(look.style)],
        labels=[look.style.title],
        show_labels=True,
    )
    _static(recording, f"{path}/label", label)


def _log_trail(
    recording: rr.RecordingStream, path: str, look: Look, t: FloatArray, tool: FloatArray
) -> None:
    """A short strip a frame; the view shows those up to its time cursor."""
    radius = (0.2 if look.style.highlighted else 0.15) * look.radius
    style = rr.LineStrips3D.from_fields(radii=[radius], colors=[_screen_color(look.style)])
    _static(recording, path, style)
    strips = np.stack([tool[:-1], tool[1:]], axis=1).astype(np.float32)
    _columns(recording, path, t[1:], rr.LineStrips3D.columns(strips=strips))


def _log_curves(
    recording: rr.RecordingStream, robot: Robot, style: EntryStyle, motion: Motion
) -> None:
    kept = thinned(motion.t)
    for quantity in scene.QUANTITIES:
        for joint in range(robot.joint_count):
            path = joint_path(robot, quantity, joint, style.name)
            look = rr.SeriesLines.from_fields(
                names=[style.title],
                colors=[_screen_color(style)],
                widths=[2.5 if style.highlighted else 1.6],
            )
            _static(recording, path, look)
            values = getattr(motion, quantity)[kept, joint]
            values = values * scene.display_factor(robot, quantity, joint)
            _columns(recording, path, motion.t[kept], rr.Scalars.columns(scalars=values))


def thinned(t: FloatArray) -> np.ndarray:
    """Indices of evenly spread samples, with both sides of every jump and both ends among them."""
    step = max(CURVE_STEP, t[-1] / CURVE_POINTS)
    cell = np.floor(t / step + 1e-6)
    keep = np.append(True, np.diff(cell) > 0)
    jump = np.diff(t) <= 2 * JUMP_GAP
    keep[:-1] |= jump
    keep[1:] |= jump
    keep[-1] = True
    return np.flatnonzero(keep)


def _log_limits(recording: rr.RecordingStream, comparison: Comparison) -> None:
    """Dashed lines: rows without a value interrupt them."""
    robot = comparison.robot
    end = scene.longest_duration(comparison)
    if end == 0.0:
        return
    gap = 1e-6  # s after a dash, the row without a value
    edges = np.linspace(0.0, end - gap, 2 * DASHES)
    t = np.column_stack([edges[::2], edges[1::2], edges[1::2] + gap]).ravel()
    lengths = np.tile([1, 1, 0], DASHES)
    look = rr.SeriesLines.from_fields(names=["limit"], colors=[LIMIT_COLOR], widths=[1.2])
    for quantity in scene.QUANTITIES:
        for joint in range(robot.joint_count):
            limits = scene.axis_limits(comparison, quantity, joint)
            for leaf, value in (("limit_lower", limits.lower), ("limit_upper", limits.upper)):
                if value is None:
                    continue
                path = joint_path(robot, quantity, joint, leaf)
                _static(recording, path, look)
                values = np.full(2 * DASHES, value)
                dashes = rr.Scalars.columns(scalars=values).partition(lengths=lengths)
                _columns(recording, path, t, dashes)


def _log_marks(recording: rr.RecordingStream, style: EntryStyle, motion: Motion) -> None:
    marks = sorted(motion.marks, key=lambda mark: mark.time)
    if not marks:
        return
    texts = [f"{mark.name}: {style.title}" for mark in marks]
    columns = rr.TextLog.columns(
        text=texts, level=["INFO"] * len(marks), color=[_screen_color(style)] * len(marks)
    )
    _columns(recording, f"marks/{style.name}", np.array([mark.time for mark in marks]), columns)


def _color(look: Look) -> tuple[int, int, int, int]:
    return _screen_color(look.style, look.alpha)


def _screen_color(style: EntryStyle, alpha: int = 255) -> tuple[int, int, int, int]:
    red, green, blue, _ = style.rgba()
    red, green, blue = (round(v + BRIGHTER * (255 - v)) for v in (red, green, blue))
    return red, green, blue, alpha


def _quaternions(rotations: FloatArray) -> FloatArray:
    """Unit quaternions [N,4] (x, y, z, w) of rotation matrices [N,3,3].

    4 q q' is linear in the matrix, and every row of it is a multiple of q; the row with the
    largest diagonal entry is far from zero.
    """
    r = rotations
    square = np.empty((len(r), 4, 4))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        square[:, i, i] = 1 + r[:, i, i] - r[:, j, j] - r[:, k, k]
        square[:, i, j] = square[:, j, i] = r[:, i, j] + r[:, j, i]
        square[:, i, 3] = square[:, 3, i] = r[:, k, j] - r[:, j, k]
    square[:, 3, 3] = 1 + np.trace(r, axis1=1, axis2=2)
    best = np.diagonal(square, axis1=1, axis2=2).argmax(axis=1)
    rows = square[np.arange(len(r)), best]
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def _along_z(vectors: FloatArray) -> FloatArray:
    """Quaternions [N,4] (x, y, z, w) that turn the z axis into the directions of vectors [N,3]."""
    length = np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    x, y, z = (vectors / length).T
    turned = np.column_stack([-y, x, np.zeros_like(x), 1 + z])
    turned[z < -1 + 1e-9] = (1.0, 0.0, 0.0, 0.0)  # half a turn, about any level axis
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def _blueprint(comparison: Comparison) -> rrb.Blueprint:
    words = rrb.TextDocumentView(origin="comparison", name="comparison")
    marks = rrb.TextLogView(
        origin="marks", name="marks", columns=rrb.TextLogColumns(text_log_columns=["Body"])
    )
    below = rrb.Horizontal(words, marks, column_shares=[2.5, 1.0])
    left = rrb.Vertical(_space_view(comparison), below, row_shares=[2.2, 1.0])
    return rrb.Blueprint(
        rrb.Horizontal(left, _plot_views(comparison), column_shares=[1.15, 1.0]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            play_state="playing",
            loop_mode="all",
            playback_speed=0.5,
        ),
    )


def _space_view(comparison: Comparison) -> rrb.Spatial3DView:
    to_cursor = rrb.VisibleTimeRanges(
        timeline=TIMELINE,
        start=rrb.TimeRangeBoundary.infinite(),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    trails = [f"world/{look.style.name}/trail" for look, _ in _looks(comparison)]
    eye, target = _camera(comparison)
    return rrb.Spatial3DView(
        origin="world",
        name=comparison.robot.name,
        line_grid=rrb.LineGrid3D(visible=True, spacing=_grid_spacing(comparison.robot)),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0)
        ),
        overrides=dict.fromkeys(trails, to_cursor),
    )


def _camera(comparison: Comparison) -> tuple[FloatArray, FloatArray]:
    """Place and target of the eye [3], m: everything that moves, seen from the tool's side."""
    robot = comparison.robot
    positions = [motion.q for _, motion in scene.solved_entries(comparison)]
    points = scene.link_origins(robot, np.vstack([comparison.via_q, *positions])).reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    high[2] += max((look.label_height for look, _ in _looks(comparison)), default=0.0)
    middle = (low + high) / 2
    level = scene.link_origins(robot, comparison.via_q)[:, -1].mean(axis=0)[:2]
    angle = np.arctan2(level[1], level[0]) if np.linalg.norm(level) > 1e-6 else -np.pi / 4
    tilt = np.radians(22.0)
    towards_eye = np.array(
        [np.cos(tilt) * np.cos(angle), np.cos(tilt) * np.sin(angle), np.sin(tilt)]
    )
    return middle + EYE_DISTANCE * np.linalg.norm(high - low) * towards_eye, middle


def _grid_spacing(robot: Robot) -> float:
    """A power of ten or half of one, m, about an eighth of the reach."""
    wanted = scene.reach(robot) / 8
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(decade * (5.0 if wanted / decade >= 5 else 1.0))


def _plot_views(comparison: Comparison) -> rrb.Container:
    robot = comparison.robot
    joints = range(robot.joint_count)
    rows = {q: [_plot_view(comparison, q, joint) for joint in joints] for q in scene.QUANTITIES}
    if robot.joint_count > WIDE_ROBOT:
        tabs = [rrb.Grid(*views, grid_columns=2, name=q) for q, views in rows.items()]
        return rrb.Tabs(*tabs, active_tab=0)
    every = [view for views in rows.values() for view in views]
    return rrb.Grid(*every, grid_columns=robot.joint_count)


def _plot_view(comparison: Comparison, quantity: str, joint: int) -> rrb.TimeSeriesView:
    robot = comparison.robot
    limits = scene.axis_limits(comparison, quantity, joint)
    unit = scene.display_unit(robot, quantity, joint)
    name = f"{robot.joint_names[joint]} {quantity} [{unit}]"
    return rrb.TimeSeriesView(
        origin=joint_path(robot, quantity, joint),
        name=name,
        axis_y=rrb.ScalarAxis(range=limits.axis),
        plot_legend=rrb.PlotLegend(visible=False),  # the arms' labels show the colours
    )
