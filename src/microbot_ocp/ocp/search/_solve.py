"""Solution of a problem as declared, by a table of strategies, until it passes its judgement.

A solve that fails says little about the problem: its start or its scales may have been bad. The
strategies of a table are therefore tried in turn. A solution is judged by the checks behind its
certificate: meshes are refined until it passes, a saddle is left downwards, and a requirement that
remains unmet determines the status. Effort is limited by iterations, starts and meshes; processor
time is only the final limit.

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
from microbot_ocp.ocp.problem import OptimalControlProblem, tied_controls, with_shapes
from microbot_ocp.ocp.refinement import (
    BARRIER_NEAR_BOUNDS,
    CONVERGED,
    PASSING,
    UNREACHED_SAVING,
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
    per_phase,
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
from microbot_ocp.ocp.starts import Rollouts, default_guess, following_lines, guess_from
from microbot_ocp.ocp.transcription import Meshes, Transcription
from microbot_ocp.ocp.transcription.schemes import Scheme
from microbot_ocp.ocp.verification import judge

ENDED = (*CONVERGED, Status.INTERRUPTED)
# Other shapes of controls may help in these cases.
UNSETTLED = (Status.NO_PROGRESS, Status.NOT_ACCEPTED, Status.ROUND_LIMIT, Status.SIZE_LIMIT)

GIVEN = "as given"
OWN_SCALES = "with the scales of the first answer"
CONSTANT = "with controls that are constant over every interval"
COARSER = "from a coarser mesh"
OTHER_STARTS = "from other starts"
NOT_COMPARED = f"It was {UNCOMPARED}: there may be a cheaper optimum."
NOT_ALL = "Not every strategy was tried for want of time."

INTERVALS = 50  # intervals per phase of the default mesh, for one or two phases
FEWEST_INTERVALS = 10  # the same for many phases
STARTS_COMPARED = 12  # other starts that a solution on a default mesh is compared with
STARTS_ON_GIVEN_MESH = 4  # other starts that a solution on a given mesh is compared with
MOST_ITERATIONS = 400  # iteration limit of a try: another strategy converges sooner than a long one
LEAST_TOLERANCE = 1e-10  # least tolerance of the solver that an accuracy requires


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
    """Transcribe a problem, and solve it until it passes its judgement or has an accuracy.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
        A transcription keeps its kernels from solve to solve, and is solved by one strategy.
    mesh : int or array of fractions [N+1], or one per phase
        Default: 50 intervals, shared if there are more than two phases, and refined until
        :func:`~microbot_ocp.ocp.verify` passes the solution and the cost changes by less than 1e-4,
        relative; a cost that does not settle is not solved. On a given mesh, a solution whose
        states, cost or limits fail between the mesh points has the status TOO_COARSE; with an
        accuracy, the given mesh is the first one.
    guess : mapping from phase name to Guess, Solution or "rollout", optional
        Missing values start from :func:`~microbot_ocp.ocp.solution.default_guess`. A solution may
        have another mesh or other phases; with equal phases its multipliers are used as well.
        "rollout" simulates with constant controls. A guess that is no solution is displaced by
        about a hundredth of the scales, so that it is not symmetric.
    settings : SolverSettings, optional
        Settings of the solver. If they name a solver, it alone is used, with the undisplaced guess
        and one strategy.
    scheme : str or Scheme
        Scheme for a problem that is not transcribed: "shooting", "radau", "gauss", "trapezoidal",
        "hermite_simpson", or a Scheme with settings.
    accuracy : float or Accuracy, optional
        Accepted relative state error of any interval, or requirements for limits, switches and
        cost as well: see :class:`~microbot_ocp.ocp.Accuracy`. Meshes are refined until it is met;
        otherwise ``status`` and ``advice`` give the reason and the unmet requirement. The solver's
        tolerance is at most a tenth of it.
    time_limit : float
        Limit of the processor time of this thread and of the solver processes, s. It makes results
        reproducible on a busy machine. Strategies are limited by iterations, starts and
        meshes; ``advice`` reports if this limit ends the search. The wall time is limited to ten
        times as much, which is reported as well.
    progress : callable, optional
        Function called with an :class:`~microbot_ocp.ocp.solution.Iteration` at every iteration,
        and with a line of text for every mesh if there is an accuracy. It may raise
        KeyboardInterrupt to stop the solve.
        stop the solve.

    Returns
    -------
    Solution
        Also returned if no solver converged: see ``status``, which is SOLVED if ``verify`` passes
        the solution. ``attempts`` lists all solver runs, except those from other starts that led to
        nothing cheaper; ``history`` lists the meshes, ``ledger`` the strategies. After Ctrl-C, the
        last accepted solution is returned with the status INTERRUPTED.

    Raises
    ------
    InputError
        The declaration, mesh or guess is incomplete or not finite; the dynamics, constraints or
        costs are not finite at the guess; or an accuracy is not a positive number.

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
    goal, settings = _with_accuracy(accuracy, settings or SolverSettings())
    how = mesh, guess, settings, scheme, cast("Progress | None", progress), goal
    with deadline.of_work(time_limit, settings.time_limit) as begin:
        best = _searched(SolveTask(problem, *how))
        if best.status not in ENDED and begin.busy:
            best = best.remarked(begin.busy)
    return best


