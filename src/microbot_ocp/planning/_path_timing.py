"""The best timing of a given joint path, from rest to rest.

The path stays, only s(t) is found: by the reachability passes, to the global optimum on a grid,
where they keep every limit. Rates of torques and accelerations are kept by a program on places of
the path (``_rate_timing.py``), others by an optimal-control problem that starts from there. Each
polynomial piece is a phase with the states s and s' and a continuous, piecewise linear s'' as
the control; the torque is the inverse dynamics of ``q(s), q' s', q' s'' + q'' s'^2``. At a corner
of the path, where its tangent jumps, the arm has to stop.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.codegen import compile_recipe, compiles
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LIMIT_TOLERANCE, JointLimits, LimitFamily, Limits, MotionSamples
from microbot_ocp.motion import (
    JUMP_GAP,
    SAMPLE_STEP,
    Mark,
    Motion,
    PiecewisePolynomial,
    State,
    dense_times,
    sample_times,
    samples_at,
)
from microbot_ocp.ocp.problem import OptimalControlProblem, Phase
from microbot_ocp.ocp.refinement import Refiner
from microbot_ocp.ocp.solution import Gap, PhaseSolution, Solution, StepProgress, quiet
from microbot_ocp.ocp.solvers import SolverSettings
from microbot_ocp.ocp.transcription import Guess, Transcription
from microbot_ocp.planning._blocked_path import blocking_limit
from microbot_ocp.planning._curve import CurvePiece, evaluate, symbolic_derivatives
from microbot_ocp.planning._fast_timing import sampled
from microbot_ocp.planning._friction import dry_friction
from microbot_ocp.planning._path_limits import LATER, limits_kept_by
from microbot_ocp.planning._paths import check_path, corners, segments, stops
from microbot_ocp.planning._progress import Samples, with_motion
from microbot_ocp.planning._rate_timing import RATES, Profile, first_profile, with_rates
from microbot_ocp.planning._reachability import MOST_GRIDS, Reached, settled
from microbot_ocp.planning._scale import rates_alone
from microbot_ocp.planning._task import (
    CHECKS_PER_INTERVAL,
    GAP,
    ROUGH_TOLERANCE,
    TIME_LIMIT,
    check_limits,
    declare_limits,
    derivatives_for,
    jerk_switches,
    provenance_of,
    torques_of,
    verdict,
    whole,
    with_changes,
    with_drives_noted,
    with_locked_joints_held,
)
from microbot_ocp.robot import Robot

SMOOTHING = 1e-8  # weight of the squared rate of s'': picks one timing where many are equally fast
# Intervals of a piece, and of all together, where nobody says how many
FULL_MESH, FULL_MESH_SUM, LEAST_MESH = 100, 200, 20
LATE = "The time was over before the grid was fine enough; a longer time_limit may find less time."
TOO_LATE = "The time was over before a timing was found that keeps limits of {}: this one does not."
BLOCKED = (
    "No timing of the path keeps the limits. On a grid, viscous friction left out, the least that "
    "has to give, all limits by the same share, is:"
)
RATE_EXCEEDED = (
    "The dry friction of {} turns at {:.4g} s faster than its torque rate allows, by {:.2g} %: "
    "raise taud_max, or give the path another curvature there."
)
SLOWER = 0.05  # share by which the timing may be slower than reachability, which is the optimum


@dataclass(frozen=True)
class PathTimingSettings:
    """Settings of path timing.

    Attributes
    ----------
    mesh : intervals of each polynomial piece in the optimal-control problem; default 100, fewer on
        paths of more than two
    grid : points of the reachability passes on each smooth segment to begin with; they become more
        until the duration settles
    limit_tolerance : largest relative excess of a limit between grid or mesh points
    solver : "ipopt" or "fatrop" (IPOPT steps in where it fails) of the optimal-control problem;
        default None: where reachability keeps every limit there is none, otherwise IPOPT
    compiled : compile to C where there is a compiler
    time_limit : wall time, s, after which the best so far is returned with the status "time limit";
        infinite is none
    """

    mesh: int | None = None
    grid: int = 1000
    limit_tolerance: float = 5e-4
    solver: str | None = None
    compiled: bool = True
    time_limit: float = TIME_LIMIT

    def __post_init__(self) -> None:
        checks.time_limit(self.time_limit)
        if self.mesh is not None:
            whole("mesh", self.mesh, "intervals", at_least=4)
        whole("grid", self.grid, "points", at_least=10)
        checks.number("limit_tolerance", self.limit_tolerance, above=0.0)
        if self.solver is not None:
            checks.one_of("solver", self.solver, ("ipopt", "fatrop"))


def time_optimal_path(
    robot: Robot,
    path: PiecewisePolynomial,
    limits: Limits | JointLimits | None = None,
    *,
    settings: PathTimingSettings | None = None,
    label: str = "path, best timing",
    progress: StepProgress | None = None,
    **changes: Any,
) -> Motion:
    """The fastest motion along a path, at rest at both ends and at its corners.

    Under limits of the torque rate or the jerk it rests wherever the curvature of the path jumps,
    too. Limits that are affine in s'' and s'^2 (torque, acceleration) and those of the velocity are
    kept by reachability, on a grid that becomes finer until they hold between its points. Limits of
    the torque rate and the jerk are kept by a program that starts from there, with places on the
    path as mesh points, so that it evaluates no dynamics. Where there are others (power), or the
    setting ``solver`` asks for it, it is an optimal-control problem in time; the provenance's
    ``limits_kept_by`` says which is which.

    Parameters
    ----------
    robot : Robot
        Without masses only limits of its motion count, none of torques.
    path : PiecewisePolynomial
        Joint positions over any path parameter: a trajectory (its timing is replaced), or
        :func:`straight_path`.
    limits : Limits, optional
        Default the robot's own.
    settings : PathTimingSettings, optional
        Single settings may be given as keywords: ``mesh``, ``grid``,
        ``limit_tolerance``, ``solver``, ``compiled``, ``time_limit`` (by default 120 s).

    Returns
    -------
    Motion
        ``motion.solved`` tells whether the solver converged; the provenance holds the duration
        found by reachability, too.

    Raises
    ------
    InputError
        A path outside the position limits, an end or corner that cannot be held at rest, bad
        limits: before any solver starts.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> path = mo.straight_path(np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]]))
    >>> motion = mo.time_optimal_path(mo.load_robot("microbot"), path, mesh=40)
    >>> motion.solved
    True
    """
    chosen = with_changes(settings or PathTimingSettings(), changes)
    family = check_limits(robot, limits)
    check_path(family, path)
    return best_timing(family, path, chosen, label, progress or quiet)


def best_timing(
    family: LimitFamily,
    path: PiecewisePolynomial,
    settings: PathTimingSettings,
    label: str,
    progress: StepProgress,
) -> Motion:
    """As :func:`time_optimal_path`, of a path that is checked."""
    with deadline.within(settings.time_limit):
        motion = _PathSearch(family, path, settings, label, progress).run()
    return with_drives_noted(family.robot, motion)


@dataclass(frozen=True, eq=False)
class _Piece:
    """One piece of a curve between two stops: a phase."""

    name: str
    shape: CurvePiece
    segment: int
    offset: float  # parameter of the segment where the piece's own is zero
    begins: bool  # whether the segment begins with it
    ends: bool
    start_free: bool  # the tangent vanishes there: at rest whatever the speed of the parameter
    end_free: bool
    via: bool  # whether it ends at a break of the path

    @property
    def stops_before(self) -> bool:
        return self.begins and not self.start_free

    @property
    def stops_after(self) -> bool:
        return self.ends and not self.end_free


class _PathSearch:
    """Reachability on every smooth segment, then all pieces as one optimal-control problem."""

    def __init__(
        self,
        family: LimitFamily,
        path: PiecewisePolynomial,
        settings: PathTimingSettings,
        label: str,
        progress: StepProgress,
    ) -> None:
        self.family, self.path = with_locked_joints_held(family, None), path
        self.settings = settings
        self.robot: Robot = family.robot
        self.label, self.progress = label, progress
        self.stops = stops(path, self.family)
        self.passed = segments(path, self.family)  # as the passes of reachability take them
        self.curves = segments(path, self.family, 3) if self.family.jerk_matters else self.passed
        self.pieces = self._pieces()

    def _pieces(self) -> list[_Piece]:
        pieces: list[_Piece] = []
        for index, curve in enumerate(self.curves):
            for i, shape in enumerate(curve.pieces):
                begins, ends = i == 0, i == len(curve.pieces) - 1
                pieces.append(
                    _Piece(
                        name=f"piece {len(pieces) + 1}",
                        shape=shape,
                        segment=index,
                        offset=float(curve.breaks[i]) - shape.limits[0],
                        begins=begins,
                        ends=ends,
                        start_free=begins and curve.start_free,
                        end_free=ends and curve.end_free,
                        via=not shape.halved,
                    )
                )
        return pieces

    def run(self) -> Motion:
        begin = time.perf_counter()
        timings, kept_by, excess = self._reach()
        reached = sum(timing.duration for timing in timings)
        for timing in timings:
            if not timing.feasible:
                self.progress(
                    f"reachability: the end cannot be reached from s = {timing.blocked_at:g}"
                )
        if np.isfinite(reached):
            self.progress(f"reachability on a grid: {reached:.6f} s")
        settings, complete = self.settings, not kept_by[LATER]
        passes = excess <= 2.0 * settings.limit_tolerance  # else the solver may come nearer
        if settings.solver is None and complete and passes:
            return self._reached_motion(timings, kept_by, excess, time.perf_counter() - begin)
        if settings.solver is None and self._only_rates_are_left(kept_by) and np.isfinite(reached):
            solution = self._with_rates(self._starts(timings))
            if solution.status.solved:
                wall = time.perf_counter() - begin
                history = [attempt.as_dict() for attempt in solution.attempts]
                found = self._motion(solution, history, timings, reached, kept_by, wall)
                return self._with_rates_at_reversals(found)
        solver = settings.solver or "ipopt"
        guesses, scales = self._guesses(self._starts(timings))
        try:
            with deadline.given_up(bool(np.isfinite(reached))):
                transcription = self._transcription(scales)
        except deadline.Over:
            return self._reached_motion(timings, kept_by, excess, time.perf_counter() - begin)
        refiner = Refiner(
            transcription,
            self._guess_from,
            self._excess,
            self.settings.limit_tolerance,
            solver=solver,
            settings=SolverSettings(gap=GAP),
            rough=ROUGH_TOLERANCE,
            deep=True,
            progress=with_motion(
                self.progress, self.robot, self.path(self.path.breaks), self._at_mesh
            ),
        )
        mesh = self._mesh
        solution = refiner.solve(mesh, guesses)
        if not (solution.status.solved or refiner.over) and self.settings.solver != "ipopt":
            solution = refiner.solve(mesh, guesses, solver="ipopt")
        self.progress(
            f"mesh {' + '.join([str(mesh)] * len(self.pieces))}: "
            f"{solution.duration:.6f} s, {solution.status}"
        )
        solution = refiner.refine(solution)
        if "qddd" in self.family:
            solution = refiner.refine(refiner.sharpen(solution, self._jerk_switches))
        solution = refiner.finished(solution)
        wall = time.perf_counter() - begin
        return self._motion(solution, refiner.history, timings, reached, kept_by, wall)

    def _transcription(self, scales: dict[str, float]) -> Transcription:
        deadline.check()
        compiled = compiles(self.settings.compiled)
        return Transcription(
            self._problem(scales),
            scheme="shooting",
            prepare=compile_recipe if compiled else None,
            derivatives=derivatives_for(self.robot),
        )

    def _with_rates_at_reversals(self, motion: Motion) -> Motion:
        """The same, not solved where dry friction breaks a limit of the torque rate all the same.

        Where a joint turns back that is a peak of some milliseconds, which may lie between the
        places at which a mesh is looked at. A slower motion does not help: its torque jumps, too.
        """
        if not motion.solved or "taud" not in self.family or not dry_friction(self.robot).any():
            return motion
        t = dense_times(motion)[0]
        use = self.family.use(samples_at(motion, t), ["taud"])["taud"]
        i, joint = np.unravel_index(int(use.argmax()), use.shape)
        if use[i, joint] <= 1.0 + LIMIT_TOLERANCE:
            return motion
        advice = RATE_EXCEEDED.format(
            self.robot.joint_names[joint], t[i], 100 * (use[i, joint] - 1.0)
        )
        more = {"status": str(Status.LIMITS_EXCEEDED), "advice": advice}
        note = f"not solved: {advice}"
        return replace(motion, provenance={**motion.provenance, **more}, note=note)

    # torque rates and jerk ------------------------------------------------------------------

    def _only_rates_are_left(self, kept_by: dict[str, list[str]]) -> bool:
        rates, left = {self.family[key].name for key in RATES if key in self.family}, kept_by[LATER]
        return bool(left) and set(left) <= rates

    def _with_rates(self, timings: list[Reached]) -> Solution:
        """All segments under limits of torque rates and the jerk, refined until they hold."""
        fast = compiles(self.settings.compiled)
        profiles: list[Profile] = []
        for curve, timing in zip(self.curves, timings, strict=True):
            start = first_profile(timing)
            tolerance = self.settings.limit_tolerance
            profiles.append(with_rates(self.family, curve, start, tolerance, fast, self.progress))
            if not profiles[-1].solved:
                break
        return self._solution_of(profiles)

    def _solution_of(self, profiles: list[Profile]) -> Solution:
        """Profiles as the solution of an optimal-control problem with a phase a piece."""
        phases = []
        for piece in self.pieces if profiles[-1].solved else ():
            profile = profiles[piece.segment]
            ends = piece.offset + np.array(piece.shape.limits)
            first, last = (int(np.argmin(np.abs(profile.s - at))) for at in ends)
            own = slice(first, last + 1)
            t = profile.t[own] - profile.t[first]
            values = _without_gaps(profile, own, *piece.shape.limits)
            phases.append(PhaseSolution(piece.name, float(t[-1]), t / t[-1], values))
        attempts = [attempt for profile in profiles for attempt in profile.attempts]
        return Solution(
            status=attempts[-1].status,
            cost=sum(profile.duration for profile in profiles),
            phases=tuple(phases),
            attempts=tuple(attempts),
            row_multipliers=np.zeros(0),
            build_time=0.0,
            gap=Gap(sum(profile.gap for profile in profiles), 0.0),
            advice=attempts[-1].status.sentence,
        )

    @property
    def _mesh(self) -> int:
        if self.settings.mesh is not None:
            return self.settings.mesh
        return max(min(FULL_MESH, FULL_MESH_SUM // len(self.pieces)), LEAST_MESH)

    def _reach(self) -> tuple[list[Reached], dict[str, list[str]], float]:
        """The timing of every segment, who keeps which limit, and the largest excess over them."""
        fast = compiles(self.settings.compiled)
        timings, kept_by, worst = [], {}, -1.0
        for curve in self.passed:
            count, tolerance = self.settings.grid, self.settings.limit_tolerance
            # with rates it is a start alone: as it is
            meshes = 1 if self.family.jerk_matters else MOST_GRIDS
            timing, along, excess = settled(self.family, curve, count, tolerance, fast, meshes)
            timings.append(timing)
            worst = max(worst, excess)
            kept_by = kept_by or limits_kept_by(along.limits)
        return timings, kept_by, worst

    def _starts(self, timings: list[Reached]) -> list[Reached]:
        """What solvers start from: with rates, of which reachability knows nothing, gentler ones.

        No joint is faster than it would be alone under rates only.
        """
        if not self.family.jerk_matters:
            return timings
        starts, fast = [], compiles(self.settings.compiled)
        for passed, curve, timing in zip(self.passed, self.curves, timings, strict=True):
            if timing.feasible:
                jerk, more = rates_alone(self.family, passed.evaluate(timing.s)[0])
                gentle = LimitFamily.of(self.robot, self.robot.limits.changed(more))
                timing = settled(gentle, passed, self.settings.grid, np.inf, fast, 1)[0]
                _, tangent, curvature = passed.evaluate(timing.s)
                rises = np.append(timing.start, timing.end[-1])[:, None]
                qdd = tangent * rises + curvature * timing.speed_squared[:, None]
                rise = float((np.abs(qdd).max(axis=0) / jerk).max())
                timing = timing.smoothed(passed, curve, min(rise, timing.duration), self._mesh)
            starts.append(timing)
        return starts

    def _reached_motion(
        self, timings: list[Reached], kept_by: dict[str, list[str]], excess: float, wall: float
    ) -> Motion:
        late, left = deadline.over(), kept_by[LATER]
        advice = TOO_LATE.format(", ".join(left)) if left else LATE
        stopping = _stops_said(self.stops, corners(self.path).size)
        t, state, breaks = sampled(list(zip(self.passed, timings, strict=True)))
        begins = np.cumsum([0.0, *(timing.duration for timing in timings)])
        passed = [0.0]
        for begin, curve, timing in zip(begins, self.passed, timings, strict=False):
            ends = begin + np.interp(curve.breaks[1:], timing.s, timing.t)
            passed += [at for at, k in zip(ends, curve.pieces, strict=True) if not k.halved]
        return Motion.from_state(
            self.robot,
            t,
            state,
            label=self.label,
            breaks=breaks,
            marks=[Mark(float(at), f"via {i + 1}") for i, at in enumerate(passed)],
            provenance={
                "method": "time-optimal timing of a given path, reachability",
                "status": str(Status.TIME_LIMIT if late else Status.SOLVED),
                "advice": advice if late else "",
                "excess": excess,
                "intervals": [timing.t.size - 1 for timing in timings],
                "phase_durations": [timing.duration for timing in timings],
                "reachability_duration": float(t[-1]),
                "limits_kept_by": kept_by,
                "blocked_at": [],
                "stops": [float(s) for s in self.stops],
                "wall_time": wall,
            },
            note=f"not solved: {advice}" if late else stopping,
        )

    def _guesses(self, timings: list[Reached]) -> tuple[dict[str, Guess], dict[str, float]]:
        """Guess for every piece from the reachability profile; where it failed a slow walk."""
        guesses: dict[str, Guess] = {}
        speeds, accelerations = [], []
        for piece in self.pieces:
            guess, speed, acceleration = _piece_guess(piece, timings[piece.segment])
            guesses[piece.name] = guess
            speeds.append(speed)
            accelerations.append(acceleration)
        return guesses, {"v": max(speeds), "a": max(accelerations)}

    def _problem(self, scales: dict[str, float]) -> OptimalControlProblem:
        problem = OptimalControlProblem(f"timing of a path of {self.robot.name}")
        longest = max(piece.shape.span for piece in self.pieces)
        phases = [_declare(problem, self.family, piece, longest, scales) for piece in self.pieces]
        for before, after in itertools.pairwise(zip(phases, self.pieces, strict=True)):
            kept = ("v", "a") if self.family.jerk_matters else ("v",)
            problem.link(before[0], after[0], names=() if after[1].begins else kept)
        return problem

    def _at_mesh(self, phases: Sequence[PhaseSolution]) -> Samples:
        starts = np.cumsum([0.0, *(phase.duration for phase in phases)])
        states = [
            State(*_samples(phase_polynomial(phase), piece, phase.t)[:3])
            for phase, piece in zip(phases, self.pieces, strict=True)
        ]
        t = [start + phase.t for start, phase in zip(starts, phases, strict=False)]
        joined = (np.concatenate(parts) for parts in zip(*states, strict=True))
        return np.concatenate(t), State(*joined)

    def _guess_from(self, solution: Solution) -> dict[str, Guess]:
        """Guesses for another mesh from a solution."""
        guesses = {}
        for phase, piece in zip(solution.phases, self.pieces, strict=True):
            curve = phase_polynomial(phase)
            slope = curve.derivative()
            curves = {"s": curve, "v": slope, "a": slope.derivative()}
            # Beyond its ends a bent piece is no number.
            ends = {"s": piece.shape.limits}
            values = {
                name: partial(_along, c, phase.duration, ends.get(name, (-np.inf, np.inf)))
                for name, c in curves.items()
            }
            guesses[phase.name] = Guess(phase.duration, values)
        return guesses

    def _jerk_switches(self, solution: Solution) -> list[np.ndarray]:
        found = []
        for phase, piece in zip(solution.phases, self.pieces, strict=True):
            middle = 0.5 * (phase.t[:-1] + phase.t[1:])
            jerk = _samples(phase_polynomial(phase), piece, middle).qddd
            found.append(jerk_switches(jerk, self.family["qddd"]))
        return found

    def _excess(self, solution: Solution) -> list[FloatArray]:
        result = []
        for phase, piece in zip(solution.phases, self.pieces, strict=True):
            inside = np.linspace(0, 1, CHECKS_PER_INTERVAL + 1)
            t = (phase.t[:-1, None] + inside * np.diff(phase.t)[:, None]).ravel()
            excess = self.family.excess(_samples(phase_polynomial(phase), piece, t))
            result.append(excess.reshape(-1, inside.size))
        return result

    def _motion(
        self,
        solution: Solution,
        history: list[dict[str, Any]],
        timings: list[Reached],
        reached: float,
        kept_by: dict[str, list[str]],
        wall: float,
    ) -> Motion:
        edges = np.cumsum([0.0, *(phase.duration for phase in solution.phases)])
        t_parts, states = [], []
        breaks = [np.zeros(1)]
        for index, (phase, piece) in enumerate(zip(solution.phases, self.pieces, strict=True)):
            last = index + 1 == len(self.pieces)
            local = sample_times(phase.t, np.zeros(0), SAMPLE_STEP, least=5)
            if not last:  # the acceleration may jump where the next piece begins
                local[-1] -= min(JUMP_GAP, 0.01 * (local[-1] - local[-2]))
            t_parts.append(edges[index] + local)
            states.append(State(*_samples(phase_polynomial(phase), piece, local)[:3]))
            breaks.append(edges[index] + phase.t[1:])
        t = np.concatenate(t_parts)
        state = State(*(np.concatenate(parts) for parts in zip(*states, strict=True)))
        passed = [0.0, *(at for at, k in zip(edges[1:], self.pieces, strict=True) if k.via)]
        outcome = verdict(
            self.family, solution, self._excess(solution), self.settings.limit_tolerance
        )
        # the passes know nothing of what is left to the optimal-control problem
        if not (kept_by[LATER] or deadline.over()) and solution.duration > (1 + SLOWER) * reached:
            outcome |= _too_slow(outcome, solution.duration, reached)
        blocked = [self._place(i, t.blocked_at) for i, t in enumerate(timings) if not t.feasible]
        if blocked and not (outcome["status"] == "solved" or deadline.over()):
            outcome |= self._blocking(timings)
        how = "rates on its places" if solution.variables is None else "multiple shooting"
        return Motion.from_state(
            self.robot,
            t,
            state,
            label=self.label,
            breaks=np.concatenate(breaks),
            marks=[Mark(float(at), f"via {i + 1}") for i, at in enumerate(passed)],
            provenance=provenance_of(
                f"time-optimal timing of a given path, {how}",
                outcome,
                solution,
                wall,
                SMOOTHING,
                reachability_duration=reached if np.isfinite(reached) else None,
                limits_kept_by=kept_by,
                blocked_at=blocked,
                stops=[float(s) for s in self.stops],
                solves=history,
            ),
            note=_note(outcome, self.stops, corners(self.path).size, blocked, reached),
        )

    def _place(self, segment: int, at: float) -> float:
        """The path's parameter at a parameter of one of its curves."""
        begin = [float(self.path.breaks[0]), *map(float, self.stops)][segment]
        return begin + float(self.passed[segment].parameter(np.array([at]))[0][0])

    def _blocking(self, timings: list[Reached]) -> dict[str, Any]:
        """Status and advice that name the limits that keep the path from being travelled."""
        fast = compiles(self.settings.compiled)
        lines, entries = [], []
        for index, (curve, timing) in enumerate(zip(self.passed, timings, strict=True)):
            found = None if timing.feasible else blocking_limit(self.family, curve, fast)
            if found is None:
                continue
            member = self.family[found.key]
            name, unit = member.title(found.component), member.units[found.component]
            s = self._place(index, found.at)
            beyond = found.share * abs(found.limit)
            joints = enumerate(found.q)
            at = ", ".join(
                self.robot.position_text(j, float(f"{value:.4g}")) for j, value in joints
            )
            lines.append(
                f"  {name}, {beyond:.4g} {unit} beyond its limit of {found.limit:.6g} {unit}, at "
                f"s = {s:.4g}, q = ({at}), with every limit {100 * found.share:.3g} % larger"
            )
            entries.append(
                {
                    "limit": name,
                    "value": found.limit,
                    "exceeded_by": beyond,
                    "unit": unit,
                    "s": s,
                    "q": found.q.tolist(),
                }
            )
        if not lines:
            return {}
        return {
            "status": str(Status.INFEASIBLE),
            "advice": "\n".join([BLOCKED, *lines]),
            "least_violation": entries,
        }


