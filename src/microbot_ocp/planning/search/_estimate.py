"""A quick look at a task: what its motion takes from rest to rest, straight from pose to pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import JointLimits
from microbot_ocp.ocp.solution import quiet
from microbot_ocp.planning.search._among_obstacles import LegPlanner
from microbot_ocp.planning.search._branches import segment_timings, ways_through
from microbot_ocp.planning.search._orders import rest_duration_of
from microbot_ocp.planning.search._settings import TimeOptimalSettings
from microbot_ocp.planning.search._through_stops import SolveRequest
from microbot_ocp.planning.task import Segment, Stop
from microbot_ocp.robot import Robot
from microbot_ocp.scene import Scene, with_arm_capsules


def rested_duration(
    robot: Robot,
    stops: Sequence[Stop],
    limits: JointLimits,
    segments: Sequence[Segment] | None,
    cycle: bool,
    scene: Scene | None,
) -> tuple[float, FloatArray]:
    """Return the time of the best branches from rest to rest, s, and their poses [N,n] on the way.

    The way is straight from pose to pose, or along tool lines, and through obstacles.

    Poses at the stops touch nothing. It is infinite where no such motion keeps the limits, though
    others may.

    Raises
    ------
    InputError
        A stop out of reach, or one at which every branch of the arm touches something.
    """
    robot = robot if scene is None else with_arm_capsules(robot)
    settings = TimeOptimalSettings()
    request = SolveRequest(robot, limits, stops, segments, cycle, settings, quiet, scene=scene)
    task = request.task()
    clear = None if scene is None else [way for way, _ in LegPlanner(request).clear_ways(task)]
    ways = clear or ways_through(task)
    durations = [
        [np.inf if shape is None else shape.duration for shape in segment_timings(task, way, True)]
        for way in ways
    ]
    totals = [rest_duration_of(task, row) for row in durations]
    best = int(np.argmin(totals))
    return totals[best], np.vstack(ways[best].paths)
