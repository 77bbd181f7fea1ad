"""Result of a solve: status, values by phase and name, attempts and history."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.foreign_words import Hinting
from microbot_ocp._base.outcome import Advice, Ledger, LedgerRow, Outcome, remark
from microbot_ocp._base.portable import Portable
from microbot_ocp._base.showing import DrawnAxes, GivenAxes, view_for
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.problem import Variable, node_variables, parts_of
from microbot_ocp.ocp.solution._gap import UNKNOWN, Gap
from microbot_ocp.ocp.transcription import (
    Guess,
    Guesses,
    IntArray,
    PhaseLayout,
    Program,
    assemble,
    fill_transitions,
    fill_values,
    guess_table,
    interpolate,
)

if TYPE_CHECKING:
    from microbot_ocp.ocp.refinement import RefinementStep


AGREEING_STARTS = 2  # starts that have to lead to the best of several optima
RARE_SHARE = 0.05  # fraction of the starts below which others may have been missed

INSIDE = ("polynomial", "algebraic")  # variable shapes with values at the points of a scheme
UNCOMPARED = "compared with nothing"


@dataclass(frozen=True)
class Attempt:
    """One run of a solver on a program."""

    solver: str
    status: Status
    message: str
    iterations: int
    cost: float
    infeasibility: float
    wall_time: float
    create_time: float
    function_time: float
    broke_down: bool = False  # True if the solver raised an error, which is the message
    way: str = ""  # name of the strategy; empty for the first solve

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return {**vars(self), "status": self.status}


@dataclass(frozen=True, eq=False)
class PhaseSolution(Hinting, Portable):
    """Values of one phase at its mesh points.

    Attributes
    ----------
    name : str
    duration : float, s
    mesh : array [N+1], fractions of the phase
    values : mapping from the name of a state or control to [N+1, size] (states and linear
        controls), [N, size] (constant controls) or [N, points, size] (polynomial controls and
        algebraic variables), in the units of the declaration. A matrix stands here column by
        column, and as [..., rows, columns] in ``phase[name]``
    layout : places of the values in the program
    stages : scaled stages of the phase, consecutively
    parameters : free parameters [size] by name; ``values`` has them at every mesh point
    """

    name: str
    duration: float
    mesh: FloatArray
    values: Mapping[str, FloatArray]
    layout: Any = None
    stages: FloatArray | None = None
    parameters: Mapping[str, FloatArray] = field(default_factory=dict)

    def __repr__(self) -> str:
        names = ", ".join(self.values)
        return (
            f"<PhaseSolution {self.name!r}: {self.duration:.6g} s, {self.mesh.size - 1} intervals; "
            f"{names}>"
        )

    @property
    def t(self) -> FloatArray:
        """Times of the mesh points since the start of the phase, s."""
        return self.mesh * self.duration

    def __getitem__(self, name: str) -> FloatArray:
        table = checks.by_name(f"phase {self.name!r}", self.values, name)
        variables = () if self.layout is None else self.layout.phase.variables
        columns = next((v.columns for v in variables if v.name == name), 1)
        if columns == 1:
            return table
        return table.reshape(*table.shape[:-1], columns, -1).swapaxes(-1, -2)

    @property
    def laid_out(self) -> PhaseLayout:
        """Layout of the phase in its program; an InputError if no solve made the values."""
        if self.layout is None or self.stages is None:
            raise InputError(
                f"phase {self.name!r} was not made by a solve: it has mesh values only"
            )
        return self.layout

    def points(self, shares: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return the same points [K] of every interval: intervals, fractions of them, times [M]."""
        count = self.mesh.size - 1
        interval, share = np.repeat(np.arange(count), shares.size), np.tile(shares, count)
        t = (self.mesh[interval] + share * np.diff(self.mesh)[interval]) * self.duration
        return interval, share, t

    def rates(self, interval: IntArray) -> dict[str, FloatArray]:
        """Return the time derivatives [size, M] of the linear controls in given intervals."""
        h = np.diff(self.mesh) * self.duration
        return {
            name: (np.diff(self.values[name], axis=0).T / h)[:, interval]
            for name in self.laid_out.phase.rates
        }

    def sample(self, t: ArrayLike) -> dict[str, FloatArray]:
        """Return every state, control and algebraic variable [M, size] at times t [M], s.

        Times count from the start of the phase. Between mesh points the scheme's own interpolation
        is used.
        Raises
        ------
        InputError
            A time is outside the phase or not finite.
        """
        layout = self.laid_out
        assert self.stages is not None
        times = checks.array("t", np.atleast_1d(np.asarray(t, dtype=float)), (None,), "s")
        slack = ROUNDING * max(1.0, self.duration)
        outside = times[(times < -slack) | (times > self.duration + slack)]
        if outside.size:
            raise InputError(
                f"t must be within the phase, 0 to {self.duration:g} s, not {outside[0]:g} s"
            )
        share = np.clip(times / self.duration, self.mesh[0], self.mesh[-1])
        k = np.clip(np.searchsorted(self.mesh, share, side="right") - 1, 0, self.mesh.size - 2)
        step = np.diff(self.mesh)[k]
        return layout.interpolated(self.stages, k, (share - self.mesh[k]) / step)


