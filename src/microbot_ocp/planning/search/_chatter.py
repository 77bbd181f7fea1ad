"""Torques that oscillate, as on singular arcs of fastest motions, and the price of calmer ones.

On a singular arc many motions take nearly the same time, so the optimum fixes the torque weakly.
"""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.outcome import Advice
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Robot

SWING = 0.3  # smallest counted swing, share of a torque's range
LEAST_REVERSALS = 4  # smallest number of consecutive reversals: two periods
WINDOW = 0.3  # time window of the reversals, s
SLACK = 1e-3  # share of the duration that is offered for a calmer motion


def chatter(robot: Robot, motion: Motion, *, calmer: bool = False) -> tuple[Advice, ...]:
    """Return advice on the joint whose torque reverses most often within a short time.

    The advice names the remedies and their price. There is none for a robot without masses or
    without such a joint. A motion that is ``calmer`` than the fastest is offered no further slack.
    """
    if not robot.has_dynamics:
        return ()
    found: list[tuple[int, float, str, float]] = []
    spans = robot.limits.tau_max - robot.limits.tau_min
    for name, tau, span in zip(robot.joint_names, motion.tau.T, spans, strict=True):
        turns = _turns(tau, SWING * span)
        t = motion.t[turns]
        counts = np.searchsorted(t, t + WINDOW, side="right") - np.arange(t.size)
        if t.size and counts.max() >= LEAST_REVERSALS:
            first = int(counts.argmax())
            run = tau[turns[first : first + counts[first]]]
            found.append((run.size, float(np.ptp(run) / span), name, float(t[first])))
    if not found:
        return ()
    times, swing, name, at = max(found)
    price = f"{100 * SLACK:g} % ({1e3 * SLACK * motion.duration:.2g} ms)"
    slack = "" if calmer else f"slack={SLACK:g} asks for a calmer motion, at most {price} slower, "
    sentence = (
        f"the torque of {name} reverses {times} times within {WINDOW:g} s, from {at:.3g} s on, by "
        f"up to {100 * swing:.0f} % of its range, as on a singular arc: {slack}limits of torque "
        "rates or jerks cost more and bound it"
    )
    return (Advice("chatter", sentence, name, 100 * swing, "%"),)


def _turns(values: FloatArray, least: float) -> list[int]:
    """Return the indices of the reversals of values [N], with swings above ``least`` on both sides.

    Hysteresis: a maximum counts once the values have fallen by ``least`` below it, a minimum once
    they have risen by as much.
    """
    turns, lowest, highest, rising = [], 0, 0, None
    slope = np.sign(np.diff(values))
    extremes = 1 + np.flatnonzero(slope[:-1] != slope[1:])  # a reversal is a local extreme
    for k in [0, *extremes.tolist(), values.size - 1]:
        value = values[k]
        lowest = k if value < values[lowest] else lowest
        highest = k if value > values[highest] else highest
        if rising is not False and value < values[highest] - least:
            turns += [highest] if rising else []
            lowest, rising = k, False
        elif rising is not True and value > values[lowest] + least:
            turns += [lowest] if rising is False else []
            highest, rising = k, True
    return turns