def _without_gaps(profile: Profile, own: slice, begin: float, end: float) -> dict[str, FloatArray]:
    """Values of a profile from one place to another, integrated from s'' anew.

    Divided by the third power of a short step a gap of 1e-11 in s would be a jerk.
    """
    h, a, d = np.diff(profile.t[own]), profile.a[own], profile.d[own.start : own.stop - 1]
    rise = 0.5 * h * (a[:-1] + a[1:]) - h**2 * d / 12.0
    v = profile.v[own.start] + np.append(0.0, np.cumsum(rise))
    step = h * v[:-1] + h**2 * (2.0 * a[:-1] + a[1:]) / 6.0 - h**3 * d / 24.0
    way = np.append(0.0, np.cumsum(step))
    ratio = (end - begin) / way[-1]
    values = {"s": begin + ratio * way, "v": ratio * v, "a": ratio * a, "d": ratio * d}
    return {name: value[:, None] for name, value in values.items()}


def _too_slow(outcome: dict[str, Any], duration: float, reached: float) -> dict[str, Any]:
    if outcome["status"] != "solved":
        return {}
    return {
        "status": str(Status.SLOWER_THAN_REACHABILITY),
        "advice": (
            f"the solver converged at {duration:.4g} s, but reachability on a grid finds "
            f"{reached:.4g} s: give a finer mesh"
        ),
    }