@dataclass(frozen=True, eq=False)
class StartingPoint:
    """Scaled variables at the start of a solve, with multipliers if an earlier solve has them."""

    x: FloatArray
    row_multipliers: FloatArray | None = None
    variable_multipliers: FloatArray | None = None
    missing: tuple[str, ...] = ()  # names of variables that the earlier solution lacks

    @property
    def warm(self) -> bool:
        """True if there are multipliers."""
        return self.row_multipliers is not None and self.variable_multipliers is not None

    @property
    def multipliers(self) -> tuple[FloatArray, FloatArray]:
        """Multipliers of the rows and of the variables."""
        assert self.row_multipliers is not None
        assert self.variable_multipliers is not None
        return self.row_multipliers, self.variable_multipliers


@dataclass(frozen=True, eq=False)
class Solution(Hinting, Portable):
    """Result of an optimal-control solve, converged or not.

    Attributes
    ----------
    status : Status
    cost : float
    phases : one PhaseSolution per phase
    attempts : runs of solvers, in order
    row_multipliers : multipliers of the rows of the scaled program, positive at upper bounds
    variable_multipliers : multipliers of the bounds of its variables, positive at upper bounds
    build_time : wall time of the transcription, s
    variables : scaled variables
    settings : settings of the solve as plain values
    cost_scale : divisor of the cost inside the solver; ``cost`` and multipliers are not divided
    gap : estimate of the cost above the nearby local optimum, in the unit of the cost
    rows : meaning of the status, with remedies if the solve did not converge
    start : starting point of the solve
    maximize : True if the cost is a negative gain, see ``objective``
    rivals : excess of every local optimum of nearly the least cost, this solution included, over
        the least one, on a coarse mesh and relative to the cost, in increasing order; empty if only
        one was found
    agreed : number of starts that led to the least cost found, this one included
    compared : number of other starts whose results it was compared with; with 0, other optima are
        unknown, as ``advice`` and the printed solution state
    history : meshes of the refinement with their errors; printed as a table
    ledger : strategies of the search and their effect; printed as a table
    """

    status: Status
    cost: float
    phases: tuple[PhaseSolution, ...]
    attempts: tuple[Attempt, ...]
    row_multipliers: FloatArray
    build_time: float
    variable_multipliers: FloatArray | None = None
    variables: FloatArray | None = None
    settings: Mapping[str, object] = field(default_factory=dict)
    cost_scale: float = 1.0
    gap: Gap = UNKNOWN
    rows: tuple[Advice, ...] = ()
    start: StartingPoint | None = field(default=None, repr=False)
    maximize: bool = False
    rivals: tuple[float, ...] = ()
    agreed: int = 0
    compared: int = 0
    history: Sequence[RefinementStep] = field(default=(), repr=False)
    ledger: Ledger = field(default=Ledger(), repr=False)

    def __repr__(self) -> str:
        last = f", {self.attempts[-1].solver}" if self.attempts else ""
        cost = f"cost {self.cost:.8g}{self.gap}"
        if self.maximize:
            cost = f"objective {self.objective:.8g}{self.gap}".replace("above", "below")
        alone = f", {UNCOMPARED}" if self.solved and not self.compared else ""
        return f"<Solution: {self.status}, {cost}, {self.duration:.6g} s{last}{alone}>"

    def _repr_html_(self) -> str:
        return view_for(self, "table")(self)._repr_html_()

    def plot(self, axes: GivenAxes | None = None, **options: Any) -> DrawnAxes:
        """Plot states and controls over time: :func:`microbot_ocp.plots.solution`."""
        return view_for(self, "plot")(self, axes, **options)

    def __getitem__(self, name: str) -> PhaseSolution:
        phases = {phase.name: phase for phase in self.phases}
        inside = next((phase for phase in phases if name in phases[phase].values), None)
        hint = f"; write solution[{inside!r}][{name!r}]" if inside else ""
        return checks.by_name("the solution", phases, name, hint)

    @property
    def solved(self) -> bool:
        """True if the status is a success."""
        return self.status.solved

    @property
    def outcome(self) -> Outcome:
        """Status, advice and ledger."""
        return Outcome(self.status, self.rows, self.ledger)

    @property
    def advice(self) -> str:
        """Meaning of the status and remedies, one sentence per line."""
        return self.outcome.text

    def ended(self, status: Status, *remarks: str) -> Solution:
        """Return a copy with another status, and remarks on it; empty texts are skipped."""
        return replace(self, status=status, rows=Outcome.of(status).advice).remarked(*remarks)

    def remarked(self, *remarks: str) -> Solution:
        """Return a copy with further remarks; empty texts are skipped."""
        return replace(self, rows=self.outcome.and_(*map(remark, filter(None, remarks))).advice)

    @property
    def objective(self) -> float:
        """Cost, or gain of a problem that maximises."""
        return -self.cost if self.maximize else self.cost

    @property
    def unsettled(self) -> bool:
        """True for one of several local optima whose least one was found from few starts."""
        return bool(self.rivals) and self.agreed < max(AGREEING_STARTS, RARE_SHARE * self.compared)

    def with_rivals_of(self, other: Solution) -> Solution:
        """Return a copy with the rivals and remarks of another solution."""
        remarks = [r for r in other.rows if r.kind == "remark" and r not in self.rows]
        known = {"rivals": other.rivals, "agreed": other.agreed, "compared": other.compared}
        return replace(self, **known, rows=(*self.rows, *remarks))

    @property
    def several(self) -> str:
        """Remark on several local optima; empty if there is only one."""
        if not self.rivals:
            return ""
        return (
            f"One of several local optima: other starts ended in {len(self.rivals) - 1} more, the "
            f"second best {self.rivals[1]:.1g} of the cost above the best on a coarse mesh; the "
            "best one found is kept, and there may be others."
        )

    def sensitivities(self) -> dict[str, dict[str, FloatArray]]:
        """Return derivatives of the objective by parameters and measurements, by phase and name.

        They follow from the multipliers without another solve, and are valid while the active set
        does not change. Any number may be declared as a parameter:
        ``initial=phase.parameter("x0", 1.0)``, ``upper=phase.parameter("limit", 2.0)``.

        Raises
        ------
        InputError
            The solution did not converge, or was not made by a solve.

        Examples
        --------
        A mass m needs T = 2 sqrt(m s / F) for a distance s with a force F: dT/dm = T / (2 m).

        >>> from microbot_ocp.ocp import OptimalControlProblem, solve
        >>> problem = OptimalControlProblem("car")
        >>> phase = problem.phase("move", duration=(0.1, 20.0))
        >>> x = phase.state("x", initial=0.0, final=phase.parameter("distance", 4.0))
        >>> v = phase.state("v", initial=0.0, final=0.0)
        >>> u = phase.control("u", lower=-1.0, upper=1.0)
        >>> phase.derivative(x, v)
        >>> phase.derivative(v, u / phase.parameter("mass", 1.0))
        >>> phase.end_cost(phase.duration)
        >>> {k: s.round(4).tolist() for k, s in solve(problem).sensitivities()["move"].items()}
        {'distance': [0.5], 'mass': [2.0]}
        """
        layouts = [phase.layout for phase in self.phases if phase.layout is not None]
        if not self.solved or self.variables is None or len(layouts) < len(self.phases):
            raise InputError("sensitivities need a converged solution of a solve")
        nlp = assemble(layouts, parametric=True).nlp
        multipliers = ca.MX.sym("multipliers", self.row_multipliers.size)
        lagrangian = nlp["f"] + ca.dot(multipliers, nlp["g"])
        given = [nlp["x"], nlp["p"], multipliers]
        slope = ca.Function("slope", given, [ca.gradient(lagrangian, nlp["p"])])
        data = np.concatenate([layout.data for layout in layouts])
        slopes = np.array(slope(self.variables, data, self.row_multipliers)).ravel()
        slopes *= -1.0 if self.maximize else 1.0
        result: dict[str, dict[str, FloatArray]] = {}
        for phase in (layout.phase for layout in layouts):
            table = result[phase.name] = {}
            for constant in (*phase.parameters, *phase.measurements):
                table[constant.name] = slopes[: constant.value.size].reshape(constant.value.shape)
                slopes = slopes[constant.value.size :]
        return result

    def shifted(self, seconds: float) -> Solution:
        """Return the solution as seen some seconds later, to start the next receding-horizon solve.

        For problems with one phase of fixed duration. As ``guess`` of a :class:`ParametricSolver`
        or of :func:`~microbot_ocp.ocp.solve` it supplies values and multipliers at the times of the
        new horizon, and its final values beyond its end. Its times begin at ``-seconds``.
        """
        seconds = checks.number("seconds", seconds, "s", at_least=0.0, at_most=self.duration)
        phase = self.phases[0]
        layout = phase.layout
        if len(self.phases) > 1 or layout is None or np.ptp(layout.phase.duration_bounds) > 0.0:
            raise InputError("shifted needs the solution of one phase of fixed duration")
        mesh = phase.mesh - seconds / phase.duration
        later = replace(phase, mesh=mesh, layout=replace(layout, mesh=mesh))
        return replace(self, phases=(later,))

    @property
    def parameters(self) -> dict[str, FloatArray]:
        """Free parameters by name [size], and point values that expressions of phases use."""
        return {k: v for phase in self.phases for k, v in phase.parameters.items()}

    @property
    def duration(self) -> float:
        """Sum of the durations of the phases, s."""
        return float(sum(phase.duration for phase in self.phases))


