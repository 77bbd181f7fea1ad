"""Advice on a solve that did not converge, in the names and units of the problem."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.outcome import Advice, remark
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.diagnosis._finiteness import not_finite
from microbot_ocp.ocp.solution import Attempt, StartingPoint
from microbot_ocp.ocp.transcription import DURATION, Label, Program

VIOLATED = 1e-6  # scaled violation above which a row is reported
POOR = 1e3  # value of a variable, or slope of a row, in units of scales, that counts as bad scaling
GUESS_DEFECT = 0.1  # scaled violation of the dynamics by a guess above which it is reported
DYNAMICS = ("step", "defect", "equation")
NO_COST = "No cost is declared: every solution within the constraints is optimal."


def advice(
    program: Program, begin: StartingPoint, x: FloatArray, attempts: Sequence[Attempt]
) -> tuple[Advice, ...]:
    """Return the status of a solve, followed by its problems and remedies.

    Parameters
    ----------
    program : Program
    begin : StartingPoint
        Point at which the solve started.
    x : numpy.ndarray
        Scaled variables at its end.
    attempts : sequence of Attempt
        Attempts of the solvers; the last one ended at x.
    """
    status, start = attempts[-1].status, begin.x
    if status is Status.SOLVED and not any(k.phase.has_cost for k in program.layouts):
        return Advice("status", status.sentence), remark(NO_COST)
    rows = [Advice("status", status.sentence)]
    if status in (Status.SOLVED, Status.INTERRUPTED) or deadline.over():
        return tuple(rows)
    if falls_for_ever(attempts[-1].cost, program.cost_scale):
        worst = int(np.argmax(np.abs(x)))
        label = program.variable_labels[worst]
        sentence = (
            f"The cost seems to be unbounded: it fell to {attempts[-1].cost:.2g}, while the "
            f"{label.description} of phase {label.phase!r} reached {_amount(label, x[worst])}; "
            "bound the variables that grow."
        )
        return *rows, Advice("unbounded", sentence)
    broken = [attempt for attempt in attempts if attempt.broke_down]
    rows += [Advice("solver", f"The solver {a.solver} stopped with: {a.message}") for a in broken]
    if status is Status.GAP_LEFT:
        rows.append(Advice("gap", f"The cost is {attempts[-1].message}."))
    rows += [Advice("program", sentence) for sentence in _overdetermined(program)]
    if not np.isfinite(x).all():
        rows.append(remark("The last iterate is not finite: the advice below is about the start."))
        x = start
    complaint = not_finite(program, x, "the last iterate")
    if complaint is not None:
        sentence = (
            f"{complaint[0].upper()}{complaint[1:]}; exclude such values by a bound or a better "
            "guess."
        )
        rows.append(remark(sentence))
    else:
        rows += _most_violated(program, x)
    rows += _guess(program, start)
    if begin.missing:
        names = ", ".join(begin.missing)
        rows.append(Advice("program", f"The solution given as start has no values for: {names}."))
    rows += [Advice("program", sentence) for sentence in _badly_scaled(program, x)]
    if complaint is None and attempts[-1].infeasibility > VIOLATED:
        sentence = "Call explain(problem, mesh, solution): it tells whether the limits conflict."
        rows.append(Advice("program", sentence))
    return tuple(rows)


def falls_for_ever(cost: float, scale: float) -> bool:
    """Return True if a cost is so negative that half of the digits of its scale are lost."""
    return bool(cost < -scale / np.sqrt(np.finfo(float).eps))


def _most_violated(program: Program, x: FloatArray) -> Iterator[Advice]:
    excess = program.violations(x, program.row_values(x))
    labels = [*program.row_labels, *program.variable_labels]
    # A phase that is too short violates its duration steps, but these are not the cause.
    causes = np.array([not (k.kind == "step" and k.name == DURATION) for k in labels])
    worst = int(np.argmax(np.where(causes, excess, 0.0)))
    if excess[worst] > VIOLATED:
        label = labels[worst]
        at, amount = _placed(program, label, x), _amount(label, excess[worst])
        yield Advice(
            "violation",
            f"Most violated: {at}, by {amount}.",
            at,
            float(excess[worst] * label.scale),
            label.unit,
            (label, program.time_of(label, x)),
        )


def _guess(program: Program, start: FloatArray) -> Iterator[Advice]:
    rows = program.row_labels
    excess = program.violations(start, program.row_values(start))[: len(rows)]
    defects = np.where([label.kind in DYNAMICS for label in rows], excess, 0.0)
    worst = int(np.argmax(defects))
    if defects[worst] > GUESS_DEFECT:
        label = rows[worst]
        sentence = (
            f"The guess is no trajectory: it violates the {_placed(program, label, start)}, by "
            f'{_amount(label, defects[worst])}; start from guess="rollout", a simulation, or a '
            "solution on a coarser mesh."
        )
        yield Advice("program", sentence)


def _badly_scaled(program: Program, x: FloatArray) -> Iterator[str]:
    largest: dict[tuple[str, str], tuple[float, Label]] = {}
    for value, label in zip(np.abs(x).tolist(), program.variable_labels, strict=True):
        key = (label.phase, label.component_name)
        if label.kind != "transition" and value > largest.get(key, (POOR, label))[0]:
            largest[key] = (value, label)
    for value, label in largest.values():
        yield (
            f"The {label.description} of phase {label.phase!r} reaches {_amount(label, value)}, "
            f"{value:.2g} times its scale of {label.scale:g}: declare scale={_power(label, value)}."
        )
    jacobian = program.functions["jacobian"](x, program.parameters)[1]
    entries = np.abs(np.array(jacobian.nonzeros()))
    steep: dict[tuple[str, str, str], tuple[float, Label]] = {}
    for row, value in zip(jacobian.sparsity().row(), entries.tolist(), strict=True):
        label = program.row_labels[row]
        key = (label.phase, label.kind, label.name)
        if steep.get(key, (POOR, label))[0] < value < np.inf:
            steep[key] = (value, label)
    for value, label in steep.values():
        yield (
            f"The {label.description} of phase {label.phase!r} changes by {value:.2g} times its "
            f"scale of {label.scale:g} when one variable changes by its scale: declare a larger "
            "scale."
        )


def _overdetermined(program: Program) -> Iterator[str]:
    """Yield a sentence on the first mesh point with more equations than variables.

    The solver fatrop rejects such programs.
    """
    counts: dict[tuple[str, int], list[Label]] = {}
    equal = program.row_lower == program.row_upper
    for label, demanded in zip(program.row_labels, equal, strict=True):
        if demanded and label.kind not in ("step", "link"):
            counts.setdefault((label.phase, label.interval), []).append(label)
    for layout in program.layouts:
        nodes, controls, _ = layout.stage_sizes
        for interval, variables in enumerate((nodes + controls).tolist()):
            equations = counts.get((layout.phase.name, interval), [])
            if len(equations) > variables:
                names = ", ".join(dict.fromkeys(label.description for label in equations))
                yield (
                    f"There are {len(equations)} equations ({names}) for {variables} variables in "
                    f"interval {interval + 1} of phase {layout.phase.name!r}: leave some out."
                )
                return


def _placed(program: Program, label: Label, x: FloatArray) -> str:
    t = program.time_of(label, x)
    return f"{label.description} in phase {label.phase!r} at t = {t:.4g} s"


def _amount(label: Label, scaled: float) -> str:
    return f"{scaled * label.scale:.4g} {label.unit}".rstrip()


def _power(label: Label, value: float) -> str:
    return f"{10.0 ** np.round(np.log10(value * label.scale)):g}"