def _note(
    outcome: dict[str, Any],
    at: FloatArray,
    corner_count: int,
    blocked: list[float],
    reached: float,
) -> str:
    if outcome["status"] != "solved":
        where = f"; the end cannot be reached from s = {blocked[0]:g}" if blocked else ""
        return f"not solved: {outcome['advice']}{where}"
    said = _stops_said(at, corner_count)
    if not np.isfinite(reached):
        return f"{said}; reachability on a grid found no timing"
    return f"{said}; reachability on a grid gives {reached:.4f} s"


def _stops_said(at: FloatArray, corner_count: int) -> str:
    what = "corner" if at.size == corner_count else "jump of the curvature or corner"
    return f"stops at {at.size} {what}{'s' if at.size != 1 else ''}" if at.size else "no stop"


def _declare(
    problem: OptimalControlProblem,
    family: LimitFamily,
    piece: _Piece,
    longest: float,
    scales: dict[str, float],
) -> Phase:
    robot = family.robot
    phase = problem.phase(piece.name, duration=(1e-4, 1e4))
    begin, end = piece.shape.limits
    # Beyond a bent end there is no path.
    most = end if piece.shape.bent and piece.shape.bent_at_end else np.inf
    s = phase.state("s", lower=begin, upper=most, initial=begin, final=end, scale=longest)
    v = phase.state(
        "v",
        lower=0.0,
        initial=0.0 if piece.stops_before else None,
        final=0.0 if piece.stops_after else None,
        scale=scales["v"],
        unit="1/s",
    )
    rated = family.jerk_matters  # then the acceleration is zero at rest
    a = phase.control(
        "a",
        initial=0.0 if rated and piece.stops_before else None,
        final=0.0 if rated and piece.stops_after else None,
        scale=scales["a"],
        unit="1/s^2",
        shape="linear",
    )
    phase.derivative(s, v)
    phase.derivative(v, a)
    constants = phase.parameter("piece", piece.shape.constants)
    degree = piece.shape.coefficients.shape[0] - 1
    q, tangent, curvature, bend = symbolic_derivatives(
        constants, degree, robot.joint_count, piece.shape.powers, s
    )
    qd = tangent * v
    qdd = tangent * a + curvature * v**2
    jerk = tangent * phase.rate(a) + 3 * curvature * v * a + bend * v**3
    keys = [key for key in family.keys if key != "q"]
    usual = evaluate(piece.shape, np.array([0.5 * (begin + end)]))[0][0]
    torques = torques_of(robot, keys)
    declare_limits(phase, family, keys, (q, qd, qdd, jerk), usual, torques)
    phase.end_cost(phase.duration)
    phase.running_cost(SMOOTHING * (phase.rate(a) / (10.0 * scales["a"])) ** 2)
    return phase


