"""A solution in the terms of the problem that was declared, not of the program that was solved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase, node_variables
from microbot_ocp.ocp.solution import PhaseSolution, Solution
from microbot_ocp.ocp.starts import problem_data, with_problem_data
from microbot_ocp.ocp.transcription import (
    PhaseLayout,
    PointGroup,
    Transcription,
    fill_transitions,
    stage_kind,
)


def as_declared(
    problem: OptimalControlProblem | Transcription, solution: Solution
) -> tuple[PhaseSolution, ...]:
    """Return the phases of a solution with the declared expressions and the data of the solve.

    Limits, conditions, parameters and scales may be others than those declared, see
    :class:`~microbot_ocp.ocp.ParametricSolver`. Kernels are built anew, without derivatives; of
    the program that was solved only the places of its rows and variables stay.

    Raises
    ------
    InputError
        The solution is of another problem.
    """
    stated = problem.problem if isinstance(problem, Transcription) else problem
    names = [phase.name for phase in stated.phases]
    if names != [phase.name for phase in solution.phases]:
        raise InputError(
            f"the solution has phases {[p.name for p in solution.phases]}, but problem "
            f"{stated.name!r} has {names}"
        )
    restated = []
    for declared, phase in zip(stated.phases, solution.phases, strict=True):
        given = phase.laid_out
        layout = _laid_out(with_problem_data(declared, problem_data(given)), given)
        same = [[block.entries for block in (*k.rows, *k.variables)] for k in (layout, given)]
        if same[0] != same[1]:
            raise InputError(
                f"phase {declared.name!r} of the solution has other variables or constraints than "
                f"that of problem {stated.name!r}"
            )
        restated.append(replace(phase, layout=layout))
    return tuple(restated)


def _laid_out(phase: Phase, given: PhaseLayout) -> PhaseLayout:
    """Return a layout with the places of another, and kernels of its own."""

    def derive(functions: Sequence[ca.Function], _: object) -> Sequence[ca.Function]:
        # differentiated here, not by the builder
        return [function for function in functions for _ in range(3)]

    kind = stage_kind(phase, given.kind.scheme, float(given.node_scale[-1]), derive)
    points = tuple(
        PointGroup(kernel, replace(point.block, entries=kernel.rows))
        for point, kernel in zip(given.points, kind.kernels.points, strict=True)
    )
    return replace(given, phase=phase, kind=kind, points=points)


def scaled_variables(phases: Sequence[PhaseSolution]) -> FloatArray:
    """Return variables of the program, from the stages and the last mesh values of every phase."""
    layouts = [phase.laid_out for phase in phases]
    x = np.zeros(sum(layout.variable_count for layout in layouts))
    for layout, phase in zip(layouts, phases, strict=True):
        assert phase.stages is not None
        end = [phase.values[v.name][-1] for v in node_variables(layout.phase)]
        x[layout.stages] = phase.stages
        x[layout.nodes[-1]] = np.append(np.concatenate(end), phase.duration) / layout.node_scale
    fill_transitions(layouts, x)
    return x
