"""Free time-optimal motions through via points: both path and timing are optimised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp.limits import JointLimits, Limits, with_reserve
from microbot_ocp.motion import Motion
from microbot_ocp.ocp.solution import StepProgress, quiet
from microbot_ocp.planning.search._among_obstacles import stops_among
from microbot_ocp.planning.search._orders import solve_stops
from microbot_ocp.planning.search._settings import TimeOptimalSettings
from microbot_ocp.planning.search._through_stops import (
    SolveRequest,
    fastest_through,
    with_load_noted,
)
from microbot_ocp.planning.task import (
    CELL_TIME_LIMIT,
    TIME_LIMIT,
    Segment,
    Stop,
    Task,
    check_limits,
    check_via,
    is_task,
    robust_limits,
    with_changes,
    with_drives_noted,
)
from microbot_ocp.robot import Robot
from microbot_ocp.scene import Scene

UNCERTAIN = ("mass", "friction")


def time_optimal(
    robot: Robot,
    via_q: ArrayLike | Sequence[Stop],
    limits: Limits | JointLimits | None = None,
    *,
    reserve: ArrayLike = 0.0,
    payload: tuple[float, float] = (0.0, 0.0),
    uncertain: Mapping[str, float] | None = None,
    segments: Sequence[Segment] | None = None,
    cycle: bool = False,
    order: str = "given",
    duration: float | None = None,
    scene: Scene | None = None,
    settings: TimeOptimalSettings | None = None,
    progress: StepProgress | None = None,
    **changes: Any,
) -> Motion:
    """Return the fastest motion through via points, at rest at both ends.

    The other via points are passed at any velocity.

    Minimises the sum of the phase durations subject to every limit: of positions, velocities,
    accelerations, jerk, torques, their rates, and those of ``limits.also``.

    Parameters
    ----------
    robot : Robot
        Robot; without masses only limits of the motion apply, none of torques.
    via_q : array_like [m,n], or sequence of Stop
        Via points, rad (m for prismatic joints), or stops: tool poses, tolerances, velocities,
        dwells and payloads (:class:`~microbot_ocp.Stop`).
    limits : Limits, optional
        Default: the robot's own.
    reserve : float or array_like [n]
        Share of the torque limits reserved for feedback, for all joints or per joint.
    payload : (float, float)
        Least and largest point mass at the tool, kg: torque limits hold for every mass between.
    uncertain : mapping, optional
        Largest relative errors of every "mass" and "friction", such as ``{"mass": 0.05}``. Torque
        limits hold for every such arm; pass ``mo.execution.robust_limits`` to certificates and
        other planners.
    segments : sequence, optional
        Segment between each stop and the next: a :class:`~microbot_ocp.Line`,
        :class:`~microbot_ocp.Circle` or :class:`~microbot_ocp.JointLine`, or None for a free one.
    cycle : bool
        Return to the first stop with its velocity, in the shortest period; ``segments`` has one
        more entry.
    order : str
        "free" searches all orders of at most 7 stops; the first stop keeps its place, and so does
        the last unless the motion is a cycle. Orders are compared by coarse answers, in the
        ``scene`` if there is one, and those within 1 % of the best are refined; lower bounds and
        estimates from timed paths exclude others. Two stops with a segment between them stay
        neighbours. The provenance lists the result of every order as ``orders``.
    duration : float, optional
        Available time, s: the motion of least effort that takes no longer is returned, as with
        ``slack``.
    scene : Scene, optional
        Obstacles from which the arm keeps clear, as its links do from each other; needs the extra
        ``cell``. The provenance holds the proved clearance and the initial paths.
    settings : TimeOptimalSettings, optional
        Single settings may be keywords instead: ``mesh``, ``starts``, ``tries``, ``slack``,
        ``limit_tolerance``, ``switching_times``, ``solver``, ``compiled``, ``seed``,
        ``time_limit`` (default 120 s of work, and 600 s with stops, a free order or a scene).
    progress : callable, optional
        Function called with a line of text at every step, and with a
        :class:`~microbot_ocp.planning.MotionIteration` at every iteration of a solver.

    Returns
    -------
    Motion
        ``motion.solved`` is True if the solver converged; ``motion.provenance`` holds status,
        advice, every start with its duration, and every mesh.

    Raises
    ------
    InputError
        Invalid via points or limits; raised before any solver starts.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> via_q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
    >>> motion = mo.time_optimal(mo.load_robot("microbot"), via_q, mesh=40, starts=1)
    >>> motion.solved, round(motion.duration, 2)
    (True, 1.92)

    One motion for every arm with masses off by up to 5 %, with up to 0.2 kg at the tool:

    >>> robot, box = mo.load_robot("microbot"), {"payload": (0.0, 0.2)}
    >>> motion = mo.time_optimal(
    ...     robot, via_q, **box, uncertain={"mass": 0.05}, mesh=20, starts=1
    ... )
    >>> limits = mo.execution.robust_limits(robot, mass=0.05, **box)
    >>> round(motion.duration, 2), mo.certify(robot, motion, limits).ok
    (2.12, True)
    """
    chosen = with_changes(settings or TimeOptimalSettings(), changes)
    limits = with_reserve(robot.limits, limits, reserve)
    for name in uncertain or {}:
        checks.one_of("uncertain", name, UNCERTAIN)
    if any(payload) or uncertain:
        limits = robust_limits(robot, limits, payload=payload, **(uncertain or {}))
    checks.one_of("order", order, ("given", "free"))
    report = progress or quiet
    plain = segments is None and not cycle and order == "given" and duration is None
    if plain and not is_task(via_q):
        family = check_limits(robot, limits, means=scene is None)
        via = check_via(family, cast("ArrayLike", via_q))
        task = Task.through(family, via)
        if scene is None:
            return fastest_through(task, chosen, report, usual=TIME_LIMIT)
        via_q = task.stops
    if not isinstance(via_q, Sequence) and np.ndim(cast("Any", via_q)) == 0:
        raise InputError(f"via_q must be stops or poses, not {checks.shown(via_q)}")
    stops = list(cast("Sequence[Any]", via_q))
    request = SolveRequest(
        robot, limits, stops, segments, cycle, chosen, report, order, duration, scene
    )
    if scene is None:
        return with_drives_noted(robot, solve_stops(request), limits)
    with chosen.within(CELL_TIME_LIMIT) as limit:
        motion = with_load_noted(stops_among(request), limit)
    return with_drives_noted(robot, motion, limits)