def _piece_guess(piece: _Piece, timing: Reached) -> tuple[Guess, float, float]:
    begin, end = piece.shape.limits
    if not timing.feasible:
        duration = 10.0
        speed = 2 * (end - begin) / duration
        values = {"s": lambda f: begin + (end - begin) * f[:, None], "v": speed, "a": 0.0}
        return Guess(duration, values), speed, speed / duration
    own = timing.s - piece.offset
    slack = 1e-9 * piece.shape.span
    inside = (own >= begin - slack) & (own <= end + slack)
    s, x, t = own[inside], timing.speed_squared[inside], timing.t[inside]
    t = t - t[0]
    v = np.sqrt(x)
    a = np.append(np.diff(x) / (2 * np.diff(s)), 0.0)
    a[-1] = a[-2]
    even = a[np.searchsorted(s, np.linspace(s[0], s[-1], s.size))]  # the grid is finer at breaks
    typical = max(float(np.percentile(np.abs(even), 90)), _where_speed_changes(a, t), 1e-6)
    # near a vanishing tangent s'' hardly matters and the grid makes it jump
    a = np.clip(a, -3 * typical, 3 * typical)

    def at(values: FloatArray, f: FloatArray) -> FloatArray:
        return np.interp(f * t[-1], t, values)[:, None]

    values = {
        "s": partial(at, s),
        "v": partial(at, v),
        "a": partial(at, a),
    }
    return Guess(float(t[-1]), values), float(v.max()), typical


