"""Switching times as unknowns: the arcs of a solution, each a phase of free length.

On an arc every control is at a bound, or follows from a limit that acts, or is free; what is held
has no discretisation, and the dynamics are integrated by Radau collocation of order 9,
until they hold to a wanted accuracy. A bang-bang problem becomes a handful of equations for its
switching times. Source: C. Y. Kaya and J. L. Noakes, *Computational method for time-optimal
switching control*, J. Optim. Theory Appl. 117 (2003) 69-92.

The arcs are corrected as the solves go: what shrinks to nothing is left out, where a held control
would rather leave its bound it is freed, and a free one that comes to lie at a bound is held.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp._base.table import Column, Table
from microbot_ocp.ocp.arcs._cutter import (
    MOST_ARCS,
    SHORTEST_DURATION,
    Conditions,
    Sample,
    Stretch,
    conditions_of,
    controls_at_bounds,
    cut,
    limits_of,
    links_between,
)
from microbot_ocp.ocp.arcs._detector import arcs_between_events
from microbot_ocp.ocp.arcs._singular import (
    Near,
    NotPossibleError,
    SingularArcs,
    costate_sample,
    solve_conditions,
)
from microbot_ocp.ocp.mesh import divide, excess_of_limits, state_errors
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase
from microbot_ocp.ocp.solution import (
    UNKNOWN,
    Gap,
    PhaseSolution,
    Solution,
    StepProgress,
    cost_size,
    quiet,
    scaled,
)
from microbot_ocp.ocp.solvers import SolverSettings, solve
from microbot_ocp.ocp.transcription import (
    Label,
    Mesh,
    Transcription,
    row_labels,
    variable_labels,
)
from microbot_ocp.ocp.transcription.schemes import Collocation
from microbot_ocp.ocp.verification import phase_layout

SCHEME = Collocation("radau", 5)
FREE_DEGREE = 3  # where a control is free: more would let it swing where it is singular
SETTINGS = SolverSettings(
    "ipopt", tolerance=1e-10, gap=1e-7, initial_barrier=1e-4, max_iterations=300
)
LOOSER = 1e-8
LEAST_INTERVALS, MOST_INTERVALS = 2, 8  # of an arc at first: the order is high
COARSER = 3  # intervals of the mesh that an arc is read from, for one of its own
WORSE = 1e-3  # share by which the arcs may cost more than what they come from
WRONG = 1e-3  # of its largest: a multiplier of the wrong sign that is larger frees a control
EXCEEDED = 1e-4  # of a limit: by more it may not be exceeded on an arc where it is free to act
KEPT = 1e-8  # of a limit: by more it is exceeded only where an arc has no more intervals to get
FINEST = 64  # intervals of an arc that are to keep a limit between its points
CHANGES = 8  # solves that may change the arcs
INSERTED = 2e-3  # of a phase: an arc for what happens in another order than was thought
MET = 1e-5  # of its range: a limit of the states that is so near is met
MISSED = 1e-7  # of its range: by more a limit of states may not be exceeded
CHECKED = 200  # times an arc at which these are looked at
FREE_INTERVALS = 6  # at least, of an arc on which something is free: fewer hide what it does
MOST = 2 * MOST_ARCS  # of a phase: short ones may turn out to be none
CONDITIONS_AFTER = (Status.SOLVED, Status.ROUND_LIMIT, Status.GAP_LEFT, Status.NO_PROGRESS)
MOVED = 1e-2  # of a phase: arcs that have not moved by so much are the same start
AMID = 1e-2  # of a phase: a shorter arc amid a singular one may be none
NAMES = {-1: "lower limit", 0: "free", 1: "upper limit"}
SINGULAR = "singular, by its own conditions"


@dataclass(frozen=True)
class Junction:
    """Where one arc ends and another begins, and one thing that changes there.

    Attributes
    ----------
    phase : str
    time : s since the start of the phase
    name, component : the control or limit that changes
    before, after : "lower limit", "upper limit", "free", or "singular, by its own conditions"
    """

    phase: str
    time: float
    name: str
    component: int
    before: str
    after: str


@dataclass(frozen=True, eq=False)
class SwitchingTimes:
    """A solution in arcs.

    Attributes
    ----------
    status : Status
    advice : str
    junctions : in the order of time
    solution : of the problem with one phase an arc; its gap is that of the times
    pieces : names of its phases by the phase that they are arcs of
    state_error : largest relative error of the dynamics in any interval
    singular : where singular arcs follow from their own conditions, these; then times, cost and
        samples are theirs, and ``solution`` is what they were read from
    """

    status: Status
    advice: str
    junctions: tuple[Junction, ...]
    solution: Solution
    pieces: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    state_error: float = np.inf
    singular: SingularArcs | None = None

    @property
    def solved(self) -> bool:
        """Whether the arcs are those of a local optimum, and followed to the accuracy."""
        return self.status.solved

    @property
    def cost(self) -> float:
        """Cost of the whole."""
        return self.solution.cost if self.singular is None else self.singular.cost

    @property
    def gap(self) -> Gap:
        """How much the cost may be above that of the local optimum; unknown of singular arcs."""
        return self.solution.gap if self.singular is None else UNKNOWN

    def duration(self, phase: str) -> float:
        """Duration of a phase, s."""
        if self.singular is not None:
            return float(self.singular.lengths.sum())
        return float(sum(self.solution[name].duration for name in self.pieces[phase]))

    def sample(self, phase: str, t: ArrayLike) -> dict[str, FloatArray]:
        """Every variable [M, size] of a phase at times t [M] since its start.

        At a junction it is the arc that begins there.
        """
        times = checks.array("t", np.atleast_1d(np.asarray(t, dtype=float)), (None,), "s")
        if self.singular is not None:
            return self.singular.sample(times)
        return _joined([self.solution[name] for name in self.pieces[phase]])(times)

    def table(self) -> Table:
        """One row a junction."""
        columns = (
            Column("phase", left=True),
            Column("time", "s", ".12g"),
            Column("what", left=True),
            Column("before", left=True),
            Column("after", left=True),
        )
        rows = [
            (j.phase, j.time, f"{j.name}[{j.component}]", j.before, j.after) for j in self.junctions
        ]
        return Table(columns, rows)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "status": str(self.status),
            "advice": self.advice,
            "cost": self.cost,
            "gap": self.gap.total if self.singular is None else None,
            "state_error": self.state_error,
            "junctions": [vars(junction) for junction in self.junctions],
        }

    def __str__(self) -> str:
        return f"{self.table()}\ncost {self.cost:.15g}{self.gap}\n{self.advice}"

    def __repr__(self) -> str:
        count = len(self.junctions)
        return f"<SwitchingTimes: {self.status}, {count} switches, cost {self.cost:.12g}{self.gap}>"


def solve_switching_times(
    problem: OptimalControlProblem | Transcription,
    start: Solution | None = None,
    *,
    accuracy: float = 1e-9,
    settings: SolverSettings | None = None,
    rounds: int = 16,
    time_limit: float = 60.0,
    progress: StepProgress = quiet,
    transcribe: Callable[..., Transcription] = Transcription,
) -> SwitchingTimes:
    """Solve for the times at which controls switch and limits begin or cease to act.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
    start : Solution, optional
        That shows the arcs; its cost is what theirs may not exceed. Default: :func:`solve` on 50
        intervals.
    accuracy : float
        Relative error of the dynamics that is accepted in any interval.
    settings : SolverSettings, optional
        Default: IPOPT to a tolerance of 1e-10 and a gap of 1e-7 of the cost.
    rounds : int
        Most solves of one set of arcs.
    time_limit : float
        Wall time after which it is stopped, s.
    progress : callable
        Called with a line of text for every solve.
    transcribe : callable
        Makes a transcription of the problem with one phase an arc; its keyword is ``scheme``.

    Returns
    -------
    SwitchingTimes
        Also where that failed: look at ``status``.

    Raises
    ------
    InputError
        The start is none of the problem, or the problem cannot be cut: it has expressions of the
        duration of a phase along that phase.

    Examples
    --------
    >>> problem = OptimalControlProblem("double integrator")
    >>> phase = problem.phase("move", duration=(0.1, 10.0))
    >>> x = phase.state("x", initial=0.0, final=3.0)
    >>> v = phase.state("v", initial=0.0, final=0.0)
    >>> u = phase.control("u", lower=-1.0, upper=2.0)
    >>> phase.derivative(x, v)
    >>> phase.derivative(v, u)
    >>> phase.end_cost(phase.duration)
    >>> found = solve_switching_times(problem)  # 1 s at 2, then 2 s at -1
    >>> [(j.name, round(j.time, 9), j.after) for j in found.junctions], round(found.cost, 9)
    ([('u', 1.0, 'lower limit')], 3.0)
    """
    accuracy = checks.number("accuracy", accuracy, above=0.0)
    with deadline.within(time_limit):
        how = settings or SETTINGS, progress, transcribe
        return _switching_times(problem, start, accuracy, rounds, how)


def _switching_times(
    problem: OptimalControlProblem | Transcription,
    start: Solution | None,
    accuracy: float,
    rounds: int,
    how: Any,
) -> SwitchingTimes:
    """As :func:`solve_switching_times`, until the time is over."""
    declared = problem.problem if isinstance(problem, Transcription) else problem
    first = solve(problem, 50) if start is None else start
    names = [phase.name for phase in first.phases]
    if names != [phase.name for phase in declared.phases]:
        raise InputError(f"start has the phases {names}, which are not those of the problem")
    if first.status not in (Status.SOLVED, Status.TOO_COARSE):  # which shows the arcs, too
        return SwitchingTimes(first.status, first.advice, (), first)
    until = deadline.until()
    plans = [_planned(phase) for phase in first.phases]
    return _Search(declared, first, plans, accuracy, *how).run(rounds, until)


@dataclass(frozen=True, eq=False)
class _Plan:
    """The arcs of one phase as they are guessed, and what the guess is made of."""

    declared: Phase
    duration: float
    sample: Sample
    arcs: tuple[Stretch, ...]
    limits: tuple[Any, ...]
    columns: tuple[tuple[str, int], ...]  # names and components of what a signature says

    @property
    def signatures(self) -> tuple[tuple[int, ...], ...]:
        return tuple(arc.signature for arc in self.arcs)


def _planned(phase: PhaseSolution) -> _Plan:
    declared = phase_layout(phase).phase
    found, limits = arcs_between_events(phase)
    count = phase.mesh.size - 1
    arcs = [replace(arc, intervals=_intervals((arc.end - arc.begin) * count)) for arc in found]
    columns = [(c.name, i) for c in declared.controls if c.shape != "linear" for i in range(c.size)]
    columns += [(limit.constraint.name, limit.component) for limit in limits]
    arcs = [arc if arc.signature else replace(arc, signature=(0,) * len(columns)) for arc in arcs]
    arcs = _merged([replace(arc, signature=_active(arc, limits)) for arc in arcs])
    return _Plan(declared, phase.duration, phase.sample, tuple(arcs), tuple(limits), tuple(columns))


def _intervals(of_mesh: float) -> int:
    """Intervals of an arc that has so many on the mesh that it is read from."""
    return int(np.clip(np.ceil(of_mesh / COARSER), LEAST_INTERVALS, MOST_INTERVALS))


def _active(arc: Stretch, limits: Sequence[Any]) -> tuple[int, ...]:
    """A signature without limits of states that are met where no control is left to keep them."""
    controls = arc.signature[: len(arc.signature) - len(limits)]
    sides = arc.signature[len(controls) :]
    if not controls or not all(controls):
        return arc.signature
    return (*controls, *(k * limit.mixed for k, limit in zip(sides, limits, strict=True)))


def _merged(arcs: Sequence[Stretch]) -> list[Stretch]:
    """Neighbours that have everything in common are one."""
    found: list[Stretch] = []
    for arc in arcs:
        if found and found[-1].signature == arc.signature:
            intervals = min(found[-1].intervals + arc.intervals, MOST_INTERVALS)
            found[-1] = replace(found[-1], end=arc.end, intervals=intervals)
        else:
            found.append(arc)
    return found


def _order(piece: PhaseSolution) -> int:
    return int(phase_layout(piece).kinds[0].scheme.order)


def _joined(pieces: Sequence[PhaseSolution]) -> Sample:
    """Values at times since the start of the first piece."""
    ends = np.cumsum([piece.duration for piece in pieces])

    def sample(t: FloatArray) -> dict[str, FloatArray]:
        own = np.minimum(np.searchsorted(ends, t, side="right"), len(pieces) - 1)
        found: dict[str, FloatArray] = {}
        for index in np.unique(own).tolist():
            piece, chosen = pieces[index], own == index
            begin = float(ends[index]) - piece.duration
            for name, values in piece.sample(t[chosen] - begin).items():
                found.setdefault(name, np.zeros((t.size, values.shape[1])))[chosen] = values
        return found

    return sample


class _Search:
    """Solves with one phase an arc, and what changes between them."""

    def __init__(
        self,
        problem: OptimalControlProblem,
        first: Solution,
        plans: list[_Plan],
        accuracy: float,
        settings: SolverSettings,
        progress: StepProgress,
        transcribe: Callable[..., Transcription],
    ) -> None:
        self.problem, self.first, self.plans = problem, first, plans
        self.accuracy, self.settings, self.progress = accuracy, settings, progress
        self.transcribe = transcribe
        self.made: Any = (None, None, None)  # signatures, and what was transcribed for them
        self.tried: set[tuple[Any, ...]] = set()  # signatures of all phases
        self.by_conditions: set[tuple[Any, ...]] = set()  # arcs that were tried so
        self.not_by_conditions = ""  # why the first of these was not accepted
        self.closing = False  # whether the gap is to be closed, once all else is well

    def run(self, rounds: int, until: float) -> SwitchingTimes:
        status, said = Status.ROUND_LIMIT, ""
        found: SwitchingTimes | None = None
        before: tuple[Solution, list[list[Phase]], list[_Plan]] | None = None
        for done in range(rounds):
            if any(len(plan.arcs) > MOST for plan in self.plans):
                said = f"More than {MOST} arcs in a phase are too many to solve for."
                status = Status.NOT_POSSIBLE
                break
            if time.perf_counter() > until:
                status = Status.TIME_LIMIT
                break
            solution, groups = self._solved()
            self.progress(
                f"{sum(map(len, groups))} arcs: cost {solution.cost:.12g}, {solution.status}"
            )
            if solution.status in (Status.SOLVED, Status.GAP_LEFT, Status.TOO_COARSE):
                before = solution, groups, self.plans
                changed = self._changed(solution, groups) if done < CHANGES else None
            elif before is None or solution.status is Status.INTERRUPTED:
                status = solution.status
                said = (
                    f"The {sum(map(len, groups))} arcs that the solution shows cannot follow one "
                    "another, or were not made to: one is missing or wrong, and a start on a finer "
                    f"mesh may show which. Of their solve: {status.sentence}"
                )
                break
            else:  # that change led nowhere
                self.tried.add(tuple(plan.signatures for plan in self.plans))
                solution, groups, self.plans = before
                changed = self._changed(solution, groups) if done < CHANGES else None
            if changed is not None:
                self.plans = changed
                continue
            if not self.by_conditions:  # before meshes are refined for what these determine
                determined = self._by_conditions(solution, groups, self.plans)
                if determined is not None:
                    return determined
            errors = state_errors(solution)
            found = self._result(solution, groups, max(float(e.max()) for e in errors))
            exceeding = self._exceeding(solution)
            if found.state_error <= self.accuracy and not (exceeding and done < rounds - 1):
                status, said = self._judged(solution, groups)
                if status is not Status.GAP_LEFT or self.closing:
                    break
                self.closing, status = True, Status.ROUND_LIMIT
            self._refine(solution, groups, errors, exceeding)
        found = found or SwitchingTimes(status, "", (), self.first)
        if status is Status.ROUND_LIMIT:
            said = (
                f"{status.sentence} The dynamics hold to {found.state_error:.1e}, "
                f"{self.accuracy:.1e} is wanted."
            )
        said = said or status.sentence
        if status in CONDITIONS_AFTER and before is not None:
            determined = self._by_conditions(*before)
            if determined is not None:
                return determined
        if status is not Status.INTERRUPTED:
            said += _undetermined(self.plans)
            if self.not_by_conditions:
                said += f" Its own conditions do not determine it: {self.not_by_conditions}."
        return replace(found, status=status, advice=said)

    def _by_conditions(
        self, solution: Solution, groups: Sequence[Sequence[Phase]], plans: list[_Plan]
    ) -> SwitchingTimes | None:
        """The answer with its singular arcs by their own conditions, where these can be solved.

        A solve for the least cost may put arcs that are none into a singular one, or lose one
        beside it: if the conditions cannot be solved with the arcs that it has, they are without
        short ones amid a singular arc, and with those that the start shows.
        """
        if self.transcribe is not Transcription or not _undetermined(plans):
            return None  # dynamics with derivatives of their own have no higher ones
        solved = [[solution[piece.name] for piece in group] for group in groups]
        known = zip(plans, solved, strict=True)
        plans = [
            replace(plan, arcs=tuple(_as_solved(plan, own)), sample=_joined(own))
            for plan, own in known
        ]
        guessed = [(plan, own, solution) for plan, own in zip(plans, solved, strict=True)]
        guessed += [
            (replace(plan, arcs=tuple(_without_short(plan))), own, solution)
            for plan, own in zip(plans, solved, strict=True)
        ]
        guessed += [(_planned(phase), [phase], self.first) for phase in self.first.phases]
        for plan, own, source in guessed:
            key = tuple((arc.signature, round(arc.end / MOVED)) for arc in plan.arcs)
            if key in self.by_conditions:
                continue
            self.by_conditions.add(key)
            try:
                singular = solve_conditions(self.problem, _near(plan, own, source), self.accuracy)
            except NotPossibleError as error:
                self.progress(f"conditions of {len(plan.arcs)} arcs: {error}")
                self.not_by_conditions = self.not_by_conditions or str(error)
                continue
            self.progress(f"conditions of {len(plan.arcs)} arcs: cost {singular.cost:.12g}")
            self.plans = plans
            return _with_singular(self._result(solution, groups, np.inf), plan, singular)
        return None

    def _solved(self) -> tuple[Solution, list[list[Phase]]]:
        whole = OptimalControlProblem(f"{self.problem.name} in arcs")
        guesses, meshes, groups = {}, [], []
        conditions = [
            conditions_of(plan.declared, plan.arcs, plan.limits, first=index == 0)
            for index, plan in enumerate(self.plans)
        ]
        for index, plan in enumerate(self.plans):
            before = conditions[index - 1][-1] if index else Conditions()
            after = conditions[index + 1][0] if index + 1 < len(conditions) else Conditions()
            own = [before, *conditions[index], after]
            cut_up = cut(plan.declared, plan.duration, plan.arcs, plan.limits, plan.sample, own)
            if cut_up is None:
                raise InputError(
                    f"phase {plan.declared.name!r} cannot be cut into arcs: what holds along it "
                    "depends on its duration"
                )
            pieces, own_guesses, own_meshes = cut_up
            groups.append(pieces)
            whole.phases += pieces
            guesses |= {k.name: guess for k, guess in zip(pieces, own_guesses, strict=True)}
            meshes += [_with_degree(*pair) for pair in zip(pieces, own_meshes, strict=True)]
        whole.links = links_between(self.problem, groups)
        key = tuple(plan.signatures for plan in self.plans)
        if key != self.made[0]:  # else only meshes and guesses are new
            self.made = key, self.transcribe(scaled(whole, guesses), scheme=SCHEME), groups
        _, made, groups = self.made
        settings = self.settings if self.closing else replace(self.settings, gap=np.inf)
        solution = solve(made, meshes, guesses, settings)
        if solution.status is Status.FAILED:  # rounding may leave the first tolerance out of reach
            looser = replace(settings, tolerance=max(settings.tolerance, LOOSER))
            solution = solve(made, meshes, guesses, looser)
        return solution, groups

    def _changed(self, solution: Solution, groups: Sequence[Sequence[Phase]]) -> list[_Plan] | None:
        """Plans with other arcs, where the solution asks for them."""
        shrunk = any(
            _is_gone(plan, solution[piece.name])
            for plan, group in zip(self.plans, groups, strict=True)
            for piece in group
        )
        wrong = {} if shrunk else _wrong_signs(solution, self.plans, groups)  # first these
        self.tried.add(tuple(plan.signatures for plan in self.plans))
        for bold in (True, False):
            plans = [
                _revised(plan, [solution[piece.name] for piece in group], wrong, bold)
                for plan, group in zip(self.plans, groups, strict=True)
            ]
            if tuple(plan.signatures for plan in plans) not in self.tried:
                return plans
        return None

    def _exceeding(self, solution: Solution) -> dict[str, int]:
        """Into how many to divide the intervals of the arcs that exceed a limit between points."""
        return {
            piece.name: int(np.clip(np.ceil((excess.max() / KEPT) ** (1 / SCHEME.degree)), 2, 4))
            for piece, excess in zip(solution.phases, excess_of_limits(solution)[0], strict=True)
            if excess.size and excess.max() > KEPT and piece.mesh.size <= FINEST
        }

    def _refine(
        self,
        solution: Solution,
        groups: Sequence[Sequence[Phase]],
        errors: Sequence[FloatArray],
        exceeding: Mapping[str, int],
    ) -> None:
        """More intervals for arcs whose dynamics are not accurate or whose limits are not kept."""
        left = iter(errors)
        for index, (plan, group) in enumerate(zip(self.plans, groups, strict=True)):
            pieces = [solution[piece.name] for piece in group]
            arcs = [
                replace(
                    arc,
                    intervals=max(
                        divide(piece.mesh, next(left), self.accuracy, _order(piece)).size - 1,
                        exceeding.get(piece.name, 1) * (piece.mesh.size - 1),
                    ),
                )
                for arc, piece in zip(_as_solved(plan, pieces), pieces, strict=True)
            ]
            duration = sum(piece.duration for piece in pieces)
            self.plans[index] = replace(
                plan, arcs=tuple(arcs), duration=duration, sample=_joined(pieces)
            )

    def _result(
        self, solution: Solution, groups: Sequence[Sequence[Phase]], error: float
    ) -> SwitchingTimes:
        junctions = []
        for plan, group in zip(self.plans, groups, strict=True):
            ends = np.cumsum([solution[piece.name].duration for piece in group])
            for end, (one, other) in zip(ends, itertools.pairwise(plan.signatures), strict=False):
                junctions += [
                    Junction(plan.declared.name, float(end), *column, NAMES[a], NAMES[b])
                    for column, a, b in zip(plan.columns, one, other, strict=True)
                    if a != b
                ]
        pieces = {
            plan.declared.name: tuple(piece.name for piece in group)
            for plan, group in zip(self.plans, groups, strict=True)
        }
        return SwitchingTimes(Status.SOLVED, "", tuple(junctions), solution, pieces, error)

    def _judged(self, solution: Solution, groups: Sequence[Sequence[Phase]]) -> tuple[Status, str]:
        """Whether the arcs are those of a local optimum, and why not."""
        if solution.cost > self.first.cost + WORSE * abs(self.first.cost):
            return Status.NOT_ACCEPTED, (
                f"The arcs cost {solution.cost:.8g}, more than the {self.first.cost:.8g} of the "
                "solution that they were read from: give one of a finer mesh."
            )
        missed = _missed_states(self.plans, [[solution[p.name] for p in own] for own in groups])
        if missed:
            return Status.LIMITS_EXCEEDED, (
                f"{missed} there are more arcs than the solution that was given shows."
            )
        worst = excess_of_limits(solution)[1]
        if worst is not None and worst.relative > EXCEEDED:
            return Status.LIMITS_EXCEEDED, (
                f"Between mesh points {worst.kind} {worst.name} of {worst.phase!r} is "
                f"{100 * worst.relative:.2g} % beyond its limit: there are more arcs than the "
                "solution that was given shows."
            )
        wanted = self.settings.gap * cost_size(solution.cost, solution.cost_scale)
        if not solution.gap.total <= wanted:
            return Status.GAP_LEFT, (
                f"{Status.GAP_LEFT.sentence} It is {solution.gap.total:.2g}, not {wanted:.2g}."
            )
        wrong = _wrong_signs(solution, self.plans, groups)
        if wrong:
            return Status.NO_PROGRESS, (
                f"A control that is held at its limit in {', '.join(wrong)} would rather leave it: "
                "there are more switches than the solution that was given shows."
            )
        return Status.SOLVED, ""


def _missed_states(plans: Sequence[_Plan], groups: Sequence[Sequence[PhaseSolution]]) -> str | None:
    """The limit of states that is exceeded most, of those that arcs keep by equations or beside."""
    found: list[tuple[float, str]] = []
    for plan, pieces in zip(plans, groups, strict=True):
        ends = sum(piece.duration for piece in pieces)
        known = _joined(pieces)(np.linspace(0.0, ends, CHECKED * len(pieces)))
        states = [known[s.name].T for s in plan.declared.states]
        for limit in plan.limits:
            if limit.mixed:
                continue
            own, i = limit.constraint, limit.component
            run = ca.Function("value", [s.symbol for s in plan.declared.states], [own.expression])
            values = np.array(run(*states))[i]
            reach = own.upper[i] - own.lower[i]
            reach = reach if np.isfinite(reach) else own.scale[i]
            excess = max(float((values - own.upper[i]).max()), float((own.lower[i] - values).max()))
            found.append((excess / float(reach), f"{own.name}[{i}] of {plan.declared.name!r}"))
    excess, name = max(found, default=(0.0, ""))
    return f"{name} is {100 * excess:.2g} % beyond its limit:" if excess > MISSED else None


def _without_short(plan: _Plan) -> list[Stretch]:
    """Arcs without short ones between two others that have everything in common."""
    arcs = plan.arcs
    kept = [
        arc
        for index, arc in enumerate(arcs)
        if arc.end - arc.begin > AMID
        or index in (0, len(arcs) - 1)
        or arcs[index - 1].signature != arcs[index + 1].signature
    ]
    return _merged(kept)


def _near(plan: _Plan, pieces: Sequence[PhaseSolution], solution: Solution) -> Near:
    return Near(
        plan.declared,
        plan.arcs,
        plan.limits,
        float(sum(piece.duration for piece in pieces)),
        solution.cost,
        cost_size(solution.cost, solution.cost_scale),
        max(float(e.max()) for e in state_errors(solution)),
        plan.sample,
        costate_sample(pieces, solution),
    )


def _with_singular(found: SwitchingTimes, plan: _Plan, singular: SingularArcs) -> SwitchingTimes:
    """An answer whose arcs are those of the conditions."""
    controls = len(plan.columns) - len(plan.limits)
    names = [
        [SINGULAR if k < controls and side == 0 else NAMES[side] for k, side in enumerate(one)]
        for one in plan.signatures
    ]
    junctions = [
        Junction(plan.declared.name, float(end), *column, a, b)
        for end, (one, other) in zip(
            np.cumsum(singular.lengths), itertools.pairwise(names), strict=False
        )
        for column, a, b in zip(plan.columns, one, other, strict=True)
        if a != b
    ]
    return replace(
        found,
        status=Status.SOLVED,
        advice=f"{Status.SOLVED.sentence} A control is {SINGULAR}.",
        junctions=tuple(junctions),
        state_error=singular.state_error,
        singular=singular,
    )


def _undetermined(plans: Sequence[_Plan]) -> str:
    """What is said of the time in which fewer limits act than there are controls."""
    spent: dict[str, float] = {}
    for plan in plans:
        count = len(plan.columns) - len(plan.limits)
        free = [arc for arc in plan.arcs if sum(map(abs, arc.signature)) < count]
        reach = sum(arc.end - arc.begin for arc in free)
        if reach > 0:
            spent[plan.declared.name] = reach
    if not spent:
        return ""
    where = ", ".join(f"{100 * share:.2g} % of {name!r}" for name, share in spent.items())
    return (
        f" Along {where} fewer limits act than there are controls: a control is singular there, or "
        "other solutions are as good, and it has no switching times of its own."
    )


def _with_degree(piece: Phase, mesh: Mesh) -> Mesh:
    """The mesh of an arc, of a lower degree where something is free on it."""
    equations = sum(int(np.sum(c.lower == c.upper)) for c in piece.constraints)
    free = sum(int(np.sum(c.lower < c.upper)) for c in piece.controls if c.shape == "polynomial")
    if free <= equations:
        return Mesh(mesh.fractions, SCHEME.degree)
    return Mesh(max(mesh.intervals, FREE_INTERVALS), FREE_DEGREE)


def _as_solved(plan: _Plan, pieces: Sequence[PhaseSolution]) -> list[Stretch]:
    """The arcs of a plan where a solution has them."""
    ends = np.cumsum([0.0, *(piece.duration for piece in pieces)])
    ends /= ends[-1]
    return [
        replace(arc, begin=float(a), end=float(b))
        for arc, (a, b) in zip(plan.arcs, itertools.pairwise(ends), strict=True)
    ]


def _revised(
    plan: _Plan, pieces: Sequence[PhaseSolution], wrong: Mapping[str, Sequence[_Wrong]], bold: bool
) -> _Plan:
    """A plan without the arcs that shrank to nothing, and with those that are divided.

    A ``bold`` one holds a control at its other limit where its multiplier has the sign of that,
    and lets two changes that came to happen at once do so in the other order; else the control
    is free there, and the two happen at once.
    """
    duration = float(sum(piece.duration for piece in pieces))
    arcs = _as_solved(plan, pieces)
    gone = [_is_gone(plan, piece) for piece in pieces]
    count = len(plan.columns) - len(plan.limits)
    found: list[Stretch] = []
    for index, (arc, piece) in enumerate(zip(arcs, pieces, strict=True)):
        if gone[index]:
            if bold and 0 < index < len(arcs) - 1:
                found += _in_other_order(arc, arcs[index - 1], arcs[index + 1])
        elif sum(map(abs, arc.signature)) < count:
            found += _with_sides(plan, arc, piece)
        else:
            beside = [a.signature for a in arcs[max(index - 1, 0) : index + 2]]
            found += _divided(plan, arc, piece, beside, wrong.get(piece.name, ()), bold)
    merged = _merged(found)
    # what was left out leaves no hole, and what is new takes its time from what is beside it
    ends = np.cumsum([0.0, *(max(arc.end - arc.begin, SHORTEST_DURATION) for arc in merged)])
    ends = itertools.pairwise((ends / ends[-1]).tolist())
    closed = [replace(arc, begin=a, end=b) for arc, (a, b) in zip(merged, ends, strict=True)]
    return replace(plan, arcs=tuple(closed), duration=duration, sample=_joined(pieces))


def _is_gone(plan: _Plan, piece: PhaseSolution) -> bool:
    """Whether an arc shrank to nothing."""
    return piece.duration <= 2 * SHORTEST_DURATION * plan.duration and len(plan.arcs) > 1


def _in_other_order(arc: Stretch, before: Stretch, after: Stretch) -> list[Stretch]:
    """What lies between two arcs where all that changes does so in the other order."""
    signature = tuple(
        y if own == x else x if own == y else own
        for own, x, y in zip(arc.signature, before.signature, after.signature, strict=True)
    )
    if signature in (before.signature, arc.signature, after.signature):
        return []
    middle = (arc.begin + arc.end) / 2
    reach = min(INSERTED, before.end - before.begin, after.end - after.begin) / 2
    return [Stretch(middle - reach, middle + reach, signature, LEAST_INTERVALS)]


def _divided(
    plan: _Plan,
    arc: Stretch,
    piece: PhaseSolution,
    beside: Sequence[tuple[int, ...]],
    wrong: Sequence[_Wrong],
    bold: bool,
) -> list[Stretch]:
    """An arc with others where what is held would rather leave its limit.

    Where a limit of the states is met there it takes the place of what leaves.
    """
    places = sorted({0.0, 1.0, *(w.begin for w in wrong), *(w.end for w in wrong)})
    found = []
    for a, b in itertools.pairwise(places):
        signature = list(arc.signature)
        for own in wrong:
            if not (own.begin <= a and b <= own.end):
                continue
            side, signature[own.column] = -signature[own.column], 0
            instead = [
                (*signature[:column], other, *signature[column + 1 :])
                for column, other in _met_on(plan, piece, a, b)
                if not signature[column]
            ]
            instead = [one for one in instead if one not in beside]
            if instead and bold:
                signature = list(instead[0])
            elif bold and _is_limited(plan, own.column, side):
                signature[own.column] = side
        whole = arc.end - arc.begin
        share = max(round((b - a) * arc.intervals), LEAST_INTERVALS)
        begin, end = arc.begin + a * whole, arc.begin + b * whole
        found.append(Stretch(begin, end, tuple(signature), share))
    return found


def _met_on(plan: _Plan, piece: PhaseSolution, begin: float, end: float) -> list[tuple[int, int]]:
    """Columns and sides of limits of the states that are met on a part of an arc."""
    count = len(plan.columns) - len(plan.limits)
    first = max(int(np.searchsorted(piece.mesh, begin, side="right")) - 1, 0)
    last = int(np.searchsorted(piece.mesh, end - 1e-9))
    found = []
    for column, limit in enumerate(plan.limits, start=count):
        if limit.mixed:
            continue
        low, high = limit.constraint.lower, limit.constraint.upper
        reach = float((high - low)[limit.component])
        reach = reach if np.isfinite(reach) else float(limit.constraint.scale[limit.component])
        sides = limit.touched(limit.values(piece, plan.declared), MET * reach)[first : last + 1]
        if np.any(sides):
            found.append((column, int(sides[sides != 0][0])))
    return found


def _is_limited(plan: _Plan, column: int, side: int) -> bool:
    """Whether a column has a limit at a side."""
    name, component = plan.columns[column]
    count = len(plan.columns) - len(plan.limits)
    own: Any = (
        next(c for c in plan.declared.controls if c.name == name)
        if column < count
        else plan.limits[column - count].constraint
    )
    return bool(np.isfinite((own.lower if side < 0 else own.upper)[component]))


def _with_sides(plan: _Plan, arc: Stretch, piece: PhaseSolution) -> list[Stretch]:
    """A free arc, divided where what nothing held is at a limit all along some intervals."""
    held = np.tile(arc.signature, (piece.mesh.size - 1, 1))
    own = phase_layout(piece).phase
    bounds = {c.name: c for c in plan.declared.controls}
    declared = replace_controls(
        own,
        [replace(c, lower=bounds[c.name].lower, upper=bounds[c.name].upper) for c in own.controls],
    )
    declared.constraints = list(plan.declared.constraints)
    sides, _ = controls_at_bounds(piece, declared)
    table = held.copy()
    for column, values in enumerate(sides):
        table[:, column] = values
    for limit in limits_of(piece, declared, mixed=True):
        key = (limit.constraint.name, limit.component)
        if limit.mixed and key in plan.columns[len(sides) :]:
            table[:, plan.columns.index(key, len(sides))] = limit.sides
    table = np.where(held == 0, table, held)
    edges = np.flatnonzero(np.any(np.diff(table, axis=0) != 0, axis=1)) + 1
    whole, found = arc.end - arc.begin, []
    for first, after in itertools.pairwise([0, *edges.tolist(), len(table)]):
        begin, end = (arc.begin + piece.mesh[[first, after]] * whole).tolist()
        signature = tuple(int(side) for side in table[first])
        found.append(Stretch(begin, end, signature, max(after - first, LEAST_INTERVALS)))
    return found


def replace_controls(phase: Phase, controls: Sequence[Any]) -> Phase:
    """A phase that differs from another in its controls only."""
    made = Phase(phase.name, phase.duration_bounds)
    made.__dict__.update({**vars(phase), "controls": list(controls)})
    return made


@dataclass(frozen=True)
class _Wrong:
    """Where on an arc, as fractions of it, a column that is held would rather leave its limit."""

    column: int
    begin: float
    end: float


def _wrong_signs(
    solution: Solution, plans: Sequence[_Plan], groups: Sequence[Sequence[Phase]]
) -> dict[str, list[_Wrong]]:
    """By the name of a piece, where its multipliers have the sign of the other limit."""
    layouts = [phase_layout(phase) for phase in solution.phases]
    assert solution.variable_multipliers is not None
    values: dict[tuple[str, str, str, int], list[float]] = {}

    def gather(labels: Sequence[Label], multipliers: FloatArray, kind: str) -> None:
        for label, multiplier in zip(labels, multipliers.tolist(), strict=True):
            if label.kind == kind:  # a constraint may have the name of a control
                key = (label.phase, kind, label.name, label.component)
                values.setdefault(key, []).append(multiplier)

    gather(variable_labels(layouts), np.asarray(solution.variable_multipliers), "control")
    gather(row_labels(layouts), solution.row_multipliers, "constraint")
    found: dict[str, list[_Wrong]] = {}
    for plan, group in zip(plans, groups, strict=True):
        controls = len(plan.columns) - len(plan.limits)
        for place, (name, component) in enumerate(plan.columns):
            if place >= controls and not plan.limits[place - controls].mixed:
                continue
            column = ("control", name, component)
            if place >= controls:
                column = ("constraint", f"{name}[{component}] met", 0)
            own = {
                piece.name: _density(solution[piece.name], values[piece.name, *column])
                for piece in group
                if (piece.name, *column) in values
            }
            largest = max((float(np.abs(d).max()) for _, d in own.values()), default=0.0)
            for piece, arc in zip(group, plan.arcs, strict=True):
                side = arc.signature[place]
                if piece.name not in own or side == 0:
                    continue
                at, density = own[piece.name]
                spans = _negative(at, side * density, WRONG * largest)
                if spans:
                    found.setdefault(piece.name, []).extend(_Wrong(place, *s) for s in spans)
    return found


def _density(piece: PhaseSolution, multipliers: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """Fractions of an arc, and a multiplier there by its weight in time."""
    count = piece.mesh.size - 1
    table = np.array(multipliers[: len(multipliers) // count * count]).reshape(count, -1)
    scheme = Collocation("radau", table.shape[1])
    points, weights = np.array(scheme.points), scheme.weights
    if table.shape[1] == 1:
        points = np.array([0.5])
    steps = np.diff(piece.mesh)[:, None]
    at = piece.mesh[:-1, None] + points * steps
    return at.ravel(), (table / (weights * steps * piece.duration)).ravel()


def _negative(at: FloatArray, values: FloatArray, least: float) -> list[tuple[float, float]]:
    """Where values are negative, in spans on which they come below ``-least`` somewhere."""
    edges = [0, *(np.flatnonzero(np.diff(values < 0)) + 1).tolist(), values.size]
    found = []
    for first, after in itertools.pairwise(edges):
        if values[first:after].min() >= -least:
            continue
        ends = [
            1.0 * (k > 0)
            if k in (0, values.size)
            else float(np.interp(0.0, *_rising(values[k - 1 : k + 1], at[k - 1 : k + 1])))
            for k in (first, after)
        ]
        found.append((ends[0], ends[1]))
    return found


def _rising(values: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    order = np.argsort(values)
    return values[order], at[order]
