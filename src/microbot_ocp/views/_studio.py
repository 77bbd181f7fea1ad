"""Studio: a page in the browser with movable via points, limits, payload and the fastest motion.

viser serves the page, its 3-D view and its charts from this machine.
"""

from __future__ import annotations

import io
import threading
import time
from contextlib import redirect_stdout
from functools import partial
from importlib.resources import as_file, files
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.codegen import interpreted
from microbot_ocp._base.needed import needed
from microbot_ocp.inverse_kinematics import solve_ik
from microbot_ocp.robot import Robot, joint_scale
from microbot_ocp.scene import rotation_to
from microbot_ocp.tasks import read_task
from microbot_ocp.trajectories import best_cubic, best_lspb
from microbot_ocp.views import _palette as palette, _style as style
from microbot_ocp.views._eye import find_eye, grid_spacing, upward
from microbot_ocp.views._scene import AXIS_MARGIN, link_poses, reach, tool_places
from microbot_ocp.views.animation import Faces, arm_bodies
from microbot_ocp.views.live import LOOPBACK, InteractiveTask, NewestOnly, Setting
from microbot_ocp.views.recording import signed_share

CHARTS = {"tau": "torque, % of its limit", "qd": "velocity, % of its limit"}
LINK, JOINT = (*style.rgb(style.FIXED[style.PREFERRED][0]), 255), palette.NEUTRAL
SAMPLES = 400  # samples per curve: more than the pixels of a chart, few enough for one message
FREE = 6  # joints from which on a dragged via point keeps its orientation and can be rotated


class _Dragged(NamedTuple):
    """Pose that a via point is dragged to, and True if the drag has ended."""

    place: int
    position: FloatArray
    quaternion: FloatArray
    ended: bool


def studio(
    robot: Robot, via_q: ArrayLike | None = None, *, port: int = 8080, dark: bool = False
) -> Studio:
    """Open a page in the browser that solves for the fastest motion after every change.

    Via points are dragged in space, by inverse kinematics (with six joints or more they keep their
    orientation, and can be rotated), or moved joint by joint. Sliders scale all torque limits and
    all velocity limits and set a payload at the tool. :class:`microbot_ocp.TimeOptimalSolver`
    solves each new task. The page shows the moving arm, torques and velocities as shares of their
    limits, and the time saved against the faster of the best cubic (:func:`best_cubic`) and the
    best LSPB (:func:`best_lspb`). The page is served to this machine only and loads nothing from
    elsewhere.

    Parameters
    ----------
    robot : Robot
        Robot with masses and limits.
    via_q : array_like [m,n], optional
        Via points, rad (prismatic: m); the default for the demo's arm is the demo's task, for any
        other arm three bent poses near the middle of the joint ranges.
    port : int
        Port of the page; the next free port if it is taken.
    dark : bool
        Start with the dark theme; the page has a switch for it.

    Returns
    -------
    Studio
        Open page: ``address`` is its URL, ``close()`` closes it.

    Raises
    ------
    InputError
        Errors of :class:`microbot_ocp.TimeOptimalSliders`; viser is missing.
    """
    checks.number("port", port, at_least=1, at_most=65535)
    if via_q is None:
        with as_file(files("microbot_ocp.tasks") / "packaged" / "demo.toml") as path:
            demo = read_task(path)
        via_q = demo.via_q if robot == demo.robot else _bent_poses(robot)
    return Studio(robot, via_q, port, dark)


