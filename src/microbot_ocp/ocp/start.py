"""Starting points of a solver: default guesses, guesses from earlier solutions, and their check.

An earlier solution may have another mesh or other phases. Where only the mesh differs its
multipliers go along: those of the dynamics are values of the costate and are interpolated as they
are, those of path constraints and bounds stand for an interval and are interpolated per length.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np

from microbot_ocp.checks import FloatArray, InputError
from microbot_ocp.ocp.assembly import Program
from microbot_ocp.ocp.layout import PhaseLayout
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase, Variable, node_variables
from microbot_ocp.ocp.rows import Entry, inner_variables, stage_rows
from microbot_ocp.ocp.schemes import Collocation
from microbot_ocp.ocp.schemes.base import pointwise
from microbot_ocp.ocp.solution import PhaseSolution, Solution, pack, unpack
from microbot_ocp.ocp.transcription import Guess, GuessValue

PUSH = 1e-2  # how far solvers move a guess off its bounds, as a share of their size or distance


@dataclass(frozen=True, eq=False)
class Start:
    """Scaled variables to start from, with multipliers where an earlier solve knows them."""

    x: FloatArray
    row_multipliers: FloatArray | None = None
    variable_multipliers: FloatArray | None = None

    @property
    def warm(self) -> bool:
        """Whether there are multipliers."""
        return self.row_multipliers is not None and self.variable_multipliers is not None


def start_from(
    program: Program,
    problem: OptimalControlProblem,
    guess: Mapping[str, Guess] | Solution | None,
) -> Start:
    """Starting point from guesses, from an earlier solution, or from nothing."""
    if not isinstance(guess, Solution):
        return Start(pack(program, guess or default_guess(problem)))
    layouts = [phase.layout for phase in guess.phases]
    old = [layout for layout in layouts if layout is not None]
    comparable = len(old) == len(program.layouts) == len(layouts) and all(
        _alike(a, b) for a, b in zip(old, program.layouts, strict=True)
    )
    if not comparable or guess.variables is None:
        return Start(pack(program, guess_from(problem, guess)))
    same = all(_same_mesh(a, b) for a, b in zip(old, program.layouts, strict=True))
    x = guess.variables if same else pack(program, guess_from(problem, guess))
    rows, variables = guess.row_multipliers, guess.variable_multipliers
    if not guess.status.ok or variables is None:
        return Start(x)
    if not same:
        rows, variables = _moved_multipliers(program, old, rows, variables)
    return Start(x, rows, variables)


def _alike(a: PhaseLayout, b: PhaseLayout) -> bool:
    """Whether two layouts differ in their meshes and degrees only."""
    conditions = [
        (k.initial_rows, k.final_rows, k.end_rows, k.transition, k.next_nodes) for k in (a, b)
    ]
    return (
        type(a.scheme) is type(b.scheme)
        and conditions[0] == conditions[1]
        and _content(a) == _content(b)
    )


def _content(layout: PhaseLayout) -> set[tuple[str, str, int, float]]:
    """Kind, name, component and scale of everything that a stage may hold."""
    entries = [
        entry
        for kind in layout.kinds
        for entry in (*stage_rows(layout, kind), *inner_variables(kind))
    ]
    return {(kind, name, i, scale) for kind, name, i, _, _, _, scale in entries}


def _same_mesh(a: PhaseLayout, b: PhaseLayout) -> bool:
    schemes = [[k.kinds[i].scheme for i in k.kind_of] for k in (a, b)]
    sizes = [(k.variable_count, k.row_count) for k in (a, b)]
    return np.array_equal(a.mesh, b.mesh) and sizes[0] == sizes[1] and schemes[0] == schemes[1]


# guesses ------------------------------------------------------------------------------------------


def default_guess(problem: OptimalControlProblem) -> dict[str, Guess]:
    """Straight lines between the end conditions, or the middle of the bounds, or zero."""
    guesses = {}
    for phase in problem.phases:
        values = {}
        for variable in node_variables(phase):
            start, end = (_middle(variable, which) for which in ("initial", "final"))
            values[variable.name] = partial(_line, start, end)
        low, high = phase.duration_bounds
        guesses[phase.name] = Guess(float(np.sqrt(low * min(high, 1e3 * low))), values)
    return guesses


def _middle(variable: Variable, which: str) -> FloatArray:
    low, high = variable.lower, variable.upper
    condition = getattr(variable, which)
    if condition is not None:
        low, high = np.maximum(low, condition[0]), np.minimum(high, condition[1])
    both = np.isfinite(low) & np.isfinite(high)
    with np.errstate(invalid="ignore"):
        return np.where(both, (low + high) / 2, np.clip(0.0, low, high))


def _line(start: FloatArray, end: FloatArray, s: FloatArray) -> FloatArray:
    return start + s[:, None] * (end - start)


def guess_from(problem: OptimalControlProblem, solution: Solution) -> dict[str, Guess]:
    """Guesses for the phases of a problem from a solution of it or of a similar one.

    Phases of the same names take over each other's values. Where the names differ, the whole
    solution is cut into as many pieces of equal duration as the problem has phases. What the
    solution does not have starts from the default guess.
    """
    known = {phase.name: phase for phase in solution.phases}
    ordinary = default_guess(problem)
    guesses = {}
    matched = all(phase.name in known for phase in problem.phases)
    for index, phase in enumerate(problem.phases):
        if matched:
            pieces: tuple[PhaseSolution, ...] = (known[phase.name],)
            share = (0.0, 1.0)
        else:
            pieces = solution.phases
            share = (index / len(problem.phases), (index + 1) / len(problem.phases))
        whole = sum(piece.duration for piece in pieces)
        values: dict[str, GuessValue] = dict(ordinary[phase.name].values)
        for variable in [*phase.states, *phase.controls, *phase.algebraics]:
            if all(_has(piece, variable) for piece in pieces):
                values[variable.name] = partial(_along, pieces, variable.name, share)
        duration = float(np.clip(whole * (share[1] - share[0]), *phase.duration_bounds))
        guesses[phase.name] = Guess(duration, values)
    return guesses


def _has(piece: PhaseSolution, variable: Variable) -> bool:
    return variable.name in piece.values and piece[variable.name].shape[-1] == variable.size


def _along(
    pieces: Sequence[PhaseSolution], name: str, share: tuple[float, float], s: FloatArray
) -> FloatArray:
    """Values [M, size] of a variable at fractions [M] of a share of the pieces."""
    edges = np.cumsum([0.0, *(piece.duration for piece in pieces)])
    t = (share[0] + s * (share[1] - share[0])) * edges[-1]
    which = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(pieces) - 1)
    result = np.zeros((t.size, pieces[0][name].shape[-1]))
    for index, piece in enumerate(pieces):
        own = which == index
        if own.any():
            result[own] = _values(piece, name, t[own] - edges[index])
    return result


def _values(piece: PhaseSolution, name: str, t: FloatArray) -> FloatArray:
    if piece.layout is not None:
        return piece.sample(t)[name]
    table, share = piece[name], np.clip(t / piece.duration, 0.0, 1.0)
    if table.ndim == 2 and table.shape[0] == piece.mesh.size:
        return np.column_stack([np.interp(share, piece.mesh, column) for column in table.T])
    k = np.searchsorted(piece.mesh, share, side="right") - 1
    if piece.degrees is not None and table.shape[0] == piece.degrees.sum():
        first = np.cumsum(piece.degrees) - piece.degrees
        flat = np.add.reduceat(table, first) / piece.degrees[:, None]
    else:
        flat = table if table.ndim == 2 else table.mean(axis=1)  # of the points of every interval
    return flat[np.clip(k, 0, flat.shape[0] - 1)]


# multipliers on another mesh ----------------------------------------------------------------------


def _moved_multipliers(
    program: Program, old: Sequence[PhaseLayout], rows: FloatArray, variables: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Multipliers for a program from those of the same problem on another mesh."""
    new_rows = np.zeros(program.row_lower.size)
    new_variables = np.zeros(program.variable_lower.size)
    for before, after in zip(old, program.layouts, strict=True):
        for which in ("start", "end"):
            new_rows[_fixed_rows(after, which)] = rows[_fixed_rows(before, which)]
        _move(_row_series(before), _row_series(after), rows, new_rows)
        _move(_variable_series(before), _variable_series(after), variables, new_variables)
        _move_nodes(before, after, variables, new_variables)
    return new_rows, new_variables