def _searched(task: SolveTask) -> Solution:
    """Return the solution of the first strategy that is final, or the best one of all."""
    settings, journal = task.settings, task.journal
    best: Solution | None = None
    unconverged: tuple[Solution, SolveContext] | None = None
    refused: InputError | None = None
    for strategy in STRATEGIES[: 1 if task.alone else None]:
        if (best or unconverged) and task.over:
            break
        mark, began = len(journal.rows), time.perf_counter()
        tried: list[Attempt] = []
        last, not_finite = _run(task, strategy, tried)
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


def _run(
    task: SolveTask, strategy: Strategy, tried: list[Attempt]
) -> tuple[tuple[Solution, Start] | None, NotFinite | None]:
    """Return the last solve of a strategy with its start, and the refusal of a default guess.

    The first solve that converges or is interrupted ends the strategy. Attempts are appended to
    ``tried``.
    """
    last: tuple[Solution, Start] | None = None
    try:
        for start in strategy.propose(task, tried):
            solution = start.context.solve(start.mesh, start.guess, uneven=start.uneven)
            tried += named(strategy.name, solution.attempts)
            last = solution, start
            if solution.status in ENDED:
                break
    except NotFinite as not_finite:
        if task.alone or task.guess is not None:
            raise
        return last, not_finite
    return last, None


def _with_accuracy(
    accuracy: float | Accuracy | None, settings: SolverSettings
) -> tuple[Accuracy | None, SolverSettings]:
    """Return the wanted accuracy, and settings with the tolerance that it needs."""
    if accuracy is None:
        return None, settings
    if not isinstance(accuracy, Accuracy):
        accuracy = Accuracy(checks.number("accuracy", accuracy, above=0.0))
    tolerance = max(accuracy.states / 10, LEAST_TOLERANCE)
    return accuracy, replace(settings, tolerance=min(settings.tolerance, tolerance))


def _keeps_more(solution: Solution, other: Solution, tolerance: float) -> bool:
    """Return True if only the first of two failed solutions is feasible within the tolerance."""
    left_open = [one.attempts[-1].infeasibility for one in (solution, other)]
    return left_open[0] <= tolerance < left_open[1]


def _ended(task: SolveTask, best: Solution) -> Solution:
    """Return the result with remarks on the search."""
    if best.status not in ENDED and task.over:
        best = best.remarked(NOT_ALL)
    if best.solved and best.unsettled:
        best = best.ended(Status.LOCAL_OPTIMUM, best.several)
    return best.remarked(
        kinks(best), unheld(best), NOT_COMPARED if best.solved and not best.compared else ""
    )


# task ---------------------------------------------------------------------------------------------


