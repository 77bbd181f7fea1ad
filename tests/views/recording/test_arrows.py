"""Velocity and force arrows: against differences of the tool's own places, and Newton's law."""

import numpy as np
import pytest
from reading import read, scalars

from helpers import any_robot
from microbot_ocp.motion import State
from microbot_ocp.robot import Robot, forward_kinematics, inverse_dynamics
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.recording._loads import LONGEST_ARROW, tool_velocity, wrist_force

H = 1e-4  # s, step of the differences


def along(robot, frame, point):
    """Place of a point in a frame as a function of the time on a smooth joint motion, and state."""
    rng = np.random.default_rng(3)
    q0, amplitude, rate = rng.uniform(-1, 1, (3, robot.joint_count))

    def state(t):
        phase = rate * t + q0
        return (
            q0 + amplitude * np.sin(phase),
            amplitude * rate * np.cos(phase),
            -amplitude * rate**2 * np.sin(phase),
        )

    def place(t):
        return (np.array(forward_kinematics(robot, frame)(state(t)[0])) @ [*point, 1.0])[:3]

    return place, state


@pytest.mark.parametrize("name", ["microbot", "stanford", "rprr"])
def test_tool_velocity_is_the_rate_of_its_place(name):
    robot = any_robot(name)
    place, state = along(robot, robot.joint_count + 1, np.zeros(3))
    found = tool_velocity(robot, State(*(np.array([x, x]) for x in state(0.4))))
    expected = (place(0.4 + H) - place(0.4 - H)) / (2 * H)
    np.testing.assert_allclose(found, [expected, expected], rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("name", ["microbot", "stanford", "rprr"])
def test_wrist_force_obeys_newton(name):
    robot = any_robot(name)
    last = robot.links[-1]
    place, state = along(robot, robot.joint_count, last.center_of_mass)
    found = wrist_force(robot, State(*(x[None] for x in state(0.4))))[0]
    acceleration = (place(0.4 + H) - 2 * place(0.4) + place(0.4 - H)) / H**2
    expected = last.mass * (acceleration - robot.gravity)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-4)


def test_wrist_force_along_a_slide_is_its_drive_force():
    """Recursive Newton-Euler takes the same force along the axis of a last prismatic joint."""
    stanford = any_robot("stanford")
    slide = Robot.from_dh(
        stanford.alpha[:3], stanford.a[:3], stanford.d[:3], stanford.theta_offset[:3],
        stanford.joint_types[:3], stanford.links[:3], gravity=stanford.gravity,
    )  # fmt: skip
    _, state = along(slide, 3, np.zeros(3))
    q, qd, qdd = state(0.7)
    force = wrist_force(slide, State(q[None], qd[None], qdd[None]))[0]
    axis = np.array(forward_kinematics(slide, 3)(q))[:3, 2]
    drive = np.array(inverse_dynamics(slide)(q, qd, qdd)).ravel()[2]
    own = slide.links[2]
    friction = own.viscous_friction * qd[2] + own.coulomb_friction * np.tanh(qd[2] / 0.01)
    assert axis @ force == pytest.approx(drive - friction - own.armature * qdd[2], rel=1e-9)


def test_arrows_and_curves_hold_the_velocity(comparison, recording):
    largest, rows = 0.0, {}
    for entry in comparison.entries[:3]:
        t, arrows = read(recording, f"/world/{entry.name}/tool/velocity", "Arrows3D:vectors")
        state = entry.motion.sample(t)
        expected = tool_velocity(comparison.robot, state)
        _, speed = scalars(recording, f"/plots/speed/{entry.name}")
        # times come back in whole nanoseconds
        np.testing.assert_allclose(speed, np.linalg.norm(expected, axis=1), rtol=1e-6, atol=1e-7)
        largest = max(largest, speed.max())
        rows[entry.name] = np.array(arrows)[:, 0], expected
    scale = LONGEST_ARROW * scene.reach(comparison.robot) / largest
    for drawn, expected in rows.values():
        np.testing.assert_allclose(drawn, scale * expected, atol=1e-5)