def _fixed_rows(layout: PhaseLayout, which: str) -> np.ndarray:
    """Rows that do not belong to an interval."""
    if which == "start":
        return layout.start_row + np.arange(len(layout.initial_rows))
    return np.arange(layout.last_row, layout.row_offset + layout.row_count)


@dataclass(frozen=True, eq=False)
class _Series:
    """Multipliers of one kind along a phase: where they stand, and what they weigh.

    Attributes
    ----------
    places : fractions of the phase [M], increasing
    indices : in the program [M]
    weights : of a multiplier against its density along the phase [M]
    """

    places: FloatArray
    indices: np.ndarray
    weights: FloatArray


Key = tuple[str, str, int, float]


def _row_series(layout: PhaseLayout) -> dict[Key, _Series]:
    return _series(layout, [(stage_rows(layout, g.kind), g.rows) for g in layout.groups])


def _variable_series(layout: PhaseLayout) -> dict[Key, _Series]:
    inner = [g.variables[:, layout.node_size :] for g in layout.groups]
    kinds = [inner_variables(g.kind) for g in layout.groups]
    return _series(layout, list(zip(kinds, inner, strict=True)))


def _series(
    layout: PhaseLayout, tables: Sequence[tuple[Iterable[Entry], np.ndarray]]
) -> dict[Key, _Series]:
    """Everything that has the same name and stands at the same kind of point."""
    found: dict[Key, list[FloatArray]] = {}
    for group, (entries, table) in zip(layout.groups, tables, strict=True):
        start, h = layout.mesh[group.intervals], np.diff(layout.mesh)[group.intervals]
        scheme = group.kind.scheme
        shares = (
            dict(zip(scheme.points, scheme.weights, strict=True))
            if isinstance(scheme, Collocation)
            else {}
        )
        for column, (kind, name, i, _, fraction, _, _) in enumerate(entries):
            # at points of collocation all belongs together, whatever the degree
            point = np.inf if fraction in shares else fraction
            weight = np.full(h.size, shares.get(fraction, 1.0) if kind != "step" else 1.0)
            if kind not in ("step", "defect"):  # those are values of the costate
                weight = weight * h
            part = np.vstack([start + fraction * h, table[:, column], weight])
            found.setdefault((kind, name, i, point), []).append(part)
    series = {}
    for key, parts in found.items():
        places, indices, weights = np.hstack(parts)
        order = np.argsort(places, kind="stable")
        series[key] = _Series(places[order], indices[order].astype(int), weights[order])
    return series


