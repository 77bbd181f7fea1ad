"""Places of the variables and rows of a phase in its program.

For each phase the variables are (z_0, w_0, z_1, w_1, ..., z_N, transition) and the rows
``[z_1 - next(z_0, w_0), constraints_0, start conditions, z_2 - next(z_1, w_1), constraints_1, ...,
link to the next phase, end constraints, end conditions]``: the block order that fatrop requires,
and a banded matrix for other solvers. Constraints at a mesh point are rows of its stage. All stages
of a phase have one kind, and are evaluated by one mapped call.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.portable import Portable
from microbot_ocp._base.quiet import quiet
from microbot_ocp.ocp.problem import Phase, Variable, node_variables, parts_of
from microbot_ocp.ocp.transcription._kernels import (
    Derive,
    Kernel,
    Kernels,
    build_kernels,
    interpolated_variables,
    joined,
    stage_variables,
)
from microbot_ocp.ocp.transcription._table import (
    DURATION,
    Block,
    IntArray,
    Label,
    TableEntry,
    conditions_of,
    entries_of,
    limits_of,
)
from microbot_ocp.ocp.transcription.schemes import Scheme, StageVariable, within_bounds


@dataclass(frozen=True, eq=False)
class StageKind:
    """Description of the stages of a phase with one scheme.

    Attributes
    ----------
    scheme : Scheme
    inner : inner variables w
    variables : entries of (z, w)
    rows : entries of the rows, beginning with the step to the next z
    kernels : Kernels
    node_size : number of components of z
    """

    scheme: Scheme
    inner: tuple[StageVariable, ...]
    variables: tuple[TableEntry, ...]
    rows: tuple[TableEntry, ...]
    kernels: Kernels
    node_size: int

    @property
    def node(self) -> tuple[TableEntry, ...]:
        """Entries of z: states, linear controls, free parameters, duration."""
        return self.variables[: self.node_size]

    @cached_property
    def scale(self) -> FloatArray:
        """Scales of (z, w)."""
        return np.array([entry.scale for entry in self.variables])


def stage_kind(phase: Phase, scheme: Scheme, duration_scale: float, derive: Derive) -> StageKind:
    """Return the kind of the stages of a phase with a scheme, and its kernels."""
    inner = tuple(stage_variables(phase, scheme))
    kernels = build_kernels(phase, duration_scale, scheme, derive)
    node = [e for v in node_variables(phase) for e in entries_of(phase, _kind(v), v)]
    node.append(TableEntry("duration", None, DURATION, 0, 1, 0.0, "s", duration_scale))
    control: list[TableEntry] = []
    for value in inner:
        kind = "arrival" if value.source.shape == "linear" else _kind(value.source)
        control += entries_of(phase, kind, value.source, value.fraction)
    steps = [replace(entry, kind="step", fraction=1.0) for entry in node]
    variables, rows = (*node, *control), (*steps, *kernels.stage.rows)
    return StageKind(scheme, inner, variables, rows, kernels, len(node))


def _kind(variable: Variable) -> str:
    return variable.shape if variable.shape in ("state", "algebraic", "parameter") else "control"


@dataclass(frozen=True, eq=False)
class PointGroup:
    """Mesh points with one constraint or cost in common.

    Attributes
    ----------
    kernel : Kernel
    block : rows of the constraint, with the indices of the mesh points as intervals
    """

    kernel: Kernel
    block: Block

    @property
    def nodes(self) -> IntArray:
        """Indices of the mesh points [M]."""
        return self.block.intervals


@dataclass(frozen=True, eq=False)
class PhaseLayout(Portable):
    """Places of one phase in the program, and its kernels.

    Attributes
    ----------
    phase : Phase
    mesh : fractions [N+1] from 0 to 1
    kind : kind of its stages
    stage_variables : indices [N, components of (z, w)] in the program
    stage_rows : indices [N, ...] in the program, step rows first
    nodes : indices [N+1, node size] of every z in the program
    transition : extra variables at the last mesh point, for the link to the next phase
    initial, final : rows of the conditions at both ends
    points : constraints and costs at given mesh points; the last one is the end of the phase
    link : rows ``x[targets] - factors * x[sources] = 0`` that link the end of the phase to the
        next phase; empty for the last phase
    targets : indices of the first z of the next phase
    sources : indices in the last z, or of transition variables for components that may jump
    factors : ratios of the scales of sources and targets
    """

    phase: Phase
    mesh: FloatArray
    kind: StageKind
    stage_variables: IntArray
    stage_rows: IntArray
    nodes: IntArray
    transition: Block
    initial: Block
    points: tuple[PointGroup, ...]
    final: Block
    link: Block
    targets: IntArray
    sources: IntArray
    factors: FloatArray

    @property
    def intervals(self) -> int:
        """Number of intervals N."""
        return self.mesh.size - 1

    @property
    def node_size(self) -> int:
        """Number of components of z."""
        return self.kind.node_size

    @property
    def node_scale(self) -> FloatArray:
        """Scales of z."""
        return self.kind.scale[: self.node_size]

    @property
    def stages(self) -> slice:
        """Slice of the stages (z_0, w_0, ..., w_N-1) in the program."""
        return slice(int(self.nodes[0, 0]), int(self.nodes[-1, 0]))

    @property
    def variables(self) -> tuple[Block, ...]:
        """All variables of the phase."""
        stages = Block(self.kind.variables, np.arange(self.intervals), self.stage_variables)
        last = Block(self.kind.node, np.array([self.intervals]), self.nodes[-1:])
        return (stages, last, self.transition)

    @property
    def rows(self) -> tuple[Block, ...]:
        """All rows of the phase."""
        stages = Block(self.kind.rows, np.arange(self.intervals), self.stage_rows)
        points = (group.block for group in self.points)
        return (stages, self.initial, self.link, *points, self.final)

    @property
    def end(self) -> Block:
        """Rows of constraints at the end."""
        return self.points[-1].block

    @property
    def variable_count(self) -> int:
        """Number of variables of the phase."""
        return sum(block.places.size for block in self.variables)

    @property
    def row_count(self) -> int:
        """Number of rows of the phase."""
        return sum(block.places.size for block in self.rows)

    @property
    def stage_sizes(self) -> tuple[IntArray, IntArray, IntArray]:
        """Components of z, components of w, and rows without steps, of every stage [N+1].

        The last stage is the last mesh point with the transition to the next phase.
        """
        nz, n = self.node_size, self.intervals
        controls = np.full(n, len(self.kind.variables) - nz)
        rows = np.append(np.full(n, len(self.kind.rows) - nz), len(self.final.entries))
        rows[0] += len(self.initial.entries)
        for group in self.points:
            rows[group.nodes] += len(group.block.entries)
        return np.full(n + 1, nz), np.append(controls, len(self.transition.entries)), rows

    def node_columns(self, block: Block) -> list[int]:
        """Return the indices of the components of z that the rows of a block constrain."""
        node = [(entry.source, entry.component) for entry in self.kind.node]
        return [node.index((entry.source, entry.component)) for entry in block.entries]

    def place_of(self, label: Label) -> float:
        """Return the place of a row or variable as a fraction of the phase."""
        if label.interval == self.intervals:
            return 1.0
        start, end = self.mesh[label.interval : label.interval + 2]
        return float(start + label.fraction * (end - start))

    @property
    def parameters(self) -> FloatArray:
        """Values of the parameters of the phase, in one array."""
        return joined([p.value for p in self.phase.parameters])

    @property
    def data(self) -> FloatArray:
        """Values of the parameters followed by the measurements of the phase, in one array."""
        return joined([self.parameters, *(m.value.ravel() for m in self.phase.measurements)])

    def point_places(self, group: PointGroup) -> IntArray:
        """Return indices into ``data`` [..., M] of the constants of a point kernel."""
        offset = self.parameters.size
        places = [np.tile(np.arange(offset)[:, None], (1, group.nodes.size))]
        for measurement in self.phase.measurements:
            if measurement.name in group.kernel.data:
                table = np.arange(measurement.value.size).reshape(measurement.value.shape)
                places.append(offset + table.T)
            offset += measurement.value.size
        return np.vstack(places)

    def point_constants(self, group: PointGroup) -> FloatArray:
        """Return the second argument of a point kernel [..., M]."""
        return np.vstack([self.mesh[group.nodes], self.data[self.point_places(group)]])

    def constants(self, intervals: IntArray) -> FloatArray:
        """Return the second argument of the stage kernel, for given intervals [..., M]."""
        fixed = np.tile(self.parameters[:, None], (1, intervals.size))
        return np.vstack([self.mesh[intervals], np.diff(self.mesh)[intervals], fixed])

    def table(self, stages: FloatArray) -> FloatArray:
        """Return scaled (z, w) of every stage [N, ...] from their consecutive values."""
        return stages[self.stage_variables - self.stages.start]

    def interpolated(
        self, stages: FloatArray, intervals: IntArray, share: FloatArray
    ) -> dict[str, FloatArray]:
        """Return unscaled states, controls and algebraic variables [M, size] by name.

        Values are interpolated by the scheme in given intervals [M] at fractions [M]; polynomial
        controls are kept within their bounds by :func:`within_bounds`.
        """
        v = _within_bounds(self.phase, self.kind, self.table(stages)[intervals]).T
        try:
            with quiet():
                dense = self.kind.kernels.dense(v, self.constants(intervals), share[None])
            table = np.vstack([part.full() for part in dense])
        except RuntimeError:  # an integrator inside the scheme failed
            height = sum(k.size for k in interpolated_variables(self.phase))
            table = np.full((height, intervals.size), np.nan)
        return parts_of(interpolated_variables(self.phase), table.T)


def _within_bounds(phase: Phase, kind: StageKind, table: FloatArray) -> FloatArray:
    """Return scaled (z, w) [M, ...] with polynomial controls limited to their bounds."""
    limited = table.copy()
    for variable in phase.shaped("polynomial"):
        source = "controls", phase.controls.index(variable)
        places = [k for k, entry in enumerate(kind.variables) if entry.source == source]
        columns = np.reshape(places, (-1, variable.size))
        points = [kind.variables[k].fraction for k in columns[:, 0]]
        limits = variable.lower / variable.scale, variable.upper / variable.scale
        limited[:, columns] = within_bounds(table[:, columns], points, *limits)
    return limited


def lay_out(
    phase: Phase,
    mesh: FloatArray,
    kind: StageKind,
    following: Sequence[TableEntry],
    linked: Sequence[str],
    begin: IntArray,
) -> PhaseLayout:
    """Return the layout of a phase on a mesh.

    Parameters
    ----------
    phase : Phase
    mesh : fractions [N+1]
    kind : kind of its stages
    following : entries of the z of the next phase
    linked : names of the variables that are continuous to the next phase
    begin : index of the first variable and of the first row of the phase [2]
    """
    node, intervals = kind.node, mesh.size - 1
    initial, final = (conditions_of(phase, which, node) for which in ("initial", "final"))
    corners = begin[0] + len(kind.variables) * np.arange(intervals + 1)
    kernels = kind.kernels.points
    where = [np.searchsorted(mesh, kernel.fractions) for kernel in kernels]
    # Numbers of rows before those of points: the stage rows, and at the last mesh point the link.
    row_counts = np.append(np.full(intervals, len(kind.rows)), len(following))
    row_counts[0] += len(initial)  # the start conditions follow the rows of the first stage
    heights = row_counts.copy()
    for kernel, nodes in zip(kernels, where, strict=True):
        heights[nodes] += len(kernel.rows)
    # First row of every stage.
    first = begin[1] + np.cumsum(heights) - heights

    def block(entries: Sequence[TableEntry], begin: int, interval: int = intervals) -> Block:
        places = np.arange(begin, begin + len(entries))[None, :]
        return Block(tuple(entries), np.array([interval]), places)

    # A component that may jump starts from a transition variable of its own, a linked one from z_N.
    jumping = [e for e in following if e.source is None or e.name not in linked]
    transition = block([replace(e, kind="transition") for e in jumping], corners[-1] + len(node))
    link = block([replace(e, kind="link") for e in following], first[-1])
    points, next_row = [], first + row_counts
    for kernel, nodes in zip(kernels, where, strict=True):
        places = next_row[nodes][:, None] + np.arange(len(kernel.rows))
        next_row[nodes] += len(kernel.rows)
        points.append(PointGroup(kernel, Block(kernel.rows, nodes, places)))
    ends = {(e.name, e.component): k for k, e in enumerate(node) if e.source is not None}
    tied = [None if e in jumping else ends[e.name, e.component] for e in following]
    free = iter(transition.places[0])
    sources = [next(free) if k is None else corners[-1] + k for k in tied]
    pairs = zip(tied, following, strict=True)
    factors = [1.0 if k is None else node[k].scale / entry.scale for k, entry in pairs]
    after = corners[-1] + len(node) + len(jumping)
    return PhaseLayout(
        phase=phase,
        mesh=mesh,
        kind=kind,
        stage_variables=corners[:-1, None] + np.arange(len(kind.variables)),
        stage_rows=first[:-1, None] + np.arange(len(kind.rows)),
        nodes=corners[:, None] + np.arange(len(node)),
        transition=transition,
        initial=block(initial, first[0] + len(kind.rows), 0),
        link=link,
        points=tuple(points),
        final=block(final, next_row[-1]),
        targets=np.arange(after, after + len(following)),
        sources=np.array(sources, dtype=int),
        factors=np.array(factors),
    )


def fill_transitions(layouts: Sequence[PhaseLayout], x: FloatArray) -> None:
    """Set the transition variables in x to the initial values of the next phases."""
    for layout in layouts:
        free = layout.sources > layout.nodes[-1, -1]
        x[layout.sources[free]] = x[layout.targets[free]]


def fill_values(layouts: Sequence[PhaseLayout], x: FloatArray) -> None:
    """Set free parameters in x that are values of expressions to these values."""
    for layout in layouts:
        for group in layout.points:
            names = [entry.name for entry in group.block.entries if entry.kind == "value"]
            if not names:
                continue
            z = x[layout.nodes[group.nodes]].T
            # The row of a point value is expression - parameter: its residual corrects the
            # parameter.
            missed = group.kernel.value(z, layout.point_constants(group))[0].full()[:, 0]
            for other in layouts:
                node = [entry.name for entry in other.kind.node]
                if names[0] in node:
                    first = node.index(names[0])
                    x[other.nodes[:, first : first + len(names)]] += missed


@dataclass(frozen=True, eq=False)
class Bounds:
    """Lower and upper bounds of all variables and rows of a program, scaled."""

    variable_lower: FloatArray
    variable_upper: FloatArray
    row_lower: FloatArray
    row_upper: FloatArray

    @cached_property
    def lower(self) -> FloatArray:
        """Lower bounds of the rows followed by those of the variables."""
        return np.concatenate([self.row_lower, self.variable_lower])

    @cached_property
    def upper(self) -> FloatArray:
        """Upper bounds of the rows followed by those of the variables."""
        return np.concatenate([self.row_upper, self.variable_upper])

    def violations(self, x: FloatArray, rows: FloatArray) -> FloatArray:
        """Return the scaled excess of the rows followed by the variables over their bounds.

        Infinite for a value that is not finite.
        """
        values = np.concatenate([rows, x])
        excess = np.maximum(np.maximum(self.lower - values, values - self.upper), 0.0)
        return np.nan_to_num(excess, nan=np.inf, posinf=np.inf)


def bounds_of(layouts: Sequence[PhaseLayout]) -> Bounds:
    """Return the declared bounds of all variables and rows."""
    variables = np.zeros((2, sum(layout.variable_count for layout in layouts)))
    rows = np.zeros((2, sum(layout.row_count for layout in layouts)))
    for layout in layouts:
        for table, blocks in ((variables, layout.variables), (rows, layout.rows)):
            for block in blocks:
                for side, limits in zip(table, limits_of(layout.phase, block.entries), strict=True):
                    side[block.places] = limits
        low, high = layout.phase.duration_bounds
        # Parameters and fixed durations are equal at all nodes: bound them at the first one only.
        node = layout.kind.node
        repeated = [entry.kind == "parameter" for entry in node[:-1]] + [low == high]
        again = layout.nodes[1:, np.flatnonzero(repeated)]
        variables[0, again], variables[1, again] = -np.inf, np.inf
    return Bounds(*variables, *rows)


def labels_of(layouts: Sequence[PhaseLayout], kind: str) -> list[Label]:
    """Return the labels of the "rows" or "variables" of a program."""
    labels: dict[int, Label] = {}
    for layout in layouts:
        for block in getattr(layout, kind):
            for interval, places in zip(block.intervals.tolist(), block.places, strict=True):
                for entry, place in zip(block.entries, places.tolist(), strict=True):
                    labels[place] = Label(**vars(entry), phase=layout.phase.name, interval=interval)
    return [labels[place] for place in range(len(labels))]
