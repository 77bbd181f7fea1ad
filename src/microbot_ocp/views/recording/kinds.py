"""What can be recorded: a comparison, one motion."""

from __future__ import annotations

from microbot_ocp.certificate import Certificate
from microbot_ocp.checks import FloatArray
from microbot_ocp.comparison import Comparison
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Robot
from microbot_ocp.views import scene
from microbot_ocp.views.recording import words
from microbot_ocp.views.recording.actors import RATE, Actor, looks
from microbot_ocp.views.recording.recording import Recording
from microbot_ocp.views.style import FIXED, PREFERRED, EntryStyle, entry_styles
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
        via_names=_via_names(comparison.via_q),
    )


def of_motion(
    robot: Robot, motion: Motion, certificate: Certificate | None = None, rate: float = RATE
) -> Recording:
    """One motion under the robot's limits, as the arm ``motion``.

    Its ends, and the marks named "via ...", are marked in space.
    """
    inner = sorted(
        m.time for m in motion.marks if m.name.startswith("via") and 0.0 < m.time < motion.duration
    )
    via_q = motion.sample([0.0, *inner, motion.duration]).q
    (look,) = looks(robot, [_foreground("motion", "")])
    actor = Actor.of(motion, look, rate)
    values = {quantity: actor.values(quantity) for quantity in words.SHARES}
    status = str(motion.provenance.get("status", "solved")).replace("_", " ")
    sentences = [
        "" if motion.solved else f"Not solved: {status}.",
        "Not certified." if certificate is None else certificate.verdict,
        motion.note,
    ]
    return Recording(
        robot=robot,
        limits=robot.limits,
        actors=(actor,),
        via_q=via_q,
        summary=words.document(
            f"{robot.name}: {motion.label}, {motion.duration:.3f} s",
            words.table(*words.peaks(robot, robot.limits, values)),
            [sentence for sentence in sentences if sentence],
        ),
        via_names=_via_names(via_q) if inner else ("start", "end"),
    )


def _foreground(name: str, title: str) -> EntryStyle:
    """The style of an arm that has the scene, or the foreground, to itself."""
    color, line = FIXED[PREFERRED]
    return EntryStyle(name, title, color, line, highlighted=True)


def _via_names(via_q: FloatArray) -> tuple[str, ...]:
    return tuple(f"via {k}" for k in range(1, len(via_q) + 1))
