"""Detection of active controls and limits in a solution on a mesh: switches and arcs.

Every component of a control or limit is treated separately (:class:`Activity`): in each interval it
is at its upper side, at its lower side or at neither. Two controls may switch within one interval
of each other: then no interval of the arc between them has all sides decided, but the sides of each
single component are. If a component passes from one side to the other within a few intervals, its
mean over them determines the switching time (:func:`find_switches`). Where one limit becomes
inactive, another becomes active. The arcs are the time spans between these events
(:func:`plan_of`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp.ocp.problem import Expressions, PathConstraint, Phase, Variable
from microbot_ocp.ocp.solution import PhaseSolution
from microbot_ocp.ocp.transcription.schemes import Collocation
from microbot_ocp.ocp.verification import point_values, runs

Sample = Callable[[FloatArray], dict[str, FloatArray]]  # argument: times since the phase start, s
Signature = tuple[int, ...]  # sides of all control components followed by those of all limits

SMEARED_INTERVALS = 3  # intervals over which a mesh may smear one event
NEGLIGIBLE_LENGTH = 0.05  # length below which an arc is dropped, in intervals


@dataclass(frozen=True)
class Switch:
    """A jump of a control from one of its bounds to the other.

    Attributes
    ----------
    control, component : identity of the control component
    place : fraction of the phase at which the control would switch if it were exactly at its bounds
        on both sides and had the time integral that it has over the ramp
    begin, end : fractions of the phase between which the control is at neither bound
    rising : True for a switch from the lower to the upper bound
    continuous : True if the control cannot jump, but has a ramp
    offset : distance between mesh and switch as a fraction of the phase: half of a ramp, or the
        distance to the nearest mesh point
    """

    control: str
    component: int
    place: float
    begin: float
    end: float
    rising: bool
    continuous: bool
    offset: float


@dataclass(frozen=True, eq=False)
class ActiveLimit:
    """Component of a limit that depends on states only, or on controls too (``mixed``)."""

    constraint: PathConstraint
    component: int
    mixed: bool

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper limit."""
        i = self.component
        return float(self.constraint.lower[i]), float(self.constraint.upper[i])

    @property
    def range(self) -> float:
        """Difference of upper and lower limit, or the scale of a one-sided limit."""
        low, high = self.bounds
        scale = float(self.constraint.scale[self.component])
        return high - low if np.isfinite(high - low) else scale

    def met(self, side: int) -> PathConstraint:
        """Return the limit on one side as an equation."""
        limit, i = self.constraint, self.component
        value = (limit.lower if side < 0 else limit.upper)[i : i + 1]
        name, scale = f"{limit.name}[{i}] met", limit.scale[i : i + 1]
        return PathConstraint(name, limit.expression[i], value, value, scale, limit.unit)

    def along(self, values: Mapping[str, FloatArray], declared: Phase) -> FloatArray:
        """Return values of a limit of the states of a phase at tabulated states."""
        symbols = Expressions(declared).symbols  # the states come first
        run = ca.Function("value", [*symbols], [self.constraint.expression])
        given = [values[s.name].T if s.name in values else 0.0 for s in declared.states]
        # The expression may contain other symbols on which its value does not depend.
        return np.array(run(*given, *([0.0] * (len(symbols) - len(given)))))[self.component]

    def sides(self, values: FloatArray, near: float) -> np.ndarray:
        """Return the side that each value is within ``near`` of: 1, -1, or 0 for neither."""
        low, high = self.bounds
        return (values >= high - near).astype(int) - (values <= low + near).astype(int)


@dataclass(frozen=True, eq=False)
class Activity:
    """Component of a control or limit, and the intervals of a mesh in which it is active.

    Attributes
    ----------
    name, component : identity of the component
    sides : side at which the component stays throughout each interval [N]: upper 1, lower -1,
        neither 0
    means : interval means [N], scaled to -1 at the lower and 1 at the upper side; None for a
        one-sided limit and for limits of the states
    limit : limit of the component; None for a control
    touched : mask of the intervals [N] with at least one end at a limit of the states
    """

    name: str
    component: int
    sides: np.ndarray
    means: FloatArray | None = None
    limit: ActiveLimit | None = None
    touched: np.ndarray | None = None

    @property
    def of_states(self) -> bool:
        """True if the limit depends on states only."""
        return self.limit is not None and not self.limit.mixed


@dataclass(frozen=True, eq=False)
class PlannedArc:
    """A planned arc: fractions of its phase, active components, and number of mesh intervals."""

    begin: float
    end: float
    signature: Signature
    intervals: int


