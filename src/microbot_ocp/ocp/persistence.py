"""Solutions in one file: a numpy archive with what is needed to repeat the run.

Holds the values of every phase, the scaled variables and multipliers, the mesh, the attempts, the
settings of the solver and the versions of the packages.
"""

from __future__ import annotations

import json
import platform
from pathlib import Path
from typing import Any
from zipfile import BadZipFile
from zlib import error as zlib_error

import casadi as ca
import numpy as np

from microbot_ocp.checks import FloatArray, InputError
from microbot_ocp.ocp.layout import PhaseLayout
from microbot_ocp.ocp.mesh import Mesh
from microbot_ocp.ocp.solution import Attempt, PhaseSolution, Solution, Status
from microbot_ocp.ocp.transcription import Transcription

SCHEMA = 1
_BROKEN = (
    OSError,
    EOFError,
    LookupError,
    TypeError,
    ValueError,
    AttributeError,
    NotImplementedError,
    BadZipFile,
    zlib_error,
)
_OPTIONAL = ("variable_multipliers", "variables")


def versions() -> dict[str, str]:
    """Versions of what computes."""
    return {
        "casadi": ca.CasadiMeta.version(),
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def save_solution(solution: Solution, path: str | Path) -> Path:
    """Write a solution to one ``.npz`` file.

    Raises
    ------
    InputError
        Solver options that are no plain JSON values.
    """
    target = Path(path)
    arrays: dict[str, Any] = {"row_multipliers": solution.row_multipliers}
    for name in _OPTIONAL:
        value = getattr(solution, name)
        if value is not None:
            arrays[name] = value
    phases = []
    for index, phase in enumerate(solution.phases):
        arrays[f"phase{index}.mesh"] = phase.mesh
        if phase.degrees is not None:
            arrays[f"phase{index}.degrees"] = phase.degrees
        if phase.stages is not None:
            arrays[f"phase{index}.stages"] = phase.stages
        for place, value in enumerate(phase.values.values()):
            arrays[f"phase{index}.value{place}"] = value
        described: dict[str, Any] = {
            "name": phase.name,
            "duration": phase.duration,
            "values": list(phase.values),
        }
        if phase.layout is not None:
            own = phase.layout.phase
            variables = (*own.states, *own.controls, *own.algebraics)
            described["units"] = {v.name: v.unit for v in variables}
            described["parameters"] = {p.name: p.value.tolist() for p in own.parameters}
            described["scheme"] = repr(phase.layout.scheme)
        phases.append(described)
    metadata = {
        "schema": SCHEMA,
        "status": solution.status.name,
        "cost": solution.cost,
        "cost_scale": solution.cost_scale,
        "build_time": solution.build_time,
        "advice": solution.said,
        "attempts": [{**vars(a), "status": a.status.name} for a in solution.attempts],
        "settings": dict(solution.settings),
        "phases": phases,
        "versions": versions(),
    }
    try:
        text = json.dumps(metadata)
    except TypeError as problem:
        raise InputError(f"solver options must be plain JSON values: {problem}") from None
    partial = target.with_name(target.name + ".part")
    with partial.open("wb") as stream:
        np.savez_compressed(stream, metadata=np.array(text), **arrays)
    partial.replace(target)
    return target


def load_solution(path: str | Path, transcription: Transcription | None = None) -> Solution:
    """Read a solution that :func:`save_solution` wrote.

    Parameters
    ----------
    path : str or Path
    transcription : Transcription, optional
        Of the same problem: the solution can then be sampled between its mesh points and start
        another solve with its multipliers.

    Raises
    ------
    InputError
        No such file, not a solution, written by a newer version, or of another problem.
    """
    try:
        with np.load(Path(path), allow_pickle=False) as stored:
            metadata = json.loads(str(stored["metadata"]))
            schema = int(metadata["schema"])
            arrays = {key: stored[key] for key in stored.files if key != "metadata"}
        if schema <= SCHEMA:
            return _restored(metadata, arrays, transcription)
    except InputError:
        raise
    except _BROKEN as problem:
        said = " ".join(str(problem).split())
        raise InputError(f"{path} is not a saved solution: {said}") from None
    raise InputError(
        f"{path} was written by a newer version (schema {schema}; this one reads up to {SCHEMA})"
    )


def saved_with(path: str | Path) -> dict[str, Any]:
    """Settings and versions that a solution was made with."""
    load_solution(path)  # refuses what is none
    with np.load(Path(path), allow_pickle=False) as stored:
        metadata = json.loads(str(stored["metadata"]))
    return {key: metadata[key] for key in ("settings", "versions")}


def _restored(
    metadata: dict[str, Any], arrays: dict[str, FloatArray], transcription: Transcription | None
) -> Solution:
    meshes = [arrays[f"phase{i}.mesh"] for i in range(len(metadata["phases"]))]
    layouts: tuple[PhaseLayout | None, ...] = (None,) * len(meshes)
    if transcription is not None:
        layouts = _layouts(metadata, arrays, meshes, transcription)
    phases = tuple(
        PhaseSolution(
            name=described["name"],
            duration=float(described["duration"]),
            mesh=meshes[i],
            values={
                name: arrays[f"phase{i}.value{k}"] for k, name in enumerate(described["values"])
            },
            layout=layouts[i],
            stages=_flat(arrays.get(f"phase{i}.stages")),
            degrees=arrays.get(f"phase{i}.degrees"),
        )
        for i, described in enumerate(metadata["phases"])
    )
    attempts = tuple(
        Attempt(**{**entry, "status": Status[entry["status"]]}) for entry in metadata["attempts"]
    )
    return Solution(
        status=Status[metadata["status"]],
        cost=float(metadata["cost"]),
        phases=phases,
        attempts=attempts,
        row_multipliers=arrays["row_multipliers"],
        build_time=float(metadata["build_time"]),
        variable_multipliers=arrays.get("variable_multipliers"),
        variables=arrays.get("variables"),
        settings=metadata["settings"],
        cost_scale=float(metadata.get("cost_scale", 1.0)),
        said=str(metadata.get("advice", "")),
    )


def _flat(stages: FloatArray | None) -> FloatArray | None:
    # earlier versions wrote a table [N, components]
    return None if stages is None else stages.ravel()


def _layouts(
    metadata: dict[str, Any],
    arrays: dict[str, FloatArray],
    meshes: list[FloatArray],
    transcription: Transcription,
) -> tuple[PhaseLayout, ...]:
    names = [described["name"] for described in metadata["phases"]]
    own = [phase.name for phase in transcription.problem.phases]
    if names != own:
        raise InputError(f"the solution has the phases {names}, the transcription {own}")
    layouts = transcription.layouts(
        [Mesh(mesh, arrays.get(f"phase{i}.degrees")) for i, mesh in enumerate(meshes)]
    )
    for i, layout in enumerate(layouts):
        stages = arrays.get(f"phase{i}.stages")
        if stages is not None and stages.size != layout.last_node - layout.variable_offset:
            raise InputError(
                f"phase {names[i]!r} of the solution has other variables than the transcription"
            )
    return layouts
