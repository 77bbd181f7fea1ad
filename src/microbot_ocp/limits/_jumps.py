"""Jumps of the acceleration, which limits of its rate do not allow: the one meaning of rest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits._family import MotionSamples

JUMP_TIME = 1e-6  # s: a jump of the acceleration counts as if it took so long


class StateHistory(NamedTuple):
    """States along a motion, with the jumps of the acceleration at its ends and inside of it.

    Attributes
    ----------
    t : array [N], s
    samples : MotionSamples [N]
        Without the jumps: at both sides of one the jerk is that of its side.
    jump_t : array [J], s
    jumps : MotionSamples [J]
        As of :func:`jumps_between`.
    """

    t: FloatArray
    samples: MotionSamples
    jump_t: FloatArray
    jumps: MotionSamples

    def between(self, start: float, end: float) -> StateHistory:
        """Return the part from one of its times to another, with the jumps at both.

        What is at its end belongs to what follows.
        """
        first, last = (int(np.abs(self.t - at).argmin()) for at in (start, end))
        here = slice(first, last + (last == self.t.size - 1))
        near = (self.jump_t >= self.t[first]) & (self.jump_t <= self.t[last])
        return StateHistory(
            self.t[here],
            MotionSamples(*(each[here] for each in self.samples)),
            self.jump_t[near],
            MotionSamples(*(each[near] for each in self.jumps)),
        )


def jumps_between(
    starts: MotionSamples, ends: MotionSamples, *, cycle: bool = False
) -> MotionSamples:
    """Return what jumps [K+1] there are before, between and after K pieces of one history.

    An arm that is at rest where its motion begins or ends is held there: before and after the
    acceleration is zero, and the torque what gravity asks for. An end that moves on has no history
    beyond it, but that of a cycle. At rest is what a jump from standing still comes to while it
    lasts.

    Parameters
    ----------
    starts, ends : MotionSamples [K]
        States at the starts and ends of the pieces.
    cycle : bool
        Whether the motion goes on at its start where it ends moving.

    Returns
    -------
    MotionSamples [K+1]
        States before the jumps (at the start of the motion after it), with the jump of the
        acceleration over its time as the jerk.
    """
    first, last = starts.qdd[:1], ends.qdd[-1:]
    before = np.concatenate([_beyond(starts, 0, last if cycle else first), ends.qdd])
    after = np.concatenate([starts.qdd, _beyond(ends, -1, first if cycle else last)])
    q, qd = (np.concatenate([a[:1], b]) for a, b in zip(starts[:2], ends[:2], strict=True))
    return MotionSamples(q, qd, before, (after - before) / JUMP_TIME)


def _beyond(states: MotionSamples, row: int, moving: FloatArray) -> FloatArray:
    """Return the acceleration [1,n] beyond an end of the motion: zero at rest, else that given."""
    rests = np.abs(states.qd[row]).max() <= JUMP_TIME * np.abs(states.qdd[row]).max()
    return np.zeros_like(moving) if rests else moving