def _move(
    before: Mapping[Key, _Series],
    after: Mapping[Key, _Series],
    values: FloatArray,
    new_values: FloatArray,
) -> None:
    for key, new in after.items():
        if key in before:
            old = before[key]
            density = values[old.indices] / old.weights
            moved = np.interp(new.places, old.places, density)
            new_values[new.indices] = moved * new.weights


def _move_nodes(
    before: PhaseLayout, after: PhaseLayout, variables: FloatArray, new_variables: FloatArray
) -> None:
    old_around, new_around = (
        (np.append(h, 0.0) + np.insert(h, 0, 0.0)) / 2
        for h in (np.diff(before.mesh), np.diff(after.mesh))
    )
    for old, new in zip(before.nodes.T, after.nodes.T, strict=True):
        density = variables[old] / old_around
        new_variables[new] = np.interp(after.mesh, before.mesh, density) * new_around


# what is not a number -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Term:
    """An expression of a phase with the name that its user knows it by."""

    label: str
    expression: ca.MX
    at_end: bool = False


def check_start(program: Program, x: FloatArray) -> None:
    """Refuse a start at which the user's expressions or their slopes are not finite.

    The guess is looked at where a solver will: a little inside its bounds.

    Raises
    ------
    InputError
        Names the expression, the place and the variable that it comes from.
    """
    x = _inside(program, x)
    f, slope = program.functions["gradient"](x, program.parameters)
    g, jacobian = program.functions["jacobian"](x, program.parameters)
    if all(np.isfinite(value.nonzeros()).all() for value in (f, slope, g, jacobian)):
        return
    for slopes in (False, True):
        for layout, phase in zip(program.layouts, unpack(program, x), strict=True):
            for term in _terms(layout.phase):
                _check_term(layout, phase, term, slopes)
    raise InputError(
        "the guess gives values that are not finite between mesh points: give a guess nearer to a "
        "real trajectory"
    )


