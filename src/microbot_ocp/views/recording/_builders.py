"""Recordings of comparisons, motions, cells, trackings and inverse kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.table import Table
from microbot_ocp.certificate import Certificate
from microbot_ocp.inverse_kinematics import IKSolution
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import Motion
from microbot_ocp.robot import JointLimits, Limits, Robot, transform_of
from microbot_ocp.scene import Scene, clearance, has_coal
from microbot_ocp.simulation import Tracking
from microbot_ocp.tasks import Cell, Comparison
from microbot_ocp.views._scene import display_factor, display_unit, solved_entries, tool_places
from microbot_ocp.views._solids import DrawnSurroundings
from microbot_ocp.views._style import FIXED, PREFERRED, SIDE_BY_SIDE, EntryStyle, entry_styles
from microbot_ocp.views.recording._animated_arm import drawn_rate, looks, moving_arm, standing_arm
from microbot_ocp.views.recording._limits import peak_table
from microbot_ocp.views.recording._recording import Recording
from microbot_ocp.views.recording._writer import BRANCH, TIME
from microbot_ocp.views.tables import narrow_table, solutions_table


def of_comparison(comparison: Comparison, rate: float | None = None) -> Recording:
    """Return a recording of all motions on one timeline; the best motion is solid among ghosts.

    ``rate`` (Hz) is the sampling rate, by default 200 Hz, or less so that there are at most 12,000
    samples.
    """
    styles, robot = entry_styles(comparison), comparison.robot
    solved = solved_entries(comparison)
    shown = looks(robot, [styles[entry.name] for entry, _ in solved])
    family = LimitFamily.of(robot, comparison.limits)
    rate, thinned = drawn_rate(rate, [motion for _, motion in solved])
    summary = narrow_table(comparison).without("solve")
    return Recording(
        title=f"{robot.name}, {len(comparison.entries)} methods",
        robot=robot,
        limits=comparison.limits,
        arms=tuple(
            moving_arm(motion, look, rate, family)
            for (_, motion), look in zip(solved, shown, strict=True)
        ),
        places=tool_places(robot, comparison.via_q),
        place_names=_via_names(len(comparison.via_q)),
        summary=replace(summary, notes=[*summary.notes, thinned]),
    )


def of_motion(
    robot: Robot,
    motion: Motion,
    certificate: Certificate | None = None,
    rate: float | None = None,
    scene: Scene | None = None,
) -> Recording:
    """Return a recording of one motion under the robot's limits, as the arm ``motion``.

    The ends of the motion, and its marks named "via ...", are marked in space. A scene adds its
    obstacles, the capsules of the arm, and the line between the closest points with its length.
    """
    checks.joints("motion", motion.joint_count, robot)
    inner = sorted(
        m.time for m in motion.marks if m.name.startswith("via") and 0.0 < m.time < motion.duration
    )
    via_q = motion.sample([0.0, *inner, motion.duration]).q
    (look,) = looks(robot, [_solid("motion", "")])
    rate, thinned = drawn_rate(rate, [motion])
    arm = moving_arm(motion, look, rate, LimitFamily.of(robot))
    title = f"{robot.name}: {motion.label}"
    sentences = [
        "" if motion.solved else f"Not solved: {motion.status}.",
        "Not certified." if certificate is None else certificate.verdict,
        motion.note,
        thinned,
    ]
    if scene is not None and certificate is None and has_coal():
        sentence = clearance(robot, motion, scene).sentence
        sentences.append(f"{sentence[0].upper()}{sentence[1:]}.")
    table = Table.of_text(*peak_table(arm))
    return Recording(
        title=title,
        robot=robot,
        limits=robot.limits,
        arms=(arm,),
        places=tool_places(robot, via_q),
        place_names=_via_names(len(via_q)) if inner else ("start", "end"),
        around=DrawnSurroundings.of_scene(robot, scene),
        summary=replace(table, title=f"{title}, {motion.duration:.3f} s", notes=sentences),
    )


def of_cell(cell: Cell, rate: float | None = None) -> Recording:
    """Return a recording of a motion through stops, with tubes of tool lines and carried parts.

    Raises
    ------
    InputError
        A motion of another task.
    """
    plain = of_motion(cell.robot, cell.motion, cell.certificate, rate, cell.scene)
    (arm,), stops = plain.arms, cell.task.stops
    if cell.task.cycle:  # the last stop repeats the first
        stops = stops[:-1]
    return replace(
        plain,
        around=DrawnSurroundings.of_cell(cell, arm.times[TIME], arm.q),
        places=np.array([stop.pose(cell.robot)[0] for stop in stops]),
        place_names=tuple(stop.name for stop in stops),
    )


def of_tracking(
    robot: Robot,
    tracking: Tracking,
    limits: Limits | JointLimits | None = None,
    rate: float | None = None,
) -> Recording:
    """Return a recording of a controlled arm ``actual`` and its reference, the ghost ``desired``.

    ``limits`` are the limits of the drives (default ``robot.limits``).

    Raises
    ------
    InputError
        The simulation did not reach its end, or belongs to another robot.
    """
    checks.joints("tracking", tracking.q.shape[1], robot)
    motion = tracking.as_motion(tracking.label or "actual")
    reference = tracking.reference
    desired = Motion(motion.t, *reference, np.zeros_like(reference.q), "desired")
    ghost_look, look = looks(robot, [_ghost("desired", "desired"), _solid("actual", "actual")])
    family = LimitFamily.of(robot, limits)
    rate, thinned = drawn_rate(rate, [desired, motion])
    ghost, actual = moving_arm(desired, ghost_look, rate), moving_arm(motion, look, rate, family)
    heads, rows = peak_table(actual)
    for joint, row in enumerate(rows):
        factor, unit = (f(robot, "error", joint) for f in (display_factor, display_unit))
        row += [f"{factor * values[joint]:.3g} {unit}" for values in (tracking.rms, tracking.peak)]
    rate_text = "continuous" if tracking.sample_rate is None else f"{tracking.sample_rate:g} Hz"
    title = f"{robot.name}: {motion.label}, {rate_text}"
    saturated = f"A torque at its limit for {100 * tracking.saturated_fraction:.3g} % of the time."
    return Recording(
        title=title,
        robot=robot,
        limits=family.robot.limits,
        arms=(
            replace(ghost, curves={key: ghost.curves[key] for key in ("q", "qd")}),
            replace(actual, curves={**actual.curves, "error": ghost.q - actual.q}),
        ),
        places=tool_places(robot, desired.q[[0, -1]]),
        place_names=("start", "end"),
        summary=replace(
            Table.of_text([*heads, "RMS error", "peak error"], rows),
            title=f"{title}, {motion.duration:.3f} s",
            notes=[saturated, tracking.advice, thinned],
        ),
        quantities=("q", "error", "tau"),
    )


def of_branches(
    robot: Robot,
    solutions: Sequence[IKSolution],
    position: FloatArray,
    orientation: FloatArray | None = None,
) -> Recording:
    """Return a recording of solutions of the inverse kinematics.

    Every solution is a ghost; the arm ``solution`` takes them one after the other. ``position`` [3]
    (m) and ``orientation`` [3,3] are the target.
    """
    if not solutions:
        raise InputError("solutions must hold at least one IKSolution, not none")
    checks.joints("solutions", len(solutions[0].q), robot)
    q = np.array([solution.q for solution in solutions])
    styles = [_ghost(f"branch_{k}", "") for k in range(1, len(q) + 1)]
    shown = looks(robot, [*styles, _solid("solution", "")])
    ghosts = [standing_arm(q[k : k + 1], look) for k, look in enumerate(shown[:-1])]
    turned, named = orientation is not None, robot.joint_count <= SIDE_BY_SIDE
    table = solutions_table(robot, solutions, turned=turned, named=named)
    pairs = zip(table.rows, solutions, strict=True)
    rows = [[str(k), *row, s.status] for k, (row, s) in enumerate(pairs, 1)]
    place = ", ".join(f"{value:.4g}" for value in position)
    title = f"{robot.name}: inverse kinematics to ({place}) m"
    return Recording(
        title=title,
        robot=robot,
        limits=robot.limits,
        arms=(*ghosts, standing_arm(q, shown[-1])),
        places=np.array([position], dtype=float),
        place_names=("target",),
        summary=replace(
            Table.of_text(["branch", *table.heads, "status"], rows),
            title=title,
            notes=list(dict.fromkeys([table.title, *(s.advice for s in solutions)])),
        ),
        target=None if orientation is None else transform_of(orientation, position),
        quantities=(),
        timeline=BRANCH,
    )


def _solid(name: str, title: str) -> EntryStyle:
    return EntryStyle(name, title, *FIXED[PREFERRED], highlighted=True)


def _ghost(name: str, title: str) -> EntryStyle:
    return EntryStyle(name, title, FIXED["cubic"][0], "solid", highlighted=False)


def _via_names(count: int) -> tuple[str, ...]:
    return tuple(f"via {k}" for k in range(1, count + 1))
