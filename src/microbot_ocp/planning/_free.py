"""Free time-optimal motions through via points: path and timing are both found.

Each segment between two via points is a phase (see ``_free_problem.py``); torque limits are kept by
the inverse dynamics, which needs no inverse of the mass matrix. Local optima are real: several
starts are tried, and a finer mesh whose optimum is worse than the coarse one is not accepted.

:func:`time_optimal` explores on a coarse mesh and refines the best; :class:`TimeOptimalSolver`
makes one task ready and solves it again and again, with limits and payload as numbers in it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.limits import LIMIT_TOLERANCE, JointLimits, LimitFamily, Limits
from microbot_ocp.motion import Mark, Motion
from microbot_ocp.ocp import ParametricSolver, Solution, SolverSettings
from microbot_ocp.ocp.refinement import WORSE, Refiner, split
from microbot_ocp.ocp.solution import StepProgress, quiet
from microbot_ocp.ocp.transcription import Guess
from microbot_ocp.planning._free_problem import (
    OF_VARIABLES,
    SMOOTHING,
    excess_between,
    motion_at_mesh,
    polynomial,
    transcription,
    via_times,
)
from microbot_ocp.planning._initial_guesses import guesses_along, initial_guesses
from microbot_ocp.planning._progress import with_motion
from microbot_ocp.planning._task import (
    check_limits,
    check_via,
    jerk_switches,
    provenance_of,
    verdict,
    whole,
    with_changes,
)
from microbot_ocp.robot import Robot

EXPLORE_MESH = 20  # intervals a phase for the first look at every start
EXPLORE_TOLERANCE = 1e-5
# of a prepared solver: somebody waits
PREPARED = SolverSettings("ipopt", tolerance=1e-6, gap=np.inf, max_iterations=150)


@dataclass(frozen=True)
class TimeOptimalSettings:
    """How hard to look.

    Attributes
    ----------
    mesh : intervals of each phase in the first full solve
    starts : how many starting motions to try on the coarse mesh
    limit_tolerance : largest relative excess of a limit between mesh points; the mesh is refined
        until it holds
    solver : "auto" (fatrop explores, IPOPT finishes), "fatrop" or "ipopt" for everything
    compiled : compile the kernels to C where there is a compiler
    seed : of the random starts
    """

    mesh: int = 100
    starts: int = 5
    limit_tolerance: float = 5e-4
    solver: str = "auto"
    compiled: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        whole("mesh", self.mesh, "intervals", at_least=4)
        whole("starts", self.starts, at_least=1)
        whole("seed", self.seed, at_least=0)
        checks.number("limit_tolerance", self.limit_tolerance, above=0.0)
        checks.one_of("solver", self.solver, ("auto", "fatrop", "ipopt"))


def time_optimal(
    robot: Robot,
    via_q: ArrayLike,
    limits: Limits | JointLimits | None = None,
    *,
    settings: TimeOptimalSettings | None = None,
    progress: StepProgress | None = None,
    **changes: Any,
) -> Motion:
    """The fastest motion through via points: at rest at both ends, passing the others at any speed.

    Minimises the sum of the phase durations subject to every limit: of positions, velocities,
    accelerations, jerk, torques, their rates, and those of ``limits.also``.

    Parameters
    ----------
    robot : Robot
        With masses.
    via_q : array_like [m,n]
        Via points, rad (m for prismatic joints).
    limits : Limits, optional
        Default the robot's own.
    settings : TimeOptimalSettings, optional
        Single settings may be given as keywords instead: ``mesh``, ``starts``,
        ``limit_tolerance``,
        ``solver``, ``compiled``, ``seed``.
    progress : callable, optional
        Called with a line of text at every step, and at every iteration of a solver with a
        :class:`~microbot_ocp.planning.MotionIteration`.

    Returns
    -------
    Motion
        ``motion.solved`` tells whether the solver converged, ``motion.provenance`` how it went:
        status, advice, every start with its duration, every mesh.

    Raises
    ------
    InputError
        Bad via points or limits, before any solver starts.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> via_q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
    >>> motion = mo.time_optimal(mo.load_robot("microbot"), via_q, mesh=40, starts=1)
    >>> motion.solved, round(motion.duration, 2)
    (True, 1.92)
    """
    chosen = with_changes(settings or TimeOptimalSettings(), changes)
    family = check_limits(robot, limits)
    return fastest_motion(family, check_via(family, via_q), chosen, progress or quiet)


def fastest_motion(
    family: LimitFamily, via: FloatArray, settings: TimeOptimalSettings, progress: StepProgress
) -> Motion:
    """As :func:`time_optimal`, of via points that are checked."""
    return _Search(family, via, settings, progress).run()


class _Search:
    """Several starts on a coarse mesh, the best refined until limits hold between points."""

    def __init__(
        self,
        family: LimitFamily,
        via: FloatArray,
        settings: TimeOptimalSettings,
        progress: StepProgress,
    ) -> None:
        self.family, self.via, self.settings = family, via, settings
        self.robot: Robot = family.robot
        self.progress = progress
        self.names = [f"phase {i + 1}" for i in range(len(via) - 1)]
        begin = time.perf_counter()
        kernels = transcription(self.robot, self.via.tobytes(), len(self.via), settings.compiled)
        self.kernel_time = time.perf_counter() - begin
        self.refiner = Refiner(
            kernels,
            self._guess_from,
            self._excess,
            settings.limit_tolerance,
            solver="ipopt" if settings.solver == "auto" else settings.solver,
            progress=with_motion(progress, self.robot, via, motion_at_mesh),
        )

    def run(self) -> Motion:
        begin = time.perf_counter()
        starts, best = self._explore()
        solution = self._finish(best)
        return self._motion(solution, starts, time.perf_counter() - begin + self.kernel_time)

    # starts ---------------------------------------------------------------------------------

    def _explore(self) -> tuple[list[dict[str, Any]], Solution]:
        mesh = min(EXPLORE_MESH, self.settings.mesh)
        tried: list[dict[str, Any]] = []
        best: Solution | None = None
        chosen = self.settings.starts, self.settings.seed
        for start in initial_guesses(self.robot, self.via, self.names, *chosen):
            solution = self.refiner.solve(
                mesh, start.guesses, tolerance=EXPLORE_TOLERANCE, solver=self.settings.solver
            )
            tried.append(
                {
                    "start": start.name,
                    "status": str(solution.status),
                    "duration": solution.duration,
                }
            )
            self.progress(
                f"start {start.name}: {solution.duration:.4f} s on {mesh} intervals a phase, "
                f"{solution.status}"
            )
            if _better(solution, best):
                best = solution
        assert best is not None
        return tried, best

    # refinement -----------------------------------------------------------------------------

    def _finish(self, best: Solution) -> Solution:
        """Coarse to fine from the best start, then local refinement while limits are exceeded."""
        best = self.refiner.finer(best, [self.settings.mesh] * len(self.names))
        best = self.refiner.refine(best)
        if "qddd" in self.family:
            best = self.refiner.refine(self.refiner.sharpen(best, self._jerk_switches))
        return best

    def _jerk_switches(self, solution: Solution) -> list[np.ndarray]:
        member = self.family["qddd"]
        return [
            jerk_switches(np.diff(phase["qdd"], axis=0) / np.diff(phase.t)[:, None], member)
            for phase in solution.phases
        ]

    def _guess_from(self, solution: Solution) -> dict[str, Guess]:
        return guesses_along(self.names, polynomial(solution), via_times(solution))

    def _excess(self, solution: Solution) -> list[FloatArray]:
        return excess_between(self.family, solution)

    # result ---------------------------------------------------------------------------------

    def _motion(
        self,
        solution: Solution,
        starts: list[dict[str, Any]],
        wall: float,
    ) -> Motion:
        outcome = verdict(solution, self._excess(solution), self.settings.limit_tolerance)
        found = sorted({round(s["duration"], 3) for s in starts if s["status"] == "solved"})
        return _as_motion(
            self.robot,
            solution,
            provenance_of(
                "free time-optimal motion, multiple shooting on the inverse dynamics",
                outcome,
                solution,
                wall,
                SMOOTHING,
                optima_seen=found,
                starts=starts,
                solves=self.refiner.history,
                kernel_time=self.kernel_time,
            ),
            _note(outcome, len(self.via), len(starts), found),
        )


def _as_motion(robot: Robot, solution: Solution, provenance: dict[str, Any], note: str) -> Motion:
    marks = [Mark(float(t), f"via {i + 1}") for i, t in enumerate(via_times(solution))]
    return Motion.from_polynomial(
        robot,
        polynomial(solution),
        label="time-optimal",
        marks=marks,
        provenance=provenance,
        note=note,
    )


def _note(outcome: dict[str, Any], via_count: int, start_count: int, found: list[float]) -> str:
    if outcome["status"] != "solved":
        return f"not solved: {outcome['advice']}"
    optima = ", ".join(f"{duration:.3f}" for duration in found)
    passed = {2: "", 3: "via point passed at any velocity; "}
    return (
        f"{passed.get(via_count, 'via points passed at any velocity; ')}{start_count} starts ended "
        f"at {optima} s on the coarse mesh, the best was refined"
    )


def _better(solution: Solution, best: Solution | None) -> bool:
    if best is None or solution.status.solved != best.status.solved:
        return best is None or solution.status.solved
    return solution.duration < best.duration


class TimeOptimalSolver:
    """The fastest motion through via points, for one set of limits and payload after another.

    The program, its compiled kernels and the solver are made once; limits and the payload are
    numbers in it. Every solve starts from the scaled cubic, not from the solution before: it takes
    20 to 40 iterations either way, far steps fewer, and the answer does not depend on what was
    asked before.

    As :func:`microbot_ocp.time_optimal` from a coarser mesh, refined where a limit is exceeded
    between its points by more than a certificate lets pass.

    Parameters
    ----------
    robot : Robot
        With masses and limits. A kind of limit that it does not have at all (say, torque rates)
        cannot be added later.
    via_q : array_like [m,n]
        Via points, rad (prismatic: m).
    mesh : int
        Intervals of each phase, before they are refined.
    starts : int
        How many starting motions a search tries.
    rounds : int
        Largest number of refinements.
    compiled : bool
        Compile the kernels to C where there is a compiler.
    seed : int
        Of the random starts.

    Raises
    ------
    InputError
        As :func:`microbot_ocp.time_optimal`.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> via_q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
    >>> solver = mo.TimeOptimalSolver(mo.load_robot("microbot"), via_q)
    >>> round(solver().duration, 2), round(solver(payload=1.0).duration, 2)
    (1.92, 2.54)
    """

    def __init__(
        self,
        robot: Robot,
        via_q: ArrayLike,
        *,
        mesh: int = 60,
        starts: int = 5,
        rounds: int = 3,
        compiled: bool = True,
        seed: int = 0,
    ) -> None:
        whole("mesh", mesh, "intervals", at_least=4)
        whole("starts", starts, at_least=1)
        whole("rounds", rounds, at_least=0)
        whole("seed", seed, at_least=0)
        self.robot = robot
        self.via_q = check_via(check_limits(robot, None), via_q)
        self._starts, self._seed, self._rounds = starts, seed, rounds
        self._phases = [f"phase {i + 1}" for i in range(len(self.via_q) - 1)]
        self._kernels = transcription(
            robot, self.via_q.tobytes(), len(self.via_q), compiled, payload=True
        )
        self._solver = self._on([mesh] * len(self._phases))

    def __call__(
        self,
        limits: Limits | JointLimits | None = None,
        payload: float = 0.0,
        *,
        search: bool = False,
    ) -> Motion:
        """Solve once more.

        Parameters
        ----------
        limits : Limits, optional
            Default the robot's own.
        payload : float
            Point mass at the tool, kg; the motion is one of ``robot.with_payload(payload)``.
        search : bool
            Try every start, not only the scaled cubic: local optima are real. The others are tried
            anyway where the first one leads nowhere.

        Returns
        -------
        Motion
            ``motion.solved`` tells whether the solver converged, ``motion.provenance`` how it
            went.

        Raises
        ------
        InputError
            Bad limits or payload, a via point that cannot be held: before any solver starts.
        """
        begin = time.perf_counter()
        family = check_limits(self.robot.with_payload(payload), limits)
        self._check_kinds(family)
        check_via(family, self.via_q)
        robot = family.robot
        changes = self._changes(family, float(payload))
        tried: list[tuple[str, Solution]] = []
        for start in initial_guesses(robot, self.via_q, self._phases, self._starts, self._seed):
            tried.append((start.name, self._solver.solve(guess=start.guesses, **changes)))
            if tried[-1][1].status.solved and not search:
                break
        name, best = min(tried, key=lambda pair: (not pair[1].status.solved, pair[1].duration))
        solution = self._refined(family, best, changes) if best.status.solved else best
        return self._motion(family, solution, tried, name, payload, begin)

    def _on(self, meshes: Sequence[int | FloatArray]) -> ParametricSolver:
        return ParametricSolver(self._kernels, meshes, PREPARED)

    def _refined(
        self, family: LimitFamily, solution: Solution, changes: dict[str, Any]
    ) -> Solution:
        """Split intervals inside which a limit is exceeded; keep what is no worse."""
        for _ in range(self._rounds):
            excess = excess_between(family, solution)
            if max(float(e.max()) for e in excess) <= LIMIT_TOLERANCE:
                break
            pairs = zip(solution.phases, excess, strict=True)
            meshes = [split(phase.mesh, e > LIMIT_TOLERANCE) for phase, e in pairs]
            finer = self._on(meshes).solve(guess=solution, **changes)
            if not finer.status.solved or finer.cost > solution.cost * (1 + WORSE):
                break
            solution = finer
        return solution

    def _changes(self, family: LimitFamily, payload: float) -> dict[str, Any]:
        declared = {c.name for c in self._kernels.problem.phases[0].constraints}
        pairs = {key: family.robot.limits.bounds(key) for key in OF_VARIABLES}
        for member in family:
            if member.name in declared:
                pairs[member.name] = (member.lower, member.upper)
        return {
            "bounds": dict.fromkeys(self._phases, pairs),
            "parameters": {phase: {"payload": payload} for phase in self._phases},
        }

    def _check_kinds(self, family: LimitFamily) -> None:
        """Only the numbers of limits may change: their expressions are built in."""
        own = LimitFamily.of(self.robot)
        for member in family:
            if member.key in ("q", "qdd"):  # bounds of variables, which are always there
                continue
            if member.key not in own:
                raise InputError(
                    f"limits bound {member.key}, but the solver was made for a robot without any "
                    f"limit of {member.key}: make it with robot.with_limits(...)"
                )
            before = own[member.key].limit
            if member.limit is not None and before is not None:
                built, asked = (
                    (m.expression, *(b for b in (m.lower, m.upper) if callable(b)))
                    for m in (before, member.limit)
                )
                if built != asked:
                    raise InputError(
                        f"limit {member.name!r} has another expression than the one that the "
                        "solver was made with: only its numbers may change"
                    )

    def _motion(
        self,
        family: LimitFamily,
        solution: Solution,
        tried: list[tuple[str, Solution]],
        start: str,
        payload: float,
        begin: float,
    ) -> Motion:
        outcome = verdict(solution, excess_between(family, solution), LIMIT_TOLERANCE)
        starts = [
            {
                "start": name,
                "status": str(tries.status),
                "duration": tries.duration,
                "iterations": sum(a.iterations for a in tries.attempts),
            }
            for name, tries in tried
        ]
        return _as_motion(
            family.robot,
            solution,
            provenance_of(
                "free time-optimal motion, solved again with other numbers",
                outcome,
                solution,
                time.perf_counter() - begin,
                SMOOTHING,
                start=start,
                starts=starts,
                payload=float(payload),
            ),
            "" if outcome["status"] == "solved" else f"not solved: {outcome['advice']}",
        )