def _inside(program: Program, x: FloatArray) -> FloatArray:
    low, high = program.variable_lower, program.variable_upper
    width = np.where(np.isfinite(high - low), high - low, np.inf)
    with np.errstate(invalid="ignore"):
        below, above = (
            np.minimum(PUSH * np.maximum(1.0, np.abs(bound)), PUSH * width) for bound in (low, high)
        )
        floor = np.where(np.isfinite(low), low + below, -np.inf)
        ceiling = np.where(np.isfinite(high), high - above, np.inf)
    return np.clip(x, floor, ceiling)


def _terms(phase: Phase) -> Iterator[_Term]:
    for name, expression in phase.derivatives.items():
        yield _Term(f"the dynamics of state {name!r}", expression)
    for limit in phase.constraints:
        yield _Term(f"constraint {limit.name!r}", limit.expression)
    for equation in phase.algebraic_equations:
        yield _Term("an algebraic equation", equation)
    for cost in phase.running_costs:
        yield _Term("a running cost", cost)
    for limit in phase.end_constraints:
        yield _Term(f"end constraint {limit.name!r}", limit.expression, at_end=True)
    for cost in phase.end_costs:
        yield _Term("an end cost", cost, at_end=True)


def _check_term(layout: PhaseLayout, values: PhaseSolution, term: _Term, slopes: bool) -> None:
    phase = layout.phase
    symbols, tables, times, intervals = _points(layout, values, at_end=term.at_end)
    named = [symbol for _, symbol in symbols]
    expression = term.expression
    if slopes:
        expression = ca.jacobian(expression, ca.vertcat(*named))
    function = ca.Function("term", named, [ca.densify(expression)], {"allow_free": True})
    for column in range(times.size):
        point = [table[:, column] for table in tables]
        result = np.array(function(*point))
        if np.isfinite(result).all():
            continue
        what = "slope" if slopes else "value"
        place = "at its end" if term.at_end else f"in interval {intervals[column] + 1}"
        bad = result[~np.isfinite(result)][0]
        raise InputError(
            f"the {what} of {term.label} of phase {phase.name!r} is {bad:g} at the guess {place} "
            f"(t = {times[column]:.4g} s): {_cause(function, symbols, point)}"
        )


def _points(
    layout: PhaseLayout, values: PhaseSolution, *, at_end: bool
) -> tuple[list[tuple[str, ca.MX]], list[FloatArray], FloatArray, np.ndarray]:
    """Symbols of a phase, their values [size, M], times and intervals of some points."""
    phase = layout.phase
    rates = [c for c in phase.controls if c.rate is not None]
    fractions = np.array([1.0]) if at_end else np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    intervals = np.arange(layout.intervals)[-1:] if at_end else np.arange(layout.intervals)
    h = np.diff(values.mesh)
    k = np.repeat(intervals, fractions.size)
    share = np.tile(fractions, intervals.size)
    x, u = _dense(layout, values, k, share)
    order = [
        *(c for s in ("constant", "linear") for c in phase.controls if c.shape == s),
        *pointwise(phase),
    ]
    names: list[tuple[str, ca.MX]] = []
    tables: list[FloatArray] = []
    for group, table in ((phase.states, x), (order, u)):
        offset = 0
        for variable in group:
            names.append((variable.name, variable.symbol))
            tables.append(table[offset : offset + variable.size])
            offset += variable.size
    for control in rates:
        assert control.rate is not None
        names.append((f"the rate of {control.name}", control.rate))
        slope = np.diff(values[control.name], axis=0).T / (h * values.duration)
        tables.append(slope[:, k])
    for parameter in phase.parameters:
        names.append((parameter.name, parameter.symbol))
        tables.append(np.tile(parameter.value[:, None], (1, k.size)))
    times = (values.mesh[k] + share * h[k]) * values.duration
    names += [("time", phase.time), ("duration", phase.duration)]
    tables += [times[None, :], np.full((1, k.size), values.duration)]
    return names, tables, times, k


