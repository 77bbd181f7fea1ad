"""What to do about a solve that did not converge, in the names and units of the problem."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.diagnosis._finiteness import not_finite
from microbot_ocp.ocp.solution import Attempt, Start, violations
from microbot_ocp.ocp.transcription import (
    Program,
    RowLabel,
    VariableLabel,
    row_labels,
    variable_labels,
)

VIOLATED = 1e-6  # scaled; less is no reason to fail
POOR = 1e3  # a variable this many times its scale, or a row that changes so much, is badly scaled
FAR = 0.1  # scaled violation of the dynamics by a guess that is worth a word
DYNAMICS = ("step", "defect", "equation")


def advice(program: Program, begin: Start, x: FloatArray, attempts: Sequence[Attempt]) -> str:
    """What went wrong and what would help, one sentence a line.

    Parameters
    ----------
    program : Program
    begin : where the solve started
    x : scaled variables at its end
    attempts : the solvers that were tried; the last one left x
    """
    status, start = attempts[-1].status, begin.x
    if status in (Status.SOLVED, Status.INTERRUPTED):
        return status.sentence
    lines = [status.sentence]
    lines += [
        f"The solver {attempt.solver} stopped with: {attempt.message}"
        for attempt in attempts
        if attempt.broke_down
    ]
    lines += _overdetermined(program)
    rows, variables = row_labels(program), variable_labels(program)
    if not np.isfinite(x).all():
        lines.append("The last iterate is not finite: what follows is about the start.")
        x = start
    said = not_finite(program, x, "the last iterate")
    if said is not None:
        lines.append(
            f"{said[0].upper()}{said[1:]}; keep away from there by a bound or a better guess."
        )
    else:
        lines += _most_violated(program, rows, variables, x)
    lines += _guess(program, rows, start)
    if begin.missing:
        lines.append(f"Not in the solution that it started from: {', '.join(begin.missing)}.")
    lines += _badly_scaled(program, rows, variables, x)
    if said is None and attempts[-1].infeasibility > VIOLATED:
        lines.append("Call explain(problem, mesh, solution): it tells whether the limits conflict.")
    return "\n".join(lines)


def _rows_at(program: Program, x: FloatArray) -> FloatArray:
    return np.array(program.functions["jacobian"](x, program.parameters)[0]).ravel()


def _most_violated(
    program: Program,
    rows: Sequence[RowLabel],
    variables: Sequence[VariableLabel],
    x: FloatArray,
) -> Iterator[str]:
    excess = np.concatenate(violations(program, x, _rows_at(program, x)))
    worst = int(np.argmax(excess))
    if excess[worst] > VIOLATED:
        label = [*rows, *variables][worst]
        yield f"Most violated: {_placed(program, label, x)}, by {_amount(label, excess[worst])}."


def _guess(program: Program, rows: Sequence[RowLabel], start: FloatArray) -> Iterator[str]:
    excess, _ = violations(program, start, _rows_at(program, start))
    own = np.where([label.kind in DYNAMICS for label in rows], excess, 0.0)
    worst = int(np.argmax(own))
    if own[worst] > FAR:
        label = rows[worst]
        yield (
            f"The guess was no trajectory: it misses the {_placed(program, label, start)}, by "
            f"{_amount(label, own[worst])}; simulate one with a plausible control, or solve on a "
            "coarser mesh first."
        )


def _badly_scaled(
    program: Program,
    rows: Sequence[RowLabel],
    variables: Sequence[VariableLabel],
    x: FloatArray,
) -> Iterator[str]:
    found: dict[tuple[str, str], tuple[float, VariableLabel]] = {}
    for value, label in zip(np.abs(x).tolist(), variables, strict=True):
        key = (label.phase, label.component_name)
        if label.kind != "transition" and value > found.get(key, (POOR, label))[0]:
            found[key] = (value, label)
    for value, label in found.values():
        yield (
            f"The {label.words} of phase {label.phase!r} reaches {_amount(label, value)}, "
            f"{value:.2g} times its scale of {label.scale:g}: declare scale={_power(label, value)}."
        )
    jacobian = program.functions["jacobian"](x, program.parameters)[1]
    entries = np.abs(np.array(jacobian.nonzeros()))
    steep: dict[tuple[str, str, str], tuple[float, RowLabel]] = {}
    for row, value in zip(jacobian.sparsity().row(), entries.tolist(), strict=True):
        label = rows[row]
        key = (label.phase, label.kind, label.name)
        if steep.get(key, (POOR, label))[0] < value < np.inf:
            steep[key] = (value, label)
    for value, label in steep.values():
        yield (
            f"The {label.words} of phase {label.phase!r} changes by {value:.2g} times its scale of "
            f"{label.scale:g} when one variable changes by its own: declare a larger scale."
        )


def _overdetermined(program: Program) -> Iterator[str]:
    """Mesh points with more equations than variables, which fatrop refuses."""
    equal = program.row_lower == program.row_upper
    labels: list[RowLabel] = []
    first = 0
    sizes = zip(program.nodes, program.controls, program.constraints, strict=True)
    for index, (node, control, count) in enumerate(sizes):
        step = program.nodes[index + 1] if index + 1 < len(program.nodes) else 0
        own = first + step + np.arange(count)
        first += step + count
        equations = own[equal[own]]
        if equations.size > node + control:
            labels = row_labels(program)
            names = dict.fromkeys(labels[i].words for i in equations)
            label = labels[equations[0]]
            yield (
                f"There are {equations.size} equations ({', '.join(names)}) for {node + control} "
                f"variables in interval {label.interval + 1} of phase {label.phase!r}: leave some "
                "out."
            )
            return


def _placed(program: Program, label: RowLabel | VariableLabel, x: FloatArray) -> str:
    layout = next(k for k in program.layouts if k.phase.name == label.phase)
    duration = float(x[layout.variable_offset + layout.node_size - 1] * layout.node_scale[-1])
    return f"{label.words} in phase {label.phase!r} at t = {label.place(layout) * duration:.4g} s"


def _amount(label: RowLabel | VariableLabel, scaled: float) -> str:
    return f"{scaled * label.scale:.4g} {label.unit}".rstrip()


def _power(label: VariableLabel, value: float) -> str:
    return f"{10.0 ** np.round(np.log10(value * label.scale)):g}"
