"""Solve a problem as it was declared, by other strategies where one fails, until it passes.

A solve that does not converge says little about the problem: it may have begun badly or with bad
scales. So the rows of a table are tried in turn. What a solve is good for is told by the judgement
that a certificate is made of: meshes are made finer until it passes, from a saddle the solve goes
down, and what is missing at last is the status. All is counted in iterations, starts and meshes;
time is the limit only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, cast

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.outcome import Ledger, LedgerRow
from microbot_ocp._base.status import Status
from microbot_ocp.ocp import refinement
from microbot_ocp.ocp.diagnosis import POOR, NotFinite
from microbot_ocp.ocp.problem import OptimalControlProblem, node_variables, with_shapes
from microbot_ocp.ocp.refinement import improvable, improved
from microbot_ocp.ocp.search._other_starts import (
    cheaper_elsewhere,
    cheapest_of_starts,
    on_any_mesh,
)
from microbot_ocp.ocp.solution import (
    Attempt,
    PhaseSolution,
    Progress,
    Solution,
    StepProgress,
    cost_size,
    entry,
)
from microbot_ocp.ocp.solvers import SolverSettings, solve_on, transcribed
from microbot_ocp.ocp.starts import Rollouts, default_guess, rollouts
from microbot_ocp.ocp.transcription import Guess, Meshes, Transcription
from microbot_ocp.ocp.transcription.schemes import Scheme
from microbot_ocp.ocp.verification import phase_layout

if TYPE_CHECKING:
    from microbot_ocp.ocp.refinement import Accuracy

Given = Mapping[str, Guess] | Solution | str | None

CONVERGED = (Status.SOLVED, Status.GAP_LEFT)
ENDED = (*CONVERGED, Status.INTERRUPTED)
UNSETTLED = (Status.NO_PROGRESS, Status.NOT_ACCEPTED)  # other shapes of controls may help

GIVEN = "as given"
OWN_SCALES = "with the scales of the first answer"
BETTER_CONTROLS = "from controls with a smaller Hamiltonian"
STEADY = "with controls that are constant over every interval"
NOT_ALL = "Not every strategy was tried for want of time."


@dataclass(frozen=True)
class Search:
    """How a problem is tried.

    Attributes
    ----------
    intervals : of the mesh of a problem of one or two phases
    fewest : of every phase of a problem of many
    coarser : share of these intervals, from which a solve may converge sooner
    simulations : of each kind that a problem is solved from
    iterations : of a try: what takes more converges sooner by another strategy
    compared : other starts that an answer is compared with, on any mesh
    compared_there : the same on a mesh that was given
    least_tolerance : of solvers, that an accuracy may ask for
    """

    intervals: int = 50
    fewest: int = 10
    coarser: float = 0.4
    simulations: int = 2
    iterations: int = 400
    compared: int = 12
    compared_there: int = 4
    least_tolerance: float = 1e-10


SEARCH = Search()


def solve(
    problem: OptimalControlProblem | Transcription,
    mesh: Meshes | None = None,
    guess: Given = None,
    settings: SolverSettings | None = None,
    *,
    scheme: str | Scheme = "radau",
    accuracy: float | Accuracy | None = None,
    time_limit: float = 60.0,
    progress: Progress | StepProgress | None = None,
) -> Solution:
    """Transcribe a problem and solve it until it passes, or has an accuracy.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
        A transcription keeps its kernels from solve to solve; it is solved in one way only.
    mesh : int, Mesh, or one int, Mesh or array of fractions [N+1] a phase
        Default: 50 intervals, shared by the phases where there are more than two, and finer until
        :func:`~microbot_ocp.ocp.verify` passes the answer and the cost changes by less than 1e-4 of
        itself; what does not settle is not solved. On a mesh that is given, an answer whose states,
        cost or limits do not pass between the mesh points has the status TOO_COARSE; with an
        accuracy it is the first mesh.
    guess : mapping from phase name to Guess, Solution or "rollout", optional
        What is left out of it starts from :func:`~microbot_ocp.ocp.solution.default_guess`. A
        solution may be of another mesh or of other phases; with the same phases its multipliers are
        used as well. "rollout" simulates with a constant control. What is no solution is moved by
        about a hundredth of the scales, so that it is not symmetric.
    settings : SolverSettings, optional
        Where they name a solver that one is tried, from the guess as it is and by one strategy
        only.
    scheme : str or Scheme
        Of a problem that is not transcribed yet: "shooting", "radau", "gauss", "trapezoidal",
        "hermite_simpson", or one with settings.
    accuracy : float or Accuracy, optional
        Relative state error of any interval that is accepted, or what is asked of limits, switches
        and cost as well: see :class:`~microbot_ocp.ocp.Accuracy`. Meshes are made finer until it is
        met; where it is not ``status`` and ``advice`` tell why and what is missing. The solver's
        tolerance becomes a tenth of it if it is more.
    time_limit : float
        Wall time after which it is stopped, s. Strategies are limited by iterations, starts and
        meshes, so the answer is the same on a busy machine unless this limit is met, which is said.
    progress : callable, optional
        Called with an :class:`~microbot_ocp.ocp.solution.Iteration` at every iteration, and with
        a line of text for every mesh where there is an accuracy. It may raise KeyboardInterrupt to
        stop the solve.

    Returns
    -------
    Solution
        Also where no solver converged: look at ``status``, which is SOLVED where ``verify`` passes
        it. Its ``attempts`` are all that was tried, but for other starts with which it was compared
        and that led to nothing cheaper; ``history`` has its meshes, ``ledger`` the strategies that
        led to it. After Ctrl-C it is the last accepted one, with the status INTERRUPTED.

    Raises
    ------
    InputError
        The declaration, mesh or guess is not complete or not finite, or the dynamics, constraints
        or costs are not finite at the guess; an accuracy that is no positive number, degrees for a
        scheme that has none.

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
    >>> solution = solve(problem, 5, accuracy=1e-6)  # the switch is in the middle of an interval
    >>> str(solution.status), round(solution.cost, 4)
    ('solved', 2.0)
    """
    settings = settings or SolverSettings()
    goal = _goal(accuracy)
    if goal is not None:
        tolerance = max(goal.states / 10, SEARCH.least_tolerance)
        settings = replace(settings, tolerance=min(settings.tolerance, tolerance))
    own = min(checks.time_limit(time_limit), settings.time_limit)
    until = min(time.perf_counter() + own, deadline.until())
    compared = SEARCH.compared_there if mesh is not None and goal is None else SEARCH.compared
    how = mesh, guess, settings, scheme, until, cast("Progress | None", progress)
    task = _Task(problem, *how, goal, compared)
    best: Solution | None = None
    attempts: list[Attempt] = []
    ledger: list[LedgerRow] = []
    for answer, transcription in task.answers():
        solution, final = task.judged(answer, transcription)
        if solution.status in UNSETTLED and swings(problem, solution):
            solution, final = task.with_steady_controls(solution)
        attempts += solution.attempts
        if best is None or final:
            best, ledger = solution, [*Ledger(ledger).discarded(), *solution.ledger]
        else:
            ledger += solution.ledger.discarded()
        if final:
            break
    assert best is not None
    best = replace(best, attempts=tuple(attempts), ledger=Ledger.of(ledger))
    if best.status not in ENDED and time.perf_counter() >= until:
        best = replace(best, advice=f"{best.advice} {NOT_ALL}")
    if best.status.solved and best.unsettled:
        status = Status.LOCAL_OPTIMUM
        best = replace(best, status=status, advice=f"{status.sentence} {best.several}")
    return best


def _goal(accuracy: float | Accuracy | None) -> Accuracy | None:
    if accuracy is None or isinstance(accuracy, refinement.Accuracy):
        return accuracy
    return refinement.Accuracy(checks.number("accuracy", accuracy, above=0.0))


def default_mesh(problem: OptimalControlProblem | Transcription) -> int:
    """Intervals of every phase: fewer where there are many."""
    phases = (problem.problem if isinstance(problem, Transcription) else problem).phases
    return max(SEARCH.fewest, round(2 * SEARCH.intervals / max(len(phases), 2)))


# strategies ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Task:
    """What is to be solved, and the attempts and the ledger so far."""

    problem: OptimalControlProblem | Transcription
    given: Meshes | None
    guess: Given
    settings: SolverSettings
    scheme: str | Scheme
    until: float
    progress: Progress | None
    accuracy: Accuracy | None = None
    compared: int = SEARCH.compared
    attempts: list[Attempt] = field(default_factory=list)
    ledger: list[LedgerRow] = field(default_factory=list)

    @property
    def mesh(self) -> Meshes:
        return default_mesh(self.problem) if self.given is None else self.given

    @property
    def over(self) -> bool:
        return time.perf_counter() >= self.until

    @property
    def alone(self) -> bool:
        """Whether a transcription or a solver was chosen: no other strategy is tried."""
        return isinstance(self.problem, Transcription) or self.settings.solver != "auto"

    @property
    def short(self) -> SolverSettings:
        """Settings of a try that may be followed by another."""
        most = min(SEARCH.iterations, self.settings.max_iterations)
        return replace(self.settings, max_iterations=most)

    @property
    def few(self) -> SolverSettings:
        """The same by IPOPT, where no solver was chosen."""
        return self.settings if self.alone else replace(self.short, solver="ipopt")

    def transcribed(self, scaling: str) -> Transcription:
        settings = replace(self.settings, scaling=scaling)
        return transcribed(self.problem, settings, scheme=self.scheme, guess=self.guess)

    def solve(
        self, transcription: Transcription, guess: Given, settings: SolverSettings, uneven: bool
    ) -> Solution:
        """A solve on the mesh of the task."""
        mesh = self.mesh
        if self.accuracy is not None:
            mesh = self.accuracy.first_mesh(transcription, mesh)
        how = settings, self.until, self.progress
        return solve_on(transcription, mesh, guess, *how, uneven=uneven)

    def enter(
        self,
        strategy: str,
        began: float,
        before: Solution | None,
        after: Solution | None,
        attempts: Sequence[Attempt],
    ) -> None:
        """Enter what a strategy led to, or that it led to nothing, in the ledger."""
        seconds = time.perf_counter() - began
        self.ledger.append(entry(strategy, before, after, attempts, seconds))

    def judged(self, solution: Solution, transcription: Transcription) -> tuple[Solution, bool]:
        """The solution on its way to one that passes, and whether that is final."""
        finer = self.given is None or self.accuracy is not None
        how = self.short, self.until, self.progress
        return refinement.judged(solution, transcription, *how, finer=finer, accuracy=self.accuracy)

    def with_steady_controls(self, before: Solution) -> tuple[Solution, bool]:
        """The solution with controls that are constant over every interval, where that passes.

        On a singular arc a control that is free at every collocation point may go to and fro
        between them, and owe a part of its cost to what the scheme does not see; where it jumps it
        exceeds limits between them.
        """
        began = time.perf_counter()
        assert isinstance(self.problem, OptimalControlProblem)
        task = replace(
            self,
            problem=with_shapes(self.problem, "constant"),
            guess=resampled(before),
            given=None,
            attempts=[],
            ledger=[],
        )
        own = self.settings
        own = replace(own, solver="ipopt") if own.solver == "auto" else own
        transcription = task.transcribed(own.scaling)
        first = task.solve(transcription, task.guess, own, uneven=False)
        answer, final = task.judged(first, transcription)
        tries = tuple(replace(a, way=a.way or STEADY) for a in answer.attempts)
        solved = answer if answer.status.solved else None
        row = entry(STEADY, before, solved, tries, time.perf_counter() - began)
        ledger = Ledger.of([*before.ledger, row])
        attempts = (*before.attempts, *tries)
        if solved is None:
            return replace(before, attempts=attempts, ledger=ledger), False
        advice = (
            f"{answer.advice} With other values at every point the cost does not settle: {STEADY}."
        )
        answer = replace(answer, attempts=attempts, advice=advice, ledger=ledger)
        return answer.with_rivals_of(before), final

    def answers(self) -> Iterator[tuple[Solution, Transcription]]:
        """Solutions of all strategies that converge, each with its program; else of the first.

        Each is compared with what a number of other starts lead to.
        """
        first: tuple[Solution, Transcription] | None = None
        refused: InputError | None = None
        converged = False
        for strategy in STRATEGIES[: 1 if self.alone else None]:
            if first is not None and self.over:
                break
            began, before = time.perf_counter(), len(self.attempts)
            try:
                solution, start = _first_that_ends(self, strategy) or (None, None)
            except NotFinite as problem_met:
                if self.alone or self.guess is not None:
                    raise
                refused = refused or problem_met
                continue
            if solution is None or start is None:
                continue
            transcription, _, settings = start
            first = first or (solution, transcription)
            ended = solution if solution.status in ENDED else None
            self.enter(strategy.name or GIVEN, began, None, ended, self.attempts[before:])
            if ended is None:
                continue
            converged = True
            if not self.alone and solution.status in CONVERGED:
                solution, transcription = self._best_beside(solution, transcription, settings)
            yield self._answer(solution, strategy.name), transcription
            if solution.status is Status.INTERRUPTED:
                return
        if converged:
            return
        if first is None:
            assert refused is not None
            raise refused
        yield self._answer(first[0], ""), first[1]

    def _best_beside(
        self, solution: Solution, transcription: Transcription, settings: SolverSettings
    ) -> tuple[Solution, Transcription]:
        """The cheapest of an answer and of what other starts and better controls lead to."""
        how = settings, self.until, self.progress
        if not isinstance(self.guess, Solution):  # what was compared when it was found
            began, before = time.perf_counter(), solution
            more = self.compared, self.until, self.progress, self.guess
            solution, tried = cheaper_elsewhere(solution, transcription, settings, *more)
            self._decide("from other starts", began, before, solution if tried else None, tried)
            if tried:  # another valley, of other sizes
                solution, transcription = self.in_own_scales(solution, transcription, settings)
        began, before = time.perf_counter(), solution
        solution, tried = improved(solution, transcription, *how)
        self._decide(
            BETTER_CONTROLS, began, before, None if solution is before else solution, tried
        )
        return solution, transcription

    def _decide(
        self,
        strategy: str,
        began: float,
        before: Solution,
        after: Solution | None,
        tried: Sequence[Attempt],
    ) -> None:
        self.attempts.extend(tried)
        self.enter(strategy, began, before, after, tried)

    def in_own_scales(
        self, solution: Solution, before: Transcription, settings: SolverSettings
    ) -> tuple[Solution, Transcription]:
        """The solution, solved again with scales of its own where these are far from the guessed.

        What is small beside its scale is not accurate, and a cost of such a scale seems to be
        settled; what is far larger may be on its way to a slope at infinity.
        """
        if self.alone or settings.scaling != "auto" or solution.status not in CONVERGED:
            return solution, before
        began = time.perf_counter()
        after = replace(self, guess=solution).transcribed("auto")
        if not any(
            np.any(np.abs(np.log(np.asarray(old.scale) / new.scale)) >= np.log(POOR))
            for k, own in enumerate(before.problem.phases)
            for kind in ("states", "controls")
            for old, new in zip(
                getattr(own, kind), getattr(after.problem.phases[k], kind), strict=True
            )
        ):
            return solution, before
        again = self.solve(after, solution, settings, uneven=False)
        tried = [replace(a, way=OWN_SCALES) for a in again.attempts]
        most = solution.cost + refinement.PASSING.unmet * cost_size(again.cost, solution.cost_scale)
        better = again.status in CONVERGED and again.cost <= most
        self._decide(OWN_SCALES, began, solution, again if better else None, tried)
        return (again.with_rivals_of(solution), after) if better else (solution, before)

    def _answer(self, solution: Solution, strategy: str) -> Solution:
        """A solution with all attempts that led to it, and the strategy that found it."""
        advice = solution.advice
        if solution.status.solved and strategy:
            advice = f"{advice} The first try failed; this was found {strategy}."
        if solution.status.solved and solution.rivals:
            advice = f"{advice} {solution.several}"
        attempts, ledger = tuple(self.attempts), Ledger.of(self.ledger)
        self.attempts.clear()
        self.ledger.clear()
        return replace(solution, attempts=attempts, advice=advice, ledger=ledger)


Start = tuple[Transcription, Given, SolverSettings]


@dataclass(frozen=True)
class Strategy:
    """A row of the table by which a problem is tried.

    Attributes
    ----------
    name : in words that follow "found"
    propose : programs with a guess and settings of the solve; none where it does not apply
    why : the kind of problem that needs it
    """

    name: str
    propose: Callable[[_Task], Iterator[Start]]
    why: str


def _as_given(task: _Task) -> Iterator[Start]:
    yield task.transcribed(task.settings.scaling), task.guess, task.few


def _from_a_coarser_mesh(task: _Task) -> Iterator[Start]:
    coarser = round(SEARCH.coarser * default_mesh(task.problem))
    if isinstance(task.mesh, int) and task.mesh <= coarser:
        return
    transcription = task.transcribed(task.settings.scaling)
    guess = on_any_mesh(task.guess, transcription.problem)
    how = task.few, task.until, task.progress
    coarse = solve_on(transcription, coarser, guess, *how)
    task.attempts.extend(coarse.attempts)
    if coarse.status in ENDED:
        yield transcription, coarse, task.few


def _from_many_starts(task: _Task) -> Iterator[Start]:
    transcription = task.transcribed(task.settings.scaling)
    how = task.few, SEARCH.compared, task.until, task.progress
    cheapest, tried = cheapest_of_starts(transcription, *how)
    task.attempts.extend(tried)
    if cheapest is not None:
        yield transcription, cheapest, task.few


def _in_declared_scales(task: _Task) -> Iterator[Start]:
    if task.settings.scaling != "declared":
        yield task.transcribed("declared"), task.guess, replace(task.few, scaling="declared")


def _simulated(task: _Task) -> Iterator[Start]:
    assert isinstance(task.problem, OptimalControlProblem)
    if task.guess is None:
        yield from _from_the_best(task, rollouts(task.problem, default_guess(task.problem)))


def _of_any_duration(task: _Task) -> Iterator[Start]:
    assert isinstance(task.problem, OptimalControlProblem)
    free = any(low < high for low, high in (p.duration_bounds for p in task.problem.phases))
    if free and task.guess is None:
        simulations = Rollouts(task.problem, default_guess(task.problem))
        yield from _from_the_best(task, simulations.of_any_duration())


def _from_the_best(task: _Task, guesses: Sequence[Mapping[str, Guess]]) -> Iterator[Start]:
    """Start from the first of guesses that are in the order of how near they end."""
    for guess in guesses[: SEARCH.simulations]:
        yield replace(task, guess=guess).transcribed(task.settings.scaling), guess, task.few


def _with_more_iterations(task: _Task) -> Iterator[Start]:
    if task.settings.max_iterations > task.few.max_iterations:
        settings = replace(task.few, max_iterations=task.settings.max_iterations)
        yield task.transcribed(task.settings.scaling), task.guess, settings


def _by_fatrop(task: _Task) -> Iterator[Start]:
    settings = replace(task.few, solver="fatrop")
    yield task.transcribed(task.settings.scaling), task.guess, settings


STRATEGIES = (
    Strategy("", _as_given, "most problems; moved off what is symmetric"),
    Strategy(
        "from the guess as it is",
        _as_given,
        "scales that are far too large: a hundredth of them is far from the guess",
    ),
    Strategy(
        "from a coarser mesh",
        _from_a_coarser_mesh,
        "stiff reactors and long horizons take hundreds of iterations on a fine mesh, few on a "
        "coarse one",
    ),
    Strategy(
        "from the cheapest of several starts on a coarse mesh",
        _from_many_starts,
        "motions to and fro whose duration is far from the guessed one",
    ),
    Strategy(
        "from a simulation with constant controls",
        _simulated,
        "swinging up in a given time: between straight lines and the answer lies no trajectory",
    ),
    Strategy(
        "with the declared scales",
        _in_declared_scales,
        "rates and sizes that are free: what follows from the dynamics is far from the answer",
    ),
    Strategy(
        "from the simulation that ends nearest",
        _of_any_duration,
        "durations between bounds that are many powers of ten apart",
    ),
    Strategy("with more iterations", _with_more_iterations, "what is large or very nonlinear"),
    Strategy("by fatrop", _by_fatrop, "more equations than variables, which IPOPT refuses"),
)


def _first_that_ends(task: _Task, strategy: Strategy) -> tuple[Solution, Start] | None:
    """The first solution of a strategy that converges, or its last; None where there is none."""
    last: tuple[Solution, Start] | None = None
    before = len(task.attempts)
    for transcription, guess, settings in strategy.propose(task):
        name = f"{strategy.name}, first"
        task.attempts[before:] = [replace(a, way=name) for a in task.attempts[before:]]
        # where scales are wrong what is uneven is far from the guess
        uneven = not (task.alone or strategy.name)
        solution = task.solve(transcription, guess, settings, uneven)
        before = len(task.attempts)
        task.attempts.extend(solution.attempts)
        solution, transcription = task.in_own_scales(solution, transcription, settings)
        task.attempts[before:] = [
            replace(a, way=a.way or strategy.name) for a in task.attempts[before:]
        ]
        before = len(task.attempts)
        last = solution, (transcription, guess, settings)
        if solution.status in ENDED:
            break
    return last


# controls -----------------------------------------------------------------------------------------


def swings(problem: OptimalControlProblem | Transcription, solution: Solution) -> bool:
    """Whether controls have a value at every collocation point that nobody asked for.

    Not where others are known to be better, which is not looked for where controls are constant.
    """
    if isinstance(problem, Transcription) or improvable(solution) > refinement.PASSING.most_left:
        return False
    asked = {(p.name, c.name) for p in problem.phases for c in p.controls if c.shape != "auto"}
    return any(
        control.shape == "polynomial" and (phase.name, control.name) not in asked
        for phase in solution.phases
        for control in phase_layout(phase).phase.controls
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