@dataclass(frozen=True, eq=False)
class ArcPlan:
    """The planned arcs of one phase, with the data of their initial guess.

    Attributes
    ----------
    declared : declared phase
    duration : duration of the phase, s
    sample : values of the variables at times since the start of the phase
    arcs : arcs in the order of time
    columns : components that signatures refer to: jumping control components followed by limits
    """

    declared: Phase
    duration: float
    sample: Sample
    arcs: tuple[PlannedArc, ...]
    columns: tuple[Activity, ...]

    @property
    def signatures(self) -> tuple[Signature, ...]:
        return tuple(arc.signature for arc in self.arcs)

    @property
    def controls(self) -> int:
        """Number of control components among the columns."""
        return sum(column.limit is None for column in self.columns)

    def is_undetermined(self, arc: PlannedArc) -> bool:
        """Return True if fewer limits are active on an arc than there are control components."""
        return sum(map(abs, arc.signature)) < self.controls


def joined(samples: Sequence[Sample], lengths: Sequence[float] | FloatArray) -> Sample:
    """Return one sampling function for consecutive arcs, with times since the start of the first.

    At a junction it returns the values of the arc that begins there.
    """
    ends = np.cumsum(lengths)

    def sample(t: FloatArray) -> dict[str, FloatArray]:
        arcs = np.minimum(np.searchsorted(ends, t, side="right"), ends.size - 1)
        values: dict[str, FloatArray] = {}
        for index in np.unique(arcs).tolist():
            chosen = arcs == index
            begin = float(ends[index] - lengths[index])
            for name, rows in samples[index](t[chosen] - begin).items():
                values.setdefault(name, np.zeros((t.size, rows.shape[1])))[chosen] = rows
        return values

    return sample


def jumping(phase: Phase) -> list[Variable]:
    """Return the controls that may jump at a mesh point."""
    return [c for c in phase.controls if c.shape != "linear"]


# activities ---------------------------------------------------------------------------------------

AT_BOUND = 1e-3  # distance at which a control or limit is active, relative to its range
# Near the end of a ramp the barrier outweighs the small gain of a continuous control.
AT_END_OF_RAMP = 1e-2  # distance of an active continuous control from its bound, likewise


def control_activities(phase: PhaseSolution, controls: Sequence[Variable]) -> list[Activity]:
    """Return the activities of all components of the given controls."""
    activities: list[Activity] = []
    for control in controls:
        least, largest, mean = _interval_values(phase, control)
        range_ = control.upper - control.lower
        near = AT_END_OF_RAMP if control.shape == "linear" else AT_BOUND
        near = near * np.where(np.isfinite(range_), range_, control.scale)
        # A control is at a side only if it is there throughout the interval.
        upper = (least >= control.upper - near) & (range_ != 0.0)
        lower = (largest <= control.lower + near) & (range_ != 0.0)
        sides = upper.astype(int) - lower.astype(int)
        for i in range(control.size):
            means = _scaled(mean[:, i], float(control.lower[i]), float(control.upper[i]))
            activities.append(Activity(control.name, i, sides[:, i], means))
    return activities


def _interval_values(phase: PhaseSolution, control: Variable) -> tuple[FloatArray, ...]:
    """Return the least, largest and mean value [N, size] of a control in every interval."""
    if control.shape == "linear":
        nodes = phase.values[control.name]
        values = np.stack([nodes[:-1], nodes[1:]])
        return values.min(axis=0), values.max(axis=0), values.mean(axis=0)
    values, scheme = point_values(phase, control), phase.laid_out.kind.scheme
    mean = values[:, 0]
    if control.shape == "polynomial" and isinstance(scheme, Collocation):
        mean = np.einsum("j,kji->ki", scheme.weights, values)
    return values.min(axis=1), values.max(axis=1), mean


def _scaled(mean: FloatArray, low: float, high: float) -> FloatArray | None:
    if not (np.isfinite(high - low) and low < high):
        return None
    return (2 * mean - high - low) / (high - low)


def _state_limits(phase: PhaseSolution, declared: Phase) -> list[Activity]:
    """Return activities of limits of the states, active in an interval with both ends at them."""
    others = Expressions(declared).symbols[len(declared.states) :]  # the states come first
    of_states = (c for c in declared.constraints if not _depends(c, others))
    activities = []
    for constraint in (*declared.states, *of_states):
        for i in range(constraint.size):
            limit = ActiveLimit(constraint, i, mixed=False)
            values = limit.along(phase.values, declared)
            near = AT_BOUND * float(np.ptp(values))
            sides = limit.sides(values, near)
            if near > 0 and limit.bounds[0] < limit.bounds[1] and np.any(sides):
                both = np.where(sides[:-1] == sides[1:], sides[1:], 0)
                touched = (sides[:-1] != 0) | (sides[1:] != 0)
                activities.append(Activity(constraint.name, i, both, None, limit, touched))
    return activities


