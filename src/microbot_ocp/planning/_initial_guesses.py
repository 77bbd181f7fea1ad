"""Motions from which the search for a free time-optimal motion starts."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.ocp.transcription import Guess
from microbot_ocp.robot import Robot
from microbot_ocp.trajectories import ViaPoints, cubic_through, shortest_duration, via_velocities

LARGEST_BOW = 0.7  # rad (m), sideways in the middle of a segment
USUAL_SPEED = 2.0  # rad/s (m/s) where the velocity is not limited


@dataclass(frozen=True, eq=False)
class InitialGuess:
    """A motion to start from: its name, and a guess for every phase."""

    name: str
    guesses: Mapping[str, Guess]


def initial_guesses(
    robot: Robot, via: FloatArray, names: Sequence[str], count: int, seed: int
) -> Iterator[InitialGuess]:
    """The first ``count`` of: the scaled cubic, straight segments, segments bowed at random.

    Parameters
    ----------
    robot : Robot
        With its limits.
    via : array [m,n], rad (m)
    names : sequence of str
        Of the phases, one a segment between via points.
    count : int
    seed : int
        Of the random bows.
    """
    yield _cubic(robot, via, names)
    random = np.random.default_rng(seed)
    for index in range(count - 1):
        if index == 0:
            yield _bowed(robot, via, names, "straight", np.zeros(via.shape[1]))
        else:
            bow = random.uniform(-LARGEST_BOW, LARGEST_BOW, via.shape[1])
            yield _bowed(robot, via, names, f"bow {index}", bow)


def guesses_along(
    names: Sequence[str], shape: PiecewisePolynomial, times: FloatArray
) -> dict[str, Guess]:
    """A guess for every phase from a motion that passes the via points at ``times`` [m]."""
    velocity = shape.derivative()
    acceleration = velocity.derivative()
    curves = {"q": shape, "qd": velocity, "qdd": acceleration}
    guesses = {}
    for phase, start, end in zip(names, times[:-1], times[1:], strict=True):

        def along(
            curve: PiecewisePolynomial, s: FloatArray, start: float = start, end: float = end
        ) -> FloatArray:
            return curve(start + s * (end - start))

        values = {name: partial(along, curve) for name, curve in curves.items()}
        guesses[phase] = Guess(float(end - start), values)
    return guesses


def _cubic(robot: Robot, via: FloatArray, names: Sequence[str]) -> InitialGuess:
    """The cubic through the via points at the shortest duration that keeps the limits."""
    steps = np.abs(np.diff(via, axis=0)).max(axis=1)
    timed = ViaPoints(via, np.concatenate([[0.0], np.cumsum(np.maximum(steps, 1e-3))]))
    shape = cubic_through(timed, via_velocities(timed))
    # where gravity forbids rest on the way it is a start all the same, only not a feasible one
    with contextlib.suppress(InputError):
        shape = shortest_duration(robot, shape).polynomial
    return InitialGuess("cubic", guesses_along(names, shape, shape.breaks))


def _bowed(
    robot: Robot, via: FloatArray, names: Sequence[str], name: str, bow: FloatArray
) -> InitialGuess:
    """Straight segments bent sideways, at a speed that the velocity limits would allow."""
    limit = np.where(np.isfinite(robot.limits.qd_max), robot.limits.qd_max, USUAL_SPEED)
    guesses = {}
    for phase, start, end in zip(names, via[:-1], via[1:], strict=True):
        duration = max(1.5 * float(np.max(np.abs(end - start) / limit)), 1e-2)

        def position(s: FloatArray, start: FloatArray = start, end: FloatArray = end) -> FloatArray:
            return start + s[:, None] * (end - start) + np.sin(np.pi * s)[:, None] * bow

        def velocity(
            s: FloatArray,
            start: FloatArray = start,
            end: FloatArray = end,
            duration: float = duration,
        ) -> FloatArray:
            slope = (end - start) + np.pi * np.cos(np.pi * s)[:, None] * bow
            return np.clip(slope / duration, -limit, limit)

        guesses[phase] = Guess(duration, {"q": position, "qd": velocity, "qdd": 0.0})
    return InitialGuess(name, guesses)
