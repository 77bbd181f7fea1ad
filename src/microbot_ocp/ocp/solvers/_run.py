"""One solver run on a program."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.solution import Attempt, Progress, StartingPoint, Watch, watching
from microbot_ocp.ocp.solvers._acceptance import accepted
from microbot_ocp.ocp.solvers._plugins import create
from microbot_ocp.ocp.solvers._settings import SolverSettings
from microbot_ocp.ocp.solvers._status import checked, first_cause, stats_of, status_of
from microbot_ocp.ocp.transcription import Program


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one solver left."""

    attempt: Attempt
    x: FloatArray
    row_multipliers: FloatArray
    variable_multipliers: FloatArray


Made = dict[tuple[str, bool, float], ca.Function]


def run(
    program: Program,
    name: str,
    settings: SolverSettings,
    start: StartingPoint,
    variant: bool,
    progress: Progress | None,
    made: Made | None,
) -> Outcome:
    """Run one solver from a start; ``made`` keeps it for further solves of the program."""
    begin = time.perf_counter()
    watch = Watch(program, name, progress) if progress is not None else None
    key = (name, variant, program.cost_scale)
    solver = None if made is None or watch is not None else made.get(key)
    broken = ""
    if solver is None:
        try:
            solver = create(program, name, settings, variant=variant, watch=watch)
        except RuntimeError as problem:
            broken = first_cause(problem)
        if made is not None and watch is None and solver is not None:
            made[key] = solver
    created = time.perf_counter()
    arguments: dict[str, Any] = {
        "x0": start.x,
        "p": program.parameters,
        "lbx": program.variable_lower,
        "ubx": program.variable_upper,
        "lbg": program.row_lower,
        "ubg": program.row_upper,
    }
    if start.warm:
        for key, value in (
            ("lam_x0", start.variable_multipliers),
            ("lam_g0", start.row_multipliers),
        ):
            arguments[key] = np.asarray(value) / program.cost_scale
    result: Mapping[str, Any] = {}
    with watching(name) as interrupted:
        if watch is not None:
            watch.asked = interrupted
        # what stops the SQP method takes its result along
        try:
            result = {} if solver is None else solver(**arguments)
        except (KeyboardInterrupt, RuntimeError) as problem:
            asked = interrupted() or (watch is not None and watch.stopped)
            if isinstance(problem, KeyboardInterrupt) and not asked:
                raise
            broken = "" if asked else first_cause(problem)
    if broken and settings.options.get(name) and "option" in broken.lower():
        raise InputError(f"options of {name} were refused: {broken}")
    done = time.perf_counter()
    stopped = interrupted() or (watch is not None and watch.stopped)
    if watch is not None and watch.failure is not None:
        raise watch.failure
    stats = stats_of(solver) if solver is not None and result else {}
    last = start.x if watch is None or watch.x is None else watch.x
    x = np.array(result["x"]).ravel() if result else last
    if stopped and watch is not None:
        x = last
    cost, infeasibility = checked(program, x)
    attempt = Attempt(
        solver=name,
        status=Status.INTERRUPTED if stopped else status_of(name, stats, settings, infeasibility),
        message=broken or str(stats.get("return_status", "")),
        iterations=int(stats.get("iter_count", -1 if watch is None else watch.count)),
        cost=cost,
        infeasibility=infeasibility,
        wall_time=done - created,
        create_time=created - begin,
        function_time=sum(v for k, v in stats.items() if k.startswith("t_wall_nlp_")),
        broke_down=bool(broken),
    )
    # the solvers hand over the multipliers of their own bounds, though CasADi computes none
    rows, variables = (
        np.array(result[key]).ravel() * program.cost_scale if result else np.zeros(size)
        for key, size in (("lam_g", program.row_lower.size), ("lam_x", x.size))
    )
    if name == "fatrop" and attempt.status in (Status.ITERATION_LIMIT, Status.FAILED) and result:
        passed = accepted(program, x, rows, variables, settings.tolerance)
        if passed is not None:
            said = f"stopped, but its point is an optimum to {passed.error:.1e}"
            attempt = replace(attempt, status=Status.SOLVED, message=said)
            rows, variables = passed.row_multipliers, passed.variable_multipliers
    return Outcome(attempt, x, rows, variables)
