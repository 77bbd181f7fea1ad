"""A mesh as fine as an accuracy asks for: divided, raised in degree, moved to the switches.

The accuracy is that of the dynamics: how near the control is to the optimal one is another matter.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from microbot_ocp import checks
from microbot_ocp.checks import FloatArray, InputError
from microbot_ocp.ocp.arcs import distance, hold, place_junctions
from microbot_ocp.ocp.hp import Degrees, decay_rates, degrees_on, refine_hp
from microbot_ocp.ocp.mesh import Mesh, Meshes
from microbot_ocp.ocp.mesh_error import divide, state_errors
from microbot_ocp.ocp.problem import OptimalControlProblem, node_variables
from microbot_ocp.ocp.progress import StepProgress, quiet
from microbot_ocp.ocp.refinement import Refiner
from microbot_ocp.ocp.reintegration import phase_layout
from microbot_ocp.ocp.schemes import Collocation, Scheme
from microbot_ocp.ocp.solution import PhaseSolution, Solution, Status
from microbot_ocp.ocp.solvers import SolverSettings, default_guess, transcribed
from microbot_ocp.ocp.switches import Switch, find_switches, move_to_switches
from microbot_ocp.ocp.transcription import Guess, Transcription

MOST_VAIN = 2  # solves with one phase an arc that may find nothing
PROGRESS = 0.9  # share of the former error that counts as an improvement
# A finer mesh meets constraints and dynamics that the coarser one cut short, and may honestly cost
# more by this share.
DEARER = 0.05

HEAD = (
    *("round", "intervals", "degree", "variables", "state error"),
    *("switch offset", "cost", "iterations", "time", ""),
)


class RefinementStatus(Enum):
    """How a refinement ended; the value is the explanation."""

    REACHED = "the requested accuracy is reached"
    NOT_SOLVED = "the first mesh was not solved: give a better guess or another mesh"
    NOT_ACCEPTED = (
        "a finer mesh was not solved, or only at a higher cost: the last accepted solution is "
        "returned"
    )
    NO_PROGRESS = (
        "the accuracy is not reached, and the last finer meshes came no nearer: lower the "
        "solver's tolerance or ask for less"
    )
    ROUND_LIMIT = "the accuracy is not reached within the allowed number of rounds"
    SIZE_LIMIT = "the accuracy is not reached within the allowed number of intervals"
    TIME_LIMIT = "the accuracy is not reached within the allowed time"
    INTERRUPTED = "interrupted: the last accepted solution is returned"

    @property
    def ok(self) -> bool:
        """Whether the accuracy is reached."""
        return self is RefinementStatus.REACHED


@dataclass(frozen=True, eq=False)
class RefinementStep:
    """One mesh of a refinement.

    Attributes
    ----------
    meshes : of every phase
    degrees : least and most degree of collocation, None for other schemes
    variables : of the program
    state_error : largest relative state error of any interval; infinite where nothing was solved
    switch_offset : largest distance of a switch from the mesh, as a fraction of its phase
    switches : of every phase
    cost, duration, status, accepted, iterations : of the solve
    wall_time : of solve and error estimate, s
    """

    meshes: tuple[Mesh, ...]
    degrees: tuple[int, int] | None
    variables: int
    state_error: float
    switch_offset: float
    switches: tuple[tuple[Switch, ...], ...]
    cost: float
    duration: float
    status: str
    accepted: bool
    iterations: int
    wall_time: float

    @property
    def intervals(self) -> tuple[int, ...]:
        """Number of intervals of every phase."""
        return tuple(mesh.intervals for mesh in self.meshes)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            **vars(self),
            "meshes": [mesh.as_dict() for mesh in self.meshes],
            "intervals": list(self.intervals),
            "switches": [[vars(switch) for switch in phase] for phase in self.switches],
        }


class History(tuple[RefinementStep, ...]):
    """Meshes of a refinement in turn; printed as a table."""

    __slots__ = ()

    def __str__(self) -> str:
        rows: list[tuple[str, ...]] = [HEAD]
        for number, step in enumerate(self):
            low, high = step.degrees or ("", "")
            rows.append(
                (
                    str(number),
                    " + ".join(map(str, step.intervals)),
                    f"{low}" if low == high else f"{low} to {high}",
                    str(step.variables),
                    f"{step.state_error:.1e}",
                    f"{step.switch_offset:.1e}",
                    f"{step.cost:.9g}",
                    str(step.iterations),
                    f"{step.wall_time:.2f} s",
                    "" if step.accepted else f"{step.status.replace('_', ' ')}, not accepted",
                )
            )
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return "\n".join(
            "  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)).rstrip()
            for row in rows
        )


@dataclass(frozen=True, eq=False)
class Refined:
    """A solution, the meshes that led to it, and whether its accuracy is the one asked for."""

    solution: Solution
    history: History
    status: RefinementStatus

    @property
    def advice(self) -> str:
        """The status in words."""
        return self.status.value

    def __str__(self) -> str:
        return f"{self.history}\n{self.advice}"


def solve_refined(
    problem: OptimalControlProblem | Transcription,
    accuracy: float = 1e-6,
    mesh: Meshes = 20,
    scheme: str | Scheme = "shooting",
    guess: Mapping[str, Guess] | Solution | None = None,
    settings: SolverSettings | None = None,
    *,
    degrees: tuple[int, int] | None = None,
    switch_accuracy: float = 1e-3,
    arcs: bool = True,
    rounds: int = 10,
    most_intervals: int = 2000,
    most_time: float = np.inf,
    progress: StepProgress = quiet,
) -> Refined:
    """Solve on finer and finer meshes until the state error is within an accuracy.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
        A transcription keeps its scheme; ``scheme`` is that of a problem.
    accuracy : float
        Relative state error of any interval that is accepted; see
        :func:`~microbot_ocp.ocp.mesh_error.state_errors`.
    mesh : int, Mesh, or one int, Mesh or array of fractions [N+1] a phase
        The first mesh.
    scheme : str or Scheme
    guess : mapping from phase name to Guess, or Solution, optional
    settings : SolverSettings, optional
        The tolerance becomes a tenth of the accuracy if it is more.
    degrees : (least, most), optional
        Of collocation: the degree is raised where the solution is smooth, intervals are divided
        where it is not (hp). Default: intervals are divided, the degree stays.
    switch_accuracy : float
        Distance of a switch from the mesh that is accepted, as a fraction of its phase.
    arcs : bool
        Whether the problem may be solved with one phase an arc, too, to find where its arcs meet:
        see :func:`~microbot_ocp.ocp.arcs.place_junctions`. Default: it may.
    rounds : int
        Most finer meshes.
    most_intervals : int
        Of all phases together.
    most_time : float
        Wall time after which no other mesh is begun, s.
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
    >>> refined.status.name, round(refined.solution.cost, 4)
    ('REACHED', 2.0)
    """
    accuracy = checks.number("accuracy", accuracy, above=0.0)
    switch_accuracy = checks.number("switch_accuracy", switch_accuracy, above=0.0)
    if not most_time > 0:
        raise InputError(f"most_time must be above 0 s, not {most_time}")
    settings = settings or SolverSettings()
    transcription = transcribed(problem, settings, scheme=scheme, guess=guess)
    settings = replace(settings, tolerance=min(settings.tolerance, max(accuracy / 10, 1e-10)))
    refiner = Refiner(
        transcription,
        guess_from=resampled,
        excess=state_errors,
        violation=accuracy,
        solver=settings.solver,
        tolerance=settings.tolerance,
        progress=progress,
        settings=settings,
        worse=DEARER,
    )
    goal = _Goal(accuracy, switch_accuracy, None if degrees is None else Degrees(*degrees))
    limits = _Limits(rounds, most_intervals, time.perf_counter() + most_time, arcs)
    return _Refinement(refiner, goal, limits).run(mesh, guess)


@dataclass(frozen=True)
class _Goal:
    accuracy: float
    switch_accuracy: float
    degrees: Degrees | None

    def met(self, step: RefinementStep) -> bool:
        """Whether a mesh is good enough."""
        return step.state_error <= self.accuracy and step.switch_offset <= self.switch_accuracy

    def next_mesh(
        self,
        phase: PhaseSolution,
        errors: FloatArray,
        switches: Sequence[Switch],
        places: FloatArray | None,
    ) -> Mesh:
        """A mesh for a phase that comes nearer."""
        layout = phase_layout(phase)
        if self.degrees is None:
            orders = np.array([kind.scheme.order for kind in layout.kinds])[layout.kind_of]
            finer = Mesh(divide(phase.mesh, errors, self.accuracy, orders))
        else:
            finer = refine_hp(
                layout.chosen, errors, decay_rates(phase), self.accuracy, self.degrees
            )
        if places is not None:
            moved = hold(finer.fractions, places, self.switch_accuracy)
        else:
            moved = move_to_switches(finer.fractions, switches, self.switch_accuracy)
        if self.degrees is not None:
            return Mesh(moved, degrees_on(moved, finer))
        if layout.degrees is not None:
            return Mesh(moved, degrees_on(moved, layout.chosen))
        return Mesh(moved)


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
        self.places: list[FloatArray] | None = None  # where arcs meet, once it is known
        self.vain = 0  # solves with one phase an arc that found nothing
        self.history: list[RefinementStep] = []
        self.started = time.perf_counter()

    def run(self, mesh: Meshes, guess: Mapping[str, Guess] | Solution | None) -> Refined:
        transcription = self.refiner.transcription
        if self.goal.degrees is not None:
            mesh = _with_degrees(transcription, mesh, self.goal.degrees)
        start = guess or default_guess(transcription.problem)
        first = self.refiner.solve(mesh, start)
        status = RefinementStatus.INTERRUPTED
        self.best = first
        if first.status is not Status.INTERRUPTED:
            with contextlib.suppress(KeyboardInterrupt):
                self._enter(first, first.status.ok)
                status = RefinementStatus.NOT_SOLVED if not first.status.ok else self._rounds()
        return Refined(self.best, History(self.history), status)

    def _rounds(self) -> RefinementStatus:
        for done in range(self.limits.rounds + 1):
            assert self.best is not None
            step = self._placed()
            if self.goal.met(step):
                return RefinementStatus.REACHED
            if done == self.limits.rounds:
                break
            if _stalled(self.history):
                return RefinementStatus.NO_PROGRESS
            if time.perf_counter() > self.limits.until:
                return RefinementStatus.TIME_LIMIT
            meshes = [
                self.goal.next_mesh(phase, errors, switches, places)
                for phase, errors, switches, places in zip(
                    self.best.phases,
                    self.errors,
                    step.switches,
                    self.places or [None] * len(self.best.phases),
                    strict=True,
                )
            ]
            if sum(m.intervals for m in meshes) > self.limits.intervals:
                return RefinementStatus.SIZE_LIMIT
            finer = self.refiner.finer(self.best, meshes)
            if finer is self.best:
                last = self.refiner.last
                if last is not None and last is not self.best:
                    self._enter(last, False)
                    if last.status is Status.INTERRUPTED:
                        return RefinementStatus.INTERRUPTED
                return RefinementStatus.NOT_ACCEPTED
            self._enter(finer, True)
        return RefinementStatus.ROUND_LIMIT

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
        solved = made.status.ok
        errors = state_errors(made) if solved else [np.array([np.inf])]
        step = _step(made, errors, accepted, time.perf_counter() - self.started)
        if accepted:
            self.best, self.errors = made, errors
        self.history.append(step)
        self.started = time.perf_counter()
        self.refiner.progress(
            f"mesh {' + '.join(map(str, step.intervals))}: state error {step.state_error:.2g}, "
            f"cost {step.cost:.8g}"
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
    """Whether the last two meshes improved neither the state error nor the switches."""
    if len(history) < 3:
        return False
    before, *later = history[-3:]
    return all(
        step.state_error > PROGRESS * before.state_error
        and step.switch_offset >= PROGRESS * before.switch_offset
        for step in later
    )


def _step(
    solution: Solution, errors: Sequence[FloatArray], accepted: bool, wall_time: float
) -> RefinementStep:
    layouts = [phase_layout(phase) for phase in solution.phases]
    switches = tuple(find_switches(phase) for phase in solution.phases)
    used = [
        kind.scheme.degree
        for layout in layouts
        for kind in layout.kinds
        if isinstance(kind.scheme, Collocation)
    ]
    return RefinementStep(
        meshes=tuple(layout.chosen for layout in layouts),
        degrees=(min(used), max(used)) if used else None,
        variables=sum(layout.variable_count for layout in layouts),
        state_error=max(float(own.max()) for own in errors),
        switch_offset=max((s.offset for own in switches for s in own), default=0.0),
        switches=switches,
        cost=solution.cost,
        duration=solution.duration,
        status=solution.status.name.lower(),
        accepted=accepted,
        iterations=sum(attempt.iterations for attempt in solution.attempts),
        wall_time=wall_time,
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
