"""Initial guesses of the search for a free time-optimal motion."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.limits import LimitFamily
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.ocp.transcription import Guess
from microbot_ocp.planning.task import TaskScale, locked_joints
from microbot_ocp.trajectories import ViaPoints, cubic_through, shortest_duration, via_velocities


@dataclass(frozen=True, eq=False)
class InitialGuess:
    """An initial guess: its name, and a guess for every phase."""

    name: str
    guesses: Mapping[str, Guess]


LARGEST_BOW = 1.5  # largest offset of a bow in the middle of a segment, rad (m)
BOW_RATIO = 0.7  # largest offset of a bow per distance of all segments


def initial_guesses(
    family: LimitFamily,
    via: FloatArray,
    names: Sequence[str],
    count: int,
    seed: int,
    *,
    moving: bool = False,
    velocities: FloatArray | None = None,
) -> Iterator[InitialGuess]:
    """Yield the first ``count`` of: the scaled cubic, straight segments, bows and swings in turn.

    A guess for an arm that is ``moving`` at the start omits the cubic: one from rest is no nearer
    to the solution than straight segments, and its scaling takes time. Bows and swings are random.
    If torques are too small to lift the arm, it must swing up first; the solver finds such a motion
    from a guess that swings in any way.

    Parameters
    ----------
    family : LimitFamily
    via : array [m,n], rad (m)
    names : sequence of str
        Names of the phases, one per segment between via points.
    count : int
    seed : int
        Seed of the random segments.
    velocities : array [m,n], optional
        Velocities at the via points for the typical durations; zero for a free one.
    """
    bows, waves = np.random.default_rng(seed), np.random.default_rng(seed + 1)
    drawn = _Drawn(family, via, names, velocities)
    way = float(np.abs(np.diff(via, axis=0)).sum(axis=0).max())
    largest = min(LARGEST_BOW, BOW_RATIO * way) * drawn.free
    for index in range(moving, count + moving):
        number = index // 2
        if index == 0:
            yield drawn.cubic()
        elif index % 2 and index > 1:
            yield drawn.swing(number, waves)
        else:
            bow = bows.uniform(-largest, largest) if index > 1 else 0.0 * largest
            bow_of_segments = np.broadcast_to(bow, (len(names), 1, bow.size))
            name = f"bow {number}" if index > 1 else "straight"
            yield drawn.waved(name, bow_of_segments, drawn.durations)


def guesses_along(
    names: Sequence[str], shape: PiecewisePolynomial, times: FloatArray
) -> dict[str, Guess]:
    """Return a guess for every phase from a motion that passes the via points at ``times`` [m]."""
    spans = zip(names, itertools.pairwise(times), strict=True)
    return {phase: guess_along(shape, start, end) for phase, (start, end) in spans}


def guess_along(shape: PiecewisePolynomial, start: float = 0.0, end: float | None = None) -> Guess:
    """Return a guess for one phase from a motion, or from the part of it from start to end, s."""
    end = shape.duration if end is None else end
    velocity = shape.derivative()
    curves = {"q": shape, "qd": velocity, "qdd": velocity.derivative()}
    values = {name: partial(_along, curve, start, end) for name, curve in curves.items()}
    return Guess(float(end - start), values)


def _along(curve: PiecewisePolynomial, start: float, end: float, s: FloatArray) -> FloatArray:
    return curve(start + s * (end - start))


SWING_SIZES = (0.5, 2.5)  # smallest and largest amplitude of a swing, rad (m)
SWING_DURATIONS = (1.0, 4.0)  # smallest and largest duration of a swing, per typical duration
DURATION_SPREAD = 2.0  # largest factor between durations of single segments and their scale
HARMONICS = 5  # number of harmonics of a swing


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Arguments of :func:`initial_guesses`, with the guesses made of them."""

    family: LimitFamily
    via: FloatArray
    names: Sequence[str]
    velocities: FloatArray | None

    @cached_property
    def durations(self) -> FloatArray:
        """Typical durations of the segments, s."""
        return TaskScale.of(self.family, self.via, self.velocities).durations

    @cached_property
    def free(self) -> FloatArray:
        """Factors [n]: one for joints that move, zero for locked ones."""
        return np.where(locked_joints(self.family), 0.0, 1.0)

    def cubic(self) -> InitialGuess:
        """Return the cubic through the via points, at its shortest duration within the limits."""
        steps = np.abs(np.diff(self.via, axis=0)).max(axis=1)
        timed = ViaPoints(self.via, np.concatenate([[0.0], np.cumsum(steps)]))
        shape = cubic_through(timed, via_velocities(timed))
        # If gravity forbids rest on the way, the unscaled cubic is still a guess, not a feasible
        # one.
        with contextlib.suppress(InputError):
            shape = shortest_duration(self.family.robot, shape).polynomial
        return InitialGuess("cubic", guesses_along(self.names, shape, shape.breaks))

    def swing(self, number: int, random: np.random.Generator) -> InitialGuess:
        """Return segments with random oscillations."""
        size = _between(random, SWING_SIZES) * self.free
        waves = random.normal(size=(len(self.names), HARMONICS, self.via.shape[1]))
        # Amplitudes fall like 1 / k, which keeps the velocities of all harmonics alike.
        waves *= size / np.arange(1, HARMONICS + 1)[:, None]
        slower = _between(random, SWING_DURATIONS)
        factors = slower * DURATION_SPREAD ** random.uniform(-1.0, 1.0, len(self.names))
        return self.waved(f"swing {number}", waves, factors * self.durations)

    def waved(self, name: str, waves: FloatArray, durations: FloatArray) -> InitialGuess:
        """Return straight segments plus sines of 1 to K half periods, of amplitudes [m-1,K,n]."""
        limits = self.family.robot.limits
        turns = np.pi * np.arange(1, waves.shape[1] + 1)
        guesses = {}
        steps = np.diff(self.via, axis=0)
        rows = zip(self.names, self.via[:-1], steps, waves, durations, strict=True)
        for phase, start, step, wave, duration in rows:

            def position(s: FloatArray, start=start, step=step, wave=wave) -> FloatArray:
                q = start + s[:, None] * step + np.sin(np.outer(s, turns)) @ wave
                return np.clip(q, limits.q_min, limits.q_max)

            def velocity(s: FloatArray, step=step, wave=wave, duration=duration) -> FloatArray:
                slope = step + (np.cos(np.outer(s, turns)) * turns) @ wave
                return np.clip(slope / duration, limits.qd_min, limits.qd_max)

            guesses[phase] = Guess(float(duration), {"q": position, "qd": velocity, "qdd": 0.0})
        return InitialGuess(name, guesses)


def _between(random: np.random.Generator, ends: tuple[float, float]) -> float:
    """Return a random number between two ends, uniform in its logarithm."""
    return float(np.exp(random.uniform(*np.log(ends))))