def _dense(
    layout: PhaseLayout, values: PhaseSolution, k: np.ndarray, share: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """States and controls at fractions of intervals; values at mesh points as they are guessed."""
    assert values.stages is not None
    x, u = layout.dense(values.stages, k, share)
    # inside an interval the state follows from the dynamics, which may be what is wrong
    start = np.vstack([values[v.name][:-1].T for v in layout.phase.states])
    end = np.vstack([values[v.name][1:].T for v in layout.phase.states])
    straight = start[:, k] + share * (end - start)[:, k]
    bad = ~np.isfinite(x).all(axis=0) | (share == 0.0) | (share == 1.0)
    return np.where(bad, straight, x), u


_OPERATIONS: dict[int, Callable[[float, float], str]] = {
    ca.OP_SQRT: lambda a, _: f"the square root of {a:.4g}",
    ca.OP_LOG: lambda a, _: f"the logarithm of {a:.4g}",
    ca.OP_DIV: lambda a, b: f"{a:.4g} divided by {b:.4g}",
    ca.OP_INV: lambda a, _: f"1 divided by {a:.4g}",
    ca.OP_POW: lambda a, b: f"{a:.4g} to the power {b:.4g}",
    ca.OP_CONSTPOW: lambda a, b: f"{a:.4g} to the power {b:.4g}",
    ca.OP_ASIN: lambda a, _: f"the arcsine of {a:.4g}",
    ca.OP_ACOS: lambda a, _: f"the arccosine of {a:.4g}",
    ca.OP_EXP: lambda a, _: f"the exponential of {a:.4g}",
    ca.OP_TAN: lambda a, _: f"the tangent of {a:.4g}",
    ca.OP_ATANH: lambda a, _: f"the inverse hyperbolic tangent of {a:.4g}",
    ca.OP_ACOSH: lambda a, _: f"the inverse hyperbolic cosine of {a:.4g}",
}


def _cause(
    function: ca.Function, symbols: Sequence[tuple[str, ca.MX]], point: Sequence[FloatArray]
) -> str:
    """The first operation that leaves the finite numbers, and the variables behind it."""
    try:
        scalar = function.expand()
    except RuntimeError:  # calls that have no scalar graph
        used = [
            _entry(name, values, i)
            for k, ((name, _), values) in enumerate(zip(symbols, point, strict=True))
            for i in range(values.size)
            if function.which_depends(function.name_in(k), function.name_out())[i]
        ]
        return "it depends on " + ", ".join(used)
    work: dict[int, float] = {}
    sources: dict[int, frozenset[tuple[int, int]]] = {}
    for k in range(scalar.n_instructions()):
        operation = scalar.instruction_id(k)
        inputs, outputs = scalar.instruction_input(k), scalar.instruction_output(k)
        if operation == ca.OP_INPUT:
            work[outputs[0]] = float(point[inputs[0]][inputs[1]])
            sources[outputs[0]] = frozenset({(inputs[0], inputs[1])})
        elif operation == ca.OP_CONST:
            work[outputs[0]] = scalar.instruction_constant(k)
            sources[outputs[0]] = frozenset()
        elif operation != ca.OP_OUTPUT:
            a, b = (work[i] for i in (inputs[0], inputs[-1]))
            value = _apply(operation, a, b)
            behind = frozenset().union(*(sources[i] for i in inputs))
            if not np.isfinite(value) and np.isfinite(a) and np.isfinite(b):
                said = _OPERATIONS.get(operation, lambda a, b: f"an operation on {a:.4g}")(a, b)
                used = [_entry(symbols[i][0], point[i], j) for i, j in sorted(behind)]
                return said + (f", from {', '.join(used)}" if used else "")
            work[outputs[0]], sources[outputs[0]] = value, behind
    return "a parameter or variable is not finite"


def _apply(operation: int, a: float, b: float) -> float:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    result = ca.SX.binary(operation, x, y)  # of unary operations too, without their second input
    return float(ca.Function("one", [x, y], [result])(a, b))


def _entry(name: str, values: FloatArray, index: int) -> str:
    label = name if values.size == 1 else f"{name}[{index}]"
    return f"{label} = {values[index]:.4g}"
