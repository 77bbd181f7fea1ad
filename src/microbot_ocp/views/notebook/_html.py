"""What Jupyter shows of results: small tables that follow a light or dark theme."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from microbot_ocp.comparison import Certificate, Comparison
from microbot_ocp.limits import QUANTITY_NAMES
from microbot_ocp.motion import Motion
from microbot_ocp.ocp import OCPCertificate, Refined, Solution
from microbot_ocp.robot import Robot
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.tables import narrow_table, note_sentences

BAR = 8.0  # em, of a ratio of 1


def robot(robot: Robot) -> str:
    """DH table with masses and limits."""
    heads = ["joint", "type", "alpha [deg]", "a [m]", "d [m]", "offset [deg]"]
    if robot.has_dynamics:
        heads.append("mass [kg]")
    limited = [q for q in QUANTITY_NAMES if np.isfinite(robot.limits.bounds(q)).any()]
    heads += [f"{QUANTITY_NAMES[q]} limits" for q in limited]
    rows = []
    for j, name in enumerate(robot.joint_names):
        degrees = np.degrees([robot.alpha[j], robot.theta_offset[j]])
        row = [name, robot.joint_types[j], f"{degrees[0]:.4g}", f"{robot.a[j]:.4g}"]
        row += [f"{robot.d[j]:.4g}", f"{degrees[1]:.4g}"]
        if robot.has_dynamics:
            row.append(f"{robot.links[j].mass:.4g}")
        rows.append([*row, *(_limits(robot, q, j) for q in limited)])
    told = [robot.description, f"{scene.reach(robot):.4g} m stretched out"]
    return _page(repr(robot), _table(heads, rows), told)


def motion(motion: Motion) -> str:
    """Duration, status and the range of every joint."""
    heads = ["joint", "q from", "q to", "peak |qd|", "peak |qdd|", "peak |tau|"]
    peaks = [np.abs(v).max(axis=0) for v in (motion.qd, motion.qdd, motion.tau)]
    rows = [
        [str(j + 1), *(f"{round(value, 9) + 0.0:.4g}" for value in motion.q[[0, -1], j]),
         *(f"{peak[j]:.4g}" for peak in peaks)]
        for j in range(motion.joint_count)
    ]  # fmt: skip
    marks = ", ".join(f"{mark.name} at {mark.time:.4g} s" for mark in motion.marks)
    return _page(repr(motion), _table(heads, rows), [motion.note, marks, "SI and radians"])


def comparison(comparison: Comparison) -> str:
    """The table of methods with a bar for each ratio."""
    heads, rows = narrow_table(comparison)
    at = heads.index("ratio")
    cells = [[escape(cell) for cell in row] for row in rows]
    for row in cells:
        row[at] = _bar(row[at])
    return _page(repr(comparison), _table(heads, cells, escaped=True), note_sentences(comparison))


def certificate(certificate: Certificate) -> str:
    """The verdict and the worst use of every kind of limit."""
    heads = ["limit", "worst use [%]", "joint", "at [s]", "value", "limit", "excess [%]"]
    rows = [
        [QUANTITY_NAMES[check.quantity], f"{100 * np.nanmax(check.utilisation):.2f}", check.joint,
         f"{check.time:.4g}", f"{check.value:.5g} {check.unit}", f"{check.limit:.5g}",
         f"{100 * check.violation:.2g}"]
        for check in certificate.limit_checks
    ]  # fmt: skip
    again = (
        f"re-simulation: {certificate.resimulation_status}, "
        f"ends {certificate.final_position_error:.2g} rad away"
    )
    return _page(repr(certificate), _table(heads, rows), [certificate.verdict, again])


def solution(solution: Solution) -> str:
    """How every solver fared, and what is in every phase."""
    heads = ["solver", "status", "iterations", "cost", "infeasibility", "time [s]"]
    rows = [
        [a.solver, str(a.status), str(a.iterations), f"{a.cost:.8g}", f"{a.infeasibility:.1e}",
         f"{a.wall_time:.3f}"]
        for a in solution.attempts
    ]  # fmt: skip
    advice = [] if solution.status.solved else solution.advice.splitlines()
    told = [repr(phase).strip("<>") for phase in solution.phases]
    return _page(repr(solution), _table(heads, rows), [*advice, *told])


def refined(refined: Refined) -> str:
    """The history of the meshes."""
    lines = str(refined.history).splitlines()
    heads, *rows = (re.split(r" {2,}", line.strip()) for line in lines)
    return _page(repr(refined), _table(heads, rows), [refined.advice])


def ocp_certificate(certificate: OCPCertificate) -> str:
    """The conditions of an optimum, the worst limit, and what acts when."""
    conditions = certificate.optimality
    rows = [
        [name, f"{residual.value:.1e} {residual.unit}", residual.where]
        for name, residual in (
            ("stationarity", conditions.stationarity),
            ("feasibility", conditions.feasibility),
            ("complementarity", conditions.complementarity),
            ("sign", conditions.sign),
        )
    ]
    rows += [
        [f"re-simulation of {check.phase}", f"{check.error:.1e} relative", check.status]
        for check in certificate.resimulations
    ]
    rows += [
        [f"Hamiltonian of {h.phase}", f"{h.mean:.6g}", f"drift {h.drift:.1e}"]
        for h in certificate.hamiltonians
    ]
    told = [certificate.verdict]
    told += [
        f"{arc.start:.4g} to {arc.end:.4g} s: {arc.kind} {arc.name} at its {arc.side} limit"
        for arc in certificate.arcs
    ]
    return _page(repr(certificate), _table(["check", "value", "where"], rows), told)


def _limits(robot: Robot, quantity: str, joint: int) -> str:
    factor = scene.display_factor(robot, quantity, joint)
    low, high = (float(bound[joint]) * factor for bound in robot.limits.bounds(quantity))
    if not np.isfinite([low, high]).any():
        return "none"
    unit = scene.display_unit(robot, quantity, joint)
    return f"±{high:.4g} {unit}" if low == -high else f"{low:.4g} to {high:.4g} {unit}"


def _bar(text: str) -> str:
    try:
        width = min(BAR * float(text), 4 * BAR)
    except ValueError:  # a method without a motion
        return text
    style = f"display:inline-block;width:{width:.2f}em;height:.7em;background:#D55E00;opacity:.75"
    return f'{text} <span style="{style}"></span>'


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]], *, escaped: bool = False) -> str:
    plain = (lambda text: text) if escaped else escape
    cell = "padding:.15em .7em;text-align:left"
    head = "".join(f'<th style="{cell}">{escape(text)}</th>' for text in heads)
    body = "".join(
        "<tr>" + "".join(f'<td style="{cell}">{plain(text)}</td>' for text in row) + "</tr>"
        for row in rows
    )
    look = "color:inherit;font-size:inherit;border-collapse:collapse"
    return f'<table style="{look}"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'


def _page(title: str, table: str, sentences: Iterable[str]) -> str:
    lines = [text for text in sentences if text]
    told = "".join(f'<div style="font-size:90%">{escape(line)}</div>' for line in lines)
    return f"<div><b>{escape(title)}</b>{table}{told}</div>"
