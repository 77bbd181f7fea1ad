"""Frames of a film of a recording: arms in space, clocks, torques over time."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp.limits import AT_LIMIT, quantity_name
from microbot_ocp.scene import HalfSpace
from microbot_ocp.views._eye import grid_spacing
from microbot_ocp.views._scene import AXIS_MARGIN, link_origins, link_poses, reach, tool_places
from microbot_ocp.views._solids import part_solids
from microbot_ocp.views._style import LINK_RADIUS, SMALL_FONT, THEMES, THIN, TORQUE_RING, Color
from microbot_ocp.views.animation._faces import (
    LONGEST_EDGE,
    Camera,
    Faces,
    arm_bodies,
    joined,
    solid_faces,
    tube_faces,
)
from microbot_ocp.views.plots import halo, styled
from microbot_ocp.views.recording import TIME, AnimatedArm, Recording, arcs, signed_share

FILM_SIZE = (8.0, 4.5)  # width and height of a film, inches
MARGIN = 0.025  # relative to the size of the frame
TEXT_LINE = 2 * MARGIN  # height of a line of text, relative to the frame
PANELS = 0.7  # left edge of the panels in the frame
# Lower left and upper right of the arms in the frame.
SPACE_CORNERS = np.array([[MARGIN, 4 * MARGIN], [PANELS - 4 * MARGIN, 1 - 6 * MARGIN]])
GHOST: dict[str, Any] = {"alpha": 0.5}
DASHED: Any = (0, (4, 3))


def _mixed(color: Any, other: Any, share: float) -> tuple[float, float, float]:
    red, green, blue = share * np.array(to_rgb(color)) + (1.0 - share) * np.array(to_rgb(other))
    return red, green, blue


def _bytes(color: Any) -> Color:
    red, green, blue = (round(255 * part) for part in to_rgb(color))
    return red, green, blue, 255


class Film:
    """Frames of the moving arms of a recording.

    Parameters
    ----------
    recording : Recording
        Recording of a motion, a comparison or a tracking; ``recording.eye`` is the viewpoint.
    theme : str
        "light" or "dark".
    title : str, optional
        Title; default the title of the recording.
    dpi : int
        Dots per inch of a frame of 8 x 4.5 inches.

    Raises
    ------
    InputError
        No arm moves; an unknown theme.
    """

    def __init__(
        self, recording: Recording, theme: str = "light", title: str | None = None, dpi: int = 100
    ) -> None:
        self.theme = THEMES[checks.one_of("theme", theme, THEMES)]
        if not recording.moving:
            raise InputError("recording must have an arm that moves")
        # The solid arm is drawn last, on top of the ghosts.
        self.arms = sorted(recording.moving, key=lambda arm: arm.look.solid)
        self.solid = self.arms[-1]
        self.recording, self.robot, self.around = recording, recording.robot, recording.around
        self.camera, self.up = Camera(recording.eye), recording.eye.up
        self.duration = max(float(arm.times[TIME][-1]) for arm in self.arms)
        self.nearest = self.around.nearest(self.solid.times[TIME], self.solid.q)
        with styled():
            self.figure = Figure(figsize=FILM_SIZE, dpi=dpi, facecolor=self.theme["paper"])
            self.canvas = FigureCanvasAgg(self.figure)
            self._write(recording.title if title is None else title)
            self._draw_space()
            self._draw_panels()

    def frame(self, t: float) -> np.ndarray:
        """Return the picture [height,width,3] at time t (s), with values from 0 to 255."""
        with styled():
            t = min(t, self.duration)
            for place, arm in enumerate(self.arms):
                self._move_arm(place, arm, t)
            self._move_torques(t)
            self._move_panels(t)
            self._move_texts(t)
            self.canvas.draw()
        return np.asarray(self.canvas.buffer_rgba())[:, :, :3].copy()

    def _color(self, arm: AnimatedArm) -> Any:
        """Return the colour of lines and texts, lighter for the dark theme."""
        dark = self.theme is THEMES["dark"]
        red, green, blue, _ = arm.look.line_color
        return (red / 255, green / 255, blue / 255) if dark else arm.look.style.color

    def _text(self, x: float, y: float, text: str = "", color: str = "ink", **style: Any) -> Any:
        return self.figure.text(x, y, text, color=self.theme.get(color, color), **style)

    def _write(self, title: str) -> None:
        y = 1 - 3 * MARGIN
        text = self._text(MARGIN, y, title, fontsize="x-large", fontweight="bold")
        right = text.get_window_extent().transformed(self.figure.transFigure.inverted()).x1
        text.set_fontsize(text.get_fontsize() * min(1.0, (PANELS - 2 * MARGIN) / right))
        self.clocks = []
        for arm in reversed(self.arms):
            y -= TEXT_LINE
            self._text(MARGIN, y, "●", self._color(arm))
            self.clocks.append((arm, self._text(2 * MARGIN, y)))
        self.gap_text = self._text(MARGIN, y - TEXT_LINE, color="faint")
        self.saving = self._text(MARGIN, MARGIN, fontsize="large", fontweight="bold")

    def _draw_space(self) -> None:
        """Draw fixed things, and create the artists of moving things."""
        theme, size = self.theme, reach(self.robot)
        self.space = space = self.figure.add_axes((0.0, 0.0, 1.0, 1.0), zorder=-1)
        space.axis("off")
        self.floor, self.still = None, [tube_faces(tube, size) for tube in self.around.tubes]
        for obstacle, solid in self.around.obstacles(self.robot):
            if isinstance(obstacle, HalfSpace) and obstacle.normal @ self.up > 1.0 - ROUNDING:
                self.floor = obstacle.offset
            else:
                self.still.append(solid_faces(solid, LONGEST_EDGE * size))
        self._frame_space(space)
        self._draw_floor(space)

        def lines(zorder: float, **style: Any) -> LineCollection:
            collection = LineCollection([], zorder=zorder, **style)
            space.add_collection(collection)
            return collection

        self.shadow = lines(1, colors=[theme["shadow"]], linewidths=[10], capstyle="round")
        self.bodies, self.trails, self.ways = [], [], []
        for place, arm in enumerate(self.arms):
            body = PolyCollection([], zorder=3 + 2 * place, linewidths=0.5)
            self.bodies.append(space.add_collection(body))
            style: dict[str, Any] = {"zorder": 2 + 2 * place} | ({} if arm.look.solid else GHOST)
            self.trails += space.plot([], [], color=self._color(arm), **style)
            self.ways.append(self.camera.project(tool_places(self.robot, arm.q))[0])
        top = 4 + 2 * len(self.arms)
        self.rings = lines(top, linewidths=1.0, colors=[theme["faint"]])
        self.arcs = lines(top + 1, capstyle="round")
        self.gap = lines(top + 1, linewidths=2.0, colors=[theme["limit"]])
        # A dashed line through the joints shows an arm that obstacles hide.
        spine = {"color": self._color(self.solid), "linestyle": (0, (2, 2))}
        (self.spine,) = space.plot([], [], alpha=0.5 if self.still else 0.0, zorder=top, **spine)
        places, _ = self.camera.project(np.reshape(self.recording.places, (-1, 3)))
        marker: dict[str, Any] = {"color": theme["paper"], "markeredgecolor": theme["ink"]}
        note: dict[str, Any] = {"color": theme["ink"], "textcoords": "offset points"}
        note["path_effects"] = halo(theme["paper"])  # legible on obstacles and parts
        for place, name in zip(places, self.recording.place_names, strict=True):
            space.plot(*place[:, None], "o", zorder=top + 2, **marker)
            space.annotate(name, place, xytext=(7, -9), zorder=top + 2, **note)

    def _frame_space(self, space: Axes) -> None:
        """Set the limits of the axes: the whole motion, and near surroundings."""
        points = np.vstack([link_origins(self.robot, arm.q).reshape(-1, 3) for arm in self.arms])
        flat, depth = self.camera.project(np.vstack([points, self.robot.base[None, :3, 3]]))
        margin = (TORQUE_RING * LINK_RADIUS * reach(self.robot) / depth)[:, None]
        low, high = (flat - margin).min(axis=0), (flat + margin).max(axis=0)
        corners = SPACE_CORNERS.copy()
        if self.still:  # surroundings widen the view by up to a half, below the texts
            flat, more = self.camera.project(joined(self.still).corners)[0], high - low
            around = flat.reshape(-1, 2)
            low = np.minimum(low, np.maximum(around.min(axis=0), low - 0.5 * more))
            high = np.maximum(high, np.minimum(around.max(axis=0), high + 0.5 * more))
            corners[1, 1] -= 3 * TEXT_LINE
        frame = np.array(FILM_SIZE)
        scale = ((corners[1] - corners[0]) * frame / (high - low)).min()
        first = (low + high) / 2 - corners.mean(axis=0) * frame / scale
        space.set_xlim(first[0], first[0] + frame[0] / scale)
        space.set_ylim(first[1], first[1] + frame[1] / scale)

    def _draw_floor(self, space: Axes) -> None:
        """Draw a level disc with a grid at the base, or at the floor of the scene."""
        self.base = base = self.robot.base[:3, 3]
        if self.floor is not None:
            self.base = base = base + (self.floor - base @ self.up) * self.up
        across, along = (axis for axis in np.eye(3) if abs(axis @ self.up) < 0.5)
        step, radius = 2 * grid_spacing(self.robot), 0.8 * reach(self.robot)
        turn = np.linspace(0.0, 2 * np.pi, 121)[:, None]
        edge = base + radius * (np.cos(turn) * across + np.sin(turn) * along)
        disc = self.camera.project(edge)[0].T
        space.fill(*disc, color=self.theme["floor"], zorder=0, linewidth=0)
        ends = [
            [base + k * step * a + s * np.sqrt(radius**2 - (k * step) ** 2) * b for s in (-1, 1)]
            for k in range(-int(radius / step), int(radius / step) + 1)
            for a, b in ((across, along), (along, across))
        ]
        segments = list(self.camera.project(np.array(ends))[0])
        style = {"colors": [self.theme["grid"]], "zorder": 0.5}
        space.add_collection(LineCollection(segments, **style))

    def _draw_panels(self) -> None:
        """Draw one panel per joint: torque (or velocity) over time as a share of its limit."""
        theme, quantity = self.theme, self._quantity()
        heading = f"{quantity_name(quantity)} within its limits (dashed)"
        self._text(PANELS, 1 - 3 * MARGIN, heading, "faint")
        place = (PANELS - MARGIN, 0.0)
        behind = Rectangle(place, 1.0, 1.0, color=theme["paper"], linewidth=0, zorder=-0.5)
        self.figure.add_artist(behind)  # the floor ends beside the panels
        self.curves, self.cursors = [], []
        places = {"left": PANELS, "right": 1 - MARGIN, "top": 1 - 4 * MARGIN, "bottom": 5 * MARGIN}
        count = min(self.robot.joint_count, 7)
        panels = self.figure.subplots(count, sharex=True, squeeze=False, gridspec_kw=places)[:, 0]
        for joint, panel in enumerate(panels):
            panel.set_facecolor("none")
            panel.grid(False)
            panel.spines[:].set_visible(False)
            panel.axhline(0.0, color=theme["grid"], **THIN)
            for bound in (-1.0, 1.0):
                panel.axhline(bound, color=theme["limit"], linestyle=DASHED, **THIN)
            span = 1.0
            for arm in self.arms:
                share, style = self._share(arm, joint, quantity), {} if arm.look.solid else GHOST
                (curve,) = panel.plot([], [], color=self._color(arm), **style)
                self.curves.append((curve, arm.times[TIME], share))
                span = max(span, float(np.abs(share).max()))
            span *= 1 + AXIS_MARGIN
            panel.set_ylim(-span, span)
            panel.set_yticks([0.0], [_in_lines(self.robot.joint_names[joint])])
            panel.tick_params(length=0, colors=theme["faint"], labelsize=SMALL_FONT)
            panel.tick_params(axis="y", labelcolor=theme["ink"])
            self.cursors.append(panel.axvline(0.0, color=theme["faint"], **THIN))
        panels[-1].set_xlim(0.0, self.duration)
        panels[-1].set_xlabel("t [s]", fontsize="small", color=theme["faint"], labelpad=1)

    def _quantity(self) -> str:
        """Return "qd" without torques or if only a velocity limit is nearly met, or else "tau"."""
        history = self.solid.history
        if not self.robot.has_dynamics or "tau" not in self.solid.curves:
            return "qd"
        if history is None or not {"tau", "qd"} <= set(history.use):
            return "tau"
        torque, speed = (float(history.use[key].max()) for key in ("tau", "qd"))
        return "qd" if torque < AT_LIMIT <= speed else "tau"

    def _share(self, arm: AnimatedArm, joint: int, quantity: str) -> FloatArray:
        """Return the use [N] of the limit of a joint, relative to its largest value without."""
        values = arm.curves.get(quantity)
        if values is None:
            return np.full(len(arm.q), np.nan)
        return signed_share(self.recording.limits, quantity, values[:, joint], joint)[0]

    def _move_arm(self, place: int, arm: AnimatedArm, t: float) -> None:
        """Show an arm; the solid arm is depth-sorted together with its surroundings."""
        share = 1.0 if arm.look.solid else GHOST["alpha"]
        link, joint = (
            _bytes(_mixed(color, self.theme["paper"], share))
            for color in (self._color(arm), self.theme["joint"])
        )
        q = _at(arm, t)
        poses = link_poses(self.robot, q[None])[0]
        frames = arm_bodies(self.robot, poses, link, joint)
        bodies = [faces.placed(poses[frame]) for frame, faces in frames]
        if arm is self.solid:
            bodies += [*self.still, *self._parts(t)]
        polygons, colors = self.camera.picture(joined(bodies))
        self.bodies[place].set_verts(polygons)
        self.bodies[place].set_facecolors(colors)
        self.bodies[place].set_edgecolors(colors)
        self.trails[place].set_data(*self.ways[place][arm.times[TIME] <= t].T)
        if arm is self.solid:
            points = poses[1:, :3, 3]
            self.spine.set_data(*self.camera.project(points)[0].T)
            below = points - np.outer((points - self.base) @ self.up, self.up)
            self.shadow.set_segments([self.camera.project(below)[0]])

    def _parts(self, t: float) -> list[Faces]:
        """Return the carried parts at time t, with interpolated poses."""
        at, edge = _sample(self.solid, t), LONGEST_EDGE * reach(self.robot)
        faces = []
        for payload, poses in self.around.parts:
            after = min(int(at) + 1, len(poses) - 1)
            pose = (int(at) + 1 - at) * poses[int(at)] + (at - int(at)) * poses[after]
            faces += [solid_faces(solid, edge).placed(pose) for solid in part_solids(payload)]
        return faces

    def _move_torques(self, t: float) -> None:
        """Show torque arcs around the joints of the solid arm, closed at the limit."""
        if "tau" not in self.solid.curves or not self.robot.has_dynamics:
            return
        radius = TORQUE_RING * LINK_RADIUS * reach(self.robot)
        poses = link_poses(self.robot, _at(self.solid, t)[None])[0]
        rings, strips, colors, widths = [], [], [], []
        for joint, kind in enumerate(self.robot.joint_types):
            if kind != "revolute":
                continue
            shares = self._share(self.solid, joint, "tau")
            pose = poses[self.robot.joint_frames[joint]]
            share = float(np.interp(t, self.solid.times[TIME], shares))
            curves = arcs(np.array([1.0, share]), radius) @ pose[:3, :3].T + pose[:3, 3]
            (ring, strip), _ = self.camera.project(curves)
            rings.append(ring[:-3])
            strips.append(strip)
            full = abs(share) >= AT_LIMIT
            color = _mixed(self.theme["high"], self.theme["low"], min(1.0, abs(share)))
            colors.append(to_rgb(self.theme["limit"]) if full else color)
            widths.append(4 if full else 3)
        self.rings.set_segments(rings)
        self.arcs.set_segments(strips)
        self.arcs.set_colors(colors)
        self.arcs.set_linewidth(widths)

    def _move_panels(self, t: float) -> None:
        for curve, times, share in self.curves:
            curve.set_data(times[times <= t], share[times <= t])
        for cursor in self.cursors:
            cursor.set_xdata([t, t])

    def _move_texts(self, t: float) -> None:
        """Write the clocks, the smallest distance, and the time saved by the solid arm."""
        for arm, text in self.clocks:
            end = float(arm.times[TIME][-1])
            text.set_text(f"{arm.title or arm.name}   {min(t, end):.2f} s")
            text.set_fontweight("bold" if t >= end else "normal")
        if self.nearest:
            near = self.nearest[round(_sample(self.solid, t))]
            self.gap.set_segments([self.camera.project(np.array([near.on_arm, near.on_other]))[0]])
            apart = 1e3 * near.distance
            how = f"{apart:.1f} mm apart" if apart > 0.0 else f"overlap of {-apart:.1f} mm"
            self.gap_text.set_text(f"{near.pair.label}: {how}")
        end = float(self.solid.times[TIME][-1])
        others = [(float(a.times[TIME][-1]), a.title) for a in self.arms[:-1] if a.title]
        reference, title = min(others, default=(end, ""))
        saved = reference - end
        text = f"{100 * saved / reference:.0f} % less time ({saved:.2f} s) than\n{title}"
        self.saving.set_text(text if t >= end and saved > 0.0 else "")


def _in_lines(name: str) -> str:
    """Return the name of a joint in lines of up to 11 characters, split at underscores."""
    words = name.replace("_", "_ ").rstrip()
    return "\n".join(line.replace("_ ", "_") for line in textwrap.wrap(words, 11))


def _sample(arm: AnimatedArm, t: float) -> float:
    """Return the fractional index of the sample at time t, s."""
    times = arm.times[TIME]
    return float(np.interp(t, times, np.arange(len(times))))


def _at(arm: AnimatedArm, t: float) -> FloatArray:
    """Return the joint positions [n] at time t, s."""
    return np.array([np.interp(t, arm.times[TIME], column) for column in arm.q.T])