class Studio(InteractiveTask):
    """Open page of :func:`studio`.

    Attributes
    ----------
    address : str
        URL of the page, on this machine only.
    motion : Motion or None
        Motion for the last setting; None if the task was not solved.
    saved : float or None
        Time saved against the fastest cubic or LSPB, relative to its duration.
    robot : Robot
        Robot with the limits and the payload of the last setting.
    message : str
        Duration, saturated joints and solve time, or the reason why there is no motion.
    """

    def __init__(self, robot: Robot, via_q: ArrayLike, port: int, dark: bool) -> None:
        viser = needed("viser", "the studio needs", "studio")
        # No refinement rounds: a user waits, and slowing down costs at most 0.03 % more time.
        super().__init__(robot, via_q, rounds=0)
        self._via_q, self._lock = self._solver.via_q.copy(), threading.RLock()
        self._free = robot.joint_count >= FREE
        self._turns, self._drags = viser.transforms.SO3, NewestOnly(self._follow)
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
        """Close the page."""
        self._closed.set()
        self._player.join()
        with redirect_stdout(io.StringIO()):
            self._server.stop()

    def wait_until_closed(self) -> None:
        """Wait for :meth:`close` in another thread, or for Ctrl-C."""
        self._closed.wait()

    def _draw_controls(self, dark: bool) -> None:
        gui, robot, scale = self._server.gui, self._bare, joint_scale(self._bare)
        # The share button would publish the page on the internet.
        gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)
        gui.main_panel.dock_left()
        self._headline = gui.add_markdown("")
        torque = gui.add_slider("torque limits [%]", 50, 150, 1, 100)
        speed = gui.add_slider("speed limits [%]", 50, 150, 1, 100)
        payload = gui.add_slider("payload [kg]", 0.0, 2.0, 0.05, 0.0)
        self._limits, self._joints, (low, high) = (torque, speed, payload), [], _ranges(robot)
        for slider in self._limits:
            slider.on_update(lambda _: self._ask())
        for place, q in enumerate(self._via_q):
            joints = []
            with gui.add_folder(f"via point {place + 1}", expand_by_default=place == 1):
                drawn = (np.array([low, high, q]) / scale).T.tolist()
                for joint, (name, ends) in enumerate(zip(robot.joint_names, drawn, strict=True)):
                    revolute = robot.joint_types[joint] == "revolute"
                    unit, step = ("deg", 1.0) if revolute else ("m", 0.01)
                    least, most, value = (round(end, 6) for end in ends)
                    joints.append(gui.add_slider(f"{name} [{unit}]", least, most, step, value))
                    joints[-1].on_update(partial(self._turn, place, joint))
            self._joints.append(joints)
        panel = gui.add_panel()
        with panel.add_tab("limits"):
            self._charts = {key: self._chart(title) for key, title in CHARTS.items()}
        panel.dock_right()
        panel.set_width(440)

    def _ask(self) -> None:
        with self._lock:  # viser calls each control in another thread
            torque, speed, payload = (slider.value for slider in self._limits)
            first = np.array_equal(self._via_q, self._solver.via_q)
            via_q = None if first else self._via_q.copy()
            self._work.ask(Setting(torque / 100, speed / 100, payload, via_q))

    def _turn(self, place: int, joint: int, event: Any) -> None:
        """Set a joint of a via point to the value of its slider."""
        if event.client is None:  # a drag moved the slider and requests the solve itself
            return
        with self._lock:
            self._via_q[place, joint] = event.target.value * joint_scale(self._bare)[joint]
            self._put(place)
            self._ask()

    async def _drag(self, place: int, event: Any) -> None:
        grip = event.target  # no await, which would reorder events
        self._drags.ask(_Dragged(place, grip.position, grip.wxyz, event.phase == "end"))

    def _follow(self, dragged: _Dragged) -> None:
        """Solve the inverse kinematics of a dragged via point, or show why it has no solution."""
        place = dragged.place
        turn = self._turns(dragged.quaternion).as_matrix() if self._free else None
        with self._lock:
            pose = solve_ik(self._bare, dragged.position, turn, seed=self._via_q[place])
            if pose.solved:
                self._via_q[place], shown = pose.q, pose.q / joint_scale(self._bare)
                for slider, value in zip(self._joints[place], shown, strict=True):
                    slider.value = round(float(value), 2)
                self._ask()
            else:
                self._headline.content = (
                    f"## via point {place + 1}: {pose.status}\n{pose.advice} It stays where it was."
                )
            if dragged.ended:
                self._put(place)

    def _put(self, place: int) -> None:
        """Set the grip of a via point to the tool pose of its joints."""
        pose = link_poses(self._bare, self._via_q[[place]])[0, -1:]
        with self._server.atomic():
            self._grips[place].position = pose[0, :3, 3]
            if self._free:
                self._grips[place].wxyz = self._quaternions(pose)[0]

    def _quaternions(self, poses: FloatArray) -> FloatArray:
        return self._turns.from_matrix(poses[:, :3, :3]).wxyz

    def _chart(self, title: str) -> Any:
        names, highest = self._bare.joint_names, 100.0 * (1.0 + AXIS_MARGIN)
        dashed = {"stroke": style.BOUND_COLOR, "dash": [6, 4], "width": style.LINE_WIDTH}
        limits = [dashed | {"label": side} for side in ("limit", "lower limit")]
        curves = [
            {"stroke": style.look(joint, joints=True)["color"], "width": 2, "label": name}
            for joint, name in enumerate(names)
        ]
        return self._server.gui.add_uplot(
            tuple([np.zeros(2)] * (len(names) + 3)),
            ({"label": "t [s]"}, *limits, *curves),
            title=title,
            scales={"x": {"time": False}, "y": {"range": (-highest, highest)}},
            aspect=1.5,
        )

    def _draw_space(self) -> None:
        scene, robot, motion = self._server.scene, self._bare, self._reference
        size, up = reach(robot), upward(robot)
        eye = find_eye(robot, motion.q, tool_places(robot, self._via_q), style.LABEL_HEIGHT * size)
        scene.set_up_direction(up)
        camera = self._server.initial_camera
        camera.up, camera.position, camera.look_at = eye.up, eye.position, eye.target
        ground = self._quaternions(rotation_to(up)[None])[0]
        cell = grid_spacing(robot)
        scene.add_grid(
            "/ground", 2 * size, 2 * size, wxyz=ground, position=robot.base[:3, 3],
            cell_size=cell, section_size=2 * cell,
        )  # fmt: skip
        poses = link_poses(robot, motion.q[:1])[0]
        self._frames = [scene.add_frame(f"/arm/{k}", show_axes=False) for k in range(len(poses))]
        for place, (frame, faces) in enumerate(arm_bodies(robot, poses, LINK, JOINT)):
            self._add_body(f"/arm/{frame}/{place}", faces)
        self._grips = []
        for place in range(len(self._via_q)):
            grip = scene.add_transform_controls(
                f"/via/{place}", 2 * style.FRAME_LENGTH * size, disable_rotations=not self._free
            )
            self._grips.append(grip)
            radius, color = style.BALL_RADIUS * style.LINK_RADIUS * size, palette.PART[:3]
            scene.add_icosphere(f"{grip.name}/ball", radius, color=color)
            scene.add_label(f"{grip.name}/name", f"via point {place + 1}")
            self._put(place)
            grip.on_update(partial(self._drag, place))
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
            turns = self._quaternions(poses)
            for frame, pose, turn in zip(self._frames, poses, turns, strict=True):
                frame.position, frame.wxyz = pose[:3, 3], turn
            if "prismatic" in self._bare.chain.joint_types and not self._bare.shapes:
                for place, (frame, faces) in enumerate(arm_bodies(self._bare, poses, LINK, JOINT)):
                    self._add_body(f"/arm/{frame}/{place}", faces)

    def _play(self) -> None:
        begin = time.monotonic()
        while not self._closed.wait(1.0 / style.FRAME_RATE):
            motion = self.motion
            if motion is not None and self._server.get_clients():
                t = (time.monotonic() - begin) % (motion.duration + style.LAST_FRAME)
                self._place(motion.sample(min(t, motion.duration)).q[0])

    def _show(self, setting: Setting) -> None:
        motion, robot, scene = self.motion, self.robot, self._server.scene
        self.saved = None
        if motion is None:
            with self._server.atomic():
                scene.remove_by_name("/trail")
                for chart in self._charts.values():
                    chart.visible = False
                self._headline.content = f"## no motion\n{self.message}"
            return
        chosen = np.unique(np.linspace(0, len(motion.t) - 1, SAMPLES).astype(int))
        t, tool = motion.t[chosen], tool_places(robot, motion.q[chosen])
        limit, thin = np.full(t.shape, 100.0), style.LINE_RADIUS * reach(robot)
        with self._server.atomic():
            ends = np.stack([tool[:-1], tool[1:]], axis=1)
            scene.add_line_segments("/trail", ends, palette.MOTION[:3], thickness=thin)
            for key, chart in self._charts.items():
                shares = [
                    100.0 * signed_share(robot.limits, key, values, joint)[0]
                    for joint, values in enumerate(getattr(motion, key)[chosen].T)
                ]
                chart.data, chart.visible = (t, limit, -limit, *shares), True
            self._headline.content = f"## {motion.duration:.3f} s\n{self.message}"
        if self._work.newer:  # the newer setting will replace this answer
            return
        via_q = self._solver.via_q if setting.via_q is None else setting.via_q
        with interpreted():  # compiling would not pay: each payload is another robot
            rows = {"cubic": best_cubic(robot, via_q), "LSPB": best_lspb(robot, via_q)}
        name, usual = min(rows.items(), key=lambda row: row[1].duration)
        self.saved = 1.0 - motion.duration / usual.duration
        self._headline.content = (
            f"## {motion.duration:.3f} s, {100 * self.saved:.0f} % saved\n"
            f"against {usual.duration:.3f} s by the textbook's fastest ({name} with its best times "
            f"and via velocities).\n\n{self.message}"
        )


def _bent_poses(robot: Robot) -> FloatArray:
    """Return three poses [3,n] near the middle of the ranges.

    Joints lie alternately an eighth of their range above and below the middle. In the middle itself
    many arms are singular (stretched out, wrist axes aligned) and cannot be dragged.
    """
    low, high = _ranges(robot)
    bent = 0.125 * (-1.0) ** np.arange(robot.joint_count)
    return np.array([low + (share + bent) * (high - low) for share in (0.45, 0.5, 0.55)])


def _ranges(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Return the ends [n] of the joint sliders: position limits, or ±pi without a limit."""
    low, high = robot.limits.bounds("q")
    low = np.where(np.isfinite(low), low, -np.pi)
    return low, np.where(np.isfinite(high), high, np.pi)
