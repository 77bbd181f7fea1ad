"""Settings of the search for free motions, and the time that it may take."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import InputError


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the search for a free motion.

    The effect of one number is measured by ``python -m benchmarks baseline --only tasks --without
    NAME=VALUE --against FILE``.

    Attributes
    ----------
    explore_mesh : largest number of intervals per phase of a coarse mesh
    explore_tolerance : solver tolerance on coarse meshes, relative
    exploring : share of the time limit after which no further start is solved
    explore_sum : intervals of all phases of a coarse mesh together
    least_explore_mesh : smallest number of intervals per phase of a coarse mesh
    same_optimum : relative difference of durations below which two solutions count as one optimum
    least_gain : relative gain of the duration below which no further mesh is solved
    most_polished : largest number of phases for which the full solver tolerance is asked
    full_mesh : intervals per phase of the first full mesh, for jumps of accelerations or rates
    full_mesh_even : intervals per phase of the first full mesh, for continuous accelerations
    acceptable_iterations : acceptable iterations after which IPOPT stops among obstacles
    full_mesh_sum : intervals of all phases of the first full mesh together
    least_mesh : smallest number of intervals per phase of the first full mesh
    graded_share : share of the intervals that follows changes of the acceleration
    far_barrier : barrier parameter of a warm start from a coarse to a full mesh
    foresight : share of the accepted excess from which an interval is split
    many_phases : number of phases up to which multipliers of the coarse mesh are reused
    reserved_share : share of the time limit reserved for a motion within the limits
    longest_reserve : longest reserved time, s
    least_time : shortest time of a search, s
    large_mesh : intervals times joints from which slowing down may replace refinement
    largest_slowdown : largest relative slowdown that replaces refinement
    near_way_barrier : barrier parameter of a solve that stays near its initial guess
    timed_path_barrier : barrier parameter of a solve from a timed path among obstacles
    timed_path_tolerance : solver tolerance among obstacles, relative
    via_tolerance : relative position error and velocity jump allowed at a via point
    usual_iterations : iteration limit of a full or refined mesh, and of the last digits
    smoothing_factors : factors on the usual jerk weight, applied one after another
    smoothing_cost_limit : relative cost of jerk smoothing from which the weight is reduced
    reduced_smoothing : factor on the jerk weight of the reduced smoothing
    reduced_barrier : barrier parameter of the solve with reduced smoothing
    smoothing_iterations : iteration limit of each solve with increased smoothing
    smoothing_barrier : barrier parameter of the first solve with increased smoothing
    largest_slack : largest slack for least effort, relative to the shortest duration
    most_iterations : iteration limit of a start, and of a solve among obstacles
    curved_guesses : number of curved initial guesses along the best way through stops
    prune_factor : velocity bound, per best duration, above which a redundant way is skipped
    """

    explore_mesh: int = 20
    explore_tolerance: float = 1e-5
    exploring: float = 0.5
    explore_sum: int = 160
    least_explore_mesh: int = 6
    same_optimum: float = 1e-3
    least_gain: float = 1e-4
    most_polished: int = 15
    full_mesh: int = 80
    full_mesh_even: int = 100
    acceptable_iterations: int = 15
    full_mesh_sum: int = 400
    least_mesh: int = 25
    graded_share: float = 0.5
    far_barrier: float = 3e-5
    foresight: float = 0.1
    many_phases: int = 5
    reserved_share: float = 0.2
    longest_reserve: float = 1.0
    least_time: float = 1e-3
    large_mesh: int = 5000
    largest_slowdown: float = 5e-4
    near_way_barrier: float = 1e-3
    timed_path_barrier: float = 1e-5
    timed_path_tolerance: float = 1e-4
    via_tolerance: float = 1e-7
    usual_iterations: int = 100
    smoothing_factors: tuple[float, ...] = (1e6, 1e5, 1e4, 1e3, 1e2, 10.0, 1.0)
    smoothing_cost_limit: float = 2e-4
    reduced_smoothing: float = 1e-2
    reduced_barrier: float = 1e-6
    smoothing_iterations: int = 200
    smoothing_barrier: float = 1e-2
    largest_slack: float = 20.0
    most_iterations: int = 300
    curved_guesses: int = 2
    prune_factor: float = 1.25


SEARCH = SearchSettings()


@dataclass(frozen=True)
class TimeOptimalSettings:
    """Settings of a time-optimal motion.

    Attributes
    ----------
    mesh : int, optional
        Intervals of each phase in the first full solve, 80 by default, fewer for more than 5
        phases. Half of them follow changes of the acceleration, unless dry friction or limits that
        depend on the jerk ask for an even mesh. The default is 100 for dry friction alone. Many
        phases have 400 together, but at least 25 each.
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
        Wall time, s, after which the best motion so far is returned with the status "time limit".
        Default 120, and 600 with stops, a free order or a scene; infinite means no limit.
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

    def within(self, usual: float) -> AbstractContextManager[None]:
        """Return a context that ends at the time limit, s; ``usual`` is the default limit."""
        return deadline.within(usual if self.time_limit is None else self.time_limit)


@contextmanager
def reserving() -> Iterator[None]:
    """Reserve a part of the remaining time for a motion within the limits.

    The reserve is ``min(reserved_share * t, longest_reserve)`` of the remaining time t.
    """
    left = deadline.left()
    with deadline.within(
        max(left - min(SEARCH.reserved_share * left, SEARCH.longest_reserve), SEARCH.least_time)
    ):
        yield
