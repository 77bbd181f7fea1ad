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

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.ocp import refinement, verification
from microbot_ocp.ocp.diagnosis import BESIDE, POOR, NotFinite, falls_for_ever
from microbot_ocp.ocp.problem import OptimalControlProblem, with_shapes
from microbot_ocp.ocp.solution import (
    Attempt,
    Progress,
    Rollouts,
    Solution,
    cost_size,
    default_guess,
    rollouts,
)
from microbot_ocp.ocp.solvers._chain import solve_on, transcribed
from microbot_ocp.ocp.solvers._improvement import improvable, improved
from microbot_ocp.ocp.solvers._other_starts import (
    cheaper_elsewhere,
    cheapest_of_starts,
    on_any_mesh,
)
from microbot_ocp.ocp.solvers._settings import SolverSettings
from microbot_ocp.ocp.transcription import Guess, Meshes, Transcription
from microbot_ocp.ocp.transcription.schemes import Scheme
from microbot_ocp.ocp.verification import Judgement, Thresholds, judge

Given = Mapping[str, Guess] | Solution | str | None

INTERVALS = 50  # of a problem of one or two phases
FEWEST = 10  # of every phase of a problem of many
COARSER = 0.4  # of these intervals, from which a solve may converge sooner
SIMULATIONS = 2  # of each kind that a problem is solved from
FIRST = 400  # iterations of a try: what takes more converges sooner by another strategy
COMPARED = (12, 4)  # other starts that an answer is compared with, on any mesh and on a given one
CONVERGED = (Status.SOLVED, Status.GAP_LEFT)
ENDED = (*CONVERGED, Status.INTERRUPTED)

STEADY = "with controls that are constant over every interval"
CHATTERS = "the optimum may be approached by controls that jump to and fro ever faster."
NOT_ALL = "Not every strategy was tried for want of time."
ACCURACY = 1e-4  # relative: change of the cost from mesh to mesh
SETTLED = 5.0  # times the accuracy: what is left of the cost's change at which it has settled
UNMET = 1e-2  # share of the cost: where no solve saves it what is more is missed, less is said
ROUNDS = 14
MOST_INTERVALS = 1000


def solve(
    problem: OptimalControlProblem | Transcription,
    mesh: Meshes | None = None,
    guess: Given = None,
    settings: SolverSettings | None = None,
    *,
    scheme: str | Scheme = "radau",
    time_limit: float = 60.0,
    progress: Progress | None = None,
) -> Solution:
    """Transcribe a problem on a mesh and solve it.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
        A transcription keeps its kernels from solve to solve; it is solved in one way only.
    mesh : int, Mesh, or one int, Mesh or array of fractions [N+1] a phase
        Default: 50 intervals, shared by the phases where there are more than two, and finer until
        :func:`~microbot_ocp.ocp.verify` passes the answer and the cost changes by less than 1e-4 of
        itself; what does not settle is not solved. On a mesh that is given, an answer whose states,
        cost or limits do not pass between the mesh points has the status TOO_COARSE.
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
    time_limit : float
        Wall time after which it is stopped, s. Strategies are limited by iterations, starts and
        meshes, so the answer is the same on a busy machine unless this limit is met, which is said.
    progress : callable, optional
        Called with an :class:`~microbot_ocp.ocp.solution.Iteration` at every iteration. It may
        raise KeyboardInterrupt to stop the solve.

    Returns
    -------
    Solution
        Also where no solver converged: look at ``status``, which is SOLVED where ``verify`` passes
        it. Its ``attempts`` are all that was tried,
        but for other starts with which it was compared and that led to nothing cheaper. After
        Ctrl-C it is the last iterate, with the status INTERRUPTED.

    Raises
    ------
    InputError
        The declaration, mesh or guess is not complete or not finite, or the dynamics, constraints
        or costs are not finite at the guess.
    """
    settings = settings or SolverSettings()
    own = min(checks.time_limit(time_limit), settings.time_limit)
    until = min(time.perf_counter() + own, deadline.until())
    chosen = default_mesh(problem) if mesh is None else mesh
    best: Solution | None = None
    attempts: list[Attempt] = []
    most = COMPARED[0 if mesh is None else 1]
    answers = solutions(problem, chosen, guess, settings, scheme, until, progress, most)
    for solution, transcription in answers:
        solution = _judged(solution, transcription, settings, until, progress, finer=mesh is None)
        if solution.status is Status.NO_PROGRESS and swings(problem, solution):
            solution = _with_steady_controls(problem, solution, settings, scheme, until, progress)
        attempts += solution.attempts
        unbounded = falls_for_ever(solution.cost, solution.cost_scale)
        if best is None or solution.status in ENDED or unbounded:
            best = solution
        chatters = solution.advice.endswith(CHATTERS)  # no other start would change that
        if solution.status in (*ENDED, Status.TOO_COARSE) or chatters or unbounded:
            break
    assert best is not None
    best = replace(best, attempts=tuple(attempts))
    if best.status not in ENDED and time.perf_counter() >= until:
        best = replace(best, advice=f"{best.advice} {NOT_ALL}")
    if best.status.solved and best.unsettled:
        status = Status.LOCAL_OPTIMUM
        best = replace(best, status=status, advice=f"{status.sentence} {best.several}")
    return best


