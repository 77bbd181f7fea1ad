"""One frame after the other of a recording: the arms in space, clocks, and torques over time."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.views._scene import link_origins, link_poses, reach
from microbot_ocp.views.animation._around import part_faces, still_faces
from microbot_ocp.views.animation._bodies import Camera, Color, arm_faces
from microbot_ocp.views.plots import styled
from microbot_ocp.views.recording import (
    TIME,
    AnimatedArm,
    Recording,
    arcs,
    grid_spacing,
    signed_share,
)

SIZE = (8.0, 4.5)  # inches: 800 x 450 at 100 dots an inch
STAGE = (0.02, 0.105, 0.61, 0.86)  # left, bottom, right, top of the arms, of the frame
FLOOR = 0.8  # radius, of the reach
RING = 0.085  # radius of a torque's arc, of the reach
NEARLY = 0.9  # of a limit: worth showing
HIDDEN = 0.5  # opacity of the line along the arm that is seen through what stands before it
HEAD = 0.14  # of the frame's height, above the stage: for the texts, where a scene fills it
WIDE = 0.6  # share of the arm's own size that what is around it may add to the picture
GHOST = 0.34  # share of its own colour that a ghost has
PANEL_JOINTS = 7  # rows of torques: of more joints the first ones
THEMES = {
    "light": {
        "paper": "#ffffff", "ink": "#1b2330", "faint": "#8a94a3", "grid": "#dfe4ea",
        "floor": "#f1f4f7", "shadow": "#d3d9e0", "joint": "#39424f", "limit": "#c8157a",
        "low": "#7d8898", "high": "#d98200",
    },
    "dark": {
        "paper": "#0f141b", "ink": "#e8edf3", "faint": "#8793a3", "grid": "#2a3340",
        "floor": "#151c25", "shadow": "#090c10", "joint": "#a9b4c2", "limit": "#ff4da6",
        "low": "#8793a3", "high": "#f0e442",
    },
}  # fmt: skip


def _mixed(color: Any, other: Any, share: float) -> Color:
    first, second = np.array(to_rgb(color)), np.array(to_rgb(other))
    red, green, blue = share * first + (1.0 - share) * second
    return red, green, blue


class Film:
    """Frames of a recording's arms that move in time.

    Parameters
    ----------
    recording : Recording
        Of a motion, a comparison or a controlled arm; it is seen from ``recording.eye``.
    theme : str
        "light" or "dark".
    title : str, optional
        Default that of the recording.
    dpi : int
        Dots an inch of a frame of 8 x 4.5 inches.

    Raises
    ------
    InputError
        No arm moves; an unknown theme.
    """

    def __init__(
        self, recording: Recording, theme: str = "light", title: str | None = None, dpi: int = 100
    ) -> None:
        if theme not in THEMES:
            raise InputError(f"theme must be one of {', '.join(THEMES)}, not {theme!r}")
        self.arms = [arm for arm in recording.arms if arm.moves]
        if not self.arms:
            raise InputError("recording must have an arm that moves")
        self.recording, self.robot = recording, recording.robot
        self.arms.sort(key=lambda arm: arm.look.solid)  # the solid one is drawn last
        self.solid = self.arms[-1]
        self.theme = THEMES[theme]
        self.camera = Camera(recording.eye)
        self.duration = max(float(arm.times[TIME][-1]) for arm in self.arms)
        with styled():
            self.figure = Figure(figsize=SIZE, dpi=dpi, facecolor=self.theme["paper"])
            self.canvas = FigureCanvasAgg(self.figure)
            self._still(recording.title if title is None else title)

    def frame(self, t: float) -> np.ndarray:
        """The picture [height,width,3] at time t, 0 to 255."""
        with styled():
            self._move(min(t, self.duration))
            self.canvas.draw()
        return np.asarray(self.canvas.buffer_rgba())[:, :, :3].copy()

    @property
    def alone(self) -> bool:
        """Whether nothing but arms is shown."""
        return self.still is None and not self.carried

    @cached_property
    def _tools(self) -> list[FloatArray]:
        """Tool positions in the picture along each motion."""
        return [self.camera.project(link_origins(self.robot, arm.q)[:, -1])[0] for arm in self.arms]

    def _color(self, arm: AnimatedArm) -> Color:
        """Of lines and texts."""
        return _mixed(arm.look.style.color, "#ffffff", 0.8 if self.theme["paper"] < "#8" else 1.0)

    def _link_color(self, arm: AnimatedArm) -> Color:
        share = 1.0 if arm.look.solid else GHOST
        return _mixed(self._color(arm), self.theme["paper"], share)

    def _still(self, title: str) -> None:
        """What does not move, and the artists of what does."""
        theme = self.theme
        heading = {"color": theme["ink"], "fontsize": 13, "fontweight": "bold", "va": "top"}
        self.figure.text(0.025, 0.965, title, **heading)
        self.clocks = []
        for row, arm in enumerate(reversed(self.arms)):
            y = 0.885 - 0.052 * row
            self.figure.text(0.027, y, "●", color=self._color(arm), fontsize=11, va="center")
            text = self.figure.text(0.052, y, "", color=theme["ink"], fontsize=10.5, va="center")
            self.clocks.append((arm, text))
        self.words = self.figure.text(
            0.025, 0.045, "", color=theme["ink"], fontsize=12, fontweight="bold", va="center"
        )
        self.space = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self.space.set_zorder(-1)
        self.space.axis("off")
        self.up, self.base = self.recording.eye.up, self.robot.base[:3, 3]
        still, self.floor = still_faces(self.recording, self.up)
        self.still = None if still is None else self.camera.picture(still)
        self.carried, self.nearest = self.recording.carried, self.recording.nearest()
        self._frame_space(self.space)
        self._floor(self.space)
        made: dict[str, Any] = {"linewidths": 0.4, "antialiaseds": True}
        self.shadow = LineCollection([], colors=[theme["shadow"]], zorder=1, capstyle="round")
        self.space.add_collection(self.shadow)
        self.bodies, self.trails = [], []
        for place, arm in enumerate(self.arms):
            body = PolyCollection([], zorder=3 + 2 * place, **made)
            self.space.add_collection(body)
            (trail,) = self.space.plot(
                [], [], color=self._color(arm), linewidth=1.8, zorder=2 + 2 * place,
                alpha=0.9 if arm.look.solid else 0.45, solid_capstyle="round",
            )  # fmt: skip
            self.bodies.append(body)
            self.trails.append(trail)
        top = 4 + 2 * len(self.arms)
        self.rings = LineCollection([], linewidths=1.0, colors=[theme["faint"]], zorder=top)
        self.arcs = LineCollection([], zorder=top + 1, capstyle="round")
        (self.spine,) = self.space.plot(
            [], [], color=self._color(self.solid), linewidth=1.2, linestyle=(0, (2, 2)), zorder=top,
            alpha=HIDDEN if self.still is not None else 0.0,
        )  # fmt: skip
        self.gap = LineCollection([], linewidths=2.0, colors=[theme["limit"]], zorder=top + 1)
        for each in (self.rings, self.arcs, self.gap):
            self.space.add_collection(each)
        self.said = self.figure.text(
            0.027,
            0.885 - 0.052 * len(self.arms),
            "",
            color=theme["faint"],
            fontsize=9.5,
            va="center",
        )
        places, _ = self.camera.project(np.reshape(self.recording.places, (-1, 3)))
        for (x, y), name in zip(places, self.recording.place_names, strict=True):
            self.space.plot(
                [x], [y], "o", color=theme["paper"], markeredgecolor=theme["ink"], markersize=5.5,
                zorder=top + 2,
            )  # fmt: skip
            self.space.annotate(
                name, (x, y), xytext=(7, -9), textcoords="offset points", fontsize=8.5,
                color=theme["faint"], zorder=top + 2,
            )  # fmt: skip
        self._panels()

    def _frame_space(self, space: Axes) -> None:
        """Axes limits that hold the arms at all times."""
        size = reach(self.robot)
        points = np.vstack([link_origins(self.robot, arm.q).reshape(-1, 3) for arm in self.arms])
        points = np.vstack([points, self.robot.base[None, :3, 3]])
        flat, depth = self.camera.project(points)
        margin = (0.11 * size / depth)[:, None]
        low, high = (flat - margin).min(axis=0), (flat + margin).max(axis=0)
        if self.still is not None:
            seen = self.still[0].reshape(-1, 2)
            more = WIDE * (high - low)
            low = np.minimum(low, np.maximum(seen.min(axis=0), low - more))
            high = np.maximum(high, np.minimum(seen.max(axis=0), high + more))
        left, bottom, right, top = STAGE
        top -= HEAD if self.still is not None else 0.0
        scale = min(
            (right - left) * SIZE[0] / (high - low)[0], (top - bottom) * SIZE[1] / (high - low)[1]
        )
        for limits, centre, middle, inches in (
            (space.set_xlim, (left + right) / 2, (low + high)[0] / 2, SIZE[0]),
            (space.set_ylim, (bottom + top) / 2, (low + high)[1] / 2, SIZE[1]),
        ):
            limits(middle - centre * inches / scale, middle + (1.0 - centre) * inches / scale)

    def _floor(self, space: Axes) -> None:
        """A level disc with a grid under the base, or at the height of a floor of the scene."""
        up, base = self.up, self.base
        if self.floor is not None:
            self.base = base = base + (self.floor - base @ up) * up
        across, along = (axis for axis in np.eye(3) if abs(axis @ up) < 0.5)
        step, radius = 2 * grid_spacing(self.robot), FLOOR * reach(self.robot)
        turn = np.linspace(0.0, 2 * np.pi, 121)[:, None]
        edge = base + radius * (np.cos(turn) * across + np.sin(turn) * along)
        flat, _ = self.camera.project(edge)
        space.fill(*flat.T, color=self.theme["floor"], zorder=0, linewidth=0)
        lines = []
        count = int(radius / step)
        for k in range(-count, count + 1):
            half = np.sqrt(radius**2 - (k * step) ** 2)
            for a, b in ((across, along), (along, across)):
                ends = [base + k * step * a - half * b, base + k * step * a + half * b]
                lines.append(self.camera.project(np.array(ends))[0])
        grid = LineCollection(lines, colors=[self.theme["grid"]], linewidths=0.8, zorder=0.5)
        space.add_collection(grid)

    def _panels(self) -> None:
        """A panel a joint: torque over time as a share of its limit."""
        self.curves, self.cursors = [], []
        self.quantity = self._telling()
        count = min(self.robot.joint_count, PANEL_JOINTS)
        word = {"tau": "torque", "qd": "velocity"}[self.quantity]
        self.figure.text(
            0.70, 0.945, f"{word} within its limits (dashed)", color=self.theme["faint"],
            fontsize=9.5, va="center",
        )  # fmt: skip
        top, bottom, gap = 0.905, 0.115, 0.022
        height = (top - bottom - gap * (count - 1)) / count
        for joint in range(count):
            rect = (0.70, top - (joint + 1) * height - joint * gap, 0.28, height)
            panel = self.figure.add_axes(rect, facecolor=self.theme["paper"])
            self._panel(panel, joint, last=joint == count - 1)

    def _panel(self, panel: Axes, joint: int, last: bool) -> None:
        theme = self.theme
        panel.grid(False)
        for side in ("top", "right", "left", "bottom"):
            panel.spines[side].set_visible(False)
        panel.axhline(0.0, color=theme["grid"], linewidth=0.8)
        for bound in (-1.0, 1.0):
            panel.axhline(bound, color=theme["limit"], linewidth=0.9, linestyle=(0, (4, 3)))
        panel.set_xlim(0.0, self.duration)
        shares = [self._share(arm, joint, self.quantity) for arm in self.arms]
        span = 1.18 * max(1.0, *(float(np.abs(share).max()) for share in shares))
        panel.set_ylim(-span, span)
        name = self.robot.joint_names[joint]
        panel.set_yticks([0.0], [name if len(name) < 10 else f"joint {joint + 1}"], fontsize=8.5)
        panel.tick_params(length=0, colors=theme["faint"], pad=4)
        panel.tick_params(axis="y", labelcolor=theme["ink"])
        if not last:
            panel.set_xticks([])
        else:
            panel.set_xlim(0.0, self.duration)
            panel.tick_params(axis="x", labelsize=7.5, length=2)
            panel.set_xlabel("t [s]", fontsize=8, color=theme["faint"], labelpad=1)
        for arm, share in zip(self.arms, shares, strict=True):
            (curve,) = panel.plot(
                [], [], color=self._color(arm), linewidth=2.0 if arm.look.solid else 1.3,
                alpha=1.0 if arm.look.solid else 0.75,
            )  # fmt: skip
            self.curves.append((curve, arm.times[TIME], share))
        self.cursors.append(panel.axvline(0.0, color=theme["faint"], linewidth=0.8))

    def _telling(self) -> str:
        """Torque where a limit of it is nearly met, or else velocity."""
        history = self.solid.history
        if not self.robot.has_dynamics or "tau" not in self.solid.curves:
            return "qd"
        if history is None or not {"tau", "qd"} <= set(history.use):
            return "tau"
        peaks = {key: float(history.use[key].max()) for key in ("tau", "qd")}
        return "qd" if peaks["tau"] < NEARLY <= peaks["qd"] else "tau"

    def _share(self, arm: AnimatedArm, joint: int, quantity: str) -> FloatArray:
        """Share [N] of its limit that a joint uses; of its largest value where it has none."""
        values = arm.curves.get(quantity)
        if values is None:
            return np.full(len(arm.q), np.nan)
        return signed_share(self.recording.limits, quantity, values[:, joint], joint)[0]

    def _move(self, t: float) -> None:
        poses = [_at(arm, t) for arm in self.arms]
        shadows: list[FloatArray] = []
        for arm, q, body, trail, tool in zip(
            self.arms, poses, self.bodies, self.trails, self._tools, strict=True
        ):
            joint = _mixed(self.theme["joint"], self.theme["paper"],
                           1.0 if arm.look.solid else GHOST)  # fmt: skip
            faces = arm_faces(self.robot, q, self._link_color(arm), joint)
            polygons: list[FloatArray] = []
            colors: list[FloatArray] = []
            depths: list[FloatArray] = []
            middles: list[float] = []
            for each in faces:
                flat, shade, depth = self.camera.picture(each)
                polygons.append(flat)
                colors.append(shade)
                depths.append(depth)
                middles.append(float(self.camera.project(each.corners)[1].mean()))
            if arm is self.arms[-1] and not self.alone:
                self._show_among(body, arm, t, polygons, colors, depths)
            else:
                order = np.argsort(-np.array(middles), kind="stable")
                body.set_verts([polygon for k in order for polygon in polygons[k]])
                tints = np.concatenate([colors[k] for k in order])
                body.set_facecolors(tints)
                body.set_edgecolors(tints)
            shown = arm.times[TIME] <= t
            trail.set_data(*tool[shown].T)
            points = link_origins(self.robot, q[None])[0][1:]
            self.spine.set_data(*self.camera.project(points)[0].T)
            points = points - np.outer((points - self.base) @ self.up, self.up)
            if arm.look.solid:
                shadows.append(self.camera.project(points)[0])
        self.shadow.set_segments(shadows)
        self.shadow.set_linewidth([9.0])
        self._move_torques(poses[-1], t)
        self._show_nearest(t)
        for curve, times, share in self.curves:
            shown = times <= t
            curve.set_data(times[shown], share[shown])
        for cursor in self.cursors:
            cursor.set_xdata([t, t])
        for arm, text in self.clocks:
            end = float(arm.times[TIME][-1])
            name = arm.title or arm.name
            text.set_text(f"{name}   {min(t, end):.2f} s")
            text.set_fontweight("bold" if t >= end else "normal")
        self.words.set_text(self._saving(t))

    def _show_among(
        self,
        body: Any,
        arm: AnimatedArm,
        t: float,
        polygons: list[FloatArray],
        colors: list[FloatArray],
        depths: list[FloatArray],
    ) -> None:
        """The arm's faces, obstacles, tubes and parts, all sorted by depth."""
        still = () if self.still is None else (self.still,)
        at = _sample(arm, t)
        parts = [self.camera.picture(part_faces(part, at)) for part in self.carried]
        around = (*still, *parts)
        order = np.argsort(-np.concatenate([*depths, *(depth for _, _, depth in around)]))
        every = [
            polygon for flat in (*polygons, *(flat for flat, _, _ in around)) for polygon in flat
        ]
        tints = np.concatenate([*colors, *(shade for _, shade, _ in around)])[order]
        body.set_verts([every[k] for k in order])
        body.set_facecolors(tints)
        body.set_edgecolors(tints)

    def _show_nearest(self, t: float) -> None:
        """The line between the nearest points, and how long it is."""
        if not self.nearest:
            return
        near = self.nearest[round(_sample(self.solid, t))]
        self.gap.set_segments([self.camera.project(np.array([near.on_arm, near.on_other]))[0]])
        apart = 1e3 * near.distance
        how = f"{apart:.1f} mm apart" if apart > 0.0 else f"overlap of {-apart:.1f} mm"
        self.said.set_text(f"{near.pair.label}: {how}")

    def _move_torques(self, q: FloatArray, t: float) -> None:
        """Arcs around the joints of the solid arm, closed at the limit."""
        if "tau" not in self.solid.curves or not self.robot.has_dynamics:
            return
        size, times = RING * reach(self.robot), self.solid.times[TIME]
        poses = link_poses(self.robot, q[None])[0]
        rings, strips, colors, widths = [], [], [], []
        for joint, kind in enumerate(self.robot.joint_types):
            if kind != "revolute":
                continue
            share = np.interp(t, times, self._share(self.solid, joint, "tau"))
            pose = poses[joint + 1]
            for part, found in ((1.0, rings), (share, strips)):
                curve = arcs(np.array([part]), size)[0]
                if found is rings:
                    curve = curve[:25]
                world = curve @ pose[:3, :3].T + pose[:3, 3]
                found.append(self.camera.project(world)[0])
            full = abs(share) >= 0.99
            color = _mixed(self.theme["high"], self.theme["low"], float(min(1.0, abs(share))))
            colors.append(to_rgb(self.theme["limit"]) if full else color)
            widths.append(4.2 if full else 3.0)
        self.rings.set_segments(rings)
        self.arcs.set_segments(strips)
        self.arcs.set_colors(colors)
        self.arcs.set_linewidth(widths)

    def _saving(self, t: float) -> str:
        """What the solid arm saves, once it has arrived."""
        end = float(self.solid.times[TIME][-1])
        others = [float(arm.times[TIME][-1]) for arm in self.arms[:-1] if arm.title]
        if t < end or not others or max(others) <= end:
            return ""
        saved = max(others) - end
        return f"{100 * saved / max(others):.0f} % less time ({saved:.2f} s) under the same limits"


def _sample(arm: AnimatedArm, t: float) -> float:
    """Index of the sample at time t, s, a fraction between samples."""
    times = arm.times[TIME]
    return float(np.interp(t, times, np.arange(len(times))))


def _at(arm: AnimatedArm, t: float) -> FloatArray:
    """Joint positions [n] at time t, s."""
    times = arm.times[TIME]
    return np.array([np.interp(t, times, column) for column in arm.q.T])
