"""Solve a problem as it was declared; what fails is tried in other ways, and the mesh made finer.

A solve that does not converge says little about the problem: it may have begun badly or with bad
scales. So it is tried again, from a simulation, with the scales that were declared, with other
durations, from a coarse mesh. The solution says which way it was.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp.ocp import refinement, verification
from microbot_ocp.ocp.diagnosis import NotFinite
from microbot_ocp.ocp.problem import OptimalControlProblem, with_shapes
from microbot_ocp.ocp.solution import (
    Attempt,
    Progress,
    Rollouts,
    Solution,
    completed,
    default_guess,
    rollout,
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
from microbot_ocp.ocp.solvers._smoothing import smoothed
from microbot_ocp.ocp.transcription import Guess, Meshes, Transcription
from microbot_ocp.ocp.transcription.schemes import Scheme

Given = Mapping[str, Guess] | Solution | str | None

INTERVALS = 50  # of a problem of one or two phases
FEWEST = 10  # of every phase of a problem of many
COARSER = 0.4  # of these intervals, from which a solve may converge sooner
FAR_SMALLER = 1e3  # scales of an answer than those that were guessed: it is solved again
COARSE = 8  # intervals a phase of a first look
FIRST = 400  # iterations of the first try: what takes more converges sooner in another way
SHARE = 0.35  # of the time that is left, which one way may take
SHARE_FINER = 0.5  # the same of a finer mesh
SIMULATED = 4  # simulations that a problem is solved from
COMPARED = (12, 4)  # other starts that an answer is compared with, on any mesh and on a given one
ANY_DURATION = 2  # simulations of those of all durations that a problem is solved from
LONGER = (3.0, 0.3, 10.0)  # other durations, where they are free
CONVERGED = (Status.SOLVED, Status.GAP_LEFT)
ENDED = (*CONVERGED, Status.INTERRUPTED)

STEADY = "with controls that are constant over every interval"
CHATTERS = "the optimum may be approached by controls that jump to and fro ever faster."
ACCURACY = 1e-4  # relative: local errors of the state, change of the cost from mesh to mesh
ROUGH = 1e-2  # local error of the state above which an answer is none
SETTLED = 5.0  # times the accuracy: what is left of the cost's change at which it has settled
UNMET = 1e-2  # share of the cost: where no solve saves it what is more is missed, less is said
ROUNDS = 14
MOST_PIECES = 10  # into which an interval is divided at once
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
        the cost changes by less than 1e-4 of itself; what does not settle is not solved. On a mesh
        that is given, a solution whose states are wrong by more than 1 % within an interval has the
        status TOO_COARSE.
    guess : mapping from phase name to Guess, Solution or "rollout", optional
        What is left out of it starts from :func:`~microbot_ocp.ocp.solution.default_guess`. A
        solution may be of another mesh or of other phases; with the same phases its multipliers are
        used as well. "rollout" simulates with a constant control.
    settings : SolverSettings, optional
        Where they name a solver that one is tried, and in one way only.
    scheme : str or Scheme
        Of a problem that is not transcribed yet: "shooting", "radau", "gauss", "trapezoidal",
        "hermite_simpson", or one with settings.
    time_limit : float
        Wall time after which it is stopped, s.
    progress : callable, optional
        Called with an :class:`~microbot_ocp.ocp.solution.Iteration` at every iteration. It may
        raise KeyboardInterrupt to stop the solve.

    Returns
    -------
    Solution
        Also where no solver converged: look at ``status``. Its ``attempts`` are all that was tried,
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
    found = solutions(problem, chosen, guess, settings, scheme, until, progress, most)
    for solution, transcription in found:
        if mesh is None:
            solution = _on_finer_meshes(solution, transcription, settings, until, progress)
            if solution.status is Status.NO_PROGRESS and swings(problem, solution):
                how = settings, scheme, until, progress
                solution = _with_steady_controls(problem, solution, *how)
        else:
            solution = _checked(solution)
        attempts += solution.attempts
        if best is None or solution.status in ENDED:
            best = solution
        chatters = solution.advice.endswith(CHATTERS)  # no other start would change that
        if solution.status in ENDED or chatters or mesh is not None or time.perf_counter() >= until:
            break
    assert best is not None
    best = replace(best, attempts=tuple(attempts))
    if best.status.solved and best.unsettled:
        status = Status.LOCAL_OPTIMUM
        best = replace(best, status=status, advice=f"{status.sentence} {best.several}")
    return best


def default_mesh(problem: OptimalControlProblem | Transcription) -> int:
    """Intervals of every phase: fewer where there are many."""
    phases = (problem.problem if isinstance(problem, Transcription) else problem).phases
    return max(FEWEST, round(2 * INTERVALS / max(len(phases), 2)))


# other ways ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Way:
    """Another way to solve a problem, in words that follow "found"."""

    said: str
    guess: Given | tuple[dict[str, Guess], ...]  # of several the one that ends at the least cost
    scaling: str
    coarse: int = 0  # intervals a phase of a first solve
    smooth: bool = False  # from solves in which large controls cost
    many: bool = False  # from the cheapest of many starts on a coarse mesh


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
    """Solutions of all ways that converge, each with its program; of the first if none does.

    Each is compared with what a number of other starts lead to.
    """
    ways: Iterator[_Way] = iter([_Way("", guess, settings.scaling)])
    attempts: list[Attempt] = []
    first: tuple[Solution, Transcription] | None = None
    refused: InputError | None = None
    told = False
    alone = isinstance(problem, Transcription) or settings.solver != "auto"
    while (way := next(ways, None)) is not None:
        # what helps fatrop is seen in the first way
        solver = "ipopt" if way.said and settings.solver == "auto" else settings.solver
        own = replace(settings, scaling=way.scaling, solver=solver)
        if not way.said and not alone:
            own = replace(own, max_iterations=min(FIRST, own.max_iterations))
        now = time.perf_counter()
        share = until if alone or not np.isfinite(until) else now + SHARE * (until - now)
        best: tuple[Solution, Transcription] | None = None
        for given in way.guess if isinstance(way.guess, tuple) else (way.guess,):
            try:
                transcription = transcribed(problem, own, scheme=scheme, guess=given)
                if way.smooth:
                    given, tried = smoothed(transcription, mesh, given, own, share, progress)
                    attempts += [replace(a, way=f"{way.said}, first") for a in tried]
                    if given is None:
                        continue
                if way.many:
                    most = COMPARED[0]
                    given, tried = cheapest_of_starts(transcription, own, most, share, progress)
                    attempts += tried
                    if given is None:
                        continue
                if way.coarse:
                    given = on_any_mesh(given, transcription.problem)
                    given = solve_on(transcription, way.coarse, given, own, share, progress)
                    attempts += [replace(a, way=f"{way.said}, coarse") for a in given.attempts]
                    if given.status not in ENDED:
                        continue
                made = solve_on(transcription, mesh, given, own, share, progress)
                if not alone and way.scaling == "auto" and made.status in CONVERGED:
                    how = own, scheme, share, progress
                    made, transcription = _in_own_scales(made, problem, transcription, mesh, *how)
            except NotFinite as problem_met:
                if alone or guess is not None:
                    raise
                refused = refused or problem_met
                continue
            attempts += [replace(a, way=a.way or way.said) for a in made.attempts]
            first = first or (made, transcription)
            if made.status in ENDED and (best is None or made.cost < best[0].cost):
                best = made, transcription
            if made.status is Status.INTERRUPTED or time.perf_counter() >= share:
                break
        if best is not None and not alone and best[0].status in CONVERGED:
            better, found = best[0], []
            if not isinstance(guess, Solution):  # what was compared when it was found
                better, found = cheaper_elsewhere(*best, own, compared, share, progress, guess)
            better, tried = improved(better, best[1], own, share, progress)
            best, attempts = (better, best[1]), attempts + found + tried
        if best is not None:
            told = True
            yield _told(*best, attempts, way.said)
            attempts = []
            if best[0].status is Status.INTERRUPTED:
                return
        if alone or time.perf_counter() >= until:
            break
        if not way.said and not isinstance(problem, Transcription):
            ways = _other_ways(problem, mesh, guess, settings)
    if told:
        return
    if first is None:
        assert refused is not None
        raise refused
    yield _told(*first, attempts, "")


def _in_own_scales(
    solution: Solution,
    problem: OptimalControlProblem | Transcription,
    before: Transcription,
    mesh: Meshes,
    settings: SolverSettings,
    scheme: str | Scheme,
    until: float,
    progress: Progress | None,
) -> tuple[Solution, Transcription]:
    """The solution, solved again with scales of its own where it is far smaller than was guessed.

    What is small beside its scale is not accurate, and a cost of such a scale seems to be settled.
    """
    after = transcribed(problem, settings, scheme=scheme, guess=solution)
    if not any(
        np.any(np.asarray(old.scale) >= FAR_SMALLER * np.asarray(new.scale))
        for k, own in enumerate(before.problem.phases)
        for kind in ("states", "controls")
        for old, new in zip(getattr(own, kind), getattr(after.problem.phases[k], kind), strict=True)
    ):
        return solution, before
    again = solve_on(after, mesh, solution, settings, until, progress)
    attempts = tuple(replace(a, way="with the scales of the first answer") for a in again.attempts)
    return replace(again, attempts=solution.attempts + attempts), after


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


def _other_ways(
    problem: OptimalControlProblem, mesh: Meshes, guess: Given, settings: SolverSettings
) -> Iterator[_Way]:
    auto = settings.scaling
    coarser = round(COARSER * default_mesh(problem))
    if not isinstance(mesh, int) or mesh > coarser:
        yield _Way(f"from a mesh of {coarser} intervals", guess, auto, coarse=coarser)
    yield _Way("from the cheapest of several starts on a coarse mesh", guess, auto, many=True)
    simulated: Given = None
    if guess is None:
        found = rollouts(problem, default_guess(problem))
        simulated = found[0]
        yield _Way("from a simulation with constant controls", tuple(found[:SIMULATED]), auto)
    if auto != "declared":
        yield _Way("with the declared scales", guess, "declared")
    yield _Way("from solves in which controls cost", guess, auto, smooth=True)
    yield _Way("from a coarse mesh", guess, auto, coarse=COARSE)
    free = any(low < high for low, high in (p.duration_bounds for p in problem.phases))
    if free and guess is None:
        found = Rollouts(problem, default_guess(problem)).of_any_duration()
        yield _Way("from the simulation that ends nearest", tuple(found[:ANY_DURATION]), auto)
    if free and not isinstance(guess, Solution):
        ordinary = completed(problem, guess)
        for factor in LONGER:
            durations = {
                p.name: float(
                    np.clip(factor * (ordinary[p.name].duration or 1.0), *p.duration_bounds)
                )
                for p in problem.phases
            }
            said = f"from {factor:g} times the duration"
            longer = {k: Guess(durations[k], g.values) for k, g in ordinary.items()}
            yield _Way(said, longer, auto)
            if guess is None:
                longer = rollout(problem, default_guess(problem), durations)
                yield _Way(f"{said}, simulated", longer, auto)
    if simulated is not None and auto != "declared":
        said = "from a simulation with constant controls, with the declared scales"
        yield _Way(said, simulated, "declared")
    if simulated is not None:
        yield _Way("from a simulation on a coarse mesh", simulated, auto, coarse=COARSE)
    if settings.max_iterations > FIRST:
        yield _Way("with more iterations", guess, auto)


# finer meshes -------------------------------------------------------------------------------------


def _on_finer_meshes(
    solution: Solution,
    transcription: Transcription,
    settings: SolverSettings,
    until: float,
    progress: Progress | None,
) -> Solution:
    """The solution on meshes so fine that its cost does not change any more."""
    if solution.status not in CONVERGED:
        return solution
    alone = settings.solver != "auto"
    attempts, left, worst = list(solution.attempts), _Left(), np.inf
    warm = replace(settings, solver="ipopt") if settings.solver == "auto" else settings
    for done in range(ROUNDS + 1):
        errors = _errors(solution)
        worst = max(float(e.max()) for e in errors)
        if done == ROUNDS or (left.estimate <= ACCURACY and worst <= ROUGH):
            break
        meshes = _finer(solution, errors)
        if sum(m.size - 1 for m in meshes) > MOST_INTERVALS or time.perf_counter() > until:
            break
        now = time.perf_counter()
        share = until if not np.isfinite(until) else now + SHARE_FINER * (until - now)
        finer = solve_on(transcription, meshes, solution, warm, share, progress)
        attempts += [replace(a, way="on a finer mesh") for a in finer.attempts]
        if finer.status not in CONVERGED:
            break
        size = max(abs(finer.cost), abs(solution.cost), 1e-3 * finer.cost_scale)
        left.enter(abs(finer.cost - solution.cost) / size)
        advice = finer.advice if finer.status is Status.GAP_LEFT else solution.advice
        solution = replace(finer, advice=advice).with_rivals_of(solution)
    more = improvable(solution)
    if not alone and more > ACCURACY:
        solution, tried = improved(solution, transcription, settings, until, progress)
        attempts, more = attempts + tried, improvable(solution)
    solution = replace(solution, attempts=tuple(attempts))
    settled = left.estimate <= SETTLED * ACCURACY and worst <= ROUGH
    if settled and more <= SETTLED * ACCURACY:
        return solution
    said = (
        f"On the last meshes the cost still changed by {left.change:.1g} of itself; within an "
        f"interval states are wrong, or limits exceeded, by {worst:.1g} of their sizes: call "
        f"solve_refined."
    )
    if settled:
        said = (
            f"Other controls would save {more:.1g} of the cost, but no solve from there does: "
            f"{CHATTERS}"
        )
    if settled and more <= UNMET:
        return replace(solution, advice=f"{solution.advice} {said}")
    said = f"{Status.NO_PROGRESS.sentence} {said}"
    return replace(solution, status=Status.NO_PROGRESS, advice=said)


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
    """The solution with controls that are constant over every interval, where its cost settles.

    On a singular arc a control that is free at every collocation point may go to and fro between
    them, and owe a part of its cost to what the scheme does not see.
    """
    assert isinstance(problem, OptimalControlProblem)
    attempts = before.attempts
    now = time.perf_counter()
    until = until if not np.isfinite(until) else now + SHARE_FINER * (until - now)
    other = with_shapes(problem, "constant")
    guess = refinement.resampled(before)
    transcription = transcribed(other, settings, scheme=scheme, guess=guess)
    own = replace(settings, solver="ipopt") if settings.solver == "auto" else settings
    first = solve_on(transcription, default_mesh(problem), guess, own, until, progress)
    made = _on_finer_meshes(first, transcription, settings, until, progress)
    attempts += tuple(replace(a, way=a.way or STEADY) for a in made.attempts)
    if not made.status.solved:
        return replace(before, attempts=attempts)
    advice = f"{made.advice} With other values at every point the cost does not settle: {STEADY}."
    return replace(made, attempts=attempts, advice=advice).with_rivals_of(before)


def _checked(solution: Solution) -> Solution:
    """A solution on a mesh that was given, which may be too coarse for its dynamics."""
    if solution.status not in CONVERGED:
        return solution
    worst = max(float(e.max()) for e in refinement.state_errors(solution))
    if worst <= ROUGH:
        return solution
    said = (
        f"{Status.TOO_COARSE.sentence} Within an interval states are wrong by {worst:.1g} of their "
        f"sizes."
    )
    return replace(solution, status=Status.TOO_COARSE, advice=said)


def _errors(solution: Solution) -> list[FloatArray]:
    """Of every interval the larger of its state error and what it exceeds limits by in between.

    The latter counts less the shorter an interval is: where a control jumps it does not vanish.
    """
    found = []
    for phase, own in zip(solution.phases, refinement.state_errors(solution), strict=True):
        excess = verification.relative_excess(verification.dense_phase(phase)).max(axis=1)
        found.append(np.maximum(own, excess * np.minimum(1.0, INTERVALS * np.diff(phase.mesh))))
    return found


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


def _finer(solution: Solution, errors: list[FloatArray]) -> list[FloatArray]:
    """Every interval halved, or as the errors ask for where some are large.

    An interval is divided as the order of the scheme predicts, into ten at most; where nothing
    happens two become one.
    """
    meshes = []
    for phase, own in zip(solution.phases, errors, strict=True):
        assert phase.layout is not None
        orders = np.array([kind.scheme.order for kind in phase.layout.kinds])[phase.layout.kind_of]
        error = np.nan_to_num(own, nan=ROUGH, posinf=ROUGH)
        pieces = np.clip((2 * error / ACCURACY) ** (1 / (orders + 1)), 0.5, MOST_PIECES)
        count = int(np.ceil(pieces.sum()))
        if count < 1.5 * own.size and own.max() <= ROUGH:
            meshes.append(np.union1d(phase.mesh, (phase.mesh[:-1] + phase.mesh[1:]) / 2))
            continue
        filled = np.append(0.0, np.cumsum(pieces))
        mesh = np.interp(np.linspace(0.0, filled[-1], count + 1), filled, phase.mesh)
        mesh[[0, -1]] = 0.0, 1.0
        meshes.append(mesh)
    return meshes
