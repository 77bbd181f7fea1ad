"""A mesh as fine as an accuracy asks for: divided, raised in degree, moved to the switches.

The accuracy is that of the dynamics, of the limits between the mesh points, and of the cost.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.arcs import Switch, distance, hold, move_to_switches, place_junctions
from microbot_ocp.ocp.mesh import divide, excess_of_limits, state_errors
from microbot_ocp.ocp.problem import OptimalControlProblem, node_variables, with_shapes
from microbot_ocp.ocp.refinement._cost_error import (
    control_orders,
    cost_error,
    shares,
    with_more_freedom,
)
from microbot_ocp.ocp.refinement._degrees import Degrees, decay_rates, degrees_on, refine_hp
from microbot_ocp.ocp.refinement._history import (
    History,
    Refined,
    RefinementStep,
    step_of,
)
from microbot_ocp.ocp.refinement._refiner import Refiner, split
from microbot_ocp.ocp.solution import (
    PhaseSolution,
    Solution,
    StepProgress,
    cost_size,
    quiet,
)
from microbot_ocp.ocp.solvers import (
    STEADY,
    SolverSettings,
    improvable,
    solutions,
    swings,
    transcribed,
)
from microbot_ocp.ocp.transcription import Guess, Mesh, Meshes, Transcription
from microbot_ocp.ocp.transcription.schemes import Scheme
from microbot_ocp.ocp.verification import (
    OCPLimitUse,
    judge,
    phase_layout,
)

MOST_VAIN = 2  # solves with one phase an arc that may find nothing
PROGRESS = 0.9  # share of the former error that counts as an improvement
SETTLED = 5.0  # times the accuracy of the cost: more than other controls would save is said
UNMET = 1e-2  # share of the cost: if other controls would save more the optimum is missed
MOVES = 1e-2  # share of the cost: while a mesh changes it by more the errors mean little
HALF = 0.5  # of the former error of the cost: what a mesh should gain that is divided for it
# A finer mesh meets constraints and dynamics that the coarser one cut short, and may honestly cost
# more by this share.
DEARER = 0.05
MOST = 400  # iterations on a finer mesh, from a neighbouring solution
FINER = 2.5  # times the first mesh, where nothing comes of it
UNSETTLED = (Status.NOT_ACCEPTED, Status.NO_PROGRESS)  # other shapes of controls may help
DONE = (Status.SOLVED, Status.INTERRUPTED, Status.SIZE_LIMIT)  # no more is tried
AIM = 1e-6  # accuracy of the states by default
EASED = 1e-4  # of the cost, where no more is reached
ROUGH = 1e-2  # error above which what is left is refined from another start


def solve_refined(
    problem: OptimalControlProblem | Transcription,
    accuracy: float | None = None,
    mesh: Meshes = 20,
    scheme: str | Scheme = "radau",
    guess: Mapping[str, Guess] | Solution | str | None = None,
    settings: SolverSettings | None = None,
    *,
    degrees: tuple[int, int] | None = None,
    cost_accuracy: float = 1e-5,
    switch_accuracy: float = 1e-3,
    limit_tolerance: float = 1e-5,
    arcs: bool = True,
    rounds: int = 10,
    most_intervals: int = 2000,
    time_limit: float = 60.0,
    progress: StepProgress = quiet,
) -> Refined:
    """Solve on finer and finer meshes until states, limits and cost are within an accuracy.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
        A transcription keeps its scheme; ``scheme`` is that of a problem.
    accuracy : float, optional
        Relative state error of any interval that is accepted; see
        :func:`~microbot_ocp.ocp.mesh.state_errors`. Default: 1e-6 is aimed at; where finer
        meshes come no nearer what :func:`~microbot_ocp.ocp.verify` passes will do, if the cost does
        not change by more than 1e-4 of itself from mesh to mesh. ``advice`` tells what was aimed at
        and is missed.
    mesh : int, Mesh, or one int, Mesh or array of fractions [N+1] a phase
        The first mesh. Where nothing comes of it a second try begins with 2.5 times as many.
    scheme : str or Scheme
    guess : mapping from phase name to Guess, Solution or "rollout", optional
        As of :func:`~microbot_ocp.ocp.solve`; where the first mesh is not solved it is tried in
        other ways, too.
    settings : SolverSettings, optional
        The tolerance becomes a tenth of the accuracy if it is more.
    degrees : (least, most), optional
        Of collocation: the degree is raised where the solution is smooth, intervals are divided
        where it is not (hp). Default: intervals are divided, the degree stays.
    cost_accuracy : float
        Relative error of the cost that is accepted: what a solve with finer controls or a higher
        degree gains, once the rest is good enough. Infinite to ask for none.
    switch_accuracy : float
        Distance of a switch from the mesh that is accepted, as a fraction of its phase.
    limit_tolerance : float
        Excess of a state, an algebraic variable or a path constraint between the mesh points that
        is accepted, relative to half the range of its limits, or to the limit where there is only
        one. Meshes are divided where it is more. Bounds of the controls are left to
        :func:`~microbot_ocp.ocp.verify`: only polynomials leave them, and most of all where they
        jump. A path constraint of a polynomial control may stay exceeded at such a jump, on however
        short an interval; the result then names it.
    arcs : bool
        Whether the problem may be solved with one phase an arc, too, to find where its arcs meet:
        see :func:`~microbot_ocp.ocp.arcs.place_junctions`. Default: it may.
    rounds : int
        Most finer meshes.
    most_intervals : int
        Of all phases together.
    time_limit : float
        Wall time after which it is stopped, s: the last accepted solution is returned.
    progress : callable
        Called with a line of text for every mesh, and with every iteration of the solvers.

    Returns
    -------
    Refined
        Also where the accuracy is not reached: look at ``status``. After Ctrl-C it is the last
        accepted solution, with the status INTERRUPTED.

    Raises
    ------
    InputError
        An accuracy or limit that is no positive number, degrees for a scheme that has none.

    Examples
    --------
    >>> problem = OptimalControlProblem("double integrator")
    >>> phase = problem.phase("move", duration=(0.1, 10.0))
    >>> x = phase.state("x", initial=0.0, final=1.0)
    >>> v = phase.state("v", initial=0.0, final=0.0)
    >>> u = phase.control("u", lower=-1.0, upper=1.0)
    >>> phase.derivative(x, v)
    >>> phase.derivative(v, u)
    >>> phase.end_cost(phase.duration)
    >>> refined = solve_refined(problem, mesh=5)  # the switch is in the middle of an interval
    >>> str(refined.status), round(refined.solution.cost, 4)
    ('solved', 2.0)
    """
    eased = accuracy is None
    accuracy = AIM if accuracy is None else checks.number("accuracy", accuracy, above=0.0)
    switch_accuracy = checks.number("switch_accuracy", switch_accuracy, above=0.0)
    if not cost_accuracy > 0:
        raise InputError(f"cost_accuracy must be above 0, not {cost_accuracy}")
    limit_tolerance = checks.number("limit_tolerance", limit_tolerance, above=0.0)
    settings = settings or SolverSettings()
    settings = replace(settings, tolerance=min(settings.tolerance, max(accuracy / 10, 1e-10)))
    own = min(checks.time_limit(time_limit), settings.time_limit)
    until = min(time.perf_counter() + own, deadline.until())
    hp = None if degrees is None else Degrees(*degrees)
    if hp is not None:
        own = transcribed(problem, settings, scheme=scheme, guess=guess)
        mesh = _with_degrees(own, mesh, hp)
    goal = _Goal(accuracy, cost_accuracy, switch_accuracy, limit_tolerance, hp, eased)
    best: Refined | None = None
    limits = rounds, most_intervals, arcs
    meshes: list[Meshes] = [mesh]
    if isinstance(mesh, int) and not isinstance(problem, Transcription):
        meshes.append(round(FINER * mesh))
    for begin in meshes:
        found = _from_mesh(problem, begin, guess, settings, scheme, goal, limits, until, progress)
        if best is None or _preferred(found, best):
            best = found
        done = found.status in DONE and not found.solution.unsettled
        if done or time.perf_counter() >= until:
            break
    assert best is not None
    if best.status.solved and best.solution.unsettled:
        return replace(best, status=Status.LOCAL_OPTIMUM)
    return best


def _preferred(found: Refined, best: Refined) -> bool:
    """Whether a second try is better than the first."""
    if found.status.solved and best.status.solved:
        return found.solution.cost < best.solution.cost
    return found.status.solved or (not best.status.solved and _worst(found) < _worst(best))


def _from_mesh(
    problem: OptimalControlProblem | Transcription,
    mesh: Meshes,
    guess: Mapping[str, Guess] | Solution | str | None,
    settings: SolverSettings,
    scheme: str | Scheme,
    goal: _Goal,
    limits: tuple[int, int, bool],
    until: float,
    progress: StepProgress,
) -> Refined:
    """The best of what is refined from a first mesh."""
    rounds, most_intervals, arcs = limits
    watched = None if progress is quiet else progress
    best: Refined | None = None
    tried = False  # whether with controls that are constant over every interval
    for first, transcription in solutions(problem, mesh, guess, settings, scheme, until, watched):
        refiner = Refiner(
            transcription,
            guess_from=resampled,
            excess=state_errors,
            limit_tolerance=goal.accuracy,
            solver=settings.solver,
            tolerance=settings.tolerance,
            progress=progress,
            settings=replace(settings, max_iterations=min(MOST, settings.max_iterations)),
            worse=DEARER,
            until=until,
            last=first,
        )
        own_limits = _Limits(rounds, most_intervals, until, arcs)
        refined = _Refinement(refiner, goal, own_limits).run(first)
        if refined.status in UNSETTLED and not tried and swings(problem, refined.solution):
            tried = True
            assert isinstance(problem, OptimalControlProblem)
            steady = with_shapes(problem, "constant")
            how = settings, scheme, goal, limits, until, progress
            other = _from_mesh(steady, mesh, guess, *how)
            refined = replace(other, way=STEADY) if other.status.solved else refined
        if best is None or refined.status.solved or _worst(refined) < _worst(best):
            best = refined
        ended = refined.status in (Status.SOLVED, Status.INTERRUPTED)
        if ended or _worst(refined) <= ROUGH or time.perf_counter() >= until:
            break
    assert best is not None
    return best


def _worst(refined: Refined) -> float:
    """The largest error of what a refinement left: of the states, the limits or the cost."""
    kept = [step for step in refined.history if step.accepted]
    if len(kept) < 2 and not refined.status.solved:
        return np.inf  # of one mesh alone nothing is known
    costs = [step.cost for step in kept]
    last = kept[-1]
    moved = abs(costs[-1] - costs[-2]) / max(abs(costs[-1]), 1e-300) if len(costs) > 1 else 0.0
    return max(last.state_error, last.limit_excess, moved)


@dataclass(frozen=True)
class _Goal:
    accuracy: float
    cost_accuracy: float
    switch_accuracy: float
    limit_tolerance: float
    degrees: Degrees | None
    eased: bool  # whether less will do where no more is reached

    def met(self, step: RefinementStep) -> bool:
        """Whether a mesh is good enough, but for its cost."""
        return (
            step.state_error <= self.accuracy
            and step.switch_offset <= self.switch_accuracy
            and step.limit_excess <= self.limit_tolerance
        )

    def missed(self, step: RefinementStep) -> tuple[str, ...]:
        """What a mesh misses, in words."""
        parts = (
            ("state error", step.state_error, self.accuracy, ""),
            (
                "offset of a switch",
                step.switch_offset,
                self.switch_accuracy,
                " of a phase",
            ),
            ("excess of a limit", step.limit_excess, self.limit_tolerance, " of it"),
            ("error of the cost", step.cost_error, self.cost_accuracy, " of it"),
        )
        return tuple(
            f"{name} {value:.1e}{unit} instead of {wanted:.1e}"
            for name, value, wanted, unit in parts
            if wanted < value < np.inf
        )

    def next_mesh(
        self,
        phase: PhaseSolution,
        errors: FloatArray,
        excess: FloatArray,
        switches: Sequence[Switch],
        places: FloatArray | None,
        cost_errors: FloatArray | None,
    ) -> Mesh:
        """A mesh for a phase that comes nearer.

        Where errors of the cost are given, in the proportions of the intervals, the rest is good
        enough.
        """
        layout = phase_layout(phase)
        accuracy = self.accuracy
        if cost_errors is not None:
            errors, accuracy = cost_errors, self.cost_accuracy
        if self.degrees is None:
            orders = np.array([kind.scheme.order for kind in layout.kinds])[layout.kind_of]
            if cost_errors is not None:
                orders = control_orders(phase)
            finer = Mesh(divide(phase.mesh, errors, accuracy, orders))
        else:
            finer = refine_hp(layout.chosen, errors, decay_rates(phase), accuracy, self.degrees)
        finer = self._divided_at_limits(layout.mesh, finer, excess)
        if places is not None:
            moved = hold(finer.fractions, places, self.switch_accuracy)
        else:
            moved = move_to_switches(finer.fractions, switches, self.switch_accuracy)
        if self.degrees is not None:
            return Mesh(moved, degrees_on(moved, finer))
        if layout.degrees is not None:
            return Mesh(moved, degrees_on(moved, layout.chosen))
        return Mesh(moved)

    def _divided_at_limits(self, mesh: FloatArray, finer: Mesh, excess: FloatArray) -> Mesh:
        """Divide where a limit is exceeded, but for intervals that are divided already."""
        bad = excess > self.limit_tolerance
        if not bad.any():
            return finer
        cuts = split(mesh, bad)
        owner = np.searchsorted(mesh, cuts, side="right") - 1
        pieces = np.histogram(finer.fractions, mesh)[0]
        whole = np.append(pieces[:-1] == 1, pieces[-1] == 2)  # the last bin has both its ends
        fresh = cuts[~np.isin(cuts, mesh) & whole[np.minimum(owner, whole.size - 1)]]
        fractions = np.union1d(finer.fractions, fresh)
        if finer.degrees is None:
            return Mesh(fractions)
        return Mesh(fractions, degrees_on(fractions, finer))


@dataclass(frozen=True)
class _Limits:
    rounds: int
    intervals: int
    until: float
    arcs: bool


class _Refinement:
    """One refinement: its best solution and its history so far."""

    def __init__(self, refiner: Refiner, goal: _Goal, limits: _Limits) -> None:
        self.refiner, self.goal, self.limits = refiner, goal, limits
        self.best: Solution | None = None
        self.errors: list[FloatArray] = []
        self.excess: list[FloatArray] = []
        self.exceeded: OCPLimitUse | None = None  # what the best solution exceeds most
        self.places: list[FloatArray] | None = None  # where arcs meet, once it is known
        self.vain = 0  # solves with one phase an arc that found nothing
        self.history: list[RefinementStep] = []
        self.cost_errors: list[FloatArray] | None = None  # of the best, where it is all it lacks
        self.freer: Solution | None = None  # that it was found with
        self.started = time.perf_counter()

    def run(self, first: Solution) -> Refined:
        status = Status.INTERRUPTED
        self.best = first
        if first.status is not Status.INTERRUPTED:
            with contextlib.suppress(KeyboardInterrupt):
                self._enter(first, first.status.solved)
                status = self._rounds() if first.status.solved else first.status
        missed = self.goal.missed(self._last_accepted()) if self.history else ()
        if status is Status.SOLVED or (status is not Status.INTERRUPTED and self._will_do()):
            judgement = judge(self.refiner.transcription, self.best)
            missed += tuple(failure.sentence for failure in judgement.failures)
            coarse = judgement.status is Status.TOO_COARSE
            unmet = Status.NO_PROGRESS if status is Status.SOLVED else status
            status = unmet if coarse else judgement.status
        more = improvable(self.best) if status is Status.SOLVED else 0.0
        if more > UNMET:
            status = Status.NO_PROGRESS
        use = self.exceeded
        over = use is not None and use.relative > self.goal.limit_tolerance
        if more > SETTLED * EASED:
            missed = (*missed, f"controls that are known to save {more:.1e} of the cost")
        best = self.best
        if first.rivals:
            best = best.with_rivals_of(first)
        return Refined(best, History(self.history), status, use if over else None, missed)

    def _will_do(self) -> bool:
        """Whether the cost has settled, so that what a certificate passes is good enough."""
        kept = [step for step in self.history if step.accepted]
        if not self.goal.eased or len(kept) < 2 or self.best is None:
            return False
        change = abs(kept[-1].cost - kept[-2].cost)
        return change <= EASED * cost_size(self.best.cost, self.best.cost_scale)

    def _rounds(self) -> Status:
        for done in range(self.limits.rounds + 1):
            assert self.best is not None
            step = self._placed()
            if self.goal.met(step):
                step = self._with_cost_error()
                if step.cost_error <= self.goal.cost_accuracy:
                    return Status.SOLVED
                if self.freer is None:
                    return self._refused()
                if self._cost_stalls():
                    self._enter(self.freer, True)
                    continue
            if done == self.limits.rounds:
                break
            if _stalled(self.history):
                return Status.NO_PROGRESS
            if time.perf_counter() > self.limits.until:
                return Status.TIME_LIMIT
            meshes = [
                self.goal.next_mesh(phase, errors, excess, switches, places, costs)
                for phase, errors, excess, switches, places, costs in zip(
                    self.best.phases,
                    self.errors,
                    self.excess,
                    step.switches,
                    self.places or [None] * len(self.best.phases),
                    self.cost_errors or [None] * len(self.best.phases),
                    strict=True,
                )
            ]
            if sum(m.intervals for m in meshes) > self.limits.intervals:
                return Status.SIZE_LIMIT
            before = self.freer or self.best
            finer = self.refiner.finer(before, meshes)
            if finer is before:
                return self._refused()
            self._enter(finer, True)
        return Status.ROUND_LIMIT

    def _refused(self) -> Status:
        """Why the last solve was not accepted, which goes into the history."""
        last = self.refiner.last
        if last is not None and last is not self.best:
            self._enter(last, False)
            if last.status is Status.INTERRUPTED:
                return Status.INTERRUPTED
        return Status.NOT_ACCEPTED

    def _cost_stalls(self) -> bool:
        """Whether dividing where controls differ brought the cost no nearer."""
        known = [step.cost_error for step in self.history if step.cost_error < np.inf]
        return len(known) > 1 and known[-1] > HALF * known[-2]

    def _last_accepted(self) -> RefinementStep:
        return next((s for s in reversed(self.history) if s.accepted), self.history[-1])

    def _with_cost_error(self) -> RefinementStep:
        """The last step with the error of its cost, found by a solve with more freedom."""
        assert self.best is not None
        if self.goal.cost_accuracy == np.inf:
            self.history[-1] = replace(self.history[-1], cost_error=0.0)
            return self.history[-1]
        freer = self.refiner.finer(self.best, with_more_freedom(self.best))
        if freer is self.best:
            return self.history[-1]
        found = cost_error(self.best, freer)
        self.refiner.progress(f"error of the cost {found:.2g}")
        own = shares(self.best, freer)
        count = sum(part.size for part in own)
        self.freer, self.cost_errors = freer, [found * count * part for part in own]
        step = self.history[-1] = replace(self.history[-1], cost_error=found)
        return step

    def _placed(self) -> RefinementStep:
        """The last step, with the distance of the mesh from where arcs meet."""
        assert self.best is not None
        step, found = self.history[-1], None
        if not self.limits.arcs:
            return step
        if self.vain < MOST_VAIN:
            transcription = self.refiner.transcription
            found = place_junctions(
                transcription.problem, self.best, transcription.scheme, self.refiner.settings
            )
        if found is None:
            self.vain += 1
            if self.places is not None:  # what was not confirmed is as far away as it was
                offset = max(step.switch_offset, self.history[-2].switch_offset)
                step = self.history[-1] = replace(step, switch_offset=offset)
            return step
        self.places = found
        meshes = [mesh.fractions for mesh in step.meshes]
        step = replace(step, switch_offset=max(map(distance, meshes, self.places)))
        self.history[-1] = step
        self.refiner.progress(
            f"arcs meet {step.switch_offset:.2g} of a phase away from the mesh, at most"
        )
        return step

    def _enter(self, made: Solution, accepted: bool) -> None:
        """Put a solve into the history; an accepted one is the best so far."""
        solved = made.status.solved
        errors, excess, worst = [np.array([np.inf])], [np.array([np.inf])], None
        if solved:
            errors = state_errors(made)
            excess, worst = excess_of_limits(made)
        taken = time.perf_counter() - self.started
        step = step_of(made, errors, excess, worst, accepted, taken)
        if accepted:
            self.best, self.errors, self.excess, self.exceeded = made, errors, excess, worst
            self.cost_errors = self.freer = None
        self.history.append(step)
        self.started = time.perf_counter()
        self.refiner.progress(
            f"mesh {' + '.join(map(str, step.intervals))}: state error {step.state_error:.2g}, "
            f"limits exceeded by {step.limit_excess:.2g}, cost {step.cost:.8g}"
        )


def _with_degrees(transcription: Transcription, mesh: Meshes, degrees: Degrees) -> list[Mesh]:
    """Meshes of all phases with the degree of the scheme, within the limits."""
    layouts = transcription.layouts(mesh)
    own = getattr(transcription.scheme, "degree", degrees.least)
    start = int(np.clip(own, degrees.least, degrees.most))
    return [
        layout.chosen if layout.degrees is not None else Mesh(layout.mesh, start)
        for layout in layouts
    ]


def _stalled(history: Sequence[RefinementStep]) -> bool:
    """Whether the last two meshes improved no error, switch nor limit."""
    if len(history) < 3:
        return False
    before, *later = history[-3:]
    costs = [step.cost for step in (before, *later)]
    if np.ptp(costs[-2:]) > MOVES * abs(costs[-1]):
        return False
    return all(
        step.state_error > PROGRESS * before.state_error
        and step.switch_offset >= PROGRESS * before.switch_offset
        and step.limit_excess >= PROGRESS * before.limit_excess
        and not step.cost_error < PROGRESS * before.cost_error
        for step in later
    )


def resampled(solution: Solution) -> dict[str, Guess]:
    """Guess for another mesh by the scheme's own interpolation."""
    guesses = {}
    for phase in solution.phases:
        declared = phase_layout(phase).phase
        names = [v.name for v in (*node_variables(declared), *declared.controls)]
        names += [v.name for v in declared.algebraics]
        guesses[phase.name] = Guess(
            phase.duration, {name: _sampler(phase, name) for name in dict.fromkeys(names)}
        )
    return guesses


def _sampler(phase: PhaseSolution, name: str) -> Callable[[FloatArray], FloatArray]:
    # just before the point: the points of Radau collocation are those of the interval on the left
    return lambda places: phase.sample((places - 1e-10) * phase.duration)[name]
