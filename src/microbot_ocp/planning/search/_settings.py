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

    What is said of 28 tasks is of random ones of all kinds, tried without the number or with its
    natural value (``python -m benchmarks baseline --only tasks --without NAME=VALUE --against``).

    Attributes
    ----------
    explore_mesh : intervals a phase for the first look: of other meshes optima are others
    explore_tolerance : of its solves: with 1e-4 13 tasks with friction or rates take 1.7 times as
        long; to 1e-6 fatrop does not get on the course's own task
    explore_sum : intervals of its phases together: without it 17 tasks through 9 to 30 via points
        take 1.25 of their time and end up to 4e-4 faster
    least_explore_mesh : intervals of each of them: with fewer, two of 17 tasks through 9 to 30 via
        points are 3e-4 and 2e-3 slower
    same : share of the duration by which two solves of the same optimum may differ: where less
        smoothing is worth less it ends
    worth : share of the duration: less is not worth another mesh where joints turn back, or a jerk
        or torque rate switches. With 0 the motions of a Puma and of a Panda take 2 and 1.4 times as
        long to find
    most_polished : phases of a motion whose last digits are looked for: 29 of the Microbot need
        many iterations. None are looked for with dry friction, where 50 to 80 iterations gain 7e-5
        of the duration
    most_refined : of the optima on the coarse mesh: of 300 tasks three refine another one, in one
        of them it is faster by 1.2e-4
    full_mesh : intervals a phase of the first full mesh where accelerations jump, or jerks or
        torque rates, which is split where they do
    full_mesh_even : the same elsewhere. With 80 three of 13 scenes are 6e-5 to 2.7e-4 slower
    guided_still : iterations within ten times that tolerance after which it is left at that:
        IPOPT's default. A Panda at a shelf has its duration to 1e-7 after 90, and goes on to 300
    full_mesh_sum : intervals of all phases together where nobody says how many: of 14 tasks with
        6 to 30 via points none is faster by more than 4e-4 without it; a Panda takes 1.25 of the
        time through 10 and 20
    least_mesh : intervals a phase in any case: with fewer, five of these 17 are 1.3e-4 to 4.5e-4
        slower
    graded : share of a mesh's intervals that are where the accelerations change. With 0, on 100
        even intervals, 32 tasks take the same time, three are 1.2e-4 to 1.4e-4 slower, and a UR5e
        takes 1.6 times as long
    far_barrier : barrier parameter from the coarse mesh to the full one, with multipliers: 17,
        14, 14 and 62 iterations on four tasks of the Microbot with 1e-5; 22, 14, 15 and 109
        with 1e-7
    foresight : of the accepted excess: intervals near it are split along with the others. With 1
        six of 28 tasks, all of tight torques, are 1.4e-4 to 9e-4 slower
    many_phases : more take over 40 iterations to the full tolerance on a refined mesh. Without it
        three of 28 tasks, of 10 to 30 phases, take 9 to 23 % longer and are up to 3e-5 slower
    spared : share of the time limit that is kept for a motion within the limits when the search
        is over
    most_spared : s, at most
    least_time : s, of the search in any case
    large : intervals times joints from which a mesh is refined no further where a motion that
        is slowed down at limits by no more than enough keeps them. Refined further 32 tasks take
        1.09 of their time and three are 2e-4 to 5e-4 faster; with none and 1e-4 for enough ten are
        slower by 1e-4 to 1e-3
    enough : share of the duration
    near_way_barrier : barrier parameter of a solve that stays near the way that it starts from, as
        that for less effort does
    timed_path_barrier : the same from a timed path among obstacles, which keeps every limit, and on
        the full mesh after it: with 1e-3 the solver leaves one of 1.068 s of a UR5 for an optimum
        of 2.568 s; with 1e-7 the full mesh of one in a cage takes 371 iterations, so 252
    timed_path_tolerance : of that solve and of its finer meshes: with the usual tolerances a UR5 in
        a cage was not solved. A Panda has its motion after 25 iterations, and where the other
        joints rest between their limits, which 1e-6 asks for, after 100. Limits keep their
        distances with it, which costs up to 0.8 % of the duration (of 37 scenes), until the last
        digits
    missed : of the way and the velocity, by which a motion may miss or jump at a via point
    usual_iterations : of the first full mesh: 14 to 43 where coarse meshes tell what happens; of a
        refined one to the full tolerance, before roughly; of the last digits: 8 to 10 are usual,
        from a timed path 2 to 20, of a Panda's cycle 60. With 300 one of 32 tasks, a chain of eight
        joints, takes 37 s in place of 21
    smoother : times the usual smoothing of the jerk, in turn, where coarse meshes do not tell
        what happens: four of five chains of seven and eight joints, which took minutes before,
        get to the full mesh in 5 to 14 s so
    smoothing_told : share of the duration: where the smoothing costs more it is weaker, and
        what it costs all the same is said. Without it six of 28 tasks, of arms from URDF files and
        of tight torques, are 1.2e-4 to 3e-3 slower
    less_smoothing : times the usual smoothing, then
    less_smoothing_barrier : barrier parameter of that solve
    smoother_iterations : of each of these solves, and of a refined mesh: without them a tool at
        1 mm/s takes 62 s for its refined meshes in place of 25; 45 tasks are the same to the bit
    smoother_barrier : barrier parameter of the first of them
    slowest : times the shortest duration: no longer time is given for less effort
    most_iterations : of a start, where another one is solved or may be; of a solve to the rough
        ``timed_path_tolerance``: 20 to 60 are usual, and 100 where much has to give way
    bows : further guesses from the best way through stops: of five tasks of tight torques with
        stops two are 2 and 4 % slower without
    spare : a way is left out whose poses are so many times the best duration apart at the
        highest velocities, where the arm has joints or tolerances to spare: its poses might
        move; without, it is never better. With 1 a UR5e through three positions is 12 % slower
    """

    explore_mesh: int = 20
    explore_tolerance: float = 1e-5
    explore_sum: int = 160
    least_explore_mesh: int = 6
    same: float = 1e-3
    worth: float = 1e-4
    most_polished: int = 15
    most_refined: int = 3
    full_mesh: int = 80
    full_mesh_even: int = 100
    guided_still: int = 15
    full_mesh_sum: int = 400
    least_mesh: int = 25
    graded: float = 0.5
    far_barrier: float = 3e-5
    foresight: float = 0.5
    many_phases: int = 5
    spared: float = 0.2
    most_spared: float = 1.0
    least_time: float = 1e-3
    large: int = 5000
    enough: float = 5e-4
    near_way_barrier: float = 1e-3
    timed_path_barrier: float = 1e-5
    timed_path_tolerance: float = 1e-4
    missed: float = 1e-7
    usual_iterations: int = 100
    smoother: tuple[float, ...] = (1e6, 1e5, 1e4, 1e3, 1e2, 10.0, 1.0)
    smoothing_told: float = 2e-4
    less_smoothing: float = 1e-2
    less_smoothing_barrier: float = 1e-6
    smoother_iterations: int = 200
    smoother_barrier: float = 1e-2
    slowest: float = 20.0
    most_iterations: int = 300
    bows: int = 2
    spare: float = 1.25


SEARCH = SearchSettings()


@dataclass(frozen=True)
class TimeOptimalSettings:
    """How hard to look.

    Attributes
    ----------
    mesh : intervals of each phase in the first full solve; half of them are where the accelerations
        change, except with dry friction and limits that depend on the jerk, where they are even; by
        default 80, with dry friction alone 100, and fewer where there are many phases: 400
        together, but at least 25 each
    starts : how many starting motions to try on the coarse mesh
    tries : how many to try at most, while another is likely to lead to an optimum that none of
        them led to; if it still is in the end the status is "local optimum". Of a single start
        that is solved nothing is known
    slack : share of the shortest duration that may be given for less effort: of all motions at
        most so much slower the one of least effort is returned, the time integral of the squared
        torques, each relative to its limit (of the accelerations where a robot has no masses). Zero
        is the fastest motion but for a smoothing of the jerk, which picks one where many are
        equally fast: it costs 1.3e-5 of the duration of the Microbot task, and is made a hundred
        times weaker where it would cost more than 2e-4 (not with dry friction and limits that
        depend on the jerk); about how much it costs is ``smoothing_cost``, s, in the provenance,
        and in the note from 0.02 % on
    limit_tolerance : largest relative excess of a limit between mesh points; the mesh is refined
        until it holds
    switching_times : whether the times at which one limit takes over from another are solved for
        in the end, each arc a phase of free length: the fastest motion to the accuracy of the
        integrator, with accelerations that jump, and its times in the provenance. Where the arcs
        cannot be found it is the motion of the mesh, and the provenance says why
    solver : "auto" (fatrop explores, IPOPT finishes), "fatrop" or "ipopt" for everything
    compiled : compile the kernels to C where there is a compiler
    seed : of the random starts
    time_limit : wall time, s, after which the best so far is returned with the status "time limit":
        by default 120, and 600 where there are stops, a free order or a scene; infinite is none
    """

    mesh: int | None = None
    starts: int = 5
    tries: int = 30
    slack: float = 0.0
    limit_tolerance: float = 5e-4
    switching_times: bool = False
    solver: str = "auto"
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
        checks.one_of("solver", self.solver, ("auto", "fatrop", "ipopt"))

    def within(self, usual: float) -> AbstractContextManager[None]:
        """Return what is called inside ends at the time limit, s, by default the ``usual`` one."""
        return deadline.within(usual if self.time_limit is None else self.time_limit)


@contextmanager
def sparing() -> Iterator[None]:
    """Keep some of the time inside for a motion within the limits."""
    left = deadline.left()
    with deadline.within(
        max(left - min(SEARCH.spared * left, SEARCH.most_spared), SEARCH.least_time)
    ):
        yield
