"""The services for ROS 2: with its messages where they can be imported, on stand-ins elsewhere."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import tells

ROS2 = Path(__file__).resolve().parents[2] / "ros2"
PROFILE = "ros2_jtc_cubic@250"


class Point:
    """Fields of trajectory_msgs/JointTrajectoryPoint with the defaults of the message."""

    def __init__(self) -> None:
        self.positions: Any = []
        self.velocities: Any = []
        self.accelerations: Any = []
        self.effort: Any = []
        self.time_from_start = SimpleNamespace(sec=0, nanosec=0)


class Trajectory:
    """Fields of trajectory_msgs/JointTrajectory."""

    def __init__(self) -> None:
        self.joint_names: list[str] = []
        self.points: list[Any] = []


@pytest.fixture
def messages(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(ROS2 / "microbot_ocp_ros")
    try:
        from trajectory_msgs import msg  # type: ignore[import-not-found]
    except ImportError:
        package, msg = ModuleType("trajectory_msgs"), ModuleType("trajectory_msgs.msg")
        msg.JointTrajectory, msg.JointTrajectoryPoint = Trajectory, Point  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "trajectory_msgs", package)
        monkeypatch.setitem(sys.modules, "trajectory_msgs.msg", msg)
    return msg


def trajectory_of(messages: Any, names: list[str], rows: Any, step: float = 0.0) -> Any:
    trajectory = messages.JointTrajectory()
    trajectory.joint_names = names
    for k, row in enumerate(rows):
        point = messages.JointTrajectoryPoint()
        point.positions = [float(value) for value in row]
        point.time_from_start.sec, nano = divmod(round(k * step * 1e9), 1_000_000_000)
        point.time_from_start.nanosec = nano
        trajectory.points.append(point)
    return trajectory


def answer(messages: Any) -> SimpleNamespace:
    return SimpleNamespace(success=None, message="", trajectory=messages.JointTrajectory())


@pytest.mark.slow
def test_a_plan_is_a_trajectory_that_the_check_accepts(messages: Any) -> None:
    from microbot_ocp_ros import services  # type: ignore[import-not-found]

    robot = mo.load_robot("planar_2r").with_limits(qdd_max=20.0)
    turned = list(robot.joint_names)[::-1]
    via = trajectory_of(messages, turned, [[0.5, 0.0], [-0.4, 0.7]])  # joints the other way round
    request = SimpleNamespace(via_points=via, profile=PROFILE)
    planned = services.plan(robot, request, answer(messages))
    assert planned.success, planned.message
    points = planned.trajectory.points
    assert planned.trajectory.joint_names == list(robot.joint_names)
    assert list(points[0].positions) == pytest.approx([0.0, 0.5], abs=1e-9)
    assert list(points[-1].positions) == pytest.approx([0.7, -0.4], abs=1e-9)
    request = SimpleNamespace(trajectory=planned.trajectory, profile=PROFILE)
    judged = services.check(robot, request, answer(messages))
    assert judged.success, judged.message
    slow = robot.with_limits(qd_max=0.1)
    judged = services.check(slow, request, answer(messages))
    assert not judged.success
    assert "velocity" in judged.message


def test_what_cannot_be_read_is_said(messages: Any) -> None:
    from microbot_ocp_ros import services  # type: ignore[import-not-found]

    robot = mo.load_robot("planar_2r")
    names = list(robot.joint_names)
    for trajectory, said in (
        (
            trajectory_of(messages, ["a", "b"], np.zeros((2, 2))),
            ("joint_names", "shoulder, elbow", "['a', 'b']"),
        ),
        (trajectory_of(messages, names, np.zeros((2, 3)), 0.1), ("2 positions", "not 3")),
        (trajectory_of(messages, names, [], 0.1), ("t",)),
    ):
        request = SimpleNamespace(trajectory=trajectory, profile=PROFILE)
        told = services.check(robot, request, answer(messages))
        assert not told.success
        tells(told.message, *said)
    via = trajectory_of(messages, names, [[0.0, 0.0], [9.0, 0.0]])
    told = services.plan(robot, SimpleNamespace(via_points=via, profile=PROFILE), answer(messages))
    assert not told.success
    tells(told.message, "via point 2", "'shoulder'", "515.662 deg", "-170 deg to 170 deg")
