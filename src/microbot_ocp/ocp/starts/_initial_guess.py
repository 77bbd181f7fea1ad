"""Starting points of a solver: default guesses and guesses from earlier solutions.

An earlier solution may have another mesh or other phases. If only the mesh differs, its multipliers
are transferred: those of the dynamics are costates and are interpolated directly; those of path
constraints and bounds are proportional to interval length and are interpolated per length.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase, Variable, node_variables
from microbot_ocp.ocp.solution import Given, PhaseSolution, Solution, StartingPoint, pack
from microbot_ocp.ocp.starts._measured_guess import with_measurements
from microbot_ocp.ocp.starts._rollout import rollouts
from microbot_ocp.ocp.starts._tied_guess import with_tied_controls
from microbot_ocp.ocp.transcription import Block, Guess, PhaseLayout, Program, interpolate
from microbot_ocp.ocp.transcription.schemes import Collocation


def starting_point(program: Program, problem: OptimalControlProblem, guess: Given) -> StartingPoint:
    """Return a starting point from guesses, from an earlier solution, or from the default guess."""
    if not isinstance(guess, Solution):
        return StartingPoint(pack(program, completed(problem, guess)))
    old = [phase.layout for phase in guess.phases if phase.layout is not None]
    comparable = len(old) == len(program.layouts) == len(guess.phases) and all(
        _alike(a, b) for a, b in zip(old, program.layouts, strict=True)
    )
    if not comparable or guess.variables is None:
        missing = tuple(missing_from(problem, guess))
        return StartingPoint(pack(program, guess_from(problem, guess)), missing=missing)
    same = all(_same_mesh(a, b) for a, b in zip(old, program.layouts, strict=True))
    x = guess.variables if same else pack(program, guess_from(problem, guess))
    rows, variables = guess.row_multipliers, guess.variable_multipliers
    if not guess.status.solved or variables is None:
        return StartingPoint(x)
    if not same:
        rows, variables = _moved_multipliers(program, old, rows, variables)
    return StartingPoint(x, rows, variables)


def _alike(a: PhaseLayout, b: PhaseLayout) -> bool:
    """Return True if two layouts differ only in meshes and degrees."""
    alike = type(a) is type(b) and type(a.kind.scheme) is type(b.kind.scheme)
    return alike and _content(a) == _content(b)


def _content(layout: PhaseLayout) -> set[tuple[str, str, int, float]]:
    """Return kind, name, component and scale of every row and variable of a phase."""
    return {
        (entry.kind, entry.name, entry.component, entry.scale)
        for block in (*layout.rows, *layout.variables)
        for entry in block.entries
    }


def _same_mesh(a: PhaseLayout, b: PhaseLayout) -> bool:
    contents = [(k.kind.scheme, k.variable_count, k.row_count) for k in (a, b)]
    return np.array_equal(a.mesh, b.mesh) and contents[0] == contents[1]


# guesses ------------------------------------------------------------------------------------------


def completed(
    problem: OptimalControlProblem, guess: Mapping[str, Guess] | str | None
) -> dict[str, Guess]:
    """Return a guess for every phase, with the default guess for missing values.

    Parameters
    ----------
    problem : OptimalControlProblem
    guess : mapping from phase name to Guess, "rollout" or None
        "rollout" simulates the problem: :func:`rollouts`.

    Raises
    ------
    InputError
        The guess names a phase that the problem does not have, or is an unknown word.
    """
    if guess == "rollout":
        return rollouts(problem, default_guess(problem))[0]
    if isinstance(guess, str):
        raise InputError(f"guess must be a mapping, a Solution or 'rollout', not {guess!r}")
    given = guess or {}
    whole = all(_is_whole(given.get(phase.name), phase) for phase in problem.phases)
    ordinary = {p.name: Guess() for p in problem.phases} if whole else _lines(problem)
    free = {v.name for phase in problem.phases for v in phase.free_parameters}
    shared = {k: v for g in given.values() for k, v in g.values.items() if k in free}
    for phase in problem.phases:  # a free parameter has one value in all its phases
        usual = {v.name: shared[v.name] for v in phase.free_parameters if v.name in shared}
        ordinary[phase.name] = ordinary[phase.name].with_values(usual)
    for name, value in given.items():
        if name not in ordinary:
            raise InputError(f"guess has phase {name!r}; the problem has {list(ordinary)}")
        usual = ordinary[name]
        duration = usual.duration if value.duration is None else value.duration
        ordinary[name] = replace(usual.with_values(value.values), duration=duration)
    return {p.name: with_tied_controls(p, ordinary[p.name]) for p in problem.phases}


def _is_whole(guess: Guess | None, phase: Phase) -> bool:
    """Return True if a guess needs no value of the default guess, which may be a fit to data."""
    names = {v.name for v in node_variables(phase)}
    return guess is not None and guess.duration is not None and names <= guess.values.keys()


def default_guess(problem: OptimalControlProblem) -> dict[str, Guess]:
    """Return straight lines between the end conditions.

    A variable with a condition at one end keeps that value; a variable without any is in the middle
    of its bounds, or zero. Measured states pass through the measurements, and free parameters are
    fitted to them. Controls that equations determine satisfy these.
    """
    guesses = _lines(problem)
    return {phase.name: with_tied_controls(phase, guesses[phase.name]) for phase in problem.phases}


def _lines(problem: OptimalControlProblem) -> dict[str, Guess]:
    guesses = {}
    links = {link.after: link.names for link in problem.links}
    last: dict[str, FloatArray] = {}
    for phase in problem.phases:
        values = {}
        for variable in node_variables(phase):
            name = variable.name
            linked = name in last and name in links.get(phase.name, ())
            before = last[name] if linked else _middle(variable.lower, variable.upper)
            start = _at_end(variable, "initial", before)
            end = last[name] = _at_end(variable, "final", start)
            if not linked:
                start = _at_end(variable, "initial", end)
            values[name] = partial(_line, start, end)
        low, high = phase.duration_bounds
        guesses[phase.name] = Guess(float(np.sqrt(low * min(high, 1e3 * low))), values)
    return with_measurements(problem, guesses)


def _at_end(variable: Variable, which: str, otherwise: FloatArray) -> FloatArray:
    """Return the middle of the condition at one end, or ``otherwise`` clipped to the limits."""
    low, high = variable.lower, variable.upper
    condition = getattr(variable, which)
    if condition is None:
        return np.clip(otherwise, low, high)
    given = np.isfinite(condition[0]) & np.isfinite(condition[1])
    low, high = np.maximum(low, condition[0]), np.minimum(high, condition[1])
    return np.where(given, _middle(low, high), np.clip(otherwise, low, high))


def _middle(low: FloatArray, high: FloatArray) -> FloatArray:
    both = np.isfinite(low) & np.isfinite(high)
    with np.errstate(invalid="ignore"):
        return np.where(both, (low + high) / 2, np.clip(0.0, low, high))


def _line(start: FloatArray, end: FloatArray, s: FloatArray) -> FloatArray:
    return start + s[:, None] * (end - start)


def guess_from(problem: OptimalControlProblem, solution: Solution) -> dict[str, Guess]:
    """Return guesses for the phases of a problem from a solution of it or of a similar one.

    Phases of equal names take over the values. If the names differ, the solution is divided into as
    many pieces of equal duration as the problem has phases. Variables that the solution does not
    have start from the default guess.
    """
    ordinary = default_guess(problem) if any(missing_from(problem, solution)) else {}
    guesses = {}
    samples: Samples = {}
    for phase, pieces, share in _taken_over(problem, solution):
        values = dict(ordinary[phase.name].values) if ordinary else {}
        for variable in phase.variables:
            if all(_has(piece, variable) for piece in pieces):
                values[variable.name] = partial(_sampled, pieces, variable.name, share, samples)
        whole = sum(piece.duration for piece in pieces)
        duration = float(np.clip(whole * (share[1] - share[0]), *phase.duration_bounds))
        guesses[phase.name] = Guess(duration, values)
    return guesses


def missing_from(problem: OptimalControlProblem, solution: Solution) -> Iterator[str]:
    """Yield the variables that start from the default guess because a solution lacks them."""
    for phase, pieces, _ in _taken_over(problem, solution):
        for variable in phase.variables:
            if not all(_has(piece, variable) for piece in pieces):
                yield f"{variable.name} of phase {phase.name!r}"


def _taken_over(
    problem: OptimalControlProblem, solution: Solution
) -> Iterator[tuple[Phase, Sequence[PhaseSolution], tuple[float, float]]]:
    """Yield every phase with the solution's phases that it starts from, and its share of them."""
    solved, count = {phase.name: phase for phase in solution.phases}, len(problem.phases)
    matched = all(phase.name in solved for phase in problem.phases)
    for k, phase in enumerate(problem.phases):
        if matched:
            yield phase, (solved[phase.name],), (0.0, 1.0)
        else:
            yield phase, solution.phases, (k / count, (k + 1) / count)