Given = Guesses | Solution | str | None  # starting points that a solve accepts


@dataclass(frozen=True, eq=False)
class Journal:
    """Attempts of a solve, and a ledger row for every strategy."""

    attempts: list[Attempt] = field(default_factory=list)
    rows: list[LedgerRow] = field(default_factory=list)

    def enter(
        self,
        strategy: str,
        before: Solution | None,
        after: Solution | None,
        attempts: Sequence[Attempt],
        seconds: float,
    ) -> None:
        """Add the attempts of a strategy, and the solution that it led to, if any."""
        last = before if after is None else after
        old, new = (None if each is None else each.cost for each in (before, last))
        iterations = sum(max(attempt.iterations, 0) for attempt in attempts)
        self.attempts.extend(attempts)
        decided = after is not None
        self.rows.append(LedgerRow(strategy, 1, decided, old, new, iterations, seconds))

    def discard(self, part: slice) -> None:
        """Mark rows whose strategy did not lead to the result."""
        self.rows[part] = Ledger(self.rows[part]).discarded()

    def closed(self, solution: Solution) -> Solution:
        """Return the result with all attempts and the ledger."""
        return replace(solution, attempts=tuple(self.attempts), ledger=Ledger.of(self.rows))


def unpack(layouts: Sequence[Any], x: FloatArray) -> tuple[PhaseSolution, ...]:
    """Return phase values by name from the scaled variables."""
    return tuple(
        layout.unpacked(x) if hasattr(layout, "unpacked") else _phase_values(layout, x)
        for layout in layouts
    )


