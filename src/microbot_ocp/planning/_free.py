"""Free time-optimal motions through via points: path and timing are both found.

Each stretch between two via points is a phase of free duration with the states q, qd and a
continuous, piecewise linear acceleration as the control, so that the discrete motion is exact and
the torque continuous; torque limits are kept by the inverse dynamics, which needs no inverse of the
mass matrix. Local optima are real: several starts are tried on a coarse mesh, the best goes on to
finer ones, and a finer mesh whose optimum is worse than the coarse one is not accepted.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.codegen import compile_functions, compiler
from microbot_ocp.motion import Mark, Motion, PiecewisePolynomial, State, quintic_between
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.refinement import Refiner
from microbot_ocp.ocp.solution import PhaseSolution, Solution, StepProgress, quiet
from microbot_ocp.ocp.transcription import Guess, Transcription
from microbot_ocp.planning._initial_guesses import guesses_along, starting_motions
from microbot_ocp.planning._progress import Samples, with_motion
from microbot_ocp.planning._task import (
    check_limits,
    check_via,
    finite_scale,
    limit_excess,
    verdict,
    whole,
)
from microbot_ocp.robot import JointLimits, Limits, Robot, torque_and_rate

# Weight of the squared jerk: picks one motion where many are equally fast. It costs 1.3e-5 of the
# duration of the Microbot task and halves the swing of the torques that are not at a limit.
SMOOTHING = 1e-6
EXPLORE_MESH = 20  # intervals a phase for the first look at every start
EXPLORE_TOLERANCE = 1e-5
CHECKS_PER_INTERVAL = 20


@dataclass(frozen=True)
class TimeOptimalSettings:
    """How hard to look.

    Attributes
    ----------
    mesh : intervals of each phase in the first full solve
    starts : how many starting motions to try on the coarse mesh
    violation : largest relative excess of a limit between mesh points; the mesh is refined until
        it holds
    solver : "auto" (fatrop explores, IPOPT finishes), "fatrop" or "ipopt" for everything
    compiled : compile the kernels to C where there is a compiler
    seed : of the random starts
    """

    mesh: int = 100
    starts: int = 5
    violation: float = 5e-4
    solver: str = "auto"
    compiled: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        whole("mesh", self.mesh, "intervals", at_least=4)
        whole("starts", self.starts, at_least=1)
        whole("seed", self.seed, at_least=0)
        checks.number("violation", self.violation, above=0.0)
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

    Minimises the sum of the phase durations subject to q, qd, qdd, tau and taud within limits.

    Parameters
    ----------
    robot : Robot
        With masses.
    via_q : array_like [m,n]
        Via points, rad (m for prismatic joints).
    limits : Limits, optional
        Default the robot's own.
    settings : TimeOptimalSettings, optional
        Single settings may be given as keywords instead: ``mesh``, ``starts``, ``violation``,
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
    chosen = replace(settings or TimeOptimalSettings(), **changes)
    bounds = check_limits(robot, limits)
    via = check_via(robot, via_q, bounds)
    search = _Search(robot, via, bounds, chosen, progress or quiet)
    return search.run()


@lru_cache(maxsize=16)
def transcription(
    robot: Robot, via_bytes: bytes, count: int, compiled: bool, *, payload: bool = False
) -> Transcription:
    """Kernels for a robot (its own limits) and via points, built once."""
    via = np.frombuffer(via_bytes).reshape(count, -1)
    prepare = None
    if compiled and compiler() is not None:
        prepare = compile_functions
    return Transcription(free_problem(robot, via, payload=payload), prepare=prepare)


def free_problem(robot: Robot, via: FloatArray, *, payload: bool = False) -> OptimalControlProblem:
    """The optimal-control problem of a robot (with its limits) through via points [m,n].

    With ``payload`` every phase has the parameter "payload": a mass at the tool, kg, zero at first.
    """
    count, limits = robot.joint_count, robot.limits
    torques = _torque_and_rate_with_payload(robot) if payload else torque_and_rate(robot)
    acceleration_scale = _acceleration_scale(robot)
    torque_scale = finite_scale(limits.tau_min, limits.tau_max)
    problem = OptimalControlProblem(f"time-optimal motion of {robot.name}")
    for index, (start, end) in enumerate(itertools.pairwise(via)):
        first, last = index == 0, index == len(via) - 2
        phase = problem.phase(f"phase {index + 1}", duration=(1e-3, 1e3))
        q = phase.state(
            "q",
            count,
            lower=limits.q_min,
            upper=limits.q_max,
            initial=start,
            final=end if last else None,
            unit="rad",
        )
        qd = phase.state(
            "qd",
            count,
            lower=limits.qd_min,
            upper=limits.qd_max,
            initial=0.0 if first else None,
            final=0.0 if last else None,
            scale=finite_scale(limits.qd_min, limits.qd_max),
            unit="rad/s",
            interior_points=bool(np.isfinite(limits.qd_max).any()),
        )
        qdd = phase.control(
            "qdd",
            count,
            lower=limits.qdd_min,
            upper=limits.qdd_max,
            scale=acceleration_scale,
            unit="rad/s^2",
            shape="linear",
        )
        phase.derivative(q, qd)
        phase.derivative(qd, qdd)
        jerk = phase.rate(qdd)
        held = [phase.parameter("payload", 0.0)] if payload else []
        torque, torque_rate = torques(q, qd, qdd, jerk, *held)
        if np.isfinite(torque_scale).all() and np.isfinite([limits.tau_min, limits.tau_max]).any():
            phase.constraint(
                "torque",
                torque,
                limits.tau_min,
                limits.tau_max,
                scale=torque_scale,
                unit="N m",
            )
        if np.isfinite([limits.taud_min, limits.taud_max]).any():
            phase.constraint(
                "torque rate",
                torque_rate,
                limits.taud_min,
                limits.taud_max,
                scale=finite_scale(limits.taud_min, limits.taud_max),
                unit="N m/s",
            )
        phase.end_cost(phase.duration)
        phase.running_cost(SMOOTHING * ca.sumsqr(jerk / (10.0 * acceleration_scale)))
    for before, after in itertools.pairwise(problem.phases):
        problem.link(before, after, names=("q", "qd", "qdd"))
    return problem


def _torque_and_rate_with_payload(robot: Robot) -> ca.Function:
    """As :func:`torque_and_rate`, with the mass of a payload as a fifth argument: linear in it."""
    functions = [torque_and_rate(held) for held in (robot, robot.with_payload(1.0))]
    state = [ca.SX.sym(name, robot.joint_count) for name in ("q", "qd", "qdd", "qddd")]
    payload = ca.SX.sym("payload")
    pairs = zip(*(function(*state) for function in functions), strict=True)
    values = [empty + payload * (holding_one - empty) for empty, holding_one in pairs]
    return ca.Function("torque_and_rate", [*state, payload], values)


def _acceleration_scale(robot: Robot) -> FloatArray:
    """Typical accelerations [n]: the limits, where given, else 10 rad/s^2."""
    return np.where(
        np.isfinite(robot.limits.qdd_max) & (robot.limits.qdd_max > 0), robot.limits.qdd_max, 10.0
    )


class _Search:
    """Several starts on a coarse mesh, the best refined until limits hold between points."""

    def __init__(
        self,
        robot: Robot,
        via: FloatArray,
        limits: JointLimits,
        settings: TimeOptimalSettings,
        progress: StepProgress,
    ) -> None:
        self.robot, self.via, self.settings = robot.with_limits(limits), via, settings
        self.progress = progress
        self.names = [f"phase {i + 1}" for i in range(len(via) - 1)]
        begin = time.perf_counter()
        kernels = transcription(self.robot, self.via.tobytes(), len(self.via), settings.compiled)
        self.kernel_time = time.perf_counter() - begin
        self.refiner = Refiner(
            kernels,
            self._guess_from,
            self._excess,
            settings.violation,
            solver="ipopt" if settings.solver == "auto" else settings.solver,
            progress=with_motion(progress, self.robot, via, _motion_at_mesh),
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
        for start in starting_motions(self.robot, self.via, self.names, *chosen):
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
        return self.refiner.refine(best)

    def _guess_from(self, solution: Solution) -> dict[str, Guess]:
        return guesses_along(self.names, polynomial(solution), via_times(solution))

    def _excess(self, solution: Solution) -> list[FloatArray]:
        return excess_between(self.robot, solution)

    # result ---------------------------------------------------------------------------------

    def _motion(
        self,
        solution: Solution,
        starts: list[dict[str, Any]],
        wall: float,
    ) -> Motion:
        times = via_times(solution)
        outcome = verdict(solution, self._excess(solution), self.settings.violation)
        found = sorted({round(s["duration"], 3) for s in starts if s["status"] == "solved"})
        return Motion.from_polynomial(
            self.robot,
            polynomial(solution),
            label="time-optimal",
            marks=[Mark(float(t), f"via {i + 1}") for i, t in enumerate(times)],
            provenance={
                "method": "free time-optimal motion, multiple shooting on the inverse dynamics",
                **outcome,
                "solver": solution.attempts[-1].solver,
                "intervals": [phase.mesh.size - 1 for phase in solution.phases],
                "phase_durations": [phase.duration for phase in solution.phases],
                "optima_seen": found,
                "starts": starts,
                "solves": self.refiner.history,
                "kernel_time": self.kernel_time,
                "wall_time": wall,
                "smoothing": SMOOTHING,
                "casadi": ca.CasadiMeta.version(),
            },
            note=_note(outcome, starts, found),
        )


def _motion_at_mesh(phases: Sequence[PhaseSolution]) -> Samples:
    starts = np.cumsum([0.0, *(phase.duration for phase in phases)])
    # where a phase ends the next begins
    last = len(phases) - 1
    kept = [slice(None) if k == last else slice(-1) for k in range(len(phases))]
    parts = list(zip(phases, kept, strict=True))
    t = [start + phase.t[part] for start, (phase, part) in zip(starts, parts, strict=False)]
    states = (
        np.concatenate([phase[name][part] for phase, part in parts]) for name in State._fields
    )
    return np.concatenate(t), State(*states)


def _note(outcome: dict[str, Any], starts: list[dict[str, Any]], found: list[float]) -> str:
    if outcome["status"] != "solved":
        return f"not solved: {outcome['advice']}"
    optima = ", ".join(f"{duration:.3f}" for duration in found)
    return (
        f"via point passed at any velocity; {len(starts)} starts ended at {optima} s on the "
        "coarse mesh, the best was refined"
    )


def _better(solution: Solution, best: Solution | None) -> bool:
    if best is None or solution.status.solved != best.status.solved:
        return best is None or solution.status.solved
    return solution.duration < best.duration


def excess_between(robot: Robot, solution: Solution) -> list[FloatArray]:
    """Largest relative excess of any limit along every interval: an array [N, K] a phase."""
    shape = polynomial(solution)
    velocity = shape.derivative()
    inside = np.linspace(0, 1, CHECKS_PER_INTERVAL + 1)
    t = (shape.breaks[:-1, None] + inside * np.diff(shape.breaks)[:, None]).ravel()
    acceleration = velocity.derivative()
    state = State(shape(t), velocity(t), acceleration(t))
    excess = limit_excess(robot, state, acceleration.derivative()(t))
    edges = np.cumsum([phase.mesh.size - 1 for phase in solution.phases])[:-1]
    return np.split(excess.reshape(-1, inside.size), edges)


def via_times(solution: Solution) -> FloatArray:
    """Times [m] at which the via points are passed, s."""
    return np.concatenate([[0.0], np.cumsum([phase.duration for phase in solution.phases])])


def polynomial(solution: Solution) -> PiecewisePolynomial:
    """The motion between the mesh points: the quintic that meets q, qd and qdd at both ends.

    It is the cubic of the linear acceleration wherever the solver closed the gaps between
    intervals.
    """
    breaks, pieces = [np.zeros(1)], []
    start = 0.0
    for phase in solution.phases:
        q, qd, qdd = phase["q"], phase["qd"], phase["qdd"]
        ends = State(q[:-1], qd[:-1], qdd[:-1]), State(q[1:], qd[1:], qdd[1:])
        pieces.append(quintic_between(*ends, np.diff(phase.t)))
        breaks.append(start + phase.t[1:])
        start += phase.duration
    return PiecewisePolynomial(np.concatenate(breaks), np.concatenate(pieces))
