"""Tables of robots, motions, certificates, solutions and sweeps for Jupyter."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from microbot_ocp._base.growth import growth_said
from microbot_ocp._base.table import Column, Table
from microbot_ocp.certificate import Certificate
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import Motion
from microbot_ocp.ocp import OCPCertificate, Solution
from microbot_ocp.robot import Robot, load_robot, packaged_robots
from microbot_ocp.sweeps import Quartiles, Sweep, SweepSummary
from microbot_ocp.views import _scene as scene
from microbot_ocp.views._style import method_title
from microbot_ocp.views.tables._terminal import dh_table, following


def robot(robot: Robot) -> Table:
    """Return the DH table with masses and limits."""
    table = dh_table(robot)
    columns, cells = list(table.columns), list(zip(*table.rows, strict=True))
    if robot.has_dynamics:
        columns.append(Column("mass", "kg", ".4g"))
        cells.append(tuple(link.mass for link in robot.links))
    notes = ["Modified DH (Craig): alpha and a of a row come before its joint"]
    notes += [*following(robot), robot.description, f"{scene.reach(robot):.4g} m stretched out"]
    for member in LimitFamily.of(robot):
        texts = scene.limit_texts(robot, member.key)
        if scene.of_joints(robot, member.key):
            columns.append(Column(f"{member.name} limits"))
            of_joint = dict(zip(robot.joint_names, texts, strict=True))
            names = robot.chain.joint_names
            cells.append(tuple(of_joint.get(name, "follows") or "none" for name in names))
        else:
            notes.append(f"{member.name}: {', '.join(texts)}")
    return _table(robot, columns, zip(*cells, strict=True), notes)


def motion(motion: Motion) -> Table:
    """Return the table of the ends and peaks of every joint."""
    heads = ("q from", "q to", "peak |qd|", "peak |qdd|", "peak |tau|")
    columns = [Column("joint", left=True), *(Column(head, show=".4g") for head in heads)]
    ends = np.round(motion.q[[0, -1]], 9) + 0.0  # no -0
    peaks = [np.abs(values).max(axis=0) for values in (motion.qd, motion.qdd, motion.tau)]
    rows = zip(_joint_names(motion), *ends, *peaks, strict=True)
    marks = ", ".join(f"{mark.name} at {mark.time:.4g} s" for mark in motion.marks)
    return _table(motion, columns, rows, [motion.note, marks, "SI and radians"])


def _joint_names(motion: Motion) -> Sequence[object]:
    """Return the joint names of the packaged robot of a motion, or else numbers from 1."""
    name = motion.provenance.get("robot")
    names = load_robot(name).joint_names if name in packaged_robots() else ()
    return names if len(names) == motion.joint_count else range(1, motion.joint_count + 1)


def certificate(certificate: Certificate) -> Table:
    """Return the verdict and the worst use of every kind of limit."""
    columns = (
        Column("limit", left=True),
        Column("worst use", "%", ".2f"),
        Column("joint", left=True),
        Column("at", "s", ".4g"),
        Column("value", show=".5g"),
        Column("limit", show=".5g"),
        Column("unit", left=True),
        Column("excess", "%", ".2g"),
    )
    rows: list[tuple[Any, ...]] = [
        (check.name, 100 * np.nanmax(check.utilisation), check.joint,
         check.time, check.value, check.limit, check.unit, 100 * check.violation)
        for check in certificate.limit_checks
    ]  # fmt: skip
    if (near := certificate.clearance) is not None:
        # The excess is NaN: a wanted clearance of 0 has no relative excess.
        use = 100 * near.wanted / near.minimum if near.minimum > 0 else np.inf
        proof = "clearance, proved" if near.proved else "clearance, not proved"
        rows.append((proof, use, near.pair, near.time, near.minimum, near.wanted, "m", np.nan))
    again = (
        f"re-simulation: {certificate.resimulation_status}, {certificate.segments} segments with "
        f"defects up to {certificate.defect:.1g} of the torque; over the whole time errors grow "
        f"up to {growth_said(certificate.amplification)}"
    )
    return _table(
        certificate, columns, rows, [certificate.verdict, *[again] * (certificate.segments > 0)]
    )


def solution(solution: Solution) -> Table:
    """Return the table of the solvers' attempts, with advice and phases as notes."""
    columns = (
        Column("solver", left=True),
        Column("status", left=True),
        Column("iterations"),
        Column("cost", show=".8g"),
        Column("infeasibility", show=".1e"),
        Column("time", "s", ".3f"),
    )
    rows = [
        (a.solver, a.status, a.iterations, a.cost, a.infeasibility, a.wall_time)
        for a in solution.attempts
    ]
    advice = [
        row.sentence for row in solution.rows if row.kind == "remark" or not solution.status.solved
    ]
    phases = [repr(phase).strip("<>") for phase in solution.phases]
    return _table(solution, columns, rows, [*advice, *phases])


