"""Equations at mesh points that follow from or contradict others, detected by their rank.

A condition that is declared twice (an end, and a link to a start with that value) makes the
equations linearly dependent. Solvers tolerate some dependence; with as many equations as unknowns
they reject the program.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp.ocp.diagnosis._finiteness import all_different
from microbot_ocp.ocp.transcription import IntArray, Program


def independent(program: Program, x: FloatArray, tolerance: float) -> tuple[Program, list[str]]:
    """Return the program with redundant conditions removed, and a sentence on each of them.

    Conditions at ends, links and points are examined; a redundant row loses its bounds. A row is
    redundant if its gradient is a linear combination of those of other rows, at x and at a second
    point, and its value is the same combination.

    Raises
    ------
    InputError
        The value is another one: the row contradicts the others.
    """
    rows = _equations(program)
    fixed = program.variable_lower == program.variable_upper
    at = np.where(fixed, program.variable_lower, x)
    # Gradients that depend on each other at x by coincidence do not at a second point.
    beside = at + np.where(fixed, 0.0, all_different(x.size))
    for point in (at, beside):
        for first, others in _constant(program):
            point[others] = point[first]
    values = [_values(program, at, rows)]
    weights = _dependent(values[0][1])
    if not weights:
        return program, []
    values.append(_values(program, beside, rows))
    redundant, dropped = [], []
    for k, weight in weights.items():
        size = max(1.0, float(np.abs(weight).max()))
        missed, slopes = (
            max(float(np.abs(each[j][k] - weight @ each[j]).max()) for each in values)
            for j in (0, 1)
        )
        if not (slopes <= ROUNDING * size and np.isfinite(missed)):
            continue  # a coincidence at x
        others = " and ".join(_named(program, rows[j]) for j in np.flatnonzero(weight))
        others = others or "fixed variables"
        if missed > tolerance * size:
            raise InputError(f"{_named(program, rows[k])} contradicts {others}")
        redundant.append(f"{_named(program, rows[k])} follows from {others}")
        dropped.append(rows[k])
    lower, upper = program.row_lower.copy(), program.row_upper.copy()
    lower[dropped], upper[dropped] = -np.inf, np.inf
    return replace(program, row_lower=lower, row_upper=upper), redundant


def _equations(program: Program) -> IntArray:
    """Return the rows that are equations at mesh points, links first: solvers need these."""
    blocks = [layout.link for layout in program.layouts]
    for layout in program.layouts:
        blocks += [layout.initial, *(group.block for group in layout.points), layout.final]
    rows = np.concatenate([block.places.ravel() for block in blocks]).astype(int)
    return rows[program.row_lower[rows] == program.row_upper[rows]]


def _named(program: Program, row: int) -> str:
    label = program.row_labels[row]
    return f"{label.description} in phase {label.phase!r}"


def _values(program: Program, x: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return residuals of equations [m], and gradients [m, n] by the free variables in them."""
    g, jacobian = program.functions["jacobian"](x, program.parameters)
    present = jacobian[rows.tolist(), :]
    places, columns = map(np.array, present.sparsity().get_triplet())
    shared = np.arange(x.size)
    for first, others in _constant(program):
        shared[others] = first
    columns = shared[columns.astype(int)]
    free = (program.variable_lower < program.variable_upper)[columns]
    used, columns = np.unique(columns[free], return_inverse=True)
    slopes = np.zeros((rows.size, used.size))
    np.add.at(slopes, (places.astype(int)[free], columns), np.array(present.nonzeros())[free])
    return np.array(g).ravel()[rows] - program.row_lower[rows], slopes


def _constant(program: Program) -> Iterator[tuple[int, IntArray]]:
    """Yield the first index and the other indices of each duration and free parameter.

    These variables are constant along a phase.
    """
    for layout in program.layouts:
        for k, entry in enumerate(layout.kind.node):
            if entry.kind == "parameter" or entry.source is None:
                yield int(layout.nodes[0, k]), layout.nodes[1:, k]


def _dependent(slopes: FloatArray) -> dict[int, FloatArray]:
    """Return rows [m, n] that are linear combinations of earlier rows, with their weights [m]."""
    basis, kept, weights = np.zeros_like(slopes), [], {}
    for k, row in enumerate(slopes):
        # Gram-Schmidt: a row without rest depends on the rows before it.
        known = basis[: len(kept)]
        rest = row - known.T @ (known @ row)
        size = np.linalg.norm(rest)
        if size > ROUNDING * max(1.0, float(np.linalg.norm(row))):
            basis[len(kept)] = rest / size
            kept.append(k)
            continue
        weights[k] = np.zeros(len(slopes))
        if kept:
            found = np.linalg.lstsq(slopes[kept].T, row, rcond=None)[0]
            weights[k][kept] = np.where(np.abs(found) > ROUNDING, found, 0.0)
    return weights
