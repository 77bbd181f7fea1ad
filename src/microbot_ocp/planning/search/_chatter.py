"""Torques that swing to and fro, as those of fastest motions do where many motions take nearly the
same time (singular arcs), and the price of calmer ones.
"""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.outcome import Advice
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Robot

SWING = 0.3  # share of a torque's range
TIMES = 4  # reversals in a row: two periods
WITHIN = 0.3  # s
SLACK = 1e-3  # share of the duration that is offered for a calmer motion


def chatter(robot: Robot, motion: Motion, *, calmer: bool = False) -> tuple[Advice, ...]:
    """Return advice on the joint whose torque reverses most often in a short time, with the
    remedies and their price; none where no joint's does, or the robot has no masses.

    A motion that is ``calmer`` than the fastest already is offered no slack.
    """
    if not robot.has_dynamics:
        return ()
    found: list[tuple[int, float, str, float]] = []
    spans = robot.limits.tau_max - robot.limits.tau_min
    for name, tau, span in zip(robot.joint_names, motion.tau.T, spans, strict=True):
        turns = _turns(tau, SWING * span)
        t = motion.t[turns]
        counts = np.searchsorted(t, t + WITHIN, side="right") - np.arange(t.size)
        if t.size and counts.max() >= TIMES:
            first = int(counts.argmax())
            run = tau[turns[first : first + counts[first]]]
            found.append((run.size, float(np.ptp(run) / span), name, float(t[first])))
    if not found:
        return ()
    times, swing, name, at = max(found)
    price = f"{100 * SLACK:g} % ({1e3 * SLACK * motion.duration:.2g} ms)"
    slack = "" if calmer else f"slack={SLACK:g} asks for a calmer motion, at most {price} slower, "
    sentence = (
        f"the torque of {name} reverses {times} times within {WITHIN:g} s, from {at:.3g} s on, by "
        f"up to {100 * swing:.0f} % of its range, as on a singular arc: {slack}limits of torque "
        "rates or jerks cost more and bound it"
    )
    return (Advice("chatter", sentence, name, 100 * swing, "%"),)


def _turns(values: FloatArray, least: float) -> list[int]:
    """Return the indices at which values [N] reverse, with moves of more than the least before and
    after.
    """
    turns, lowest, highest, rising = [], 0, 0, None
    slope = np.sign(np.diff(values))
    extremes = 1 + np.flatnonzero(slope[:-1] != slope[1:])  # all other values lie between two
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
