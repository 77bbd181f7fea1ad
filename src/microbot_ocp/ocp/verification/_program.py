"""The program that a solution belongs to, formed anew from the declared problem."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.ocp.problem import OptimalControlProblem, node_variables
from microbot_ocp.ocp.solution import Solution
from microbot_ocp.ocp.transcription import (
    Kernels,
    PhaseLayout,
    Program,
    Transcription,
    build_kernels,
    fill_transitions,
)
from microbot_ocp.ocp.verification._reintegration import phase_layout


def transcription_of(
    problem: OptimalControlProblem | Transcription, solution: Solution
) -> Transcription:
    """A transcription of the problem that a solution is one of; InputError where it is not."""
    layouts = [phase_layout(phase) for phase in solution.phases]
    own = problem.problem if isinstance(problem, Transcription) else problem
    names = [phase.name for phase in own.phases]
    if names != [phase.name for phase in solution.phases]:
        raise InputError(
            f"the solution has phases {[p.name for p in solution.phases]}, but problem "
            f"{own.name!r} has {names}"
        )
    if isinstance(problem, Transcription):
        made = problem
    else:
        made = Transcription(problem, scheme=layouts[0].scheme)
    fresh = made.layouts([layout.chosen for layout in layouts])
    for mine, given in zip(fresh, layouts, strict=True):
        if mine.variable_count != given.variable_count or mine.row_count != given.row_count:
            raise InputError(
                f"phase {mine.phase.name!r} of the solution has other variables or constraints "
                f"than that of problem {own.name!r}"
            )
    return made


def scaled_variables(program: Program, solution: Solution) -> FloatArray:
    """Variables of the program, from the stages and the last mesh values of every phase."""
    x = np.zeros(program.variable_lower.size)
    for layout, phase in zip(program.layouts, solution.phases, strict=True):
        assert phase.stages is not None
        end = [phase.values[v.name][-1] for v in node_variables(layout.phase)]
        x[layout.stages] = phase.stages
        x[layout.nodes[-1]] = np.append(np.concatenate(end), phase.duration) / layout.node_scale
    fill_transitions(program.layouts, x)
    return x


def plain_kernels(layout: PhaseLayout) -> list[Kernels]:
    """Kernels without derivatives and not compiled: what is differentiated here is the original."""

    def derive(stage: ca.Function, end: ca.Function) -> Sequence[ca.Function]:
        return [stage, stage, stage, end, end, end]

    scale = float(layout.node_scale[-1])
    return [build_kernels(layout.phase, scale, kind.scheme, derive) for kind in layout.kinds]