def default_mesh(problem: OptimalControlProblem | Transcription) -> int:
    """Intervals of every phase: fewer where there are many."""
    phases = (problem.problem if isinstance(problem, Transcription) else problem).phases
    return max(FEWEST, round(2 * INTERVALS / max(len(phases), 2)))


# strategies ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Task:
    """What is to be solved, and the attempts so far."""

    problem: OptimalControlProblem | Transcription
    mesh: Meshes
    guess: Given
    settings: SolverSettings
    scheme: str | Scheme
    until: float
    progress: Progress | None
    attempts: list[Attempt] = field(default_factory=list)

    @property
    def alone(self) -> bool:
        """Whether a transcription or a solver was chosen: no other strategy is tried."""
        return isinstance(self.problem, Transcription) or self.settings.solver != "auto"

    @property
    def few(self) -> SolverSettings:
        """Settings of a try that may be followed by another."""
        own = self.settings
        if self.alone:
            return own
        return replace(own, solver="ipopt", max_iterations=min(FIRST, own.max_iterations))

    def transcribed(self, scaling: str) -> Transcription:
        settings = replace(self.settings, scaling=scaling)
        return transcribed(self.problem, settings, scheme=self.scheme, guess=self.guess)


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
    coarser = round(COARSER * default_mesh(task.problem))
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
    how = task.few, COMPARED[0], task.until, task.progress
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
    for guess in guesses[:SIMULATIONS]:
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


def solutions(
    problem: OptimalControlProblem | Transcription,
    mesh: Meshes,
    guess: Given,
    settings: SolverSettings,
    scheme: str | Scheme,
    until: float,
    progress: Progress | None,
    compared: int = COMPARED[0],
) -> Iterator[tuple[Solution, Transcription]]:
    """Solutions of all strategies that converge, each with its program; of the first if none does.

    Each is compared with what a number of other starts lead to.
    """
    task = _Task(problem, mesh, guess, settings, scheme, until, progress)
    alone, converged = task.alone, False
    first: tuple[Solution, Transcription] | None = None
    refused: InputError | None = None
    for strategy in STRATEGIES[: 1 if alone else None]:
        if first is not None and time.perf_counter() >= until:
            break
        try:
            found = _first_that_ends(task, strategy)
        except NotFinite as problem_met:
            if alone or guess is not None:
                raise
            refused = refused or problem_met
            continue
        if found is None:
            continue
        made, (transcription, _, own) = found
        first = first or (made, transcription)
        if made.status not in ENDED:
            continue
        if not alone and made.status in CONVERGED:
            if not isinstance(guess, Solution):  # what was compared when it was found
                how = own, compared, until, progress, guess
                made, tried = cheaper_elsewhere(made, transcription, *how)
                task.attempts.extend(tried)
                if tried:  # another valley, of other sizes
                    made, transcription, tried = _in_own_scales(made, task, transcription, own)
                    task.attempts.extend(tried)
            made, tried = improved(made, transcription, own, until, progress)
            task.attempts.extend(tried)
        converged = True
        yield _told(made, transcription, task.attempts, strategy.name)
        task.attempts.clear()
        if made.status is Status.INTERRUPTED:
            return
    if converged:
        return
    if first is None:
        assert refused is not None
        raise refused
    yield _told(*first, task.attempts, "")


