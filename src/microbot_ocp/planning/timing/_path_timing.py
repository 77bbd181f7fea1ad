"""The best timing of a given joint path, from rest to rest.

The path is given and s(t) is unknown. If the reachability passes cover every limit, they give the
global optimum on a grid (``_reachability.py``). Otherwise one program on places of the path starts
from their result (``_places_timing.py``). At a corner of the path, where its tangent jumps, the arm
stops. If no timing is feasible, the result names the blocking limits.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.codegen import compiles
from microbot_ocp._base.outcome import Advice, Outcome
from microbot_ocp._base.status import Status
from microbot_ocp.limits import LIMIT_TOLERANCE, JointLimits, LimitFamily, Limits, with_reserve
from microbot_ocp.motion import SAMPLE_STEP, Mark, Motion, PiecewisePolynomial, State, sample_times
from microbot_ocp.ocp.solution import StepProgress, quiet
from microbot_ocp.planning.path import (
    LATER,
    SETTLED_CHANGE,
    CurveLimits,
    PathCurve,
    Reached,
    blocking_limit,
    check_path,
    corners,
    harmonic,
    limits_kept_by,
    path_grid,
    reach,
    sampled,
    segments,
    stops,
)
from microbot_ocp.planning.task import (
    TIME_LIMIT,
    TaskScale,
    check_limits,
    single_joint_rates,
    with_changes,
    with_drives_noted,
    with_locked_joints_held,
)
from microbot_ocp.planning.timing._places_program import SMOOTHING_WEIGHT
from microbot_ocp.planning.timing._places_timing import (
    SpeedProfile,
    excess_of,
    timed_on_places,
)
from microbot_ocp.robot import Robot

LATE = "The time was over before the grid was fine enough; a longer time_limit may find less time."
TOO_LATE = "The time was over before a timing was found that keeps limits of {}: this one does not."
BLOCKED = (
    "No timing of the path keeps the limits. On a grid, viscous friction left out, the least that "
    "has to give, all limits by the same share, is:"
)
EXCEEDED = (
    "limits are exceeded by {:.3g} % between mesh points, and refinement ended there: widen the "
    "limit that is exceeded, or look for a place that cannot be passed"
)
UNSOLVED = (
    "The program on places of the path ended with {!r}: no timing was found that keeps {}. This "
    "one exceeds limits by {:.3g} %"
)


# Words for the method of a motion in its provenance.
PASSES, WALK = "reachability", "harmonic in its parameter"
PLACES_METHOD = "one program on its places"


@dataclass(frozen=True)
class PathTimingSettings:
    """Settings of path timing.

    Attributes
    ----------
    grid : int
        Initial number of points of the reachability passes on each smooth segment; refined until
        the duration settles.
    limit_tolerance : float
        Largest relative excess of a limit between grid or mesh points.
    compiled : bool
        Compile to C if there is a compiler.
    time_limit : float
        Wall time, s, after which the best timing so far is returned with the status "time limit";
        infinite means no limit.
    """

    grid: int = 1000
    limit_tolerance: float = LIMIT_TOLERANCE / 10.0  # closer than a certificate asks for
    compiled: bool = True
    time_limit: float = TIME_LIMIT

    def __post_init__(self) -> None:
        checks.time_limit(self.time_limit)
        checks.whole("grid", self.grid, "points", at_least=10)
        checks.number("limit_tolerance", self.limit_tolerance, above=0.0)


def time_optimal_path(
    robot: Robot,
    path: PiecewisePolynomial,
    limits: Limits | JointLimits | None = None,
    *,
    reserve: ArrayLike = 0.0,
    settings: PathTimingSettings | None = None,
    label: str = "path, best timing",
    progress: StepProgress | None = None,
    **changes: Any,
) -> Motion:
    """Find the fastest motion along a path, at rest at both ends and at its corners.

    Under limits of the torque rate or the jerk the arm also rests wherever the curvature of the
    path jumps. Reachability covers limits that are affine in s'' and s'^2 (torque, acceleration)
    and velocity limits, on a grid that is refined until they hold between its points. With other
    limits (torque rates, jerk, power, custom expressions) a program covers all of them. It starts
    from the reachability result, has places on the path as mesh points and evaluates no dynamics.
    The provenance's ``limits_kept_by`` assigns each limit to its method.

    Parameters
    ----------
    robot : Robot
        Robot; without masses only limits of the motion apply, none of torques.
    path : PiecewisePolynomial
        Joint positions over any path parameter: a trajectory, whose timing is replaced, or
        :func:`straight_path`.
    limits : Limits, optional
        Default: the robot's own.
    reserve : float or array_like [n]
        Share of the torque limits reserved for feedback, for all joints or per joint.
    settings : PathTimingSettings, optional
        Single settings may be keywords instead: ``grid``, ``limit_tolerance``, ``compiled``,
        ``time_limit`` (default 120 s).

    Returns
    -------
    Motion
        ``motion.solved`` is True if the solver converged; the provenance also holds the duration
        found by reachability.

    Raises
    ------
    InputError
        A path outside the position limits, an end or corner that cannot be held at rest, invalid
        limits, or an expression of a limit without derivatives; raised before any solver starts.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> path = mo.straight_path(np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]]))
    >>> motion = mo.time_optimal_path(mo.load_robot("microbot"), path)
    >>> motion.solved
    True
    """
    chosen = with_changes(settings or PathTimingSettings(), changes)
    family = check_limits(robot, with_reserve(robot.limits, limits, reserve))
    check_path(family, path)
    return best_timing(family, path, chosen, label, progress or quiet)


def best_timing(
    family: LimitFamily,
    path: PiecewisePolynomial,
    settings: PathTimingSettings,
    label: str,
    progress: StepProgress,
) -> Motion:
    """Find the fastest motion along a checked path, as :func:`time_optimal_path` does."""
    moving = with_locked_joints_held(family, None)
    with deadline.within(settings.time_limit):
        motion = _PathSearch(moving, path, settings, label, progress).run()
    return with_drives_noted(family.robot, motion)


MOST_GRIDS = 9  # largest number of grids of a segment
MOST_POINTS = 40_000  # points above which a grid is not refined
MOST_SETTLING_POINTS = 8000  # points above which the duration alone does not refine a grid
SHORTEST_INTERVAL = 2e-5  # length of the shortest interval that is halved, s
SHORTEST_SHARE = 1e-4  # length of the shortest interval that is halved, per duration
LARGEST_MESH = 100  # largest initial number of intervals per piece for the program on places
MESH_OF_ALL = 200  # initial number of intervals of all pieces together
LEAST_MESH = 20  # smallest initial number of intervals per piece


@dataclass
class _PathSearch:
    """Search for a timing: reachability on every smooth segment, and the program on places.

    docs/theory/path_timing.md, "Reachability" and "One program on places".
    """

    family: LimitFamily
    path: PiecewisePolynomial
    settings: PathTimingSettings
    label: str
    progress: StepProgress

    def __post_init__(self) -> None:
        self.fast = compiles(self.settings.compiled)
        self.robot: Robot = self.family.robot
        self.stops = stops(self.path, self.family)
        self.passed = segments(self.path, self.stops)  # segments of the reachability passes
        self.curves = self.passed
        if self.family.jerk_matters:
            # Limited rates need s'' = 0 at rest: the arm leaves like r^3, p = 3 in equation (4).
            self.curves = segments(self.path, self.stops, 3)

    def run(self) -> Motion:
        """Time the path."""
        self.begin = time.perf_counter()
        settled = [self._settled(curve) for curve in self.passed]
        timings, excess = [timing for timing, _, _ in settled], max(most for *_, most in settled)
        self.limits_kept_by = limits_kept_by(settled[0][1].limits)
        self.reached = sum(timing.duration for timing in timings)  # NaN if a segment is blocked
        self.blocked_at = [
            self._place(i, timing.blocked_at)
            for i, timing in enumerate(timings)
            if not timing.feasible
        ]
        for at in self.blocked_at:
            self.progress(f"reachability: the end cannot be reached from s = {at:g}")
        if self.blocked_at:
            # Unless a relaxation of the half planes explains the block, the program on places
            # decides: the grid may be the cause.
            rows, entries = self._blocking(timings)
            timings = [self._walk(*each) for each in zip(self.passed, timings, strict=True)]
            if rows:
                excess = [
                    CurveLimits.of(self.family, curve, timing.s, self.fast).excess(timing)
                    for curve, timing in zip(self.passed, timings, strict=True)
                ]
                worst = float(np.max(np.concatenate(excess)))
                outcome = Outcome.of(Status.INFEASIBLE, BLOCKED, *rows)
                return self._motion(timings, WALK, outcome, excess=worst, least_violation=entries)
        else:
            self.progress(f"reachability on a grid: {self.reached:.6f} s")
            complete = not self.limits_kept_by[LATER] and excess <= self.settings.limit_tolerance
            if complete or deadline.over():
                return self._passes_motion(timings, excess)
        # A feasible timing of the passes is an answer: at the time limit the program is given up.
        try:
            with deadline.given_up(not self.blocked_at):
                profiles = self._on_places(self._starts(timings))
        except deadline.Over:
            return self._passes_motion(timings, excess)
        return self._profile_motion(profiles)

    def _settled(self, curve: PathCurve) -> tuple[Reached, CurveLimits, float]:
        """Return a timing on a grid that is refined until it settles and limits hold inside.

        The last value is the largest relative excess of a limit inside an interval. Under limits of
        rates the timing is a start only, and one grid suffices.
        """
        s, duration = path_grid(curve, self.settings.grid), np.inf
        for left in range(0 if self.family.jerk_matters else MOST_GRIDS - 1, -1, -1):
            along = CurveLimits.of(self.family, curve, s, self.fast)
            timing = reach(along)
            if not timing.feasible:
                return timing, along, np.inf
            excess = along.excess(timing)
            apart = abs(timing.duration - duration) > SETTLED_CHANGE * timing.duration
            # Intervals with an excess are halved, and all of them while the duration changes. A
            # very short interval cannot matter.
            cut = excess > self.settings.limit_tolerance
            cut |= apart and s.size <= MOST_SETTLING_POINTS
            cut &= np.diff(timing.t) > min(SHORTEST_INTERVAL, SHORTEST_SHARE * timing.duration)
            if not cut.any() or not left or s.size > MOST_POINTS or deadline.over():
                break
            duration = timing.duration
            s = np.sort(np.concatenate([s, (0.5 * (s[1:] + s[:-1]))[cut]]))
        return timing, along, float(excess.max())

    def _walk(self, curve: PathCurve, timing: Reached) -> Reached:
        """Return a feasible timing unchanged, or a slow one at the pace of its slowest joint."""
        if timing.feasible:
            return timing
        # Poses between the ends show joints that go and return.
        shares = np.linspace(curve.breaks[0], curve.breaks[-1], 2 * len(curve.pieces) + 1)
        lasts = float(TaskScale.of(self.family, curve.evaluate(shares)[0]).durations.sum())
        return harmonic(timing.s, lasts)

    def _starts(self, timings: list[Reached]) -> list[Reached]:
        """Return starts of the program: timings on its mesh that respect all limits roughly.

        Limits that the passes cannot keep bound the speed as if it were constant. Under limits of
        rates no joint is faster than it would be alone.
        """
        starts = []
        pieces = sum(len(curve.pieces) for curve in self.curves)
        count = max(min(LARGEST_MESH, MESH_OF_ALL // pieces), LEAST_MESH)
        for passed, curve, timing in zip(self.passed, self.curves, timings, strict=True):
            rise, gentle = 0.0, timing
            if not self.blocked_at:
                family, jerk = self.family, np.full(self.robot.joint_count, np.inf)
                if family.jerk_matters:
                    jerk, more = single_joint_rates(family, passed.evaluate(timing.s)[0])
                    family = LimitFamily.of(self.robot, self.robot.limits.changed(more))
                along = CurveLimits.of(family, passed, self.settings.grid, self.fast)
                gentle = reach(along, fastest=along.steady_speed())
                # Rise: the time in which the allowed jerk builds up the largest acceleration.
                _, tangent, curvature = passed.evaluate(gentle.s)
                rises = np.append(gentle.start, gentle.end[-1])[:, None]
                qdd = tangent * rises + curvature * gentle.speed_squared[:, None]
                rise = min(float((np.abs(qdd).max(axis=0) / jerk).max()), gentle.duration)
            starts.append(gentle.smoothed(passed, curve, rise, count))
        return starts

    def _on_places(self, starts: list[Reached]) -> list[SpeedProfile]:
        """Time all segments under limits of any form, refined until they hold."""
        profiles: list[SpeedProfile] = []
        tolerance = self.settings.limit_tolerance
        for curve, start in zip(self.curves, starts, strict=True):
            profile = SpeedProfile.of(curve, start)
            if all(earlier.solved for earlier in profiles):
                profile = timed_on_places(self.family, profile, tolerance, self.fast, self.progress)
            profiles.append(profile)
        return profiles

    def _passes_motion(self, timings: list[Reached], excess: float) -> Motion:
        outcome = Outcome()
        if deadline.over():
            left = self.limits_kept_by[LATER]
            advice = TOO_LATE.format(", ".join(left)) if left else LATE
            outcome = Outcome.of(deadline.status(), advice)
        return self._motion(timings, PASSES, outcome, excess=excess)

    def _profile_motion(self, profiles: list[SpeedProfile]) -> Motion:
        """Return the profiles of all segments as a motion with its outcome."""
        attempts = [attempt for profile in profiles for attempt in profile.attempts]
        excess = max(float(excess_of(self.family, profile).max()) for profile in profiles)
        status = attempts[-1].status
        names = ", ".join(self.limits_kept_by[LATER]) or "every limit"
        advice = UNSOLVED.format(str(status), names, 100 * excess)
        if deadline.over() and status is not Status.INTERRUPTED:
            status = deadline.status()
            advice = status.sentence
        elif status.solved:
            advice = ""
            if not excess <= self.settings.limit_tolerance:
                status, advice = Status.LIMITS_EXCEEDED, EXCEEDED.format(100 * excess)
        profiles = [profile.without_gaps() for profile in profiles]
        return self._motion(
            profiles,
            PLACES_METHOD,
            Outcome.of(status, advice),
            excess=excess,
            solver=attempts[-1].solver,
            gap=sum(profile.gap for profile in profiles),  # bound on the distance to the optimum, s
            smoothing=SMOOTHING_WEIGHT,
            solves=[attempt.as_dict() for attempt in attempts],
        )

    def _samples(self, profiles: Sequence[SpeedProfile]) -> tuple[FloatArray, State, FloatArray]:
        """Return times, states and breaks of profiles; s'' may jump at corners and breaks."""
        begins = np.cumsum([0.0, *(profile.duration for profile in profiles)])
        breaks = [np.zeros(1)]
        jumps = [begins[1:-1]]
        for begin, profile in zip(begins, profiles, strict=False):
            breaks.append(begin + profile.t[1:])
            if not self.family.jerk_matters:
                # A jump of s'' needs a sample on both sides.
                jumps.append(begin + profile.t[1:-1][profile.a_end[:-1] != profile.a[1:]])
        edges = np.concatenate(breaks)
        t = sample_times(edges, np.concatenate(jumps), SAMPLE_STEP, least=5)
        i = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, edges.size - 2)
        states, first = [], 0
        for profile in profiles:
            here = (i >= first) & (i < first + profile.a.size)
            states.append(profile.samples(i[here] - first, t[here] - edges[i[here]])[:3])
            first += profile.a.size
        return t, State(*(np.concatenate(parts) for parts in zip(*states, strict=True))), edges

    def _motion(
        self, parts: Sequence[Reached | SpeedProfile], how: str, outcome: Outcome, **more: Any
    ) -> Motion:
        """Return timings of all segments as a motion with its provenance."""
        if profiles := [part for part in parts if isinstance(part, SpeedProfile)]:
            curves, (t, state, breaks) = self.curves, self._samples(profiles)
        else:
            curves, timings = self.passed, [part for part in parts if isinstance(part, Reached)]
            t, state, breaks = sampled(list(zip(curves, timings, strict=True)))
        blocked = [
            Advice("blocked", f"the end cannot be reached from s = {at:g}", "s", at)
            for at in self.blocked_at[:1]
        ]
        durations = [part.duration for part in parts]
        passed = [0.0]
        for begin, curve, part in zip(np.cumsum([0.0, *durations]), curves, parts, strict=False):
            # The end of a halved piece is no break of the path, so it is no via point.
            ends = begin + np.interp(curve.breaks[1:], part.s, part.t)
            passed += [at for at, k in zip(ends, curve.pieces, strict=True) if not k.halved]
        return Motion.from_state(
            self.robot,
            t,
            state,
            label=self.label,
            breaks=breaks,
            marks=[Mark(float(at), f"via {i + 1}") for i, at in enumerate(passed)],
            provenance={
                "method": f"time-optimal timing of a given path, {how}",
                "intervals": [part.t.size - 1 for part in parts],
                "phase_durations": durations,
                "reachability_duration": self.reached if np.isfinite(self.reached) else None,
                "limits_kept_by": self.limits_kept_by,
                "blocked_at": self.blocked_at,
                "stops": [float(s) for s in self.stops],
                "wall_time": time.perf_counter() - self.begin,
                "casadi": ca.CasadiMeta.version(),
                **more,
            },
            remark=self._remark(how),
        ).ended(outcome if outcome.solved else outcome.and_(*blocked))

    def _remark(self, how: str) -> str:
        count = self.stops.size
        word = "corner" if count == corners(self.path).size else "jump of the curvature or corner"
        rests = f"stops at {count} {word}{'s' if count != 1 else ''}" if count else "no stop"
        if how == PASSES:
            return rests
        if not np.isfinite(self.reached):
            return f"{rests}; reachability on a grid found no timing"
        return f"{rests}; reachability on a grid gives {self.reached:.4f} s"

    def _place(self, segment: int, at: float) -> float:
        """Return the path's parameter at a parameter of one of its segments."""
        begin = [float(self.path.breaks[0]), *map(float, self.stops)][segment]
        return begin + float(self.passed[segment].parameter(np.array([at]))[0][0])

    def _blocking(self, timings: list[Reached]) -> tuple[list[Advice], list[dict[str, Any]]]:
        """Return the limits that block the path, as advice and as numbers."""
        rows, entries = [], []
        for index, (curve, timing) in enumerate(zip(self.passed, timings, strict=True)):
            limit = None if timing.feasible else blocking_limit(self.family, curve, self.fast)
            if limit is None:
                continue
            member = self.family[limit.key]
            name, unit = member.title(limit.component), member.units[limit.component]
            s = self._place(index, limit.at)
            beyond = limit.share * abs(limit.limit)
            joints = enumerate(limit.q)
            at = ", ".join(
                self.robot.position_text(j, float(f"{value:.4g}")) for j, value in joints
            )
            sentence = (
                f"  {name}, {beyond:.4g} {unit} beyond its limit of {limit.limit:.6g} {unit}, at "
                f"s = {s:.4g}, q = ({at}), with every limit {100 * limit.share:.3g} % larger"
            )
            rows.append(Advice("limit", sentence, name, beyond, unit))
            entries.append(
                {
                    "limit": name,
                    "value": limit.limit,
                    "exceeded_by": beyond,
                    "unit": unit,
                    "s": s,
                    "q": limit.q.tolist(),
                }
            )
        return rows, entries