def _depends(constraint: PathConstraint, symbols: Sequence[ca.MX]) -> bool:
    return any(ca.depends_on(constraint.expression, symbol) for symbol in symbols)


def mixed_limits(phase: PhaseSolution, declared: Phase) -> list[Activity]:
    """Return activities of limits that depend on jumping controls, active at all points."""
    variables = [*declared.states, *declared.controls]
    others = [c.rate for c in declared.controls if c.rate is not None]
    others += [v.symbol for v in declared.variables if v not in variables]
    jumps = [u.symbol for u in jumping(declared)]
    chosen = [c for c in declared.constraints if _depends(c, jumps) and not _depends(c, others)]
    if not chosen:
        return []
    steps = np.diff(phase.mesh)
    scheme = phase.laid_out.kind.scheme
    if not isinstance(scheme, Collocation):
        scheme = Collocation("gauss", 3)
    points = np.array(scheme.points)
    # Sampling exactly at a mesh point would return the values of the next interval.
    t = (phase.mesh[:-1, None] + (1 - ROUNDING) * points * steps[:, None]).ravel() * phase.duration
    expressions = Expressions(declared)
    sampled = {name: table.T for name, table in phase.sample(t).items()}
    table_of_inputs = expressions.table(sampled, t, phase.duration)
    activities = []
    for constraint in chosen:
        run = expressions.function([constraint.expression])
        for i, values in enumerate(run(table_of_inputs).full()):
            limit = ActiveLimit(constraint, i, mixed=True)
            low, high = limit.bounds
            range_ = high - low if np.isfinite(high - low) else float(np.ptp(values))
            near = AT_BOUND * range_
            table = limit.sides(values, near).reshape(steps.size, points.size)
            sides = np.where(np.all(table == table[:, :1], axis=1), table[:, 0], 0)
            if near > 0 and low < high and np.any(sides):
                mean = values.reshape(steps.size, points.size) @ scheme.weights
                means = _scaled(mean, low, high)
                activities.append(Activity(constraint.name, i, sides, means, limit))
    return activities


# switches -----------------------------------------------------------------------------------------


def find_switches(phase: PhaseSolution) -> tuple[Switch, ...]:
    """Return the jumps of controls between their bounds."""
    switches = []
    for control in phase.laid_out.phase.controls:
        for activity in control_activities(phase, [control]):
            switches += _switches_of(activity, phase.mesh, control.shape == "linear")
    return tuple(switches)


def _switches_of(activity: Activity, mesh: FloatArray, continuous: bool) -> list[Switch]:
    if activity.means is None:
        return []
    switches = []
    decided = [run for run in runs(activity.sides) if run.side]
    for one, other in itertools.pairwise(decided):
        if one.side == other.side or other.begin - one.after > SMEARED_INTERVALS:
            continue
        ramp = slice(one.after, other.begin)
        begin, end = float(mesh[one.after]), float(mesh[other.begin])
        place = begin + _crossing(one.side, activity.means[ramp], np.diff(mesh)[ramp])
        offset = (end - begin) / 2 if continuous else float(np.abs(mesh - place).min())
        rising = other.side > 0
        where = activity.name, activity.component, place, begin, end
        switches.append(Switch(*where, rising, continuous, offset))
    return switches


def _crossing(before: int, means: FloatArray, steps: FloatArray) -> float:
    """Return the time after the start of a ramp at which a jump has the integral of the ramp.

    With u = A before and u = B after tau, ``A (tau - a) + B (b - tau) = int_a^b u dt``;
    for scaled means A = -B = ``before``, so ``tau - a = (b - a + before * integral) / 2``.
    """
    length = float(steps.sum())
    return float(np.clip((length + before * float(means @ steps)) / 2, 0.0, length))


# arcs ---------------------------------------------------------------------------------------------


def plan_of(phase: PhaseSolution) -> ArcPlan:
    """Return the arcs of a phase, including very short ones."""
    declared = phase.laid_out.phase
    columns = control_activities(phase, jumping(declared))
    columns += _state_limits(phase, declared)
    columns += mixed_limits(phase, declared)
    arcs = _arcs_between_events(columns, phase.mesh) if columns else []
    arcs = arcs or [PlannedArc(0.0, 1.0, (), phase.mesh.size - 1)]  # no control may jump
    arcs = merged([replace(arc, signature=_effective(arc.signature, columns)) for arc in arcs])
    return ArcPlan(declared, phase.duration, phase.sample, tuple(arcs), tuple(columns))


def _effective(signature: Signature, columns: Sequence[Activity]) -> Signature:
    """Return a signature without state limits on arcs where no control is free to follow them."""
    pairs = list(zip(signature, columns, strict=True))
    controls = [side for side, column in pairs if column.limit is None]
    if not controls or not all(controls):
        return signature
    return tuple(0 if column.of_states else side for side, column in pairs)


