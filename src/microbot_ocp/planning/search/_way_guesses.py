"""Guesses from ways through stops: every segment from rest to rest, with its best timing."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from microbot_ocp._base.checks import InputError
from microbot_ocp.limits import LimitFamily, MotionSamples
from microbot_ocp.motion import PiecewisePolynomial, pieces_of
from microbot_ocp.planning.free import InitialGuess, guess_along
from microbot_ocp.planning.path import time_path
from microbot_ocp.planning.search._branches import Way
from microbot_ocp.planning.search._settings import STOPS
from microbot_ocp.planning.task import Task, TaskScale
from microbot_ocp.robot import Robot
from microbot_ocp.trajectories import spline


class Guide(NamedTuple):
    """A way whose free segments lead around obstacles.

    Attributes
    ----------
    way : Way
    shapes : dict of str to PiecewisePolynomial
        The timed path of every free segment, from rest to rest.
    durations : list of float or None
        What every segment takes so, s; None of one that could not be timed.
    name : str
    """

    way: Way
    shapes: dict[str, PiecewisePolynomial]
    durations: list[float | None]
    name: str


def rest_to_rest(task: Task, way: Way, names: Sequence[str], compiled: bool) -> InitialGuess:
    """Return every segment from rest to rest, with its best timing where its path can be
    travelled.
    """
    guesses = {}
    durations = TaskScale.of(task.family, way.via).durations
    timings = segment_timings(task, way, compiled)
    rows = zip(names, way.paths, task.payloads, durations, timings, strict=True)
    for name, path, payload, duration, timed in rows:
        shape = spline(path, np.linspace(0.0, float(duration), len(path)))
        robot = payload.on(task.robot)
        guesses[name] = guess_along(timed or _slowed(robot, shape))
    return InitialGuess(way.name, guesses)


def segment_timings(task: Task, way: Way, compiled: bool) -> tuple[PiecewisePolynomial | None, ...]:
    """Return the best timing from rest to rest of every segment of a way; None where there is
    none.
    """
    rows = zip(way.paths, task.payloads, strict=True)
    return tuple(
        _best_timing(payload.on(task.robot), path.tobytes(), len(path), compiled)
        for path, payload in rows
    )


@lru_cache(maxsize=1024)
def _best_timing(
    robot: Robot, path_bytes: bytes, count: int, compiled: bool
) -> PiecewisePolynomial | None:
    """Do as :func:`segment_timings`, of one path [count,n]; other orders of stops have it, too."""
    shape = spline(np.frombuffer(path_bytes).reshape(count, -1), np.linspace(0.0, 1.0, count))
    with contextlib.suppress(InputError):
        timing = time_path(robot, shape, grid=STOPS.timed, compiled=compiled)
        if timing.solved:
            motion = timing.motion()
            return PiecewisePolynomial(motion.t, pieces_of(motion))
    return None


def _slowed(robot: Robot, shape: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return a shape slowed down until it keeps the limits of velocities, accelerations and
    torques.
    """
    family = LimitFamily.of(robot)
    keys = [key for key in family.of_order(1, 2, 3) if key != "taud"]
    for _ in range(STOPS.most_slowed):
        t, curves = np.linspace(0.0, shape.duration, 50), [shape]
        for _ in range(3):
            curves.append(curves[-1].derivative())
        use = family.use(MotionSamples(*(curve(t) for curve in curves)), keys)
        if all(float(share.max()) <= 1.0 for share in use.values()):
            break
        shape = shape.stretched(STOPS.slowed)
    return shape
