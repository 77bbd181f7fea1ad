"""Settings of the search for free motions, and the time that it may take."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import ROUNDING, InputError

COARSE_MESH = 20  # largest number of intervals per phase of a coarse mesh
FULL_MESH = 80  # intervals per phase of the first full mesh, for jumps of accelerations or rates
LEAST_GAIN = 1e-4  # relative gain of the duration below which no further mesh is solved
COARSE_TOLERANCE = 1e-5  # solver tolerance on coarse meshes, relative
SAME_OPTIMUM = 1e-3  # relative difference of durations of one optimum
NEAR_WAY_BARRIER = 1e-3  # barrier parameter of a solve that stays near its initial guess
SMOOTHING_COST_LIMIT = 2e-4  # relative cost of jerk smoothing from which the weight is reduced
TIMED_PATH_BARRIER = 1e-5  # barrier parameter of a solve from a timed path among obstacles
MOST_ITERATIONS = 300  # iteration limit of a start, and of a solve among obstacles
RESERVED_SHARE = 0.2  # share of the time limit reserved for a motion within the limits
LONGEST_RESERVE = 1.0  # s


@dataclass(frozen=True)
class TimeOptimalSettings:
    """Settings of a time-optimal motion.

    Attributes
    ----------
    mesh : int, optional
        Intervals of each phase in the first full solve, 80 by default, fewer for more than 5
        phases. Half of them follow changes of the acceleration. The default is 100 for dry friction
        alone. Many phases have 400 together, but at least 25 each.
    starts : int
        Number of initial guesses on the coarse mesh.
    tries : int
        Largest number of initial guesses, while another one is likely to lead to a new optimum. If
        it still is at the end the status is "local optimum". A single start is not judged.
    slack : float
        Share of the shortest duration that may be spent for less effort. Effort is the time
        integral of the squared torques, each relative to its limit (of the accelerations of a robot
        without masses). Zero returns the fastest motion, with a smoothing of the jerk that selects
        one of many equally fast motions. The smoothing costs 1.3e-5 of the duration of the Microbot
        task and is made a hundred times weaker if it costs more than 2e-4 (not with dry friction
        or limits that depend on the jerk). The provenance holds the cost as ``smoothing_cost``, s;
        the remark reports it from 0.02 % on.
    limit_tolerance : float
        Largest relative excess of a limit between mesh points; the mesh is refined until it holds.
    switching_times : bool
        Solve for the switching times at the end: each arc is a phase of free length, and the motion
        is exact up to the integrator, with accelerations that jump. The provenance holds the
        switching times, or the reason why the arcs were not found and the motion of the mesh is
        returned.
    compiled : bool
        Compile the kernels to C if there is a compiler.
    seed : int
        Seed of the random starts.
    time_limit : float, optional
        Wall time, s, after which the best motion so far is returned with the status "time limit";
        infinite means no limit. The default depends little on the load of the machine: 120 s of
        processor time, 600 s with stops, a free order or a scene, and ten times as much wall time.
    """

    mesh: int | None = None
    starts: int = 5
    tries: int = 30
    slack: float = 0.0
    limit_tolerance: float = 5e-4
    switching_times: bool = False
    compiled: bool = True
    seed: int = 0
    time_limit: float | None = None

    def __post_init__(self) -> None:
        if self.time_limit is not None:
            checks.time_limit(self.time_limit)
        if self.mesh is not None:
            checks.whole("mesh", self.mesh, "intervals", at_least=4)
        checks.whole("starts", self.starts, at_least=1)
        checks.whole("tries", self.tries, at_least=0)
        checks.whole("seed", self.seed, at_least=0, at_most=2**63)
        checks.number("slack", self.slack, at_least=0.0)
        checks.number("limit_tolerance", self.limit_tolerance, above=0.0)
        if self.switching_times and self.slack:
            raise InputError("switching_times are those of the fastest motion: slack must be 0")

    def within(self, usual: float) -> AbstractContextManager[deadline.Begin]:
        """Return a context that ends at the time limit, or by default after ``usual`` s of work."""
        if self.time_limit is None:
            return deadline.of_work(usual)
        return deadline.within(self.time_limit)


@contextmanager
def reserving() -> Iterator[None]:
    """Reserve a part of the remaining time for a motion within the limits.

    The reserve is ``min(reserved_share * t, longest_reserve)`` of the remaining time t.
    """
    left = deadline.left()
    reserve = min(RESERVED_SHARE * left, LONGEST_RESERVE)
    wall, work = deadline.until() - time.perf_counter(), deadline.work_left()
    # A time limit is above 0, also if no time is left.
    with deadline.within(max(wall - reserve, ROUNDING), max(work - reserve, ROUNDING)):
        yield
