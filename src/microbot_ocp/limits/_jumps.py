"""Jumps of the acceleration, which limits of its rate do not allow: the one meaning of rest."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits._family import MotionSamples

JUMP_TIME = 1e-6  # s: a jump of the acceleration counts as if it took so long


def jumps_between(starts: MotionSamples, ends: MotionSamples) -> MotionSamples:
    """What jumps [K+1] there are before, between and after K pieces of one history.

    An arm that is at rest where its motion begins or ends is held there: before and after the
    acceleration is zero, and the torque what gravity asks for. An end that moves on has no history
    beyond it, so nothing jumps there. At rest is what a jump from standing still comes to while it
    lasts.

    Parameters
    ----------
    starts, ends : MotionSamples [K]
        States at the starts and ends of the pieces.

    Returns
    -------
    MotionSamples [K+1]
        States before the jumps (at the start of the motion after it), with the jump of the
        acceleration over its time as the jerk.
    """
    before = np.concatenate([_beyond(starts, 0), ends.qdd])
    after = np.concatenate([starts.qdd, _beyond(ends, -1)])
    q, qd = (np.concatenate([a[:1], b]) for a, b in zip(starts[:2], ends[:2], strict=True))
    return MotionSamples(q, qd, before, (after - before) / JUMP_TIME)


def _beyond(states: MotionSamples, row: int) -> FloatArray:
    """Acceleration [1,n] beyond an end of the motion: zero for an arm that is held at rest."""
    qd, qdd = states.qd[row], states.qdd[row]
    rests = np.abs(qd).max() <= JUMP_TIME * np.abs(qdd).max()
    return np.zeros_like(qdd)[None] if rests else qdd[None]
