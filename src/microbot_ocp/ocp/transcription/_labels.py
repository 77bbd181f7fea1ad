"""Names of the rows and variables of a program: of which constraint, phase, point and component."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from microbot_ocp.ocp.problem import Link, PathConstraint, Phase, Variable, node_variables
from microbot_ocp.ocp.transcription._assembly import Program
from microbot_ocp.ocp.transcription._kernels import constraints_at_end, path_points
from microbot_ocp.ocp.transcription._layout import PhaseLayout, StageKind
from microbot_ocp.ocp.transcription.schemes import Scheme

DURATION = "duration"

_SAID = {
    "step": "step of {}",
    "defect": "dynamics of {}",
    "bound": "bound of {}",
    "equation": "algebraic equation {}",
    "constraint": "constraint {}",
    "initial": "start condition of {}",
    "link": "link of {} to the next phase",
    "end": "end constraint {}",
    "final": "end condition of {}",
    "state": "state {}",
    "control": "control {}",
    "algebraic": "algebraic variable {}",
    "duration": "{}",
    "transition": "start of {} in the next phase",
}


@dataclass(frozen=True)
class _Label:
    """What stands at one place of the program.

    Attributes
    ----------
    phase : str
        Name of the phase.
    kind : str
        See the subclasses.
    name : str
        As declared; "duration" for the duration of the phase.
    component, size : int
        Which of how many components.
    interval : int
        Interval of the mesh, the number of intervals at the last mesh point.
    fraction : float
        Place in the interval, 0 to 1.
    unit : str
    scale : float
        Value in the declared unit = scaled value times this.
    """

    phase: str
    kind: str
    name: str
    component: int
    size: int
    interval: int
    fraction: float
    unit: str
    scale: float

    @property
    def component_name(self) -> str:
        """The name, with its index where there is more than one component."""
        return f"{self.name}[{self.component}]" if self.size > 1 else self.name

    def place(self, layout: PhaseLayout) -> float:
        """Place as a fraction of the phase."""
        if self.interval == layout.intervals:
            return 1.0
        start, end = layout.mesh[self.interval : self.interval + 2]
        return float(start + self.fraction * (end - start))

    @property
    def words(self) -> str:
        """What it is, without its place."""
        return _SAID[self.kind].format(self.component_name)

    def __str__(self) -> str:
        return f"{self.words} in phase {self.phase!r}, interval {self.interval + 1}"


@dataclass(frozen=True)
class RowLabel(_Label):
    """What one row of the program says.

    Its ``kind`` is "step" (the value of a mesh point is what the scheme arrives at), "defect" (the
    dynamics inside an interval), "bound" (of a state between mesh points), "equation" (algebraic),
    "constraint" (along the phase), "initial", "link", "end" (constraint at the end) or "final".
    """


@dataclass(frozen=True)
class VariableLabel(_Label):
    """What one variable of the program is.

    Its ``kind`` is "state", "control", "algebraic", "duration", or "transition" (what the last mesh
    point holds of the start of the next phase).
    """


Entry = tuple[str, str, int, int, float, str, float]  # kind, name, component, size, ...


def row_labels(program: Program) -> list[RowLabel]:
    """One label for every row, in the order of the program."""
    labels: list[RowLabel] = []
    for index, layout in enumerate(program.layouts):
        phase, last = layout.phase, layout.intervals
        stages = [list(stage_rows(layout, kind)) for kind in layout.kinds]
        nodes = list(_nodes(phase, layout))

        rows = [(0, entry) for entry in stages[layout.kind_of[0]]]
        rows += [(0, _at_node("initial", nodes[i])) for i in layout.initial_rows]
        rows += [(k, entry) for k in range(1, last) for entry in stages[layout.kind_of[k]]]
        if layout.next_nodes:
            after = program.layouts[index + 1]
            rows += [(last, _at_node("link", entry)) for entry in _nodes(after.phase, after)]
        rows += [(last, entry) for entry in _end_rows(phase)]
        rows += [(last, _at_node("final", nodes[i])) for i in layout.final_rows]
        labels += [
            RowLabel(phase.name, kind, what, i, size, k, at, unit, scale)
            for k, (kind, what, i, size, at, unit, scale) in rows
        ]
    return labels


def variable_labels(program: Program) -> list[VariableLabel]:
    """One label for every variable, in the order of the program."""
    labels: list[VariableLabel] = []
    for index, layout in enumerate(program.layouts):
        name, last = layout.phase.name, layout.intervals
        nodes = [
            _at_node(_kind(variable), entry)
            for variable, entry in _node_entries(layout.phase, layout)
        ]
        inner = [list(inner_variables(kind)) for kind in layout.kinds]
        stages = [(k, entry) for k in range(last) for entry in (*nodes, *inner[layout.kind_of[k]])]
        stages += [(last, entry) for entry in nodes]
        if layout.transition:
            after = program.layouts[index + 1]
            kept = _kept(program.links, name)
            stages += [
                (last, _at_node("transition", entry))
                for _, entry in _node_entries(after.phase, after)
                if entry[1] not in kept
            ]
        labels += [
            VariableLabel(name, kind, what, i, size, k, at, unit, scale)
            for k, (kind, what, i, size, at, unit, scale) in stages
        ]
    return labels


def _at_node(kind: str, entry: Entry) -> Entry:
    _, name, component, size, _, unit, scale = entry
    return kind, name, component, size, 0.0, unit, scale


def _kind(variable: Variable | None) -> str:
    if variable is None:
        return "duration"
    return variable.shape if variable.shape in ("state", "algebraic") else "control"


def _kept(links: Sequence[Link], before: str) -> tuple[str, ...]:
    return next(link.names for link in links if link.before == before)


def _component(variable: Variable | PathConstraint, i: int) -> tuple[str, int, int]:
    return variable.name, i, variable.scale.size


def _unit(variable: Variable | PathConstraint, i: int) -> tuple[str, float]:
    return variable.unit, float(variable.scale[i])


def _node_entries(phase: Phase, layout: PhaseLayout) -> Iterator[tuple[Variable | None, Entry]]:
    for variable in node_variables(phase):
        for i in range(variable.size):
            yield variable, ("step", *_component(variable, i), 1.0, *_unit(variable, i))
    yield None, ("step", DURATION, 0, 1, 1.0, "s", float(layout.node_scale[-1]))


def _nodes(phase: Phase, layout: PhaseLayout) -> Iterator[Entry]:
    return (entry for _, entry in _node_entries(phase, layout))


def inner_variables(kind: StageKind) -> Iterator[Entry]:
    """What the components of w are, in stages of one kind."""
    for k in kind.inner:
        for i in range(k.source.size):
            yield (_kind(k.source), *_component(k.source, i), k.fraction, *_unit(k.source, i))


def stage_rows(layout: PhaseLayout, kind: StageKind) -> Iterator[Entry]:
    """What the rows of a stage of one kind are: the step, defects, path constraints."""
    phase = layout.phase
    yield from _nodes(phase, layout)
    path = list(_path_rows(phase, kind.scheme))
    states = [(s, i) for s in phase.states for i in range(s.size)]
    count = (kind.row_count - len(path)) // len(states)
    points = kind.scheme.points
    fractions = points if len(points) == count else (0.5,) * count
    for fraction in fractions:
        for state, i in states:
            yield ("defect", *_component(state, i), fraction, *_unit(state, i))
    yield from path


def _end_rows(phase: Phase) -> Iterator[Entry]:
    for kind, limits in (
        ("constraint", constraints_at_end(phase)),
        ("end", phase.end_constraints),
    ):
        for limit in limits:
            for i in range(limit.scale.size):
                yield (kind, *_component(limit, i), 0.0, *_unit(limit, i))


def _path_rows(phase: Phase, scheme: Scheme) -> Iterator[Entry]:
    for point in path_points(phase, scheme):
        for variable in point.states:
            for i in range(variable.size):
                yield ("bound", *_component(variable, i), point.fraction, *_unit(variable, i))
        if point.equations:
            sizes = [e.shape[0] for e in phase.algebraic_equations]
            for i in range(sum(sizes)):
                yield ("equation", "", i, sum(sizes), point.fraction, "", 1.0)
        for limit in point.constraints:
            for i in range(limit.scale.size):
                yield ("constraint", *_component(limit, i), point.fraction, *_unit(limit, i))