def _has(piece: PhaseSolution, variable: Variable) -> bool:
    return variable.name in piece.values and piece.values[variable.name].shape[-1] == variable.size


# The last samples of a phase serve all its variables: key phase name; times and values by name.
Samples = dict[str, tuple[FloatArray, Mapping[str, FloatArray]]]


def _sampled(
    pieces: Sequence[PhaseSolution],
    name: str,
    share: tuple[float, float],
    samples: Samples,
    s: FloatArray,
) -> FloatArray:
    """Return values [M, size] of a variable at fractions [M] of a share of the pieces."""
    edges = np.cumsum([0.0, *(piece.duration for piece in pieces)])
    t = (share[0] + s * (share[1] - share[0])) * edges[-1]
    which = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(pieces) - 1)
    result = np.zeros((t.size, pieces[0].values[name].shape[-1]))
    for index, piece in enumerate(pieces):
        inside = which == index
        if inside.any():
            result[inside] = _values(piece, name, t[inside] - edges[index], samples)
    return result


def _values(piece: PhaseSolution, name: str, t: FloatArray, samples: Samples) -> FloatArray:
    if piece.layout is not None:
        at, values = samples.get(piece.name, (np.zeros(0), {}))
        if not np.array_equal(at, t):
            samples[piece.name] = _, values = t, piece.sample(t)
        return values[name]
    table, share = piece.values[name], np.clip(t / piece.duration, 0.0, 1.0)
    if table.ndim == 2 and table.shape[0] == piece.mesh.size:
        return interpolate(table, share, piece.mesh)
    k = np.searchsorted(piece.mesh, share, side="right") - 1
    flat = table if table.ndim == 2 else table.mean(axis=1)  # mean over the points of an interval
    return flat[np.clip(k, 0, flat.shape[0] - 1)]


