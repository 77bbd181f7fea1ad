"""A mesh as fine as an accuracy asks for: state error by re-integration, points at the switches.

The error of an interval is the difference between the next mesh state and what an adaptive
integrator arrives at from the interval's own mesh state with the solution's own control. A scheme
of order p makes local errors of order p + 1 in the step, which says into how many pieces an
interval has to be divided (Betts, *Practical Methods for Optimal Control*, 2nd ed., section 4.7;
the error there is a quadrature of the residual over the interval). Where a control jumps between
its bounds inside an interval, a mesh point is moved there.

The accuracy is that of the dynamics: how near the control is to the optimal one is another matter.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from microbot_ocp import checks
from microbot_ocp.checks import FloatArray
from microbot_ocp.ocp.mesh import Meshes
from microbot_ocp.ocp.problem import OptimalControlProblem, Variable, node_variables
from microbot_ocp.ocp.refinement import Progress, Refiner, quiet
from microbot_ocp.ocp.reintegration import (
    each_interval,
    mesh_states,
    phase_layout,
    point_values,
    state_weights,
)
from microbot_ocp.ocp.schemes import Collocation, Scheme
from microbot_ocp.ocp.solution import PhaseSolution, Solution
from microbot_ocp.ocp.solvers import SolverSettings, default_guess, transcribed
from microbot_ocp.ocp.transcription import Guess, Transcription

MOST_PIECES = 6  # into which an interval is divided at once: its error may be estimated badly
SAFETY = 0.5  # share of the accuracy that the divided intervals aim at
AT_BOUND = 1e-3  # of a control's range: nearer to a bound it counts as at it
# The end of a short ramp is worth so little that a barrier keeps it farther away.
RAMP_AT_BOUND = 1e-2
NEARLY_AT_BOUND = 0.2  # beyond a switch: an interval that holds a small rest of the other side
PROGRESS = 0.9  # share of the former error that counts as an improvement
LONGEST_RAMP = 3  # intervals between two bounds that still count as a switch
BRACKET = 0.1  # of the interval next to a switch: how near to it points are added
RAMP_LEFT = 0.125  # of a ramp's length, to each side of the switch, after its points are moved
# A finer mesh meets constraints and dynamics that the coarser one cut short, and may honestly cost
# more by this share.
DEARER = 0.05


@dataclass(frozen=True)
class Switch:
    """A jump of a control from one of its bounds to the other.

    Attributes
    ----------
    control, component : which
    place : where it would be if the control were exactly at its bounds on both sides, as a fraction
        of the phase: the time integral of the control over the ramp is kept
    begin, end : fractions between which the control is at neither bound
    rising : from the lower bound to the upper one
    continuous : whether the control cannot jump, but has a ramp
    offset : how far the mesh is from holding the switch, as a fraction of the phase: half of a
        ramp, or the distance to the nearest mesh point
    """

    control: str
    component: int
    place: float
    begin: float
    end: float
    rising: bool
    continuous: bool
    offset: float


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

    @property
    def ok(self) -> bool:
        """Whether the accuracy is reached."""
        return self is RefinementStatus.REACHED


@dataclass(frozen=True, eq=False)
class RefinementStep:
    """One mesh of a refinement.

    Attributes
    ----------
    meshes : fractions [N+1] of every phase
    state_error : largest relative state error of any interval
    switch_offset : largest distance of a switch from the mesh, as a fraction of its phase
    switches : of every phase
    cost, duration, status, accepted, iterations : of the solve
    wall_time : of solve and error estimate, s
    """

    meshes: tuple[FloatArray, ...]
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
        return tuple(mesh.size - 1 for mesh in self.meshes)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            **vars(self),
            "meshes": [mesh.tolist() for mesh in self.meshes],
            "intervals": list(self.intervals),
            "switches": [[vars(switch) for switch in phase] for phase in self.switches],
        }


@dataclass(frozen=True, eq=False)
class Refined:
    """A solution, the meshes that led to it, and whether its accuracy is the one asked for."""

    solution: Solution
    history: tuple[RefinementStep, ...]
    status: RefinementStatus

    @property
    def advice(self) -> str:
        """The status in words."""
        return self.status.value


def state_errors(solution: Solution) -> list[FloatArray]:
    """Relative state error of every interval: one array [N] a phase.

    ``max_i |x_i(t_k+1) - reached_i| / weight_i``, where reached is the integral of the dynamics
    from the mesh state at t_k and the weight is the largest magnitude of the state along the phase,
    or a hundredth of its scale if that is more. Infinite where the integrator fails.
    """
    errors = []
    for phase in solution.phases:
        arrived, _ = each_interval(phase)
        gap = np.abs(arrived - mesh_states(phase)[1:]) / state_weights(phase)
        errors.append(np.nan_to_num(gap.max(axis=1), nan=np.inf))
    return errors


def find_switches(phase: PhaseSolution) -> tuple[Switch, ...]:
    """Jumps of controls between their bounds.

    A control at the bound A up to ``a``, and at the other bound B from ``b`` on, would do the same
    on average with one jump at tau: ``A (tau - a) + B (b - tau) = integral of u from a to b``.
    """
    found = []
    for control in phase_layout(phase).phase.controls:
        values = _interval_values(phase, control)
        for i in range(control.size):
            if np.isfinite(control.lower[i] - control.upper[i]):
                found += _component_switches(phase.mesh, control, i, values)
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _IntervalValues:
    """Least, largest and mean value [N, size] of a control in every interval."""

    least: FloatArray
    largest: FloatArray
    mean: FloatArray


def _interval_values(phase: PhaseSolution, control: Variable) -> _IntervalValues:
    if control.shape == "linear":
        nodes = phase.values[control.name]
        values = np.stack([nodes[:-1], nodes[1:]])
        return _IntervalValues(values.min(axis=0), values.max(axis=0), values.mean(axis=0))
    layout = phase_layout(phase)
    least, largest, mean = (np.zeros((layout.intervals, control.size)) for _ in range(3))
    for group in layout.groups:
        values, own = point_values(phase, group, control), group.intervals
        least[own], largest[own] = values.min(axis=1), values.max(axis=1)
        scheme = group.kind.scheme
        if control.shape == "polynomial" and isinstance(scheme, Collocation):
            mean[own] = np.einsum("j,kji->ki", scheme.weights, values)
        else:
            mean[own] = values[:, 0]
    return _IntervalValues(least, largest, mean)


def _component_switches(
    mesh: FloatArray, control: Variable, component: int, values: _IntervalValues
) -> list[Switch]:
    low, high = float(control.lower[component]), float(control.upper[component])
    if low == high:
        return []
    continuous = control.shape == "linear"
    ends = values.least[:, component], values.largest[:, component]
    means = values.mean[:, component]
    tight = _at_bounds(*ends, low, high, RAMP_AT_BOUND if continuous else AT_BOUND)
    loose = _at_bounds(*ends, low, high, NEARLY_AT_BOUND)
    steps = np.diff(mesh)
    found = []
    for before, after in itertools.pairwise(np.flatnonzero(loose)):
        if loose[before] == loose[after]:
            continue
        # an interval that is only nearly at its bound holds a rest of the ramp
        first, last = before + bool(tight[before]), after - bool(tight[after])
        if last - first + 1 > LONGEST_RAMP:
            continue
        begin, end = float(mesh[first]), float(mesh[last + 1])
        one, other = (high, low) if loose[before] > 0 else (low, high)
        area = float(means[first : last + 1] @ steps[first : last + 1])
        place = float(np.clip((area - other * end + one * begin) / (one - other), begin, end))
        offset = (end - begin) / 2 if continuous else float(np.abs(mesh - place).min())
        found.append(
            Switch(control.name, component, place, begin, end, other > one, continuous, offset)
        )
    return found


def _at_bounds(
    least: FloatArray, largest: FloatArray, low: float, high: float, share: float
) -> np.ndarray:
    """1 for intervals [N] at the upper bound, -1 at the lower one, else 0."""
    near = share * (high - low)
    return (least >= high - near).astype(int) - (largest <= low + near).astype(int)


def divide(mesh: FloatArray, errors: FloatArray, accuracy: float, order: int) -> FloatArray:
    """Divide the intervals above the accuracy into the number of pieces that the order predicts.

    A local error e that goes with the power ``order + 1`` of the step comes below the goal with
    ``(e / goal)^(1 / (order + 1))`` pieces. The goal is half the accuracy: once a mesh is changed,
    its neighbours that were just good enough may not be any more.
    """
    if errors.max() <= accuracy:
        return mesh.copy()
    wanted = np.ceil((errors / (SAFETY * accuracy)) ** (1.0 / (order + 1)))
    pieces = np.clip(wanted, 1, MOST_PIECES).astype(int)
    parts = [
        np.linspace(a, b, n, endpoint=False)
        for a, b, n in zip(mesh[:-1], mesh[1:], pieces, strict=True)
    ]
    return np.append(np.concatenate(parts), mesh[-1])


def move_to_switches(mesh: FloatArray, switches: Sequence[Switch], accuracy: float) -> FloatArray:
    """Put mesh points where the controls switch.

    The nearest mesh point moves to the switch, unless it is an end of the phase or holds another
    switch already: then a point is added. Points on both sides keep the intervals at the switch
    short: in the one that holds the rest of it the multipliers belong to a switch in its middle. A
    ramp of a continuous control becomes shorter: points go to both sides of the switch, and what
    was inside the ramp is dropped.
    """
    points = mesh.copy()
    taken = [s.place for s in switches if not s.continuous and s.offset <= accuracy]
    for switch in switches:
        if switch.offset <= accuracy:
            continue
        if switch.continuous:
            reach = RAMP_LEFT * (switch.end - switch.begin)
            inside = (points > switch.begin) & (points < switch.end)
            fresh = [switch.place - reach, switch.place + reach]
            points = np.concatenate([points[~inside], [p for p in fresh if 0.0 < p < 1.0]])
        else:
            nearest = int(np.abs(points - switch.place).argmin())
            own = points[nearest]
            free = 0.0 < own < 1.0 and all(abs(own - t) > accuracy for t in taken)
            if free:
                points = np.delete(points, nearest)
            before = switch.place - points[points < switch.place - 1e-9].max()
            after = points[points > switch.place + 1e-9].min() - switch.place
            reach = BRACKET * min(before, after)
            sides = [switch.place - reach, switch.place + reach] if reach > accuracy else []
            points = np.concatenate([points, [switch.place], sides])
            taken.append(switch.place)
        points = np.sort(points)
    return points[np.concatenate([[True], np.diff(points) > 1e-9])]


def solve_refined(
    problem: OptimalControlProblem | Transcription,
    accuracy: float = 1e-6,
    mesh: Meshes = 20,
    scheme: str | Scheme = "shooting",
    guess: Mapping[str, Guess] | None = None,
    settings: SolverSettings | None = None,
    *,
    switch_accuracy: float = 1e-3,
    rounds: int = 10,
    most_intervals: int = 2000,
    progress: Progress = quiet,
) -> Refined:
    """Solve on finer and finer meshes until the state error is within an accuracy.

    Parameters
    ----------
    problem : OptimalControlProblem or Transcription
        A transcription keeps its scheme; ``scheme`` is that of a problem.
    accuracy : float
        Relative state error of any interval that is accepted; see :func:`state_errors`.
    mesh : int, Mesh, or one int, Mesh or array of fractions [N+1] a phase
        The first mesh.
    scheme : str or Scheme
    guess : mapping from phase name to Guess, optional
    settings : SolverSettings, optional
        The tolerance becomes a tenth of the accuracy if it is more.
    switch_accuracy : float
        Distance of a switch from the mesh that is accepted, as a fraction of its phase.
    rounds : int
        Most finer meshes.
    most_intervals : int
        Of all phases together.
    progress : callable
        Called with a line of text for every mesh.

    Returns
    -------
    Refined
        Also where the accuracy is not reached: look at ``status``.

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
    started = time.perf_counter()
    solution = refiner.solve(mesh, guess or default_guess(transcription.problem))
    history: list[RefinementStep] = []

    def enter(made: Solution, accepted: bool) -> tuple[list[FloatArray], RefinementStep]:
        nonlocal started
        errors = state_errors(made)
        step = _step(made, errors, accepted, time.perf_counter() - started)
        history.append(step)
        started = time.perf_counter()
        progress(
            f"mesh {' + '.join(map(str, step.intervals))}: state error {step.state_error:.2g}, "
            f"cost {step.cost:.8g}"
        )
        return errors, step

    errors, step = enter(solution, solution.status.ok)
    if not solution.status.ok:
        return Refined(solution, tuple(history), RefinementStatus.NOT_SOLVED)
    order = transcription.scheme.order
    status = RefinementStatus.ROUND_LIMIT
    for done in range(rounds + 1):
        if step.state_error <= accuracy and step.switch_offset <= switch_accuracy:
            status = RefinementStatus.REACHED
            break
        if done == rounds:
            break
        if _stalled(history):
            status = RefinementStatus.NO_PROGRESS
            break
        meshes = [
            move_to_switches(divide(phase.mesh, own, accuracy, order), switches, switch_accuracy)
            for phase, own, switches in zip(solution.phases, errors, step.switches, strict=True)
        ]
        if sum(m.size - 1 for m in meshes) > most_intervals:
            status = RefinementStatus.SIZE_LIMIT
            break
        finer = refiner.finer(solution, meshes)
        if finer is solution:
            status = RefinementStatus.NOT_ACCEPTED
            break
        solution = finer
        errors, step = enter(solution, True)
    return Refined(solution, tuple(history), status)


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
    switches = tuple(find_switches(phase) for phase in solution.phases)
    return RefinementStep(
        meshes=tuple(phase.mesh for phase in solution.phases),
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
