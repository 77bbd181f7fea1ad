"""Solve a problem as it was declared, by other strategies where one fails, until it passes.

A solve that does not converge says little about the problem: it may have begun badly or with bad
scales. So the rows of a table are tried in turn. What a solve is good for is told by the judgement
that a certificate is made of: meshes are made finer until it passes, from a saddle the solve goes
down, and what is missing at last is the status. All is counted in iterations, starts and meshes;
processor time is the limit only.

Theory: docs/theory/transcription.md, "Solvers".
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple, cast

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.diagnosis import POOR, NotFinite, kinks, unheld
from microbot_ocp.ocp.problem import OptimalControlProblem, with_shapes
from microbot_ocp.ocp.refinement import (
    CONVERGED,
    COST,
    IMPROVEMENT,
    PASSING,
    Accuracy,
    History,
    improvable,
    judged,
    named,
)
from microbot_ocp.ocp.search._other_starts import (
    Given,
    cheaper_elsewhere,
    cheapest_of_starts,
    on_any_mesh,
)
from microbot_ocp.ocp.solution import (
    UNCOMPARED,
    Attempt,
    Journal,
    Progress,
    Solution,
    StepProgress,
    cost_size,
)
from microbot_ocp.ocp.solvers import SolveContext, SolverSettings, transcribed
from microbot_ocp.ocp.starts import Rollouts, default_guess, guess_from
from microbot_ocp.ocp.transcription import Meshes, Transcription
from microbot_ocp.ocp.transcription.schemes import Scheme
from microbot_ocp.ocp.verification import judge

ENDED = (*CONVERGED, Status.INTERRUPTED)
# other shapes of controls may help
UNSETTLED = (Status.NO_PROGRESS, Status.NOT_ACCEPTED, Status.ROUND_LIMIT, Status.SIZE_LIMIT)

GIVEN = "as given"
OWN_SCALES = "with the scales of the first answer"
CONSTANT = "with controls that are constant over every interval"
COARSER = "from a coarser mesh"
OTHER_STARTS = "from other starts"
ALONE = f"It was {UNCOMPARED}: there may be a cheaper optimum."
BUSY = "The wall time ended it: {:.0f} s, of which it had the processor for {:.0f} s."
NOT_ALL = "Not every strategy was tried for want of time."


@dataclass(frozen=True)
class Search:
    """How a problem is tried.

    Attributes
    ----------
    intervals : of the mesh of a problem of one or two phases
    fewest : of every phase of a problem of many
    coarser : share of these intervals, from which a solve may converge sooner
    simulations : that a problem is solved from
    iterations : of a try: what takes more converges sooner by another strategy
    compared : other starts that an answer is compared with, on any mesh
    compared_there : the same on a mesh that was given
    least_tolerance : of solvers, that an accuracy may ask for
    wall : times the processor time that is allowed, after which it ends on a busy machine
    """

    intervals: int = 50
    fewest: int = 10
    coarser: float = 0.4
    simulations: int = 2
    iterations: int = 400
    compared: int = 12
    compared_there: int = 4
    least_tolerance: float = 1e-10
    wall: float = 10.0


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
    mesh : int or array of fractions [N+1], or one a phase
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
        Processor time after which it is stopped, s, of this thread and of the processes that
        solvers run in, so that the answer is the same on a busy machine. Strategies are limited by
        iterations, starts and meshes; where this limit is met that is said. After ten times as much
        wall time it is stopped in any case, which is said, too.
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
        or costs are not finite at the guess; an accuracy that is no positive number.

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
    goal, settings = _asked(accuracy, settings or SolverSettings())
    seconds, began = checks.time_limit(time_limit), (time.perf_counter(), deadline.worked())
    how = mesh, guess, settings, scheme, cast("Progress | None", progress), goal
    with deadline.within(min(SEARCH.wall * seconds, settings.time_limit), seconds):
        best = _searched(SolveTask(problem, *how))
        if best.status not in ENDED and deadline.over() and deadline.work_left() > 0:
            wall, work = time.perf_counter() - began[0], deadline.worked() - began[1]
            best = best.remarked(BUSY.format(wall, work))
    return best


def _searched(task: SolveTask) -> Solution:
    """Return the answer of the first strategy that is final, or the best of all."""
    settings, guess = task.settings, task.guess
    journal = task.journal
    best: Solution | None = None
    unconverged: tuple[Solution, SolveContext] | None = None
    refused: InputError | None = None
    for strategy in STRATEGIES[: 1 if task.alone else None]:
        if (best or unconverged) and task.over:
            break
        mark, began, last = len(journal.rows), time.perf_counter(), None
        tried: list[Attempt] = []
        try:
            for start in strategy.propose(task, tried):
                solution = start.context.solve(start.mesh, start.guess, uneven=start.uneven)
                tried += named(strategy.name, solution.attempts)
                last = solution, start
                if solution.status in ENDED:
                    break
        except NotFinite as not_finite:
            if task.alone or guess is not None:
                raise
            refused = refused or not_finite
        if last is None:
            journal.attempts.extend(tried)
            continue
        solution, start = last
        ended = solution if solution.status in ENDED else None
        spent = time.perf_counter() - began
        journal.enter(strategy.name or GIVEN, None, ended, tried, spent)
        if ended is None:
            if unconverged is None or _keeps_more(solution, unconverged[0], settings.tolerance):
                unconverged = solution, start.context
            continue
        solution, final = _finished(task, strategy.name, solution, start)
        better = best is None or final
        journal.discard(slice(mark) if better else slice(mark, None))
        best = solution if better else best
        if final:
            break
    if best is None:
        if unconverged is None:
            raise cast("InputError", refused)
        solution, context = unconverged
        best = task.judged(solution, context)[0]
    return _ended(task, journal.closed(best))


def _asked(
    accuracy: float | Accuracy | None, settings: SolverSettings
) -> tuple[Accuracy | None, SolverSettings]:
    """Return the accuracy that is asked for, and settings with a tolerance that it needs."""
    if accuracy is None:
        return None, settings
    if not isinstance(accuracy, Accuracy):
        accuracy = Accuracy(checks.number("accuracy", accuracy, above=0.0))
    tolerance = max(accuracy.states / 10, SEARCH.least_tolerance)
    return accuracy, replace(settings, tolerance=min(settings.tolerance, tolerance))


def _keeps_more(solution: Solution, other: Solution, tolerance: float) -> bool:
    """Return whether of two that did not converge this one alone is within the tolerance."""
    left_open = [one.attempts[-1].infeasibility for one in (solution, other)]
    return left_open[0] <= tolerance < left_open[1]


def _ended(task: SolveTask, best: Solution) -> Solution:
    """Return the answer, with what is to be said of the search."""
    if best.status not in ENDED and task.over:
        best = best.remarked(NOT_ALL)
    if best.solved and best.unsettled:
        best = best.ended(Status.LOCAL_OPTIMUM, best.several)
    return best.remarked(
        kinks(best), unheld(best), ALONE if best.solved and not best.compared else ""
    )


def default_mesh(problem: OptimalControlProblem | Transcription) -> int:
    """Return intervals of every phase: fewer where there are many."""
    phases = (problem.problem if isinstance(problem, Transcription) else problem).phases
    return max(SEARCH.fewest, round(2 * SEARCH.intervals / max(len(phases), 2)))


# what is solved, and what was tried ---------------------------------------------------------------


class Start(NamedTuple):
    """A program on a mesh, with a guess and settings of its solve."""

    context: SolveContext
    mesh: Meshes
    guess: Given
    uneven: bool = False  # whether the guess is moved off what is symmetric


@dataclass(frozen=True, eq=False)
class SolveTask:
    """What is to be solved."""

    problem: OptimalControlProblem | Transcription
    given: Meshes | None
    guess: Given
    settings: SolverSettings
    scheme: str | Scheme
    progress: Progress | None
    accuracy: Accuracy | None
    journal: Journal = field(default_factory=Journal)

    @property
    def mesh(self) -> Meshes:
        return default_mesh(self.problem) if self.given is None else self.given

    @property
    def over(self) -> bool:
        return deadline.over()

    @property
    def alone(self) -> bool:
        """Whether a transcription or a solver was chosen: no other strategy is tried."""
        return isinstance(self.problem, Transcription) or self.settings.solver != "auto"

    @property
    def compared(self) -> int:
        """Other starts that an answer is compared with."""
        fixed = self.given is not None and self.accuracy is None
        return SEARCH.compared_there if fixed else SEARCH.compared

    @property
    def short(self) -> SolverSettings:
        """Settings of a try that may be followed by another."""
        most = min(SEARCH.iterations, self.settings.max_iterations)
        return replace(self.settings, max_iterations=most)

    @property
    def few(self) -> SolverSettings:
        """The same by IPOPT, where no solver was chosen."""
        return self.settings if self.alone else replace(self.short, solver="ipopt")

    def start(
        self, scaling: str = "", settings: SolverSettings | None = None, uneven: bool = False
    ) -> Start:
        """Start from the guess, by the few iterations of a try or by other settings."""
        scaled = replace(self.settings, scaling=scaling or self.settings.scaling)
        program = transcribed(self.problem, scaled, scheme=self.scheme, guess=self.guess)
        context = SolveContext(program, settings or self.few, self.progress)
        return Start(context, self.mesh, self.guess, uneven)

    def judged(
        self,
        solution: Solution,
        context: SolveContext,
        freer_cost: float = np.inf,
        *,
        patient: bool = True,
    ) -> tuple[Solution, bool]:
        """Return the solution on its way to one that passes, and whether that is final."""
        return judged(
            solution,
            replace(context, settings=self.short),
            self.journal,
            finer=self.given is None or self.accuracy is not None,
            goal=self.accuracy or PASSING,
            freer_cost=np.inf if self.accuracy is None else freer_cost,
            patient=patient,
        )


# from a first answer to a final one ---------------------------------------------------------------


def _finished(task: SolveTask, way: str, solution: Solution, start: Start) -> tuple[Solution, bool]:
    """Return the cheapest that an answer leads to, on meshes on which it passes, and whether it is
    final.

    It is compared with what other starts lead to.
    """
    solution, start = _in_own_scales(task, solution, start)
    compared = task.alone or isinstance(task.guess, Solution)  # what was compared when it was found
    if not compared and solution.status in CONVERGED:
        began, before = time.perf_counter(), solution
        solution, tried = cheaper_elsewhere(solution, start.context, task.compared, task.guess)
        spent = time.perf_counter() - began
        task.journal.enter(OTHER_STARTS, before, solution if tried else None, tried, spent)
        if tried:  # another valley, of other sizes
            solution, start = _in_own_scales(task, solution, start)
    first = f"The first try failed; this was found {way}." if way else ""
    remarks = [k for k in (first, solution.several) if k]
    if solution.status.solved:
        solution = solution.remarked(*remarks)
    swings = solution.status in CONVERGED and _swings(task.problem, solution)
    solution, final = task.judged(solution, start.context, patient=not swings)
    if solution.status in UNSETTLED and _swings(task.problem, solution):
        constant, final = _with_constant_controls(task, solution)
        if constant is not solution:
            return constant, final
        if swings and solution.status is Status.NO_PROGRESS:
            again, final = task.judged(solution.ended(Status.SOLVED, *remarks), start.context)
            history = (*solution.history[:-1], *again.history)
            return replace(again, history=History(history)), final
    return solution, final


def _in_own_scales(task: SolveTask, solution: Solution, start: Start) -> tuple[Solution, Start]:
    """Give the better of the solution and of one with scales of its own, where these are far from
    the guessed.

    What is small beside its scale is not accurate, and a cost of such a scale seems to be
    settled; what is far larger may be on its way to a slope at infinity. The cheaper one is better
    if it passes where the other does.
    """
    settings, problem = start.context.settings, start.context.transcription.problem
    automatic = settings.scaling == "auto" and not task.alone
    if not automatic or solution.status not in CONVERGED:
        return solution, start
    began = time.perf_counter()
    again = replace(task, guess=solution).start("auto", settings)
    pairs = zip(problem.phases, again.context.transcription.problem.phases, strict=True)
    ratios = [
        np.abs(np.log(np.asarray(old.scale) / new.scale)).max()
        for before, after in pairs
        for kind in ("states", "controls")
        for old, new in zip(getattr(before, kind), getattr(after, kind), strict=True)
    ]
    if max(ratios) < np.log(POOR):
        return solution, start
    answer = again.context.solve(again.mesh, again.guess)
    tried, better = named(OWN_SCALES, answer.attempts), False
    if answer.status in CONVERGED:
        more = _passes(answer, again) - _passes(solution, start)
        allowed = COST.unmet if more > 0 else PASSING.cost
        dearer = answer.cost - solution.cost
        better = more >= 0 and dearer <= allowed * cost_size(solution.cost, solution.cost_scale)
    spent = time.perf_counter() - began
    task.journal.enter(OWN_SCALES, solution, answer if better else None, tried, spent)
    return (answer.with_rivals_of(solution), again) if better else (solution, start)


def _passes(solution: Solution, start: Start) -> bool:
    """Return whether a solution passes, or would on a finer mesh."""
    failures = judge(start.context.transcription, solution).failures
    return all(failure.status is Status.TOO_COARSE for failure in failures)


def _swings(problem: OptimalControlProblem | Transcription, solution: Solution) -> bool:
    """Return whether controls have a value at every collocation point that nobody asked for.

    Not where others are known to be better, which is not looked for where controls are constant.
    """
    if isinstance(problem, Transcription) or improvable(solution) > COST.most_left:
        return False
    asked = {(p.name, c.name) for p in problem.phases for c in p.controls if c.shape != "auto"}
    return any(
        control.shape == "polynomial" and (phase.name, control.name) not in asked
        for phase in solution.phases
        for control in phase.laid_out.phase.controls
    )


def _with_constant_controls(task: SolveTask, before: Solution) -> tuple[Solution, bool]:
    """Return the solution with controls that are constant over every interval, where that passes.

    On a singular arc a control that is free at every collocation point may go to and fro
    between them, and owe a part of its cost to what the scheme does not see; where it jumps it
    exceeds limits between them.
    """
    began = time.perf_counter()
    assert isinstance(task.problem, OptimalControlProblem)
    problem = with_shapes(task.problem, "constant")
    guess, journal = guess_from(problem, before), Journal()
    restated = replace(task, problem=problem, guess=guess, given=None, journal=journal)
    settings = task.settings if task.alone else replace(task.settings, solver="ipopt")
    start = restated.start(settings=settings)
    answer = start.context.solve(start.mesh, start.guess)
    journal.attempts.extend(answer.attempts)
    answer, final = restated.judged(answer, start.context, before.cost)
    solved = answer if answer.status.solved else None
    tried, spent = named(CONSTANT, journal.attempts), time.perf_counter() - began
    task.journal.enter(CONSTANT, before, solved, tried, spent)
    if solved is None:
        return before, False
    remark = f"With other values at every point the cost does not settle: {CONSTANT}."
    return answer.remarked(remark).with_rivals_of(before), final


# strategies ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Strategy:
    """A row of the table by which a problem is tried.

    Attributes
    ----------
    name : in words that follow "found"
    propose : starts of its solves, none where it does not apply; it adds what it tried for them
    why : the kind of problem that needs it
    """

    name: str
    propose: Callable[[SolveTask, list[Attempt]], Iterable[Start]]
    why: str


def _moved(task: SolveTask, _: list[Attempt]) -> Iterator[Start]:
    settings = task.few
    phases = getattr(task.problem, "phases", ())
    if not task.alone and settings.initial_barrier is None and not any(p.controls for p in phases):
        # a fit begins near its data, and the usual barrier outweighs what rates still change there
        settings = replace(settings, initial_barrier=IMPROVEMENT.barrier)
    # where scales are wrong what is uneven is far from the guess
    yield task.start(settings=settings, uneven=not task.alone)


def _as_it_is(task: SolveTask, _: list[Attempt]) -> Iterator[Start]:
    yield task.start()


def _from_a_coarser_mesh(task: SolveTask, tried: list[Attempt]) -> Iterator[Start]:
    coarser = round(SEARCH.coarser * default_mesh(task.problem))
    if isinstance(task.mesh, int) and task.mesh <= coarser:
        return
    start = task.start()
    guess = on_any_mesh(task.guess, start.context.transcription.problem)
    coarse = start.context.solve(coarser, guess)
    tried += named(COARSER, coarse.attempts)
    if coarse.status in ENDED:
        yield start._replace(guess=coarse)


def _simulated(task: SolveTask, _: list[Attempt]) -> Iterator[Start]:
    assert isinstance(task.problem, OptimalControlProblem)
    if task.guess is None:
        simulations = Rollouts(task.problem, default_guess(task.problem)).of_any_duration()
        for guess in simulations[: SEARCH.simulations]:
            yield replace(task, guess=guess).start()


def _from_many_starts(task: SolveTask, tried: list[Attempt]) -> Iterator[Start]:
    start = task.start()
    cheapest, attempts = cheapest_of_starts(start.context, SEARCH.compared)
    tried += attempts
    if cheapest is not None:
        yield start._replace(guess=cheapest)


def _with_more_iterations(task: SolveTask, _: list[Attempt]) -> Iterator[Start]:
    most = task.settings.max_iterations
    if most > task.few.max_iterations:
        yield task.start(settings=replace(task.few, max_iterations=most))


def _by_fatrop(task: SolveTask, _: list[Attempt]) -> Iterator[Start]:
    yield task.start(settings=replace(task.few, solver="fatrop"))


STRATEGIES = (
    Strategy("", _moved, "most problems; moved off what is symmetric"),
    Strategy(
        "from the guess as it is",
        _as_it_is,
        "scales that are far too large: a hundredth of them is far from the guess",
    ),
    Strategy(
        COARSER,
        _from_a_coarser_mesh,
        "stiff reactors and long horizons take hundreds of iterations on a fine mesh, few on a "
        "coarse one",
    ),
    Strategy(
        "from the simulation that ends nearest",
        _simulated,
        "swinging up, and durations that are far from the guessed one: between straight lines and "
        "the answer lies no trajectory",
    ),
    Strategy(
        "from the cheapest of several starts on a coarse mesh",
        _from_many_starts,
        "turns of a body, to and fro, that no simulation with constant controls comes near",
    ),
    Strategy("with more iterations", _with_more_iterations, "what is large or very nonlinear"),
    Strategy("by fatrop", _by_fatrop, "more equations than variables, which IPOPT refuses"),
)