# multipliers on another mesh ----------------------------------------------------------------------


def _moved_multipliers(
    program: Program, layouts: Sequence[PhaseLayout], rows: FloatArray, variables: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return multipliers for a program from those of its problem on another mesh."""
    new_rows = np.zeros(program.row_lower.size)
    new_variables = np.zeros(program.variable_lower.size)
    for before, after in zip(layouts, program.layouts, strict=True):
        for old_block, new_block in zip(before.rows[1:], after.rows[1:], strict=True):
            new_rows[new_block.places] = rows[old_block.places]
        old_series, new_series = (
            (_series(k, k.rows[0], 0), _series(k, k.variables[0], k.node_size), _of_nodes(k))
            for k in (before, after)
        )
        tables = (rows, new_rows), (variables, new_variables), (variables, new_variables)
        for old, new, (values, new_values) in zip(old_series, new_series, tables, strict=True):
            _move(old, new, values, new_values)
    return new_rows, new_variables


# Multipliers of one kind [3, M]: places as increasing fractions of the phase, indices in the
# program, and weights: the multiplier divided by its weight is a density along the phase.
Series = Mapping[tuple[object, ...], FloatArray]


def _of_nodes(layout: PhaseLayout) -> Series:
    h = np.diff(layout.mesh)
    around = (np.append(h, 0.0) + np.insert(h, 0, 0.0)) / 2
    columns = enumerate(layout.nodes.T)
    return {(k,): np.vstack([layout.mesh, column, around]) for k, column in columns}


def _series(layout: PhaseLayout, block: Block, first: int) -> Series:
    """Return series of the entries from ``first`` on, by kind, name, component and point type."""
    gathered: dict[tuple[object, ...], list[FloatArray]] = {}
    start, h, scheme = layout.mesh[:-1], np.diff(layout.mesh), layout.kind.scheme
    shares: dict[float, float] = {}
    if isinstance(scheme, Collocation):
        shares = dict(zip(scheme.points, scheme.weights.tolist(), strict=True))
    for entry, places in zip(block.entries[first:], block.places.T[first:], strict=True):
        # All collocation points of a row form one series along the phase.
        point = np.inf if entry.fraction in shares else entry.fraction
        share = 1.0 if entry.kind == "step" else shares.get(entry.fraction, 1.0)
        weight = np.full(h.size, share)
        if entry.kind not in ("step", "defect"):  # multipliers of the dynamics are costates
            weight = weight * h
        part = np.vstack([start + entry.fraction * h, places, weight])
        gathered.setdefault((entry.kind, entry.name, entry.component, point), []).append(part)
    tables = {key: np.hstack(parts) for key, parts in gathered.items()}
    return {key: table[:, np.argsort(table[0], kind="stable")] for key, table in tables.items()}


def _move(before: Series, after: Series, values: FloatArray, new_values: FloatArray) -> None:
    for key in before.keys() & after.keys():
        (old_places, old, old_weights), (places, new, weights) = before[key], after[key]
        density = values[old.astype(int)] / old_weights
        new_values[new.astype(int)] = np.interp(places, old_places, density) * weights
