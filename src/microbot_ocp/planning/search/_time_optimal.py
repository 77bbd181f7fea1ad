"""Free time-optimal motions through via points: path and timing are both found."""

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
from microbot_ocp.planning.search._orders import solve_stops
from microbot_ocp.planning.search._settings import TimeOptimalSettings
from microbot_ocp.planning.search._through_stops import Asked, fastest_through
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
    """Return the fastest motion through via points: at rest at both ends, passing the others at any
    speed.

    Minimises the sum of the phase durations subject to every limit: of positions, velocities,
    accelerations, jerk, torques, their rates, and those of ``limits.also``.

    Parameters
    ----------
    robot : Robot
        Without masses only limits of its motion count, none of torques.
    via_q : array_like [m,n], or sequence of Stop
        Via points, rad (m for prismatic joints). Among them may be stops: tool poses, tolerances,
        velocities, dwells and payloads (:class:`~microbot_ocp.Stop`).
    limits : Limits, optional
        Default the robot's own.
    reserve : float or array_like [n]
        Share of the torque limits that is kept back for feedback, of all joints or one a joint.
    payload : (float, float)
        Least and largest point mass at the tool, kg: torques are kept for every one between them.
    uncertain : mapping, optional
        Shares by which every "mass" and "friction" may be off: ``{"mass": 0.05}``. Torques are kept
        for every such arm: certificates and other planners take what
        ``mo.execution.robust_limits`` gives.
    segments : sequence, optional
        What lies between two stops: a :class:`~microbot_ocp.Line`, :class:`~microbot_ocp.Circle` or
        :class:`~microbot_ocp.JointLine`, or None where the way is free.
    cycle : bool
        Whether the motion returns to its first stop, with the velocity that it has there: the
        shortest period. ``segments`` has one more then.
    order : str
        "free" looks at every order of the stops (of at most 7; the first, and the last unless it is
        a cycle, keep their places). Orders are compared by coarse answers, with the ``scene``
        where one is given, and those within 1 % of the best are refined; others are left out by
        bounds, and by what their timed paths could save at most. Two stops with a segment between
        them follow one another in every order. ``orders`` in the provenance says what each led to.
    duration : float, optional
        Time that may be taken, s: of all motions that take no longer the one of least effort, as
        with ``slack``.
    scene : Scene, optional
        Obstacles that the arm keeps clear of, its links among each other besides; needs the extra
        ``cell``. The provenance holds the proved clearance and the paths that it started from.
    settings : TimeOptimalSettings, optional
        Single settings may be given as keywords instead: ``mesh``, ``starts``, ``tries``,
        ``slack``, ``limit_tolerance``, ``switching_times``, ``solver``, ``compiled``, ``seed``,
        ``time_limit``: by default 120 s, and 600 s with stops, a free order or a scene.
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
        if scene is None:
            task = Task.through(family, via)
            return fastest_through(task, chosen, report, usual=TIME_LIMIT)
        asked = Asked(robot, limits, list(via), None, False, chosen, report, scene=scene)
        with chosen.within(CELL_TIME_LIMIT):
            from microbot_ocp.planning.search._among_obstacles import fastest_among

            return with_drives_noted(robot, fastest_among(asked, family, via), limits)
    if not isinstance(via_q, Sequence) and np.ndim(cast("Any", via_q)) == 0:
        raise InputError(f"via_q must be stops or poses, not {checks.shown(via_q)}")
    stops = list(cast("Sequence[Any]", via_q))
    asked = Asked(robot, limits, stops, segments, cycle, chosen, report, order, duration, scene)
    if scene is None:
        return with_drives_noted(robot, solve_stops(asked), limits)
    with chosen.within(CELL_TIME_LIMIT):
        from microbot_ocp.planning.search._stops_among import stops_among

        return with_drives_noted(robot, stops_among(asked), limits)
