"""The program that a solution belongs to, formed anew from the declared problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.ocp.problem import OptimalControlProblem, Variable, node_variables
from microbot_ocp.ocp.solution import Solution
from microbot_ocp.ocp.transcription import (
    Kernels,
    PhaseLayout,
    Program,
    Transcription,
    build_kernels,
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
    last = program.layouts[-1]
    x = np.zeros(last.variable_offset + last.variable_count)
    for layout, phase in zip(program.layouts, solution.phases, strict=True):
        assert phase.stages is not None
        end = [phase.values[v.name][-1] for v in node_variables(layout.phase)]
        x[layout.variable_offset : layout.last_node] = phase.stages
        node = np.append(np.concatenate(end), phase.duration) / layout.node_scale
        x[layout.last_node : layout.last_node + layout.node_size] = node
    for index, layout in enumerate(program.layouts[:-1]):
        for source, target, factor in link_places(program, index):
            if source >= layout.last_node + layout.node_size:  # a transition control
                x[source] = x[target] / factor
    return x


def link_places(program: Program, index: int) -> list[tuple[int, int, float]]:
    """Source, target and factor of the rows ``x[target] - factor x[source] = 0`` after a phase."""
    layout, after = program.layouts[index : index + 2]
    kept = next(k.names for k in program.links if k.before == layout.phase.name)
    place: dict[str, tuple[int, Variable]] = {}
    offset = layout.last_node
    for variable in node_variables(layout.phase):
        place[variable.name] = (offset, variable)
        offset += variable.size
    free, target = layout.last_node + layout.node_size, after.variable_offset
    found = []
    for variable in node_variables(after.phase):
        for i in range(variable.size):
            if variable.name in kept:
                start, before = place[variable.name]
                source, factor = start + i, float(before.scale[i] / variable.scale[i])
            else:
                source, factor, free = free, 1.0, free + 1
            found.append((source, target, factor))
            target += 1
    return [*found, (free, target, 1.0)]  # the duration


def plain_kernels(layout: PhaseLayout) -> list[Kernels]:
    """Kernels without derivatives and not compiled: what is differentiated here is the original."""

    def derive(stage: ca.Function, end: ca.Function) -> Sequence[ca.Function]:
        return [stage, stage, stage, end, end, end]

    scale = float(layout.node_scale[-1])
    return [build_kernels(layout.phase, scale, kind.scheme, derive) for kind in layout.kinds]


def limited_alike(layout: PhaseLayout, plain: Sequence[Kernels]) -> PhaseLayout:
    """The layout with the limits of its phase, which may be others than those declared."""
    limits = [
        {name: getattr(own, name) for name in vars(own) if name.endswith(("_lower", "_upper"))}
        for own in plain
    ]
    kinds = tuple(
        replace(kind, kernels=replace(kind.kernels, **own))
        for kind, own in zip(layout.kinds, limits, strict=True)
    )
    return replace(layout, kinds=kinds)