def _where_speed_changes(a: FloatArray, t: FloatArray) -> float:
    """Magnitude of s'' below which half of the change of s' happens.

    On a path that runs at a velocity limit but for its ends hardly any grid point accelerates.
    """
    size, change = np.abs(a[:-1]), np.abs(a[:-1]) * np.diff(t)
    order = np.argsort(size)
    half = np.searchsorted(np.cumsum(change[order]), 0.5 * change.sum())
    return float(size[order][min(half, size.size - 1)])


def _along(
    curve: PiecewisePolynomial, duration: float, ends: tuple[float, float], f: FloatArray
) -> FloatArray:
    return np.clip(curve(f * duration), *ends)


def phase_polynomial(phase: Any) -> PiecewisePolynomial:
    """s(t) of a phase [1 column] from s, s' and s'' at its mesh points.

    Cubic between them, or of degree four where s''' changes by d within each interval.
    """
    h = np.diff(phase.t)[:, None]
    s, v, a = phase["s"], phase["v"], phase["a"]
    d = phase["d"] if "d" in phase.values else np.zeros_like(h)
    jerk = np.diff(a, axis=0) / h - 0.5 * d
    table = np.stack([s[:-1], v[:-1], a[:-1] / 2, jerk / 6, d / (24 * h)], axis=1)
    return PiecewisePolynomial(phase.t, table)


def _samples(curve: PiecewisePolynomial, piece: _Piece, t: FloatArray) -> MotionSamples:
    """q, qd, qdd and the jerk of a piece at times t since its start."""
    slope = curve.derivative()
    s = np.clip(curve(t, from_left=True), *piece.shape.limits)
    v = slope(t, from_left=True)
    a = slope.derivative()(t, from_left=True)
    jerk = slope.derivative().derivative()(t, from_left=True)
    q, tangent, curvature, bend = evaluate(piece.shape, s.ravel(), highest=3)
    return MotionSamples(
        q,
        tangent * v,
        tangent * a + curvature * v**2,
        tangent * jerk + 3 * curvature * v * a + bend * v**3,
    )
