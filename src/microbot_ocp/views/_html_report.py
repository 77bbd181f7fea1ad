"""Reports in one HTML file for readers without Python: text, film, table, figures, certificates.

The file contains everything, loads nothing, and follows a light or dark theme.
"""

from __future__ import annotations

import base64
import io
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import date
from html import escape
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from microbot_ocp._base.checks import InputError
from microbot_ocp._base.showing import view_for
from microbot_ocp._base.table import Table
from microbot_ocp._base.writing import write_whole
from microbot_ocp.certificate import Certificate
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Robot
from microbot_ocp.tasks import Cell, Comparison, controller_duration
from microbot_ocp.views.plots import figure_of
from microbot_ocp.views.tables import comparison_table

DPI = 110  # resolution of figures, dots per inch
RATE = 12.0  # frame rate of the film, Hz; the file stays small enough for mail


def comparison_report(comparison: Comparison, path: str | Path) -> Path:
    """Write a comparison as one HTML file, with a film of its fastest motion."""
    robot, reference = comparison.robot, comparison.reference
    times = {name: motion.duration for name, motion in comparison.motions.items()}
    proofs = comparison.certificates.items()
    certified = [name for name, proof in proofs if proof.ok and comparison.motions[name].solved]
    sentences = [
        f"The arm {robot.name} goes through {len(comparison.via_q)} poses, from rest to rest."
    ]
    if best := min(certified, key=times.__getitem__, default=None):
        title = comparison[best].title
        sentences.append(f"The fastest certified motion takes {times[best]:.3f} s ({title}).")
        if reference in times and reference != best:
            usual, saved = comparison[reference].title, 1.0 - times[best] / times[reference]
            sentences.append(
                f"The fastest textbook motion ({usual}) takes {times[reference]:.3f} s under the "
                f"same limits, so {100 * saved:.0f} % of its time is saved."
            )
    else:
        sentences.append("No motion is both solved and certified.")
    film = _film(lambda to: comparison.export(to, RATE)) if times else ""
    verdicts = [
        (entry.title, entry.certificate.verdict if entry.certificate else entry.note)
        for entry in comparison.entries
    ]
    sections = {
        "Fastest motion (solid) and fastest textbook motion (transparent)": film,
        "All methods": comparison_table(comparison)._repr_html_(),
        "Position, velocity and torque": _figure(comparison.plot(), "Curves over time"),
        "Tool paths": _figure(comparison.plot_paths(), "Tool paths in space"),
        "Verification": _verdicts(verdicts),
    }
    return _write_page(f"{robot.name}: the same task by every method", sentences, sections, path)


def cell_report(cell: Cell, path: str | Path) -> Path:
    """Write a cell as one HTML file: duration, parts per hour, stops, film, curves, certificate."""
    motion, robot = cell.motion, cell.robot
    sentences = [f"The arm {robot.name} takes {motion.duration:.3f} s for the task."]
    if not motion.solved:
        sentences = [
            f"The task is not solved for the arm {robot.name} ({motion.status}): the best motion "
            f"found takes {motion.duration:.3f} s, and a much faster motion may exist."
        ]
    cycles = [motion.duration]
    if motion.solved:  # an unsolved motion is no basis for a comparison
        try:
            usual = controller_duration(cell.task, motion)
        except InputError as problem:
            sentences.append(f"A comparison with a controller's moves is not possible: {problem}.")
        else:
            cycles.append(usual)
            saved = 100.0 * (1.0 - motion.duration / usual)
            change = "saved" if saved >= 0.0 else "lost"
            saving = f"{abs(saved):.0f} % of that time is {change}"
            moves = (
                "synchronous joint moves of limited jerk from rest to rest"
                if cell.task.family.jerk_matters
                else "synchronous trapezoidal joint moves, blended at stops without rest"
            )
            sentences.append(
                f"The moves of a standard controller through these stops ({moves}; tool lines from "
                f"rest to rest) take {usual:.3f} s at best under the same limits"
                f"{', without regard to obstacles' * bool(cell.scene)}, so {saving}."
            )
    if cell.task.cycle and motion.solved:
        parts, *usual = (f"{3600.0 / duration:.0f}" for duration in cycles)
        against = "".join(f", compared with {each} by the controller's moves" for each in usual)
        sentences.append(f"Repeated, this gives {parts} parts per hour{against}.")
    carried = [f"{load.mass:g}" for load in cell.task.payloads]
    stops = [
        [mark.name, f"{mark.time:.3f}", f"{dwell:g}", load]
        for mark, dwell, load in zip(motion.marks, cell.task.dwells, [*carried, ""], strict=True)
    ]
    head = ["stop", "reached [s]", "rest [s]", "payload afterwards [kg]"]
    sections = {
        "The motion": _film(lambda to: cell.export(to, RATE)),
        "Stops": Table.of_text(head, stops)._repr_html_(),
        "Curves and limits": _figure(cell.plot(), "Curves over time"),
        "Verification": _verdicts([("certificate", cell.certificate.verdict)]),
    }
    return _write_page(f"{robot.name}: a cell", sentences, sections, path)


