"""A page in the browser: via points, limits and payload under sliders, and the fastest motion.

The page, its 3-D view and its charts are viser's; all of it comes from this machine.
"""

from __future__ import annotations

import io
import threading
import time
from contextlib import redirect_stdout
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.codegen import interpreted
from microbot_ocp._base.needed import needed
from microbot_ocp.robot import Robot, joint_scale
from microbot_ocp.tasks import compare
from microbot_ocp.views._eye import find_eye, grid_spacing, upward
from microbot_ocp.views._scene import link_poses, reach, tool_places
from microbot_ocp.views._solids import frame_along
from microbot_ocp.views._style import JOINT_LOOKS, STYLE, rgb
from microbot_ocp.views.animation import Faces, arm_bodies
from microbot_ocp.views.live import LOOPBACK, InteractiveTask, Setting
from microbot_ocp.views.recording import signed_share

CHARTS = {"tau": "torque, % of its limit", "qd": "velocity, % of its limit"}
LINK, JOINT = (*rgb("#D55E00"), 255), (130, 142, 160, 255)


def studio(
    robot: Robot, via_q: ArrayLike | None = None, *, port: int = 8080, dark: bool = False
) -> Studio:
    """Open a page for the browser on which the fastest motion follows sliders.

    Sliders move every joint of every via point, scale all torque and all velocity limits, and put
    a payload at the tool. The task is solved again by :class:`microbot_ocp.TimeOptimalSolver`; the
    arm moves, charts show torques and velocities as shares of their limits, and a line says how
    much shorter the motion is than cubic segments at their best split. The page is served to this
    machine only and loads nothing from elsewhere.

    Parameters
    ----------
    robot : Robot
        With masses and limits.
    via_q : array_like [m,n], optional
        Via points, rad (prismatic: m); default three in the middle of the joints' ranges.
    port : int
        Where the page is; a free one after it where it is taken.
    dark : bool
        Begin with the dark theme; the page's own settings change it.

    Returns
    -------
    Studio
        Its ``address`` is for the browser; ``close()`` ends the page.

    Raises
    ------
    InputError
        As :class:`microbot_ocp.TimeOptimalSliders`; viser is missing.
    """
    checks.number("port", port, at_least=1, at_most=65535)
    if via_q is None:
        low, high = _ranges(robot)
        via_q = [low + share * (high - low) for share in (0.4, 0.5, 0.6)]
    return Studio(robot, via_q, port, dark)