def merged(arcs: Sequence[PlannedArc]) -> list[PlannedArc]:
    """Return arcs with equal signatures of neighbours merged."""
    joined: list[PlannedArc] = []
    for arc in arcs:
        if joined and joined[-1].signature == arc.signature:
            intervals = joined[-1].intervals + arc.intervals
            joined[-1] = replace(joined[-1], end=arc.end, intervals=intervals)
        else:
            joined.append(arc)
    return joined


@dataclass
class _Event:
    """Start of a side of one component; ``place`` is measured in intervals."""

    place: float
    column: int
    side: int


def _arcs_between_events(columns: Sequence[Activity], mesh: FloatArray) -> list[PlannedArc]:
    # An event is the start of a side of one component; arcs lie between the events of all.
    events = [event for column in range(len(columns)) for event in _events(column, columns)]
    _join_events(events, columns)
    arcs: list[PlannedArc] = []
    active, begin = np.zeros(len(columns), dtype=int), 0.0
    count = mesh.size - 1

    def close(end: float) -> None:
        a, b = np.interp([begin, end], np.arange(count + 1.0), mesh).tolist()
        arcs.append(PlannedArc(a, b, tuple(active.tolist()), round(np.ceil(end - begin))))

    for event in sorted(events, key=lambda e: e.place):
        if event.place - begin > NEGLIGIBLE_LENGTH:
            close(event.place)
            begin = event.place
        active[event.column] = event.side
    close(float(count))
    return arcs


def _events(column: int, columns: Sequence[Activity]) -> list[_Event]:
    """Return the changes of side of one component."""
    activity = columns[column]
    stretches = runs(activity.sides)
    events = [_Event(0.0, column, stretches[0].side)]
    for index, (begin, after, side) in enumerate(stretches):
        before = stretches[index - 1].side if index else 0
        following = stretches[index + 1].side if index + 1 < len(stretches) else 0
        # A few undecided intervals beside a decided one are a smeared switch, not a free arc.
        short = after - begin <= SMEARED_INTERVALS and (before or following)
        if side or activity.means is None or not short or _is_followed(columns, begin, after):
            events.append(_Event(float(begin), column, side))
        else:
            places = _sides_within(before, following, activity.means[begin:after])
            events += [_Event(begin + place, column, other) for place, other in places]
    return [e for k, e in enumerate(events) if k == 0 or e.side != events[k - 1].side]


def _is_followed(columns: Sequence[Activity], begin: int, after: int) -> bool:
    """Return True if controls may follow a limit of the states that is met in given intervals."""
    return any(
        column.touched is not None
        and bool(column.touched[begin:after].any())
        and not column.sides[max(begin - 1, 0) : after + 1].all()
        for column in columns
    )


def _sides_within(before: int, following: int, means: FloatArray) -> list[tuple[float, int]]:
    """Return the sides of a component within a few undecided intervals, keeping its integral."""
    length = float(means.size)
    if before and following and before != following:
        return [(_crossing(before, means, np.ones(means.size)), following)]
    # Lengths a at `side` and b at the other side: a + b = n and a - b = side * sum of the means.
    side = before or following
    other = float(np.clip((length - side * means.sum()) / 2, 0.0, length))
    if other < NEGLIGIBLE_LENGTH:
        return [(0.0, side)]
    if not before:  # the phase starts here
        return [(0.0, -side), (other, side)]
    if not following:  # the phase ends here
        return [(length - other, -side)]
    return [((length - other) / 2, -side), ((length + other) / 2, side)]


def _join_events(events: Sequence[_Event], columns: Sequence[Activity]) -> None:
    """Move the end of one activity and a nearby start of another to their common midpoint.

    Two limits of states are never paired: a control at its bound lies between them.
    """
    pairs = [(last, e) for last, e in itertools.pairwise(events) if last.column == e.column]
    ends = [e for last, e in pairs if last.side and not e.side]
    begins = [e for last, e in pairs if e.side and not last.side]
    # Nearest pairs first; each end and each start is used once.
    gaps = sorted(
        (abs(one.place - other.place), i, j)
        for i, one in enumerate(ends)
        for j, other in enumerate(begins)
        if one.column != other.column
        and not (columns[one.column].means is None and columns[other.column].means is None)
    )
    moved: set[int] = set()
    for gap, i, j in gaps:
        if gap <= SMEARED_INTERVALS and not {id(ends[i]), id(begins[j])} & moved:
            moved |= {id(ends[i]), id(begins[j])}
            ends[i].place = begins[j].place = (ends[i].place + begins[j].place) / 2
