"""Data of a phase (limits, conditions, scales, parameters) as plain values, and changes of them.

A solve may use other data than those declared; the expressions are those of the declaration.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp.ocp.problem import (
    CONSTANTS,
    LIMITS,
    VARIABLES,
    Parameter,
    PathConstraint,
    Phase,
    Range,
    Variable,
    duration_bounds,
    node_variables,
    ordered,
    with_items,
)
from microbot_ocp.ocp.transcription import PhaseLayout

SIDES, ENDS = ("lower", "upper", "scale"), ("initial", "final")


def problem_data(layout: PhaseLayout) -> dict[str, Any]:
    """Return the data of a phase as plain values for JSON."""
    phase = layout.phase
    return {
        "duration": list(phase.duration_bounds),
        "duration_scale": float(layout.node_scale[-1]),
        **{kind: {p.name: p.value.tolist() for p in getattr(phase, kind)} for kind in CONSTANTS},
        **{kind: [_plain(each) for each in getattr(phase, kind)] for kind in (*VARIABLES, *LIMITS)},
    }


def with_problem_data(phase: Phase, data: Mapping[str, Any]) -> Phase:
    """Return a phase with its expressions and the data of another solve of it.

    Raises
    ------
    InputError
        The data belong to a phase with other variables, constraints or parameters.
    """
    changed = copy.copy(phase)
    for kind in (*VARIABLES, *LIMITS):
        declared, given = getattr(phase, kind), data.get(kind, [])
        same = [(v.name, v.size) for v in declared] == [(g["name"], len(g["scale"])) for g in given]
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


def _plain(item: PathConstraint) -> dict[str, Any]:
    plain = {"name": item.name, **{side: getattr(item, side).tolist() for side in SIDES}}
    if isinstance(item, Variable):
        plain["shape"] = item.shape
        for which in ENDS:
            condition = getattr(item, which)
            plain[which] = None if condition is None else [side.tolist() for side in condition]
    return plain


def _changed(item: Any, given: Mapping[str, Any]) -> Any:
    new: dict[str, Any] = {side: np.array(given[side], dtype=float) for side in SIDES}
    if getattr(item, "shape", "") == "auto":
        new["shape"] = given.get("shape", "constant")
    for which in ENDS:
        if which in given:
            pair = given[which]
            new[which] = None if pair is None else tuple(np.array(side, float) for side in pair)
    ranges = (new["lower"], new["upper"]), *(new.get(which) for which in ENDS)
    for low, high in filter(None, ranges):
        if low.shape != high.shape or not (low <= high).all():  # also rejects NaN
            raise InputError(f"{item.name!r} of the solution has impossible limits")
    if not (np.isfinite(new["scale"]) & (new["scale"] > 0)).all():
        raise InputError(f"{item.name!r} of the solution has a scale that is not above 0")
    return replace(item, **new)


# changes ----------------------------------------------------------------------------------------


def with_changes(phase: Phase, changes: Mapping[str, Any]) -> Phase:
    """Return a copy of a phase with its expressions, and other limits and parameters."""
    conditioned = {which: partial(_conditioned, phase.name, which) for which in ENDS}
    kinds: dict[str, tuple[str, Sequence[Sequence[str]], Callable[..., Any]]] = {
        "parameters": ("parameter", [CONSTANTS], Parameter.with_value),
        "bounds": ("limit", [LIMITS, VARIABLES], _bounded),
        **{which: (which, [VARIABLES], new) for which, new in conditioned.items()},
    }
    changed = copy.copy(phase)
    for kind, (label, groups, new) in kinds.items():
        if not isinstance(given := changes.get(kind, {}), Mapping):
            raise InputError(
                f"{kind} of phase {phase.name!r} must be a mapping from name to value, not "
                f"{checks.shown(given)}"
            )
        for name, value in given.items():
            changed = _renewed(changed, label, groups, name, partial(new, value=value))
    if "durations" in changes:
        if phase.point_fractions:
            raise InputError(
                f"phase {phase.name!r} has costs or constraints at given times: its duration "
                "cannot be changed"
            )
        changed.duration_bounds = duration_bounds(phase.name, changes["durations"])
    return changed


def _renewed(
    phase: Phase, label: str, groups: Sequence[Sequence[str]], name: str, new: Callable[[Any], Any]
) -> Phase:
    """Return the phase with the named item changed, in the first group of lists that has it."""
    there: set[str] = set()
    for group in groups:
        names = {item.name for kind in group for item in getattr(phase, kind)}
        if label in ENDS:
            names &= {variable.name for variable in node_variables(phase)}
        there |= names
        if name in names:
            return with_items(phase, lambda item: new(item) if item.name == name else item, group)
    raise InputError(f"phase {phase.name!r} has no {label} {name!r}; it has {sorted(there)}")


def _bounded(old: Any, value: Any) -> Any:
    low, high = _pair(old.name, value, (old.lower, old.upper), old.unit)
    return replace(old, lower=low, upper=high)


def _conditioned(phase: str, which: str, old: Variable, value: Any) -> Variable:
    declared = getattr(old, which)
    if value is None and declared is None:
        return old
    if declared is None:
        raise InputError(
            f"{old.name!r} of phase {phase!r} was declared without {which}: the program has "
            f"no row for it; declare a range that always holds"
        )
    if value is None:  # free: infinite bounds keep the row of the program
        value = np.full((2, old.size), [[-np.inf], [np.inf]])
        return replace(old, **{which: (value[0], value[1])})
    pair = value if isinstance(value, tuple) and len(value) == 2 else (value, value)
    low, high = _pair(f"{which} {old.name}", pair, declared, old.unit)
    free = np.isinf(declared[0]) & np.isinf(declared[1])
    if np.any(free & (np.isfinite(low) | np.isfinite(high))):
        raise InputError(
            f"{which} {old.name!r} of phase {phase!r} was declared free in entry "
            f"{int(np.argmax(free))}: the program has no row for it"
        )
    return replace(old, **{which: (low, high)})


def _pair(name: str, pair: Any, declared: Range, unit: str) -> Range:
    """Return bounds from a pair; None in the pair keeps a declared bound."""
    if not isinstance(pair, tuple) or len(pair) != 2:
        raise InputError(f"bounds of {name!r} must be a pair (lower, upper), not {pair!r}")
    low, high = (old if new is None else new for new, old in zip(pair, declared, strict=True))
    return ordered(name, low, high, declared[0].size, unit)
