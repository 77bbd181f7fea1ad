"""An arm with its motion, sampled as it is drawn; its look, and the colours of every recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import LimitFamily, LimitHistory
from microbot_ocp.motion import (
    Mark,
    Motion,
    State,
    history_of,
    jump_gaps,
    mesh_of,
    torque_along,
)
from microbot_ocp.robot import Robot
from microbot_ocp.views._scene import reach
from microbot_ocp.views.plots._style import EntryStyle
from microbot_ocp.views.recording._writer import BRANCH, PROGRESS, TIME, WHOLE, Times

RATE = 200.0  # Hz, of what is drawn: smoother than any screen
MOST_SAMPLES = 12_000  # of all arms together, where nobody asks for a rate: 38 MB of a 7R arm
JOINT_CURVES = ("q", "qd", "qdd", "tau")  # have curves of their own
GHOST_ALPHA = 110
BRIGHTER = 0.25  # share of white in colours, which are chosen for paper, on a dark screen

Color = tuple[int, int, int, int]
# Told apart on a dark screen with any colour vision. Shares of a limit go from slate to yellow; at
# the limit they jump to a pink that nothing else has.
NEUTRAL_COLOR: Color = (130, 142, 160, 255)
NEAR_COLOR: Color = (240, 228, 66, 255)
SATURATED_COLOR: Color = (255, 60, 150, 255)
BEYOND_COLOR: Color = (225, 50, 40, 255)
SPEED_COLOR: Color = (86, 180, 233, 255)
LIMIT_COLOR: Color = (165, 165, 165, 255)
BASE_COLOR: Color = (120, 120, 125, 255)
VIA_COLOR: Color = (245, 245, 245, 255)
MASS_COLOR: Color = (60, 200, 160, 255)
VELOCITY_COLOR: Color = (170, 235, 255, 255)
VARIABLE_COLOR: Color = (240, 150, 80, 255)
FORCE_COLOR: Color = (240, 228, 66, 255)


@dataclass(frozen=True)
class Look:
    """How one arm is drawn: its style, link radius (m) and opacity."""

    style: EntryStyle
    radius: float
    alpha: int

    @property
    def solid(self) -> bool:
        """Whether it is the one that all others are ghosts of."""
        return self.style.highlighted

    @property
    def color(self) -> Color:
        """Colour of its surfaces."""
        return (*self.line_color[:3], self.alpha)

    @property
    def line_color(self) -> Color:
        """Colour of its lines and texts."""
        red, green, blue, _ = self.style.rgba()
        red, green, blue = (round(v + BRIGHTER * (255 - v)) for v in (red, green, blue))
        return red, green, blue, 255


def looks(robot: Robot, styles: Sequence[EntryStyle]) -> list[Look]:
    """Looks that keep arms apart even where they coincide."""
    size = reach(robot)
    return [
        Look(
            style=style,
            # another radius for every ghost: surfaces at one place would flicker
            radius=size * (0.021 if style.highlighted else 0.0165 - 0.0011 * min(place, 8)),
            alpha=255 if style.highlighted else GHOST_ALPHA,
        )
        for place, style in enumerate(styles)
    ]


@dataclass(frozen=True, eq=False)
class AnimatedArm:
    """An arm in motion, as it is drawn.

    Attributes
    ----------
    look : Look
    times : mapping
        Values [N] of every timeline.
    state : State
        Position, velocity and acceleration [N,n].
    curves : mapping
        Values [N,n] of every quantity that is plotted, in stored units.
    marks : tuple of Mark
        Named instants, s.
    history : LimitHistory, optional
        How much of its limits it uses.
    """

    look: Look
    times: Times
    state: State
    curves: Mapping[str, FloatArray]
    marks: tuple[Mark, ...] = ()
    history: LimitHistory | None = None

    @property
    def name(self) -> str:
        """Its part of every entity path."""
        return self.look.style.name

    @property
    def title(self) -> str:
        """What people read; empty for an arm that has the scene to itself."""
        return self.look.style.title

    @property
    def q(self) -> FloatArray:
        """Joint positions [N,n], rad or m."""
        return self.state.q

    @property
    def moves(self) -> bool:
        """Whether it plays in time; otherwise it stands in one pose after the other."""
        return TIME in self.times

    def values(self, quantity: str) -> FloatArray | None:
        """Values [N,n] of a quantity, plotted or not; None where it is not known."""
        return self.state.qdd if quantity == "qdd" else self.curves.get(quantity)


def moving_arm(
    motion: Motion, look: Look, rate: float, family: LimitFamily | None = None
) -> AnimatedArm:
    """An arm at the motion's own samples, thinned to ``rate`` (Hz), filled in where sparser.

    ``family`` holds the limits that are drawn.
    """
    t = drawn_times(motion.t, rate)
    state = motion.sample(t)
    tau = np.column_stack([np.interp(t, motion.t, column) for column in motion.tau.T])
    times = {TIME: t, PROGRESS: np.rint(WHOLE * progress(motion, t))}
    curves = {"q": state.q, "qd": state.qd, "tau": tau}
    history = None
    if family is not None:
        states, measured = history_of(motion, t), {"tau": tau}
        if "taud" in family:
            rate_of_motion = family.robot.torques_along(*states.samples)["taud"]
            measured["taud"] = rate_of_motion + _rate_beyond(family.robot, motion, t)
        history = LimitHistory.of(family, states, measured)
    return AnimatedArm(look, times, state, curves, motion.marks, history)


def _rate_beyond(robot: Robot, motion: Motion, t: FloatArray) -> FloatArray:
    """Rates [N,n] of what stored torques are beyond those of the bare arm: of a payload, a drive.

    Steps of it count at no time: where something is picked up its weight does.
    """
    beyond = motion.tau - torque_along(robot, State(motion.q, motion.qd, motion.qdd))
    gaps, found = np.flatnonzero(jump_gaps(motion.t)), np.zeros((t.size, beyond.shape[1]))
    edges = np.concatenate([np.searchsorted(motion.t, mesh_of(motion)), gaps, gaps + 1])
    edges = np.unique(edges)
    piece = np.clip(np.searchsorted(motion.t[edges], t, side="right") - 1, 0, edges.size - 2)
    piece = piece - np.isin(edges[piece], gaps)  # at the earlier side of a jump the piece before
    for k in np.unique(piece):
        own, here = slice(edges[k], edges[k + 1] + 1), piece == k
        times, order = motion.t[own], 2 if edges[k + 1] - edges[k] > 1 else 1
        slopes = np.gradient(beyond[own], times, axis=0, edge_order=order)
        found[here] = np.column_stack([np.interp(t[here], times, each) for each in slopes.T])
    return found


def drawn_rate(rate: float | None, motions: Sequence[Motion]) -> tuple[float, str]:
    """``rate`` (Hz), or one that bounds the size of a recording; and what to say of it."""
    if rate is not None:
        return rate, ""
    together = sum(motion.duration for motion in motions)
    if RATE * together <= MOST_SAMPLES:
        return RATE, ""
    most = MOST_SAMPLES / together
    return most, f"Drawn at {most:.3g} Hz, because it is long; rate= asks for more."


def standing_arm(q: FloatArray, look: Look) -> AnimatedArm:
    """An arm that stands in poses q [N,n] one after the other, counted on the BRANCH timeline."""
    still = np.zeros_like(q)
    return AnimatedArm(look, {BRANCH: np.arange(1.0, len(q) + 1.0)}, State(q, still, still), {})


def drawn_times(t: FloatArray, rate: float) -> FloatArray:
    """Samples of t [N] about 1/rate apart, with both ends, both sides of jumps, and no wide gaps.

    What is between two of them is a time that is no sample only where the samples are further
    apart than 1/rate.
    """
    cell = np.floor(t * rate + 1e-6)
    keep = np.append(True, np.diff(cell) > 0)
    jump = jump_gaps(t)
    keep[:-1] |= jump
    keep[1:] |= jump
    keep[-1] = True
    kept = t[keep]
    parts = np.maximum(1, np.ceil(np.diff(kept) * rate / 2 - 1e-6)).astype(int)
    if (parts == 1).all():
        return kept
    first = np.repeat(np.cumsum(parts) - parts, parts)
    share = (np.arange(parts.sum()) - first) / np.repeat(parts, parts)
    filled = np.repeat(kept[:-1], parts) + share * np.repeat(np.diff(kept), parts)
    return np.append(filled, kept[-1])


def progress(motion: Motion, t: FloatArray) -> FloatArray:
    """Share [N] of the joint path travelled at times t [N]; of the time, for an arm at rest.

    The length of the path is that of the joint positions in the Euclidean norm, metres of
    prismatic joints counting as radians.
    """
    steps = np.linalg.norm(np.diff(motion.q, axis=0), axis=1)
    length = np.append(0.0, np.cumsum(steps))
    if length[-1] < 1e-9:
        return t / motion.duration
    return np.interp(t, motion.t, length / length[-1])