class Start(NamedTuple):
    """A program on a mesh, with a guess and settings of its solve."""

    context: SolveContext
    mesh: Meshes
    guess: Given
    uneven: bool = False  # True to displace the guess off symmetric points


@dataclass(frozen=True, eq=False)
class SolveTask:
    """A problem with the arguments of its solve, and the journal of the search."""

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
        """Given mesh, or the default number of intervals per phase."""
        if self.given is not None:
            return self.given
        declared = self.problem
        declared = declared.problem if isinstance(declared, Transcription) else declared
        return per_phase(declared, INTERVALS, FEWEST_INTERVALS)

    @property
    def over(self) -> bool:
        return deadline.over()

    @property
    def alone(self) -> bool:
        """True if a transcription or a solver was chosen: one strategy is used."""
        return isinstance(self.problem, Transcription) or self.settings.solver != "auto"

    @property
    def compared(self) -> int:
        """Number of other starts that a solution is compared with."""
        fixed = self.given is not None and self.accuracy is None
        return STARTS_ON_GIVEN_MESH if fixed else STARTS_COMPARED

    @property
    def short(self) -> SolverSettings:
        """Settings of a try, with the iteration limit of tries."""
        most = min(MOST_ITERATIONS, self.settings.max_iterations)
        return replace(self.settings, max_iterations=most)

    @property
    def few(self) -> SolverSettings:
        """Settings of a try by IPOPT, unless a solver was chosen."""
        return self.settings if self.alone else replace(self.short, solver="ipopt")

    def start(
        self, scaling: str = "", settings: SolverSettings | None = None, uneven: bool = False
    ) -> Start:
        """Return a start from the guess, with the settings of a try by default."""
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
        """Return the solution refined until it passes, and whether that is final."""
        return judged(
            solution,
            replace(context, settings=replace(self.short, options=context.settings.options)),
            self.journal,
            finer=self.given is None or self.accuracy is not None,
            goal=self.accuracy or PASSING,
            freer_cost=np.inf if self.accuracy is None else freer_cost,
            patient=patient,
        )


# a first solution and its improvement -------------------------------------------------------------


def _finished(task: SolveTask, way: str, solution: Solution, start: Start) -> tuple[Solution, bool]:
    """Return the best solution that follows from a first one, and whether it is final.

    The solution is compared with the results of other starts, and refined until it passes.
    """
    solution, start = _in_own_scales(task, solution, start)
    # A solution given as guess was compared when it was found.
    compared = task.alone or isinstance(task.guess, Solution)
    if not compared and solution.status in CONVERGED:
        began, before = time.perf_counter(), solution
        solution, tried = cheaper_elsewhere(solution, start.context, task.compared, task.guess)
        spent = time.perf_counter() - began
        task.journal.enter(OTHER_STARTS, before, solution if tried else None, tried, spent)
        if tried:  # another local optimum may have other sizes
            solution, start = _in_own_scales(task, solution, start)
    first = f"The first try failed; this was found {way}." if way else ""
    remarks = first, solution.several
    if solution.status.solved:
        solution = solution.remarked(*remarks)
    known = solution
    chatters = known.status in CONVERGED and _may_chatter(task.problem, known)
    solution, final = task.judged(solution, start.context, patient=not chatters)
    if solution.status in UNSETTLED and _may_chatter(task.problem, solution):
        constant, final = _with_constant_controls(task, solution)
        if constant is not solution:
            return constant.with_rivals_of(known), final
        if chatters and solution.status is Status.NO_PROGRESS:
            again, final = task.judged(solution.ended(Status.SOLVED, *remarks), start.context)
            history = (*solution.history[:-1], *again.history)
            return replace(again, history=History(history)), final
    return solution, final


