"""What can be recorded: a comparison, one motion."""

from __future__ import annotations

from microbot_ocp.certificate import Certificate
from microbot_ocp.comparison import Comparison, Entry
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Robot
from microbot_ocp.views import scene
from microbot_ocp.views.recording.actors import RATE, Actor, looks
from microbot_ocp.views.recording.recording import Recording
from microbot_ocp.views.style import entry_styles
from microbot_ocp.views.tables import comparison_markdown


def of_comparison(comparison: Comparison, rate: float = RATE) -> Recording:
    """Every motion on one timeline, the best one solid among ghosts."""
    styles = entry_styles(comparison)
    solved = scene.solved_entries(comparison)
    shown = looks(comparison.robot, [styles[entry.name] for entry, _ in solved])
    actors = [Actor.of(motion, look, rate) for (_, motion), look in zip(solved, shown, strict=True)]
    return Recording(
        robot=comparison.robot,
        limits=comparison.limits,
        actors=tuple(actors),
        via_q=comparison.via_q,
        summary=comparison_markdown(comparison),
    )


def of_motion(
    robot: Robot, motion: Motion, certificate: Certificate | None = None, rate: float = RATE
) -> Recording:
    """One motion under the robot's limits, as the arm ``motion``.

    Its ends, and the marks named "via ...", are the via points.
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
    return of_comparison(alone, rate)
