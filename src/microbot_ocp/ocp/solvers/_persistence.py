"""Solutions in one file: a numpy archive with all data to repeat the solve.

Contains the values of every phase, the scaled variables and multipliers, the mesh, the attempts,
the settings of the solver and the versions of the packages.
"""

from __future__ import annotations

import platform
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.archive import no_archive, read_archive, write_archive
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.outcome import Advice, Ledger, Outcome
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.problem import with_phases
from microbot_ocp.ocp.solution import UNKNOWN, Attempt, Gap, PhaseSolution, Solution, StartingPoint
from microbot_ocp.ocp.solvers import SolverSettings, run_chain
from microbot_ocp.ocp.starts import problem_data, with_problem_data
from microbot_ocp.ocp.transcription import (
    SCHEMES,
    AnyProblem,
    IntegratorShooting,
    PhaseLayout,
    Transcription,
    assemble,
    bounds_of,
    mesh_of,
)

SCHEMA = 1
_SCHEMES = {type(k).__name__: type(k) for k in (*SCHEMES.values(), IntegratorShooting())}
_OF_ROWS = ("row_multipliers", "start.rows")  # all other arrays belong to the variables


def save_solution(solution: Solution, path: str | Path) -> Path:
    """Write a solution to one ``.npz`` file.

    Raises
    ------
    InputError
        A solver option is no plain JSON value.
    """
    arrays, phases = _arrays_of(solution), []
    for index, phase in enumerate(solution.phases):
        arrays[f"phase{index}.mesh"] = phase.mesh
        if phase.stages is not None:
            arrays[f"phase{index}.stages"] = phase.stages
        for place, value in enumerate(phase.values.values()):
            arrays[f"phase{index}.value{place}"] = value
        described: dict[str, Any] = {
            "name": phase.name,
            "duration": phase.duration,
            "values": list(phase.values),
            "free": {name: value.tolist() for name, value in phase.parameters.items()},
        }
        if phase.layout is not None:
            declared = phase.layout.phase
            described["units"] = {v.name: v.unit for v in declared.variables}
            described["numbers"] = problem_data(phase.layout)
            scheme = phase.layout.kind.scheme
            described["scheme"] = [type(scheme).__name__, dict(vars(scheme))]
        phases.append(described)
    metadata = {
        "schema": SCHEMA,
        "status": solution.status.name,
        "cost": solution.cost,
        "cost_scale": solution.cost_scale,
        "maximize": solution.maximize,
        "gap": vars(solution.gap),
        "rivals": [list(solution.rivals), solution.agreed, solution.compared],
        "build_time": solution.build_time,
        "advice": solution.outcome.as_dict()["advice"],
        "attempts": [{**vars(a), "status": a.status.name} for a in solution.attempts],
        "ledger": solution.ledger.as_dicts(),
        "settings": dict(solution.settings),
        "phases": phases,
        "versions": {
            "casadi": ca.CasadiMeta.version(),
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
    }
    return write_archive(path, arrays, metadata, "the options of a solution")


def _arrays_of(solution: Solution) -> dict[str, FloatArray]:
    """Return the arrays over the whole program that the solution has."""
    start = solution.start or StartingPoint(np.zeros(0))
    arrays = {
        "row_multipliers": solution.row_multipliers,
        "variable_multipliers": solution.variable_multipliers,
        "variables": solution.variables,
        "start.x": None if solution.start is None else start.x,
        "start.rows": start.row_multipliers,
        "start.variables": start.variable_multipliers,
    }
    return {name: values for name, values in arrays.items() if values is not None}


def load_solution(path: str | Path, problem: AnyProblem | None = None) -> Solution:
    """Read a solution that :func:`save_solution` wrote.

    Parameters
    ----------
    path : str or Path
    problem : OptimalControlProblem or Transcription, optional
        The solved problem. It is needed to sample between mesh points, to verify the solution,
        and to start another solve with its multipliers. Limits, conditions, parameters and scales
        are those of the solve, not those declared.

    Raises
    ------
    InputError
        The file is missing, is no solution, has a newer version, or belongs to another problem.
    """
    return _read(path, problem)[0]


def _read(path: str | Path, problem: AnyProblem | None = None) -> tuple[Solution, dict[str, Any]]:
    """Return a solution and the metadata of its file."""
    arrays, metadata = read_archive(path, "solution", SCHEMA)
    try:
        solution = _restored(metadata, arrays, problem)
        _check_numbers(solution)
    except InputError as refusal:
        raise InputError(f"{path}: {refusal}") from None
    except Exception as failure:  # a document of another shape causes many types of error
        raise no_archive(path, "solution", failure) from None
    return solution, metadata


def repeat(path: str | Path, problem: AnyProblem) -> Solution:
    """Solve again with the problem data, mesh, scheme, settings and start of a saved solution.

    On one machine with unchanged versions (see :func:`saved_with`) the outcome is reproduced.

    Parameters
    ----------
    path : str or Path
    problem : OptimalControlProblem or Transcription
        The solved problem.

    Raises
    ------
    InputError
        See :func:`load_solution`; or the file has no start of its solve, or that of another one.
    """
    before = load_solution(path, problem)
    layouts = [phase.layout for phase in before.phases if phase.layout is not None]
    if before.start is None or len(layouts) < len(before.phases):
        raise InputError(f"{path} was written without the start of its solve")
    program = replace(assemble(layouts), cost_scale=before.cost_scale)
    try:
        settings = SolverSettings(**dict(before.settings))  # type: ignore[arg-type]
    except TypeError:
        raise InputError(f"{path} has unknown settings of a solver") from None
    return run_chain(program, settings, before.start)


def saved_with(path: str | Path) -> dict[str, Any]:
    """Return the settings and package versions of a saved solution."""
    metadata = _read(path)[1]
    return {key: metadata[key] for key in ("settings", "versions")}


def _restored(
    metadata: dict[str, Any], arrays: dict[str, FloatArray], problem: AnyProblem | None
) -> Solution:
    meshes = [mesh_of(arrays[f"phase{i}.mesh"]) for i in range(len(metadata["phases"]))]
    layouts = [None] * len(meshes) if problem is None else _layouts(metadata, meshes, problem)
    phases = []
    for i, (described, layout) in enumerate(zip(metadata["phases"], layouts, strict=True)):
        stages = arrays.get(f"phase{i}.stages")
        count = None if layout is None else layout.stages.stop - layout.stages.start
        if stages is not None and count not in (None, stages.size):
            raise InputError(
                f"phase {described['name']!r} of the solution has other variables than the "
                "transcription"
            )
        values = {name: arrays[f"phase{i}.value{k}"] for k, name in enumerate(described["values"])}
        free = {k: np.array(v, float) for k, v in described.get("free", {}).items()}
        named = described["name"], float(described["duration"]), meshes[i]
        phases.append(PhaseSolution(*named, values, layout, stages, free))
    attempts = (Attempt(**{**a, "status": Status[a["status"]]}) for a in metadata["attempts"])
    status = Status[metadata["status"]]
    rivals, agreed, compared = metadata.get("rivals", ((), 0, 0))
    x, rows, variables = (arrays.get(f"start.{name}") for name in ("x", "rows", "variables"))
    return Solution(
        status=status,
        cost=float(metadata["cost"]),
        phases=tuple(phases),
        attempts=tuple(attempts),
        row_multipliers=arrays["row_multipliers"],
        build_time=float(metadata["build_time"]),
        variable_multipliers=arrays.get("variable_multipliers"),
        variables=arrays.get("variables"),
        ledger=Ledger.read(metadata.get("ledger", ())),
        settings=metadata["settings"],
        cost_scale=float(metadata.get("cost_scale", 1.0)),
        maximize=bool(metadata.get("maximize", False)),
        gap=Gap(**metadata["gap"]) if metadata.get("gap") else UNKNOWN,
        rows=_advice(metadata.get("advice"), status),
        rivals=tuple(map(float, rivals)),
        agreed=int(agreed),
        compared=int(compared),
        start=None if x is None else StartingPoint(x, rows, variables),
    )


def _check_numbers(solution: Solution) -> None:
    """Check shapes against the mesh, and that a solved solution is finite.

    Raises
    ------
    InputError
        A shape does not fit the mesh, or a value of a solved solution is not finite.
    """
    if not solution.phases:
        raise InputError("it has no phases")
    layouts = [phase.layout for phase in solution.phases if phase.layout is not None]
    if layouts:
        bounds = bounds_of(layouts)
        for name, values in _arrays_of(solution).items():
            shape = (bounds.row_lower if name in _OF_ROWS else bounds.variable_lower).shape
            checks.array(name, values, shape, finite=solution.status.solved)
    for phase in solution.phases:
        rows = (phase.mesh.size - 1, phase.mesh.size)
        for name, values in phase.values.items():
            if values.ndim not in (2, 3) or values.shape[0] not in rows:
                raise InputError(
                    f"{name!r} of phase {phase.name!r} has shape {list(values.shape)}, which does "
                    f"not fit a mesh of {phase.mesh.size - 1} intervals"
                )
    if solution.status.solved:
        checks.number("cost", solution.cost)
        for phase in solution.phases:
            checks.number("duration", phase.duration, "s")
            for name, values in {**phase.values, **phase.parameters}.items():
                if not np.isfinite(values).all():
                    raise InputError(f"{name!r} of phase {phase.name!r} must be finite")
    checks.number("cost_scale", solution.cost_scale, above=0.0)


def _layouts(
    metadata: dict[str, Any], meshes: list[FloatArray], problem: AnyProblem
) -> tuple[PhaseLayout, ...]:
    """Return layouts of the problem with the data and the scheme of a solve."""
    given = problem.problem if isinstance(problem, Transcription) else problem
    described = metadata["phases"]
    names, declared = [d["name"] for d in described], [phase.name for phase in given.phases]
    if names != declared:
        raise InputError(f"the solution has the phases {names}, the problem {declared}")
    if not all("numbers" in d for d in described):
        if isinstance(problem, Transcription):
            return problem.layouts(meshes)
        raise InputError("the solution has no problem data: give its transcription")
    pairs = zip(given.phases, described, strict=True)
    solved = with_phases(given, (with_problem_data(phase, d["numbers"]) for phase, d in pairs))
    if isinstance(problem, Transcription):
        scheme = problem.scheme
    else:
        name, settings = described[0]["scheme"]
        scheme = _SCHEMES[name](**settings)
    return Transcription(solved, scheme=scheme).layouts(meshes)


def _advice(saved: Any, status: Status) -> tuple[Advice, ...]:
    """Return the advice of a file; older files hold one text."""
    if isinstance(saved, list):
        return tuple(Advice(**row) for row in saved)
    return Outcome.of(status, str(saved or status.sentence)).advice