def _in_own_scales(task: SolveTask, solution: Solution, start: Start) -> tuple[Solution, Start]:
    """Return the better of the solution and a solve with scales taken from it, if these differ.

    Variables far below their scales are inaccurate, and a small cost with a large scale seems
    settled; variables far above their scales may diverge where the cost is flat. The cheaper
    solution is better, provided that it passes if the other one does.
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
        allowed = UNREACHED_SAVING if more > 0 else PASSING.cost
        dearer = answer.cost - solution.cost
        better = more >= 0 and dearer <= allowed * cost_size(solution.cost, solution.cost_scale)
    spent = time.perf_counter() - began
    task.journal.enter(OWN_SCALES, solution, answer if better else None, tried, spent)
    return (answer.with_rivals_of(solution), again) if better else (solution, start)


def _passes(solution: Solution, start: Start) -> bool:
    """Return True if a solution passes, or fails only because its mesh is too coarse."""
    failures = judge(start.context.transcription, solution).failures
    return all(failure.status is Status.TOO_COARSE for failure in failures)


def _may_chatter(problem: OptimalControlProblem | Transcription, solution: Solution) -> bool:
    """Return True if controls are polynomials by default, and chatter may explain the failure.

    False if better controls are known, which are searched only for polynomial controls.
    """
    if isinstance(problem, Transcription) or improvable(solution) > PASSING.cost:
        return False
    chosen = {(p.name, c.name) for p in problem.phases for c in p.controls if c.shape != "auto"}
    chosen |= {(p.name, name) for p in problem.phases for name in tied_controls(p)}
    return any(
        control.shape == "polynomial" and (phase.name, control.name) not in chosen
        for phase in solution.phases
        for control in phase.laid_out.phase.controls
    )


def _with_constant_controls(task: SolveTask, before: Solution) -> tuple[Solution, bool]:
    """Return the solution with piecewise constant controls if it passes, and whether it is final.

    On a singular arc a polynomial control may oscillate between collocation points, with a cost
    that the scheme does not see; where it jumps it exceeds limits between them. A solution that is
    far dearer is another optimum.
    """
    began = time.perf_counter()
    assert isinstance(task.problem, OptimalControlProblem)
    problem = with_shapes(task.problem, "constant", tied=False)
    guess, journal = guess_from(problem, before), Journal()
    restated = replace(task, problem=problem, guess=guess, given=None, journal=journal)
    settings = task.settings if task.alone else replace(task.settings, solver="ipopt")
    start = restated.start(settings=settings)
    answer = start.context.solve(start.mesh, start.guess)
    journal.attempts.extend(answer.attempts)
    solved, final = None, False
    most = UNREACHED_SAVING * cost_size(before.cost, before.cost_scale)
    # The error of constant controls falls at least with the number of intervals.
    growth = PASSING.most_intervals / sum(phase.mesh.size - 1 for phase in answer.phases)
    if answer.cost - before.cost <= growth * most:
        answer, final = restated.judged(answer, start.context, before.cost)
        solved = answer if answer.status.solved and answer.cost - before.cost <= most else None
    tried, spent = named(CONSTANT, journal.attempts), time.perf_counter() - began
    task.journal.enter(CONSTANT, before, solved, tried, spent)
    if solved is None:
        return before, False
    remark = f"With polynomial controls the cost does not settle: {CONSTANT}."
    return answer.remarked(remark), final


# strategies ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Strategy:
    """A row of the table of strategies.

    Attributes
    ----------
    name : text that follows "found"
    propose : function that yields starts, none if it does not apply, and records its own attempts;
        the docstring of the function names the kind of problem that needs the strategy
    """

    name: str
    propose: Callable[[SolveTask, list[Attempt]], Iterable[Start]]


COARSER_INTERVALS = 20  # intervals per phase of a coarser mesh, for one or two phases
MOST_SIMULATIONS = 2  # simulations that serve as starts


def _displaced(task: SolveTask, _: list[Attempt]) -> Iterator[Start]:
    """Yield the guess, displaced off symmetric points: most problems are solved from there."""
    settings = task.few
    phases = getattr(task.problem, "phases", ())
    if not task.alone and settings.initial_barrier is None and not any(p.controls for p in phases):
        # A fit starts near its data; the default barrier would outweigh the small cost there.
        settings = replace(settings, initial_barrier=BARRIER_NEAR_BOUNDS)
    # The displaced guess is far from the given one if scales are wrong: see the next strategy.
    yield task.start(settings=settings, uneven=not task.alone)


def _undisplaced(task: SolveTask, _: list[Attempt]) -> Iterator[Start]:
    """Yield the guess as it is.

    If scales are far too large, a hundredth of them is far from the guess.
    """
    yield task.start()


def _from_a_coarser_mesh(task: SolveTask, tried: list[Attempt]) -> Iterator[Start]:
    """Yield a solution on a coarser mesh.

    Stiff reactors and long horizons take hundreds of iterations on a fine mesh, few on a coarse
    one.
    """
    assert isinstance(task.problem, OptimalControlProblem)
    coarser = per_phase(task.problem, COARSER_INTERVALS)
    if isinstance(task.mesh, int) and task.mesh <= coarser:
        return
    start = task.start()
    guess = on_any_mesh(task.guess, start.context.transcription.problem)
    coarse = start.context.solve(coarser, guess)
    tried += named(COARSER, coarse.attempts)
    if coarse.status in ENDED:
        yield start._replace(guess=coarse)


def _simulated(task: SolveTask, _: list[Attempt]) -> Iterator[Start]:
    """Yield the simulations that end nearest.

    They serve for a swing-up, and for durations far from the guessed one: straight lines are far
    from any trajectory.
    """
    assert isinstance(task.problem, OptimalControlProblem)
    if task.guess is None:
        simulations = Rollouts(task.problem, default_guess(task.problem)).of_any_duration()
        for guess in simulations[:MOST_SIMULATIONS]:
            yield replace(task, guess=guess).start()


def _regularised(task: SolveTask, _: list[Attempt]) -> Iterator[Start]:
    """Yield the guess for a solve with regularised equations.

    It serves for speeds of zero: conditions depend on each other there, and headings have no
    influence, so that they start along straight lines.
    """
    assert isinstance(task.problem, OptimalControlProblem)
    if task.guess is None:
        given, ordinary = task.few.options, default_guess(task.problem)
        options = {**given, "ipopt": {"perturb_always_cd": "yes", **given.get("ipopt", {})}}
        settings = replace(task.few, options=options)
        guess = following_lines(task.problem, ordinary)
        if any(guess[name] is not ordinary[name] for name in guess):
            constant = with_shapes(task.problem, "constant", tied=False)
            yield replace(task, problem=constant, guess=guess).start(settings=settings)
        yield replace(task, guess=guess).start(settings=settings)


def _from_many_starts(task: SolveTask, tried: list[Attempt]) -> Iterator[Start]:
    """Yield the cheapest of several solutions on a coarse mesh.

    It serves for turns of a body back and forth, which no simulation with constant controls
    approximates.
    """
    start = task.start()
    cheapest, attempts = cheapest_of_starts(start.context, STARTS_COMPARED)
    tried += attempts
    if cheapest is not None:
        yield start._replace(guess=cheapest)


def _with_more_iterations(task: SolveTask, _: list[Attempt]) -> Iterator[Start]:
    """Yield the guess with all iterations, for large or very nonlinear problems."""
    most = task.settings.max_iterations
    if most > task.few.max_iterations:
        yield task.start(settings=replace(task.few, max_iterations=most))


def _by_fatrop(task: SolveTask, _: list[Attempt]) -> Iterator[Start]:
    """Yield the guess for fatrop: IPOPT rejects more equations than variables."""
    yield task.start(settings=replace(task.few, solver="fatrop"))


STRATEGIES = (
    Strategy("", _displaced),
    Strategy("from the guess as it is", _undisplaced),
    Strategy(COARSER, _from_a_coarser_mesh),
    Strategy("with regularised equations", _regularised),
    Strategy("from the simulation that ends nearest", _simulated),
    Strategy("from the cheapest of several starts on a coarse mesh", _from_many_starts),
    Strategy("with more iterations", _with_more_iterations),
    Strategy("by fatrop", _by_fatrop),
)