def certificate_report(
    certificate: Certificate, robot: Robot, motion: Motion, path: str | Path
) -> Path:
    """Write a certificate as one HTML file: verdict, table, curves of the motion."""
    verdict = "keeps every limit" if certificate.ok else "does not keep every limit"
    sentence = f"The motion of the arm {robot.name}, {motion.duration:.3f} s long, {verdict}."
    table = replace(view_for(certificate, "table")(certificate), title="", notes=())
    sections = {
        "The motion": _film(lambda to: motion.export(to, RATE, robot)),
        "Certificate": escape(certificate.verdict),
        "Limits": table._repr_html_(),
        "Curves and limits": _figure(motion.plot(robot), "Curves over time"),
    }
    return _write_page(f"{robot.name}: check of {motion.label}", [sentence], sections, path)


def _verdicts(verdicts: Sequence[tuple[str, str]]) -> str:
    rows = (f"<dt><b>{escape(name)}</b></dt><dd>{escape(text)}</dd>" for name, text in verdicts)
    return (
        "<p>Every motion was simulated again from its torques, with equations that are independent "
        "of the planner, and every limit was checked between the samples, too.</p>"
        f"<dl>{''.join(rows)}</dl>"
    )


def _figure(axes: Any, text: str) -> str:
    stream = io.BytesIO()
    figure_of(axes).savefig(stream, format="png", dpi=DPI)
    return _image("png", stream.getvalue(), text, "figure")


def _film(write: Callable[[Path], object]) -> str:
    with tempfile.TemporaryDirectory(prefix="microbot_ocp_") as folder:
        path = Path(folder) / "film.gif"
        write(path)
        return _image("gif", path.read_bytes(), "The arm as it moves")


def _image(kind: str, data: bytes, text: str, look: str = "film") -> str:
    source = base64.b64encode(data).decode("ascii")
    return f'<img class="{look}" alt="{escape(text)}" src="data:image/{kind};base64,{source}">'


def _write_page(
    title: str, sentences: Iterable[str], sections: Mapping[str, str], path: str | Path
) -> Path:
    """Write the page: sentences and sections; a section without content is left out."""
    parts = [f"<p>{escape(' '.join(sentences))}</p>"]
    for heading, content in sections.items():
        if content:
            name = escape(heading)
            # A region with tabindex can be scrolled with the keyboard.
            box = f'<div class="wide" role="region" aria-label="{name}" tabindex="0">'
            parts.append(f"<h2>{name}</h2>\n{box}{content}</div>")
    origin = f"microbot_ocp {version('microbot_ocp')}, {date.today().isoformat()}"
    page = Template((files("microbot_ocp.views") / "_html_report.html").read_text("utf-8"))
    texts = {"title": escape(title), "body": "\n".join(parts), "origin": escape(origin)}
    return write_whole(path, page.substitute(texts))