def _first_that_ends(task: _Task, strategy: Strategy) -> tuple[Solution, Start] | None:
    """The first solution of a strategy that converges, or its last; None where there is none."""
    found: tuple[Solution, Start] | None = None
    before = len(task.attempts)
    for transcription, guess, settings in strategy.propose(task):
        name = f"{strategy.name}, first"
        task.attempts[before:] = [replace(a, way=name) for a in task.attempts[before:]]
        how = settings, task.until, task.progress
        uneven = not (
            task.alone or strategy.name
        )  # where scales are wrong it is far from the guess
        made = solve_on(transcription, task.mesh, guess, *how, uneven=uneven)
        tried, more = made.attempts, []
        if not task.alone:
            made, transcription, more = _in_own_scales(made, task, transcription, settings)
        task.attempts.extend(replace(a, way=a.way or strategy.name) for a in (*tried, *more))
        before = len(task.attempts)
        found = made, (transcription, guess, settings)
        if made.status in ENDED:
            break
    return found


def _in_own_scales(
    solution: Solution, task: _Task, before: Transcription, settings: SolverSettings
) -> tuple[Solution, Transcription, list[Attempt]]:
    """The solution, solved again with scales of its own where these are far from what was guessed.

    With what was tried. What is small beside its scale is not accurate, and a cost of such a scale
    seems to be settled; what is far larger may be on its way to a slope at infinity.
    """
    if settings.scaling != "auto" or solution.status not in CONVERGED:
        return solution, before, []
    after = replace(task, guess=solution).transcribed("auto")
    if not any(
        np.any(np.abs(np.log(np.asarray(old.scale) / new.scale)) >= np.log(POOR))
        for k, own in enumerate(before.problem.phases)
        for kind in ("states", "controls")
        for old, new in zip(getattr(own, kind), getattr(after.problem.phases[k], kind), strict=True)
    ):
        return solution, before, []
    again = solve_on(after, task.mesh, solution, settings, task.until, task.progress)
    tried = [replace(a, way="with the scales of the first answer") for a in again.attempts]
    dearer = again.cost - solution.cost > UNMET * cost_size(again.cost, solution.cost_scale)
    if again.status not in CONVERGED or dearer:
        return solution, before, tried
    return again.with_rivals_of(solution), after, tried


def _told(
    solution: Solution, transcription: Transcription, attempts: list[Attempt], said: str
) -> tuple[Solution, Transcription]:
    """A solution with all attempts that led to it, and the way that it was found in."""
    advice = solution.advice
    if solution.status.solved and said:
        advice = f"{advice} The first try failed; this was found {said}."
    if solution.status.solved and solution.rivals:
        advice = f"{advice} {solution.several}"
    return replace(solution, attempts=tuple(attempts), advice=advice), transcription


# acceptance ---------------------------------------------------------------------------------------


def _judged(
    solution: Solution,
    transcription: Transcription,
    settings: SolverSettings,
    until: float,
    progress: Progress | None,
    *,
    finer: bool,
) -> Solution:
    """The solution with the status that its judgement gives it.

    With ``finer`` on meshes so fine that it passes and its cost does not change any more. Where it
    is at a saddle the solve goes on below it.
    """
    if solution.status not in CONVERGED:
        return solution
    alone = settings.solver != "auto"
    own = settings if alone else replace(settings, solver="ipopt")
    own = replace(own, max_iterations=min(FIRST, own.max_iterations))
    way = _ToSolved(solution, judge(transcription, solution), transcription, own, until, progress)
    for _ in range(ROUNDS):
        over = time.perf_counter() >= until
        saddle = way.judgement.status is Status.SADDLE and not (alone or over)
        if not (way.below() if saddle else finer and not over and way.finer()):
            break
    if way.solution.status not in CONVERGED:
        return replace(way.solution, attempts=tuple(way.attempts))
    more = improvable(way.solution) if finer else 0.0
    if not alone and more > ACCURACY:
        more = way.improve(settings)
    solution = replace(way.solution, attempts=tuple(way.attempts))
    return _with_status(solution, way.judgement, way.left, more, until, finer=finer)


