"""How long a controller takes alone for the stops of a cell: closed forms, ruckig, the plan."""

import numpy as np
import pytest
import ruckig

import microbot_ocp as mo
from microbot_ocp.motion import Mark
from microbot_ocp.planning import Line
from microbot_ocp.planning.task import task_of
from microbot_ocp.tasks import controller_duration

pytestmark = pytest.mark.slow

SPEED, PUSH, JERK = 0.8, 2.5, 20.0


def slider(**limits):
    return mo.Robot.from_dh(
        alpha=[0.0], a=[0.0], d=[0.0], joint_type="prismatic", links=[mo.Link(3.0, [0, 0, 0])],
        gravity=(0.0, 0.0, 0.0), limits=mo.Limits(**limits),
    )  # fmt: skip


def stopped(robot, stops, **given):
    """Return a task and a slow motion that is at its stops at its marks."""
    task = task_of(robot, stops, **given)
    q = np.array([stop.q for stop in task.stops])
    leaves = np.arange(len(q)) * 10.0
    times = np.unique(np.concatenate([leaves, leaves + task.dwells]))
    rows = np.repeat(np.arange(len(q)), 1 + (task.dwells > 0))
    shape = mo.lspb(q[rows], times, 0.1)
    marks = [Mark(t, stop.name) for t, stop in zip(leaves, task.stops, strict=True)]
    return task, mo.Motion.from_polynomial(robot, shape, label="slow", marks=marks)


def of_ruckig(way):
    given = ruckig.InputParameter(1)
    given.current_position, given.target_position = [0.0], [way]
    given.max_velocity, given.max_acceleration, given.max_jerk = [SPEED], [PUSH], [JERK]
    trajectory = ruckig.Trajectory(1)
    ruckig.Ruckig(1).calculate(given, trajectory)
    return trajectory.duration


@pytest.mark.parametrize("way", [0.05, 0.3, 2.0])
def test_one_move_is_that_of_the_textbook_and_of_ruckig(way):
    ends = [mo.Stop(q=[0.0]), mo.Stop(q=[way])]
    trapezoid = way / SPEED + SPEED / PUSH if way > SPEED**2 / PUSH else 2 * np.sqrt(way / PUSH)
    robot = slider(qd_max=SPEED, qdd_max=PUSH)
    assert controller_duration(*stopped(robot, ends)) == pytest.approx(trapezoid, rel=3e-4)
    robot = slider(qd_max=SPEED, qdd_max=PUSH, qddd_max=JERK)
    assert controller_duration(*stopped(robot, ends)) == pytest.approx(of_ruckig(way), rel=1e-3)


def test_it_passes_stops_that_need_no_rest_and_waits_at_the_others():
    robot = slider(qd_max=SPEED, qdd_max=PUSH)
    half, whole = (way / SPEED + SPEED / PUSH for way in (1.0, 2.0))
    for middle, duration in (
        (mo.Stop(q=[1.0]), whole),
        (mo.Stop(q=[1.0], velocity="rest"), 2 * half),
        (mo.Stop(q=[1.0], payload=2.0), 2 * half),
        (mo.Stop(q=[1.0], dwell=0.7), 2 * half + 0.7),
    ):
        pair = stopped(robot, [mo.Stop(q=[0.0]), middle, mo.Stop(q=[2.0])])
        assert controller_duration(*pair) == pytest.approx(duration, rel=5e-4)


@pytest.mark.parametrize("jerk", [None, 80.0])
def test_a_tool_line_has_the_profile_along_its_length(jerk):
    """Two sliders, so that the line is straight in the joints, too."""
    limits = {"qd_max": SPEED, "qdd_max": PUSH} | ({"qddd_max": jerk} if jerk else {})
    robot = mo.Robot.from_dh(
        alpha=[0.0, np.pi / 2], a=[0.0, 0.0], d=[0.0, 0.0], joint_type="prismatic",
        links=[mo.Link(3.0, [0, 0, 0])] * 2, gravity=(0.0, 0.0, 0.0), limits=mo.Limits(**limits),
    )  # fmt: skip
    ends = [mo.Stop(q=[0.1, 0.1]), mo.Stop(q=[1.3, 0.6])]
    free = controller_duration(*stopped(robot, ends))
    line = controller_duration(*stopped(robot, ends, segments=[Line()]))
    assert line == pytest.approx(free, rel=5e-3)


def test_it_is_never_faster_than_the_plan(microbot):
    via = np.radians([[0, 0, 0], [20, 60, -30], [-8, 45, 30]])
    stops = [mo.Stop(q=q) for q in via]
    stops[1] = mo.Stop(q=via[1], payload=1.0)
    motion = mo.time_optimal(microbot, stops, mesh=10, starts=1)
    assert motion.duration < controller_duration(task_of(microbot, stops), motion)
