"""One time-optimal task made ready once and solved again and again: sliders, sweeps, studies.

The program, its compiled kernels and the solver are made once; limits and the payload are numbers
in it. Every solve starts from the scaled cubic, not from the solution before: it takes 20 to 40
iterations either way, far steps fewer, and the answer does not depend on what was asked before.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.motion import Mark, Motion
from microbot_ocp.ocp.refinement import WORSE, split
from microbot_ocp.ocp.solution import Solution
from microbot_ocp.ocp.solvers import ParametricSolver, SolverSettings
from microbot_ocp.planning._free import (
    SMOOTHING,
    excess_between,
    polynomial,
    transcription,
    via_times,
)
from microbot_ocp.planning._initial_guesses import starting_motions
from microbot_ocp.planning._task import MOST_EXCESS, check_limits, check_via, verdict, whole
from microbot_ocp.robot import JointLimits, Limits, Robot

TOLERANCE = 1e-6
MAX_ITERATIONS = 150  # of one attempt: somebody waits


class TimeOptimalSolver:
    """The fastest motion through via points, for one set of limits and payload after another.

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
        self.via_q = check_via(robot, via_q, check_limits(robot, None))
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
        bounds = check_limits(self.robot, limits)
        self._check_kinds(bounds)
        robot = self.robot.with_payload(payload).with_limits(bounds)
        check_via(robot, self.via_q, bounds)
        changes = self._changes(bounds, float(payload))
        tried: list[tuple[str, Solution]] = []
        for start in starting_motions(robot, self.via_q, self._phases, self._starts, self._seed):
            tried.append((start.name, self._solver.solve(guess=start.guesses, **changes)))
            if tried[-1][1].status.solved and not search:
                break
        name, best = min(tried, key=lambda pair: (not pair[1].status.solved, pair[1].duration))
        solution = self._refined(robot, best, changes) if best.status.solved else best
        return self._motion(robot, solution, tried, name, payload, begin)

    def _on(self, meshes: Sequence[int | FloatArray]) -> ParametricSolver:
        settings = SolverSettings("ipopt", tolerance=TOLERANCE, max_iterations=MAX_ITERATIONS)
        return ParametricSolver(self._kernels, meshes, settings)

    def _refined(self, robot: Robot, solution: Solution, changes: dict[str, Any]) -> Solution:
        """Split intervals inside which a limit is exceeded; keep what is no worse."""
        for _ in range(self._rounds):
            excess = excess_between(robot, solution)
            if max(float(e.max()) for e in excess) <= MOST_EXCESS:
                break
            pairs = zip(solution.phases, excess, strict=True)
            meshes = [split(phase.mesh, e > MOST_EXCESS) for phase, e in pairs]
            finer = self._on(meshes).solve(guess=solution, **changes)
            if not finer.status.solved or finer.cost > solution.cost * (1 + WORSE):
                break
            solution = finer
        return solution

    def _changes(self, bounds: JointLimits, payload: float) -> dict[str, Any]:
        ranges = {"q": "q", "qd": "qd", "qdd": "qdd", "torque": "tau", "torque rate": "taud"}
        declared = {c.name for c in self._kernels.problem.phases[0].constraints}
        known = {"q", "qd", "qdd", *declared}
        pairs = {name: bounds.bounds(kind) for name, kind in ranges.items() if name in known}
        return {
            "bounds": dict.fromkeys(self._phases, pairs),
            "parameters": {phase: {"payload": payload} for phase in self._phases},
        }

    def _check_kinds(self, bounds: JointLimits) -> None:
        for quantity in ("qd", "tau", "taud"):
            own, new = self.robot.limits.bounds(quantity), bounds.bounds(quantity)
            if np.isfinite(new).any() and not np.isfinite(own).any():
                raise InputError(
                    f"limits bound {quantity}, but the solver was made for a robot without any "
                    f"limit of {quantity}: make it with robot.with_limits(...)"
                )

    def _motion(
        self,
        robot: Robot,
        solution: Solution,
        tried: list[tuple[str, Solution]],
        start: str,
        payload: float,
        begin: float,
    ) -> Motion:
        shape = polynomial(solution)
        outcome = verdict(solution, excess_between(robot, solution), MOST_EXCESS)
        marks = [Mark(float(t), f"via {i + 1}") for i, t in enumerate(via_times(solution))]
        return Motion.from_polynomial(
            robot,
            shape,
            label="time-optimal",
            marks=marks,
            provenance={
                "method": "free time-optimal motion, solved again with other numbers",
                **outcome,
                "start": start,
                "starts": [
                    {
                        "start": name,
                        "status": str(tries.status),
                        "duration": tries.duration,
                        "iterations": sum(a.iterations for a in tries.attempts),
                    }
                    for name, tries in tried
                ],
                "payload": float(payload),
                "solver": solution.attempts[-1].solver,
                "intervals": [phase.mesh.size - 1 for phase in solution.phases],
                "phase_durations": [phase.duration for phase in solution.phases],
                "wall_time": time.perf_counter() - begin,
                "smoothing": SMOOTHING,
                "casadi": ca.CasadiMeta.version(),
            },
            note="" if outcome["status"] == "solved" else f"not solved: {outcome['advice']}",
        )
