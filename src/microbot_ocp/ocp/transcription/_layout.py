"""Where everything of a phase stands in its program.

Stage by stage the program has the variables (z_k, w_k) and the rows ``z_{k+1} - next(z_k, w_k) =
0``, followed by the defects and constraints of the stage. Intervals may differ in their degree, and
so in the size of w and in their rows: those that are alike make a group, evaluated at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.problem import Phase, Variable, node_variables
from microbot_ocp.ocp.transcription._kernels import Kernels, joined
from microbot_ocp.ocp.transcription._mesh import IntArray, Mesh
from microbot_ocp.ocp.transcription.schemes import Scheme, StageVariable


@dataclass(frozen=True, eq=False)
class StageKind:
    """What the stages of one scheme hold.

    Attributes
    ----------
    scheme : Scheme
    inner : what w holds
    control_scale : scales of w
    kernels : Kernels
    """

    scheme: Scheme
    inner: tuple[StageVariable, ...]
    control_scale: FloatArray
    kernels: Kernels

    @property
    def control_size(self) -> int:
        """Components of w."""
        return self.control_scale.size

    @property
    def row_count(self) -> int:
        """Rows of a stage besides the step to the next z."""
        return self.kernels.stage_lower.size


@dataclass(frozen=True, eq=False)
class StageGroup:
    """The stages of one kind in a phase.

    Attributes
    ----------
    kind : StageKind
    intervals : which intervals [M]
    variables : indices [M, components of (z, w)] in the program
    rows : indices [M, ...] in the program: the step first
    """

    kind: StageKind
    intervals: IntArray
    variables: IntArray
    rows: IntArray


@dataclass(frozen=True, eq=False)
class PhaseLayout:
    """Where one phase stands in the program, and its kernels.

    Attributes
    ----------
    phase : Phase
    mesh : fractions [N+1] from 0 to 1
    degrees : of the intervals [N], where they were chosen one by one
    node_scale : scales of z
    scheme : of all intervals without a degree of their own
    kinds : one a scheme that is used
    kind_of : index [N] of the kind of every interval
    variable_offset, row_offset : where the phase begins
    transition : extra controls at the last mesh point, for the link to the next phase
    initial_rows, final_rows : node components with a condition at the ends
    next_nodes : components of the first z of the next phase, 0 at the last phase
    """

    phase: Phase
    mesh: FloatArray
    degrees: IntArray | None
    node_scale: FloatArray
    scheme: Scheme
    kinds: tuple[StageKind, ...]
    kind_of: IntArray
    variable_offset: int
    row_offset: int
    transition: int
    initial_rows: tuple[int, ...]
    final_rows: tuple[int, ...]
    next_nodes: int

    @property
    def intervals(self) -> int:
        """Number of intervals N."""
        return self.mesh.size - 1

    @property
    def node_size(self) -> int:
        """Components of z."""
        return self.node_scale.size

    @property
    def chosen(self) -> Mesh:
        """The mesh, to be laid out again."""
        return Mesh(self.mesh, self.degrees)

    @property
    def end_rows(self) -> int:
        """Constraints at the last mesh point."""
        return self.kinds[0].kernels.end_lower.size

    @cached_property
    def corners(self) -> IntArray:
        """Index [N+1] of the first component of every z."""
        sizes = np.array([self.node_size + k.control_size for k in self.kinds])[self.kind_of]
        return self.variable_offset + np.concatenate([[0], np.cumsum(sizes)])

    @cached_property
    def nodes(self) -> IntArray:
        """Indices [N+1, node size] of every z."""
        return self.corners[:, None] + np.arange(self.node_size)

    @property
    def last_node(self) -> int:
        """Index of the first component of the last z."""
        return int(self.corners[-1])

    @property
    def variable_count(self) -> int:
        """All variables of the phase."""
        return self.last_node - self.variable_offset + self.node_size + self.transition

    @cached_property
    def stage_row_counts(self) -> IntArray:
        """Rows [N] of every stage besides the step to the next z."""
        return np.array([kind.row_count for kind in self.kinds])[self.kind_of]

    @cached_property
    def stage_row(self) -> IntArray:
        """Index [N] of the first row of every stage."""
        counts = self.node_size + self.stage_row_counts
        counts[0] += len(self.initial_rows)
        return self.row_offset + np.concatenate([[0], np.cumsum(counts)[:-1]])

    @property
    def start_row(self) -> int:
        """Index of the first of the conditions at the start."""
        return self.row_offset + self.node_size + int(self.stage_row_counts[0])

    @property
    def last_row(self) -> int:
        """Index of the first row at the last mesh point."""
        return int(self.stage_row[-1] + self.node_size + self.stage_row_counts[-1])

    @property
    def row_count(self) -> int:
        """All rows of the phase."""
        at_end = self.next_nodes + self.end_rows + len(self.final_rows)
        return self.last_row - self.row_offset + at_end

    @cached_property
    def groups(self) -> tuple[StageGroup, ...]:
        """Stages of the same kind together."""
        found = []
        for index, kind in enumerate(self.kinds):
            own = np.flatnonzero(self.kind_of == index)
            columns = np.arange(self.node_size + kind.control_size)
            rows = np.arange(self.node_size + kind.row_count)
            found.append(
                StageGroup(
                    kind=kind,
                    intervals=own,
                    variables=self.corners[own][:, None] + columns,
                    rows=self.stage_row[own][:, None] + rows,
                )
            )
        return tuple(found)

    def constants(self, intervals: IntArray) -> FloatArray:
        """Second argument of the kernels, for some intervals [..., M]."""
        fixed = joined([p.value for p in self.phase.parameters])
        return np.vstack(
            [
                self.mesh[intervals],
                np.diff(self.mesh)[intervals],
                np.tile(fixed[:, None], (1, intervals.size)),
            ]
        )

    def table(self, stages: FloatArray, group: StageGroup) -> FloatArray:
        """Scaled (z, w) of the stages of a group [M, ...] from those of all stages, in turn."""
        return stages[group.variables - self.variable_offset]

    def dense(
        self, stages: FloatArray, intervals: IntArray, share: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """States [n, M] and controls [m, M] in some intervals [M], at fractions [M] of them.

        Controls are the constant, linear and polynomial ones, then the algebraic variables.
        """
        x: FloatArray = np.zeros((0, 0))
        u: FloatArray = np.zeros((0, 0))
        for index, group in enumerate(self.groups):
            own = np.flatnonzero(self.kind_of[intervals] == index)
            if not own.size and x.size:
                continue
            chosen = np.searchsorted(group.intervals, intervals[own])
            v = self.table(stages, group)[chosen].T
            found = group.kind.kernels.dense(v, self.constants(intervals[own]), share[None, own])
            if not x.size:
                x, u = (np.zeros((k.shape[0], intervals.size)) for k in found)
            x[:, own], u[:, own] = (np.array(k) for k in found)
        return x, u


def condition_bounds(
    layout: PhaseLayout, which: str, rows: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Scaled bounds of some node components at the start ("initial") or end ("final")."""
    low, high = [], []
    for variable in node_variables(layout.phase):
        condition = getattr(variable, which)
        empty = (np.full(variable.size, -np.inf), np.full(variable.size, np.inf))
        a, b = condition if condition is not None else empty
        low.append(a / variable.scale)
        high.append(b / variable.scale)
    keep = list(rows)
    return joined(low)[keep], joined(high)[keep]


def conditioned(nodes: Sequence[Variable], which: str) -> tuple[int, ...]:
    """Node components that have a condition at the start ("initial") or end ("final")."""
    rows, offset = [], 0
    for variable in nodes:
        condition = getattr(variable, which)
        if condition is not None:
            finite = np.isfinite(condition[0]) | np.isfinite(condition[1])
            rows += [offset + int(i) for i in np.flatnonzero(finite)]
        offset += variable.size
    return tuple(rows)