def _phase_values(layout: PhaseLayout, x: FloatArray) -> PhaseSolution:
    nodes = x[layout.nodes] * layout.node_scale
    stages = x[layout.stages]
    values = parts_of(node_variables(layout.phase), nodes[:, :-1])
    inside: dict[str, list[FloatArray]] = {}
    controls = (x[layout.stage_variables] * layout.kind.scale)[:, layout.node_size :]
    edges = np.cumsum([k.source.size for k in layout.kind.inner])
    for k, part in zip(layout.kind.inner, np.split(controls, edges, axis=1), strict=False):
        if k.source.shape in ("constant", *INSIDE):
            inside.setdefault(k.source.name, []).append(part)
    for name, parts in inside.items():
        values[name] = np.stack(parts, axis=1) if len(parts) > 1 else parts[0]
    free = {v.name: values[v.name][0] for v in layout.phase.free_parameters}
    name, duration = layout.phase.name, float(nodes[0, -1])
    return PhaseSolution(name, duration, layout.mesh, values, layout, stages, free)


def pack(program: Program, guesses: Guesses) -> FloatArray:
    """Return scaled variables from a guess for every phase.

    Raises
    ------
    InputError
        A phase or a state has no guess, a guess has a wrong shape, or a value is not finite.
    """
    x = np.zeros(program.variable_lower.size)
    for layout in program.layouts:
        phase, steps = layout.phase, np.diff(layout.mesh)
        guess, names = guesses[phase.name], [v.name for v in phase.variables]
        label = f"guess of the duration of phase {phase.name!r}"
        duration = checks.number(label, guess.duration, "s", above=0.0)
        for name in guess.values:
            if name not in names:
                raise InputError(
                    f"guess of phase {phase.name!r} has {name!r}, which is none of its variables: "
                    f"{', '.join(names)}"
                )
        table = [_guess_table(layout, guess, v, layout.mesh) for v in node_variables(phase)]
        table.append(np.full((layout.intervals + 1, 1), duration))
        x[layout.nodes] = np.hstack(table) / layout.node_scale
        points, w = layout.kind.scheme.points, [np.zeros((layout.intervals, 0))]
        for k in layout.kind.inner:
            which = points.index(k.fraction) if k.source.shape in INSIDE else None
            at = layout.mesh[:-1] + k.fraction * steps
            w.append(_guess_table(layout, guess, k.source, at, which))
        inner = slice(layout.node_size, None)
        x[layout.stage_variables[:, inner]] = np.hstack(w) / layout.kind.scale[inner]
    fill_values(program.layouts, x)
    fill_transitions(program.layouts, x)
    return x


def _guess_table(
    layout: PhaseLayout, guess: Guess, variable: Variable, at: FloatArray, which: int | None = None
) -> FloatArray:
    """Return the guess of a variable at fractions of the phase.

    ``which`` selects the point of the scheme if the guess has values at several.
    """
    label = f"guess of {variable.name!r} in phase {layout.phase.name!r}"
    if variable.name not in guess.values:
        if variable.shape in ("state", "linear", "parameter"):
            raise InputError(f"{label} is missing")
        return np.zeros((at.size, variable.size))
    table = guess_table(guess.values[variable.name], variable.size, at)
    if table.ndim == 3 and which is not None and which < table.shape[1]:
        table = table[:, which]  # values of an earlier solution at the points of a scheme
    if table.shape == (layout.mesh.size, variable.size) and not np.array_equal(at, layout.mesh):
        table = interpolate(table, at, layout.mesh)
    if table.shape != (at.size, variable.size):
        raise InputError(
            f"{label} must have shape [{at.size}, {variable.size}], not {list(table.shape)}"
        )
    if not np.isfinite(table).all():
        raise InputError(f"{label} must be finite")
    return table