class _ToSolved:
    """A solution on its way to one that passes, with its judgement and all that was tried."""

    def __init__(
        self,
        solution: Solution,
        judgement: Judgement,
        transcription: Transcription,
        settings: SolverSettings,
        until: float,
        progress: Progress | None,
    ) -> None:
        self.solution, self.judgement, self.transcription = solution, judgement, transcription
        self.how = settings, until, progress
        self.attempts, self.left = list(solution.attempts), _Left()

    def below(self) -> bool:
        """Go on below a saddle; False where nothing is there, or where the cost falls for ever."""
        found, tried = _below(self.solution, self.judgement, self.transcription, *self.how)
        self.attempts += tried
        if found is None:
            return False
        self.solution, self.left = found.with_rivals_of(self.solution), _Left()
        if found.status not in CONVERGED:
            return False
        self.judgement = judge(self.transcription, self.solution)
        return True

    def finer(self) -> bool:
        """Go on on a finer mesh; False where none is needed or there is none."""
        before = self.solution
        coarse = any(k.status is Status.TOO_COARSE for k in self.judgement.failures)
        settled = self.left.estimate <= ACCURACY
        if settled and not coarse:
            return False
        meshes = _finer(before, self.judgement, whole=not settled)
        if _intervals(meshes) > MOST_INTERVALS:
            meshes = _finer(before, self.judgement, whole=False)
        fewest = _intervals([phase.mesh for phase in before.phases])
        if not fewest < _intervals(meshes) <= MOST_INTERVALS:
            return False
        made = solve_on(self.transcription, meshes, before, *self.how)
        self.attempts += [replace(a, way="on a finer mesh") for a in made.attempts]
        if made.status not in CONVERGED:
            return False
        size = max(cost_size(k.cost, made.cost_scale) for k in (made, before))
        self.left.enter(abs(made.cost - before.cost) / size)
        advice = made.advice if made.status is Status.GAP_LEFT else before.advice
        self.solution = replace(made, advice=advice).with_rivals_of(before)
        self.judgement = judge(self.transcription, self.solution)
        return True

    def improve(self, settings: SolverSettings) -> float:
        """Go on with better controls, and return what others would save still."""
        _, until, progress = self.how
        better, tried = improved(self.solution, self.transcription, settings, until, progress)
        self.attempts += tried
        if better is not self.solution:
            self.solution, self.judgement = better, judge(self.transcription, better)
        return improvable(better)


def _intervals(meshes: Sequence[FloatArray]) -> int:
    return sum(mesh.size - 1 for mesh in meshes)


def _with_status(
    solution: Solution,
    judgement: Judgement,
    left: _Left,
    more: float,
    until: float,
    *,
    finer: bool,
) -> Solution:
    """The solution with a status, and advice that says what is missing."""
    missing = [failure.sentence for failure in judgement.failures]
    settled = not finer or left.estimate <= SETTLED * ACCURACY
    if not settled:
        change = f"by {left.change:.1g} of itself" if np.isfinite(left.change) else "unknown"
        missing.append(f"what the cost changes from mesh to mesh: {change}")
    if not missing and more > SETTLED * ACCURACY:
        said = (
            f"Other controls would save {more:.1g} of the cost, but no solve from there does: "
            f"{CHATTERS}"
        )
        if more <= UNMET:
            return replace(solution, advice=f"{solution.advice} {said}")
        said = f"{Status.NO_PROGRESS.sentence} {said}"
        return replace(solution, status=Status.NO_PROGRESS, advice=said)
    status = judgement.status
    if not missing or (status is solution.status and settled):
        return solution
    if finer and status in (Status.SOLVED, Status.TOO_COARSE):
        over = time.perf_counter() >= until
        status = Status.TIME_LIMIT if over else Status.NO_PROGRESS
    return replace(solution, status=status, advice=f"{status.sentence} Missing: {missing[0]}.")


def _below(
    solution: Solution,
    judgement: Judgement,
    transcription: Transcription,
    settings: SolverSettings,
    until: float,
    progress: Progress | None,
) -> tuple[Solution | None, list[Attempt]]:
    """The cheaper of what solves lead to on both sides of a saddle; None where none is below it.

    Where the cost falls for ever on one side that is what it is, though it did not converge.
    """
    assert judgement.curvature is not None
    direction, x = judgement.curvature.direction, solution.variables
    assert direction is not None
    assert x is not None
    step = BESIDE / np.abs(direction).max() * direction
    worth = Thresholds().gap * cost_size(solution.cost, solution.cost_scale)
    best: Solution | None = None
    attempts: list[Attempt] = []
    meshes = [phase.mesh for phase in solution.phases]
    for start in (x + step, x - step):
        beside = replace(solution, variables=start, variable_multipliers=None)
        made = solve_on(transcription, meshes, beside, settings, until, progress)
        attempts += [replace(a, way="from beside a saddle") for a in made.attempts]
        if falls_for_ever(made.cost, made.cost_scale):
            return made, attempts
        least = solution.cost - worth if best is None else best.cost
        if made.status in CONVERGED and made.cost < least:
            best = made
    return best, attempts