def ocp_certificate(certificate: OCPCertificate) -> Table:
    """Return the table of optimality conditions, re-simulations, Hamiltonians; arcs as notes."""
    names = ("stationarity", "feasibility", "complementarity", "sign")
    residuals = [getattr(certificate.optimality, name) for name in names]
    gap = certificate.optimality.gap
    rows = [
        ("gap", f"{gap.total:.1e} cost", f"{gap.slack:.1e} of it at limits"),
        *((n, f"{r.value:.1e} {r.unit}", r.where) for n, r in zip(names, residuals, strict=True)),
        *((f"re-simulation of {check.phase}", f"{check.error:.1e} relative",
           f"{check.status}, growth {check.amplification:.2g}")
          for check in certificate.resimulations),
        *((f"Hamiltonian of {h.phase}", f"{h.mean:.6g}", f"drift {h.drift:.1e}")
          for h in certificate.hamiltonians),
    ]  # fmt: skip
    arcs = [
        f"{arc.start:.4g} to {arc.end:.4g} s: {arc.kind} {arc.name} at its {arc.side} limit"
        for arc in certificate.arcs
    ]
    columns = [Column(head, left=True) for head in ("check", "value", "where")]
    return _table(certificate, columns, rows, [certificate.verdict, *arcs])


def _table(
    result: object, columns: Sequence[Column], rows: Iterable[Sequence[Any]], notes: Sequence[str]
) -> Table:
    return Table(columns, list(rows), repr(result), [note for note in notes if note])


def sweep(results: Sweep) -> Table:
    """Return medians and quartiles of the durations and of the time saved by the best method."""
    summary = results.summary()
    columns = (
        Column("method", left=True),
        Column("solved"),
        Column("certified"),
        Column("duration: median", "s", ".3f"),
        Column("quartiles", "s"),
        Column("time saved: median", "%", ".1f"),
        Column("quartiles", "%"),
        Column("cases"),
    )
    rows = []
    for method in results.methods:
        duration, saving = summary.durations[method], summary.savings.get(method)
        saved = (None, None, None)
        if saving:
            saved = 100 * saving.median, _span(saving, 100.0, ".1f"), saving.count
        times = duration.median, _span(duration, 1.0, ".3f")
        counts = summary.solved[method], summary.certified[method]
        rows.append((method_title(method), *counts, *times, *saved))
    title = f"{summary.done:,} of {summary.count:,} cases on {results.about['robot']}"
    return Table(columns, rows, title, _sweep_notes(results, summary))


def _sweep_notes(results: Sweep, summary: SweepSummary) -> list[str]:
    notes = [f"Time saved by: {method_title(summary.best)}, where both are solved."]
    decides = sorted(summary.decides.items(), key=lambda pair: -pair[1])
    if decides:
        shares = ", ".join(
            f"{scene.limit_title(name, results.about['joints'])} {100 * share:.1f} % "
            f"({100 * summary.at_limit[name]:.1f} %)"
            for name, share in decides
        )
        notes.append(
            "Quantity at its limit longest, share of the solved cases (mean share of the time at "
            f"the limit): {shares}."
        )
    if summary.failures:
        several = [f"{f.status} {f.count:,} (first: case {f.case})" for f in summary.failures[:4]]
        rest = sum(f.count for f in summary.failures[4:])
        notes.append(f"Not solved: {', '.join(several)}{f', others {rest:,}' if rest else ''}.")
    time = summary.case_time
    if time.count:
        notes.append(f"Wall time of a case: median {time.median:.3g} s.")
    if summary.not_compiled and "time_optimal" in results.methods:
        notes.append(f"Not compiled, on CasADi's virtual machine: {summary.not_compiled:,} cases.")
    return notes


def _span(values: Quartiles, scale: float, show: str) -> str | None:
    if not values.count:
        return None
    return f"{scale * values.lower:{show}} to {scale * values.upper:{show}}"
