"""The data of a phase as plain values: limits, conditions, scales, parameters.

A solve may have been made with other data than those declared; expressions stay.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp.ocp.problem import CONSTANTS, LIMITS, VARIABLES, PathConstraint, Phase, Variable
from microbot_ocp.ocp.transcription import PhaseLayout


def problem_data(layout: PhaseLayout) -> dict[str, Any]:
    """Plain values for JSON."""
    phase = layout.phase
    return {
        "duration": list(phase.duration_bounds),
        "duration_scale": float(layout.node_scale[-1]),
        **{kind: {p.name: p.value.tolist() for p in getattr(phase, kind)} for kind in CONSTANTS},
        **{kind: [_of_variable(v) for v in getattr(phase, kind)] for kind in VARIABLES},
        **{kind: [_of_limit(c) for c in getattr(phase, kind)] for kind in LIMITS},
    }


def with_problem_data(phase: Phase, data: Mapping[str, Any]) -> Phase:
    """Return a phase with the same expressions and the data of another solve of it.

    Raises
    ------
    InputError
        The data are of a phase with other variables, constraints or parameters.
    """
    changed = copy.copy(phase)
    for kind in (*VARIABLES, *LIMITS):
        declared, given = getattr(phase, kind), data.get(kind, [])
        same = [(v.name, v.scale.size) for v in declared] == [
            (g["name"], len(g["scale"])) for g in given
        ]
        if not same:
            raise InputError(
                f"phase {phase.name!r} of the solution has other variables or constraints: "
                f"{kind.replace('_', ' ')} {[g['name'] for g in given]}, not "
                f"{[v.name for v in declared]}"
            )
        setattr(changed, kind, [_changed(v, g) for v, g in zip(declared, given, strict=True)])
    for kind in CONSTANTS:
        declared, values = getattr(phase, kind), data.get(kind, {})
        shapes = {name: np.shape(value) for name, value in values.items()}
        if shapes != {p.name: p.value.shape for p in declared}:
            raise InputError(
                f"phase {phase.name!r} of the solution has the {kind} {list(values)}, not "
                f"{[p.name for p in declared]}"
            )
        arrays = [np.array(checks.array(p.name, values[p.name], p.value.shape)) for p in declared]
        items = [replace(p, value=array) for p, array in zip(declared, arrays, strict=True)]
        setattr(changed, kind, items)
    low, high = data["duration"]
    if not 0.0 <= low <= high:
        raise InputError(f"phase {phase.name!r} of the solution has impossible durations")
    changed.duration_bounds = (low, high)
    changed.duration_scale = checks.number("duration_scale", data["duration_scale"], "s", above=0.0)
    return changed


def _of_limit(limit: PathConstraint | Variable) -> dict[str, Any]:
    sides = {side: getattr(limit, side).tolist() for side in ("lower", "upper", "scale")}
    return {"name": limit.name, **sides}


def _of_variable(variable: Variable) -> dict[str, Any]:
    ends: dict[str, Any] = {}
    for which in ("initial", "final"):
        condition: Sequence[Any] | None = getattr(variable, which)
        ends[which] = None if condition is None else [side.tolist() for side in condition]
    return {**_of_limit(variable), "shape": variable.shape, **ends}


def _changed(item: Any, given: Mapping[str, Any]) -> Any:
    new: dict[str, Any] = {k: np.array(given[k], dtype=float) for k in ("lower", "upper", "scale")}
    if getattr(item, "shape", "") == "auto":
        new["shape"] = given.get("shape", "constant")
    for which in ("initial", "final"):
        if which in given:
            pair = given[which]
            new[which] = None if pair is None else tuple(np.array(side, float) for side in pair)
    for low, high in filter(
        None, ((new["lower"], new["upper"]), new.get("initial"), new.get("final"))
    ):
        if low.shape != high.shape or not (low <= high).all():  # false of what is no number, too
            raise InputError(f"{item.name!r} of the solution has impossible limits")
    if not (np.isfinite(new["scale"]) & (new["scale"] > 0)).all():
        raise InputError(f"{item.name!r} of the solution has a scale that is not above 0")
    return replace(item, **new)