def swings(problem: OptimalControlProblem | Transcription, solution: Solution) -> bool:
    """Whether controls have a value at every collocation point that nobody asked for.

    Not where others are known to be better, which is not looked for where controls are constant.
    """
    if isinstance(problem, Transcription) or improvable(solution) > SETTLED * ACCURACY:
        return False
    asked = {(p.name, c.name) for p in problem.phases for c in p.controls if c.shape != "auto"}
    return any(
        control.shape == "polynomial" and (phase.name, control.name) not in asked
        for phase in solution.phases
        for control in verification.phase_layout(phase).phase.controls
    )


def _with_steady_controls(
    problem: OptimalControlProblem | Transcription,
    before: Solution,
    settings: SolverSettings,
    scheme: str | Scheme,
    until: float,
    progress: Progress | None,
) -> Solution:
    """The solution with controls that are constant over every interval, where that passes.

    On a singular arc a control that is free at every collocation point may go to and fro between
    them, and owe a part of its cost to what the scheme does not see; where it jumps it exceeds
    limits between them.
    """
    assert isinstance(problem, OptimalControlProblem)
    other = with_shapes(problem, "constant")
    guess = refinement.resampled(before)
    transcription = transcribed(other, settings, scheme=scheme, guess=guess)
    own = replace(settings, solver="ipopt") if settings.solver == "auto" else settings
    first = solve_on(transcription, default_mesh(problem), guess, own, until, progress)
    made = _judged(first, transcription, settings, until, progress, finer=True)
    attempts = tuple(replace(a, way=a.way or STEADY) for a in made.attempts)
    attempts = (*before.attempts, *attempts)
    if not made.status.solved:
        return replace(before, attempts=attempts)
    advice = f"{made.advice} With other values at every point the cost does not settle: {STEADY}."
    return replace(made, attempts=attempts, advice=advice).with_rivals_of(before)


class _Left:
    """What the cost would still change by, seen from what it changed by from mesh to mesh."""

    def __init__(self) -> None:
        self.change, self.ratios = np.inf, (0.5, 0.0)

    def enter(self, change: float) -> None:
        if 0 < self.change < np.inf:
            ratio = float(np.clip(change / self.change, 0.1, 0.9))
            self.ratios = (ratio, self.ratios[0] if self.ratios[1] else 0.1)
        self.change = change

    @property
    def estimate(self) -> float:
        """The sum of all further changes, if they go on shrinking as they did."""
        ratio = max(self.ratios)  # one that happens to be small proves nothing
        return self.change * ratio / (1 - ratio)


def _finer(solution: Solution, judgement: Judgement, *, whole: bool) -> list[FloatArray]:
    """Intervals divided as their errors ask for; with ``whole`` every one in two, if that will do.

    Where limits are exceeded in between they are divided further: where a control jumps a state
    leaves its limit by the step times the jump, whatever the order of the scheme.
    """
    pairs = list(zip(solution.phases, judgement.errors, judgement.excess, strict=True))
    divided = []
    for phase, errors, _ in pairs:
        layout = verification.phase_layout(phase)
        orders = np.array([kind.scheme.order for kind in layout.kinds])[layout.kind_of]
        divided.append(refinement.divide(phase.mesh, errors, 1.0, orders))
        whole &= int(np.histogram(divided[-1][:-1], phase.mesh)[0].max()) <= 2
    if whole:
        divided = [np.union1d(p.mesh, (p.mesh[:-1] + p.mesh[1:]) / 2) for p, *_ in pairs]
    return [
        np.union1d(mesh, refinement.divide(phase.mesh, excess, 1.0, 0))
        for mesh, (phase, _, excess) in zip(divided, pairs, strict=True)
    ]
