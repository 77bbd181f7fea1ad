"""Arm of a recording: its sampled motion and its style."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp.limits import LimitFamily, LimitHistory
from microbot_ocp.motion import Mark, Motion, State, history_of, jump_gaps, mesh_of, torque_along
from microbot_ocp.robot import Robot
from microbot_ocp.views._scene import display_factor, reach
from microbot_ocp.views._style import LINE_WIDTH, LINK_RADIUS, Color, EntryStyle, rgb
from microbot_ocp.views.recording._writer import (
    BRANCH,
    PROGRESS,
    TIME,
    WORLD,
    Times,
    Writer,
    plot_path,
)

SAMPLING_RATE = 200.0  # default sampling rate of a recorded arm, Hz
MOST_SAMPLES = 12_000  # largest default number of samples of all arms: 38 MB for a 7R arm
GHOST_OPACITY = 110  # opacity of ghosts, 0 to 255


@dataclass(frozen=True)
class Look:
    """Style and link radius (m) of one arm."""

    style: EntryStyle
    radius: float

    @property
    def solid(self) -> bool:
        """True for the solid arm; all other arms are ghosts."""
        return self.style.highlighted

    @property
    def color(self) -> Color:
        """Colour of the surfaces, transparent for a ghost."""
        return (*self.line_color[:3], 255 if self.solid else GHOST_OPACITY)

    @property
    def line_color(self) -> Color:
        """Colour of lines and texts: a quarter lighter than on paper, for dark screens."""
        red, green, blue = (round(0.75 * part + 0.25 * 255) for part in rgb(self.style.color))
        return red, green, blue, 255


def looks(robot: Robot, styles: Sequence[EntryStyle]) -> list[Look]:
    """Return the looks of several arms; ghosts are thinner, down to half the radius.

    Every ghost has another radius, because coincident surfaces flicker.
    """
    solid, *ghosts = LINK_RADIUS * reach(robot) * np.linspace(1.0, 0.5, len(styles) + 1)
    return [
        Look(style, float(solid if style.highlighted else ghost))
        for style, ghost in zip(styles, ghosts, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class AnimatedArm:
    """Arm in motion, sampled for drawing.

    Attributes
    ----------
    look : Look
    times : mapping
        Values [N] by timeline.
    state : State
        Position, velocity and acceleration [N,n].
    curves : mapping
        Values [N,n] of the plotted quantities, in stored units.
    marks : tuple of Mark
        Named times, s.
    history : LimitHistory, optional
        Use of the limits along the motion.
    """

    look: Look
    times: Times
    state: State
    curves: Mapping[str, FloatArray]
    marks: tuple[Mark, ...] = ()
    history: LimitHistory | None = None

    @property
    def name(self) -> str:
        """Name of the arm in entity paths."""
        return self.look.style.name

    @property
    def title(self) -> str:
        """Title of the arm in labels; empty for a single arm."""
        return self.look.style.title

    @property
    def q(self) -> FloatArray:
        """Joint positions [N,n], rad or m."""
        return self.state.q

    @property
    def moves(self) -> bool:
        """True for a motion over time, False for a list of poses."""
        return TIME in self.times

    def path(self, *below: str) -> str:
        """Return the entity path of the arm, or of an entity below it."""
        return "/".join([WORLD, self.name, *below])

    def link(self, frame: int, *below: str) -> str:
        """Return the path of link frame ``frame`` (0 is the base), or of an entity below it."""
        return self.path(f"link_{frame}", *below)

    def tool(self, *below: str) -> str:
        """Return the path of the tool, which only translates, or of an entity below it."""
        return self.path("tool", *below)

    def at(self, samples: np.ndarray) -> Times:
        """Return the values of every timeline at some samples."""
        return {key: values[samples] for key, values in self.times.items()}

    def draw_curve(
        self, writer: Writer, path: str, values: FloatArray, timelines: Sequence[str] = ()
    ) -> None:
        """Draw a curve of values [N] in the colour of the arm, over some timelines or all."""
        times = {key: self.times[key] for key in timelines or self.times}
        look, width = self.look, LINE_WIDTH * (1.5 if self.look.solid else 1.0)
        name = self.title or self.name
        writer.curve(f"{path}/{self.name}", times, values, name, look.line_color, width)

    def draw_curves(self, writer: Writer, robot: Robot) -> None:
        """Draw every quantity of every joint, progress over time, and time over progress."""
        for quantity, values in self.curves.items():
            for joint, name in enumerate(robot.joint_names):
                shown = values[:, joint] * display_factor(robot, quantity, joint)
                self.draw_curve(writer, plot_path(quantity, name), shown)
        if self.moves:
            t, percent = self.times[TIME], 0.1 * self.times[PROGRESS]
            self.draw_curve(writer, plot_path("progress"), percent, [TIME])
            self.draw_curve(writer, plot_path("elapsed"), t, [PROGRESS])


def moving_arm(
    motion: Motion, look: Look, rate: float, family: LimitFamily | None = None
) -> AnimatedArm:
    """Return the arm of a motion, sampled at about ``rate`` (Hz) by :func:`drawn_times`.

    ``family`` holds the limits of the limit history.
    """
    t = drawn_times(motion.t, rate)
    state = motion.sample(t)
    tau = np.column_stack([np.interp(t, motion.t, column) for column in motion.tau.T])
    times = {TIME: t, PROGRESS: np.rint(1000 * progress(motion, t))}
    curves = {"q": state.q, "qd": state.qd, "tau": tau}
    history = None
    if family is not None:
        states, measured = history_of(motion, t), {"tau": tau}
        if "taud" in family:
            of_bare_arm = family.robot.torques_along(*states.samples)["taud"]
            measured["taud"] = of_bare_arm + _rate_beyond(family.robot, motion, t)
        history = LimitHistory.of(family, states, measured)
    return AnimatedArm(look, times, state, curves, motion.marks, history)


def _rate_beyond(robot: Robot, motion: Motion, t: FloatArray) -> FloatArray:
    """Return the rates [N,n] of the torques that the bare arm does not explain (payload, drive).

    Jumps of these torques, such as the weight of a part at its pick, do not count as rates.
    """
    # Differentiate piece by piece of the mesh, because the torque may jump between pieces.
    beyond = motion.tau - torque_along(robot, State(motion.q, motion.qd, motion.qdd))
    gaps, rates = np.flatnonzero(jump_gaps(motion.t)), np.zeros((t.size, beyond.shape[1]))
    mesh = np.searchsorted(motion.t, mesh_of(motion))
    edges = np.unique(np.concatenate([mesh, gaps, gaps + 1]))
    piece = np.clip(np.searchsorted(motion.t[edges], t, side="right") - 1, 0, edges.size - 2)
    piece = piece - np.isin(edges[piece], gaps)  # samples before a jump: earlier piece
    for k in np.unique(piece):
        samples, here = slice(edges[k], edges[k + 1] + 1), piece == k
        times, order = motion.t[samples], 2 if edges[k + 1] - edges[k] > 1 else 1
        slopes = np.gradient(beyond[samples], times, axis=0, edge_order=order)
        rates[here] = np.column_stack([np.interp(t[here], times, each) for each in slopes.T])
    return rates


def drawn_rate(rate: float | None, motions: Sequence[Motion]) -> tuple[float, str]:
    """Return ``rate`` or a default (Hz) that bounds the size of a recording, and a note on it."""
    together = sum(motion.duration for motion in motions)
    if rate is not None or SAMPLING_RATE * together <= MOST_SAMPLES:
        return rate or SAMPLING_RATE, ""
    most = MOST_SAMPLES / together
    return most, f"Drawn at {most:.3g} Hz, because the motion is long; rate= sets another rate."


def standing_arm(q: FloatArray, look: Look) -> AnimatedArm:
    """Return an arm with the poses q [N,n], numbered on the BRANCH timeline."""
    still = np.zeros_like(q)
    return AnimatedArm(look, {BRANCH: np.arange(1.0, len(q) + 1.0)}, State(q, still, still), {})


def drawn_times(t: FloatArray, rate: float) -> FloatArray:
    """Return times about 1/rate apart: samples of t [N] with both ends and both sides of jumps.

    Gaps wider than 2/rate are filled with times between the samples.
    """
    # Keep the first sample in each cell of width 1/rate, and both samples of a jump.
    cell = np.floor(t * rate + ROUNDING)
    keep = np.append(True, np.diff(cell) > 0)
    jump = jump_gaps(t)
    keep[:-1] |= jump
    keep[1:] |= jump
    keep[-1] = True
    sparse = t[keep]
    parts = np.maximum(1, np.ceil(np.diff(sparse) * rate / 2 - ROUNDING)).astype(int)
    first = np.repeat(np.cumsum(parts) - parts, parts)
    share = (np.arange(parts.sum()) - first) / np.repeat(parts, parts)
    filled = np.repeat(sparse[:-1], parts) + share * np.repeat(np.diff(sparse), parts)
    return np.append(filled, sparse[-1])


def progress(motion: Motion, t: FloatArray) -> FloatArray:
    """Return the travelled share [N] of the joint path at times t [N].

    The length of the path is the Euclidean norm of joint steps; metres of prismatic joints count as
    radians. A motion at rest has the share of its duration instead.
    """
    steps = np.linalg.norm(np.diff(motion.q, axis=0), axis=1)
    length = np.append(0.0, np.cumsum(steps))
    if length[-1] < ROUNDING:
        return t / motion.duration
    return np.interp(t, motion.t, length / length[-1])
