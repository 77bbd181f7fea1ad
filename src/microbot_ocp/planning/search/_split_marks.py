"""Where the meshes of free motions are split, and where a finer mesh is dense."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp import PhaseSolution, Solution
from microbot_ocp.planning.free import limited_rates
from microbot_ocp.planning.search._search import MotionSearch
from microbot_ocp.planning.search._settings import SEARCH
from microbot_ocp.planning.task import dry_friction, rate_switches, reversals

TINY = 1e-12


def switch_marks(search: MotionSearch, solution: Solution) -> list[np.ndarray]:
    """Return intervals in which a velocity goes through more than half of its limit at once, or a
    limited jerk or torque rate switches.

    The arm could reach the velocity in far less time than the mesh lets it. With limits of a rate
    so it is with accelerations and torques: half an interval is lost at rest and at every switch,
    1 % of the motions of a Panda on 60 even intervals.
    """
    family = search.problem.family
    robot, rated = family.robot, limited_rates(family)
    marks = []
    for phase in solution.phases:
        q, qd, qdd = (phase[key] for key in ("q", "qd", "qdd"))
        passed = {"qd": qd}
        rates = {"qddd": np.diff(qdd, axis=0) / np.diff(phase.t)[:, None]}
        if rated:
            passed["qdd"] = qdd
        if rated and robot.has_dynamics:
            passed["tau"] = robot.torques_along(q, qd, qdd)["tau"]
        if "taud" in rated:
            middle = (0.5 * (x[:-1] + x[1:]) for x in (q, qd, qdd))
            rates["taud"] = robot.torques_along(*middle, rates["qddd"])["taud"]
        rows = np.zeros(len(rates["qddd"]), dtype=bool)
        for key, values in passed.items():
            limit = np.maximum(*(np.abs(b) for b in robot.limits.bounds(key)))
            limit = np.where(limit > 0, limit, np.inf)
            rows |= (np.abs(np.diff(values, axis=0)) > 0.5 * limit).any(axis=1)
        for key in rated:
            rows |= rate_switches(rates[key], family[key])
        marks.append(rows)
    return marks


def friction_marks(search: MotionSearch, solution: Solution) -> list[np.ndarray]:
    """Give intervals inside which a joint with dry friction turns back, or a limit is exceeded."""
    marked, dry = [], dry_friction(search.problem.family.robot) > 0.0
    for phase, excess in zip(solution.phases, search.problem.excess(solution), strict=True):
        turns = reversals(phase["qd"], dry)
        steps = np.diff(phase.mesh)
        # the window is as long as the longest of them
        turns &= steps > 0.6 * steps[turns].max(initial=0.0)
        marked.append(turns[:, None] | (excess > search.settings.limit_tolerance))
    return marked


def graded(phase: PhaseSolution, count: int) -> FloatArray:
    """Give mesh [count+1] of a phase: evenly spread, and with it where its accelerations change."""
    steps, change = np.diff(phase.mesh), np.abs(np.diff(phase["qdd"], axis=0))
    change = (change / np.maximum(np.abs(phase["qdd"]).max(axis=0), TINY)).max(axis=1)
    slope = np.pad(change / steps, 1)
    # a change may be anywhere in the interval, or begin in the one beside it
    weight = steps * np.maximum(slope[1:-1], 0.5 * np.maximum(slope[:-2], slope[2:]))
    density = (1.0 - SEARCH.graded) * steps + SEARCH.graded * weight / max(weight.sum(), TINY)
    reached = np.concatenate([[0.0], np.cumsum(density)])
    mesh = np.interp(np.linspace(0.0, reached[-1], count + 1), reached, phase.mesh)
    mesh[[0, -1]] = 0.0, 1.0
    return mesh