class Studio(InteractiveTask):
    """A page that is open; :func:`studio` makes one.

    Attributes
    ----------
    address : str
        Where the browser finds it, on this machine only.
    motion : Motion or None
        The last motion; None where there is none for the last setting.
    saved : float or None
        Share of the time of cubic segments at their best split that it saves.
    robot : Robot
        With the limits and the payload of the last setting.
    message : str
        Duration, saturated joints and solve time, or why there is no motion.
    """

    def __init__(self, robot: Robot, via_q: ArrayLike, port: int, dark: bool) -> None:
        viser = needed("viser", "the studio needs", "studio")
        super().__init__(robot, via_q)
        self._via_q = self._solver.via_q
        self._quaternions = lambda poses: viser.transforms.SO3.from_matrix(poses[:, :3, :3]).wxyz
        with redirect_stdout(io.StringIO()):  # viser prints addresses
            self._server = viser.ViserServer(LOOPBACK, port, f"{robot.name} studio", verbose=False)
        self.address = f"http://{LOOPBACK}:{self._server.get_port()}"
        self._closed = threading.Event()
        self._draw_controls(dark)
        self._draw_space()
        self._answer(Setting())
        self._player = threading.Thread(target=self._play, daemon=True)
        self._player.start()

    def close(self) -> None:
        """End the page."""
        self._closed.set()
        self._player.join()
        with redirect_stdout(io.StringIO()):
            self._server.stop()

    def wait_until_closed(self) -> None:
        """Wait for :meth:`close` in another thread, or for Ctrl-C."""
        self._closed.wait()

    def _draw_controls(self, dark: bool) -> None:
        gui, robot, scale = self._server.gui, self._bare, joint_scale(self._bare)
        # sharing would leave this machine
        gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)
        gui.main_panel.dock_left()
        self._headline = gui.add_markdown("")
        torque = gui.add_slider("torque limits [%]", 50, 150, 1, 100)
        speed = gui.add_slider("speed limits [%]", 50, 150, 1, 100)
        payload = gui.add_slider("payload [kg]", 0.0, 2.0, 0.05, 0.0)
        joints, (low, high) = [], _ranges(robot)
        for place, q in enumerate(self._via_q, start=1):
            with gui.add_folder(f"via point {place}"):
                for name, kind, *ends in zip(
                    robot.joint_names,
                    robot.joint_types,
                    low / scale,
                    high / scale,
                    q / scale,
                    strict=True,
                ):
                    unit, step = ("deg", 1.0) if kind == "revolute" else ("m", 0.01)
                    least, most, value = (round(float(end), 6) for end in ends)
                    joints.append(gui.add_slider(f"{name} [{unit}]", least, most, step, value))
        first, lock = np.array([slider.value for slider in joints]), threading.Lock()

        def ask(_: Any) -> None:
            with lock:  # every slider calls from a thread of its own
                values = np.array([slider.value for slider in joints])
                moved = (values * np.tile(scale, len(self._via_q))).reshape(self._via_q.shape)
                via_q = None if np.array_equal(values, first) else moved
                setting = Setting(torque.value / 100, speed.value / 100, payload.value, via_q)
                self._work.ask(setting)

        for slider in (torque, speed, payload, *joints):
            slider.on_update(ask)
        panel = gui.add_panel()
        with panel.add_tab("limits"):
            self._charts = {key: self._chart(title) for key, title in CHARTS.items()}
        panel.dock_right()
        panel.set_width(440)

    def _chart(self, title: str) -> Any:
        names = self._bare.joint_names
        bound = {"stroke": "#888888", "dash": [6, 4], "width": 1.5, "label": "limit"}
        curves = [
            {"stroke": color, "width": 2, "label": name}
            for name, (color, _) in zip(names, JOINT_LOOKS * len(names), strict=False)
        ]
        empty = np.zeros(2)
        return self._server.gui.add_uplot(
            tuple([empty] * (len(names) + 3)),
            ({"label": "t [s]"}, bound, {**bound, "label": "lower limit"}, *curves),
            title=title,
            scales={"x": {"time": False}, "y": {"range": (-110.0, 110.0)}},
            aspect=1.5,
        )

    def _draw_space(self) -> None:
        scene, robot, motion = self._server.scene, self._bare, self._reference
        size, up = reach(robot), upward(robot)
        eye = find_eye(robot, motion.q, tool_places(robot, self._via_q), 0.1 * size)
        scene.set_up_direction(up)
        camera = self._server.initial_camera
        camera.up, camera.position, camera.look_at = eye.up, eye.position, eye.target
        ground = self._quaternions(frame_along(up)[None])[0]
        cell = grid_spacing(robot)
        scene.add_grid(
            "/ground", 2 * size, 2 * size, wxyz=ground, position=robot.base[:3, 3],
            cell_size=cell, section_size=2 * cell,
        )  # fmt: skip
        poses = link_poses(robot, motion.q[:1])[0]
        self._frames = [scene.add_frame(f"/arm/{k}", show_axes=False) for k in range(len(poses))]
        for place, (frame, faces) in enumerate(arm_bodies(robot, poses, LINK, JOINT)):
            self._add_body(f"/arm/{frame}/{place}", faces)
        self._via = [
            scene.add_icosphere(f"/via/{place}", 1.4 * STYLE.link * size, color=STYLE.part[:3])
            for place in range(1, len(self._via_q) + 1)
        ]
        for ball in self._via:
            scene.add_label(f"{ball.name}/name", f"via point {ball.name[5:]}")
        self._place(motion.q[0])

    def _add_body(self, name: str, faces: Faces) -> None:
        corners = faces.corners.reshape(-1, 3).round(6)
        vertices, index = np.unique(corners, axis=0, return_inverse=True)
        quads = index.reshape(-1, 4)
        triangles = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        color = tuple(np.rint(255 * faces.colors.mean(axis=0)).astype(int).tolist())
        self._server.scene.add_mesh_simple(name, vertices, triangles, color=color)

    def _place(self, q: FloatArray) -> None:
        poses = link_poses(self._bare, q[None])[0]
        with self._server.atomic():
            for frame, pose, turn in zip(
                self._frames, poses, self._quaternions(poses), strict=True
            ):
                frame.position, frame.wxyz = pose[:3, 3], turn
            if "prismatic" in self._bare.joint_types and not self._bare.shapes:
                for place, (frame, faces) in enumerate(arm_bodies(self._bare, poses, LINK, JOINT)):
                    self._add_body(f"/arm/{frame}/{place}", faces)

    def _play(self) -> None:
        begin = time.monotonic()
        while not self._closed.wait(1.0 / STYLE.frame_rate):
            motion = self.motion
            if motion is not None and self._server.get_clients():
                t = (time.monotonic() - begin) % (motion.duration + STYLE.hold)
                self._place(motion.sample(min(t, motion.duration)).q[0])

    def _show(self, setting: Setting) -> None:
        motion, robot, scene = self.motion, self.robot, self._server.scene
        via_q = self._via_q if setting.via_q is None else setting.via_q
        for ball, position in zip(self._via, tool_places(robot, via_q), strict=True):
            ball.position = position
        for chart in self._charts.values():
            chart.visible = motion is not None
        self.saved = None
        if motion is None:
            scene.remove_by_name("/trail")
            self._headline.content = f"## no motion\n{self.message}"
            return
        with self._server.atomic():
            tool, limit = tool_places(robot, motion.q), np.full(motion.t.shape, 100.0)
            thin = 0.2 * STYLE.link * reach(robot)
            ends = np.stack([tool[:-1], tool[1:]], axis=1)
            scene.add_line_segments("/trail", ends, STYLE.motion[:3], thickness=thin)
            for key, chart in self._charts.items():
                shares = [
                    100.0 * signed_share(robot.limits, key, values, joint)[0]
                    for joint, values in enumerate(getattr(motion, key).T)
                ]
                chart.data = (motion.t, limit, -limit, *shares)
            self._headline.content = f"## {motion.duration:.3f} s\n{self.message}"
        with interpreted():  # an arm with a payload is met once: nothing is compiled for it
            baseline = compare(robot, via_q, ["cubic"]).motions["cubic"]
        self.saved = 1.0 - motion.duration / baseline.duration
        self._headline.content = (
            f"## {motion.duration:.3f} s, {100 * self.saved:.0f} % saved\n"
            f"Cubic segments at their best split take {baseline.duration:.3f} s.\n\n{self.message}"
        )


def _ranges(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Return the least and largest joint positions [n] of sliders: limits, or one turn."""
    low, high = robot.limits.bounds("q")
    low = np.where(np.isfinite(low), low, -np.pi)
    return low, np.where(np.isfinite(high), high, np.pi)
