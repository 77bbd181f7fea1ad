"""Who plays: an arm with its motion, sampled as it is drawn, and how it looks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.motion import JUMP_GAP, Mark, Motion, State
from microbot_ocp.robot import Robot
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.plots._style import EntryStyle
from microbot_ocp.views.recording import _paths as entities
from microbot_ocp.views.recording._palette import Color
from microbot_ocp.views.recording._writer import Times

RATE = 200.0  # Hz, of what is drawn: smoother than any screen
GHOST_ALPHA = 110
BRIGHTER = 0.25  # share of white in colours, which are chosen for paper, on a dark screen


@dataclass(frozen=True)
class Look:
    """How one arm is drawn: its style, link radius (m), opacity, and height of its label (m)."""

    style: EntryStyle
    radius: float
    alpha: int
    label_height: float

    @property
    def solid(self) -> bool:
        """Whether it is the one that all others are ghosts of."""
        return self.style.highlighted

    @property
    def color(self) -> Color:
        """Of its surfaces."""
        return screen_color(self.style, self.alpha)

    @property
    def line_color(self) -> Color:
        """Of its lines and words."""
        return screen_color(self.style)


def screen_color(style: EntryStyle, alpha: int = 255) -> Color:
    """A style's colour, brightened for a dark screen."""
    red, green, blue, _ = style.rgba()
    red, green, blue = (round(v + BRIGHTER * (255 - v)) for v in (red, green, blue))
    return red, green, blue, alpha


def looks(robot: Robot, styles: Sequence[EntryStyle]) -> list[Look]:
    """Looks that tell arms apart even where they coincide."""
    size = scene.reach(robot)
    return [
        Look(
            style=style,
            # another radius for every ghost: surfaces at one place would flicker
            radius=size * (0.021 if style.highlighted else 0.0165 - 0.0011 * min(place, 8)),
            alpha=255 if style.highlighted else GHOST_ALPHA,
            label_height=size * (0.06 if style.highlighted else 0.12 + 0.055 * place),
        )
        for place, style in enumerate(styles)
    ]


@dataclass(frozen=True, eq=False)
class Actor:
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
    """

    look: Look
    times: Times
    state: State
    curves: Mapping[str, FloatArray]
    marks: tuple[Mark, ...] = ()

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
        return entities.TIME in self.times

    def values(self, quantity: str) -> FloatArray:
        """Values [N,n] of a quantity, plotted or not."""
        return self.state.qdd if quantity == "qdd" else self.curves[quantity]

    @classmethod
    def of(cls, motion: Motion, look: Look, rate: float = RATE) -> Actor:
        """The motion's own samples, thinned to ``rate`` (Hz), filled in where they are sparser."""
        t = drawn_times(motion.t, rate)
        state = motion.sample(t)
        tau = np.column_stack([np.interp(t, motion.t, column) for column in motion.tau.T])
        times = {entities.TIME: t, entities.PROGRESS: permille(progress(motion, t))}
        curves = {"q": state.q, "qd": state.qd, "tau": tau}
        return cls(look, times, state, curves, motion.marks)


def standing(q: FloatArray, look: Look) -> Actor:
    """An arm that stands in poses q [N,n] one after the other, counted on the BRANCH timeline."""
    still = np.zeros_like(q)
    times = {entities.BRANCH: np.arange(1.0, len(q) + 1.0)}
    return Actor(look, times, State(q, still, still), {})


def drawn_times(t: FloatArray, rate: float) -> FloatArray:
    """Samples of t [N] about 1/rate apart, with both ends, both sides of jumps, and no wide gaps.

    What is between two of them is a time that is no sample only where the samples are further
    apart than 1/rate.
    """
    cell = np.floor(t * rate + 1e-6)
    keep = np.append(True, np.diff(cell) > 0)
    jump = np.diff(t) <= 2 * JUMP_GAP
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


def permille(share: FloatArray) -> FloatArray:
    """Shares as whole per mille."""
    return np.rint(entities.WHOLE * share)
