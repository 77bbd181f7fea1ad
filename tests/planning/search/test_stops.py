"""Motions through stops: closed forms on a rail, tool lines and branches of a two-link arm."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp._base import deadline
from microbot_ocp.limits import LimitFamily
from microbot_ocp.planning.free import slowed_together
from microbot_ocp.planning.search import least_duration
from microbot_ocp.planning.search._branches import bound_of, ways_through
from microbot_ocp.planning.search._through_stops import problem_of
from microbot_ocp.planning.task import TaskScale, task_of
from microbot_ocp.planning.task._segments import CircleArc, Straight, curve_limits
from planning.shared import arm, pendulum, slider

Stop = mo.Stop
QUICK = {"compiled": False, "mesh": 20}


@pytest.fixture(scope="module")
def rail():
    return slider(mass=2.0, tau_max=4.0, qd_max=10.0)


@pytest.fixture(scope="module")
def two_links():
    return arm(tau_max=[60.0, 25.0], qd_max=3.0)


@pytest.fixture(scope="module")
def gantry():
    """Two rails at right angles, the tool at [0, q2, q1], and 1 m/s^2 on each."""
    return mo.Robot.from_dh(
        alpha=[0.0, -np.pi / 2],
        a=[0.0, 0.0],
        d=[0.0, 0.0],
        joint_type="prismatic",
        links=[mo.Link(1.0, [0.0, 0.0, 0.0])] * 2,
        gravity=(0.0, 0.0, 0.0),
        limits=mo.Limits(qdd_max=1.0),
    )


def at(x, y, **more):
    """A stop of the gantry."""
    return Stop(position=[0.0, y, x], **more)


@pytest.fixture(scope="module")
def cut(two_links):
    """Straight along a tool line, then free: with the motion and what it was asked for."""
    stops = [
        Stop(position=[1.2, -0.5, 0.0], name="first"),
        Stop(position=[1.2, 0.5, 0.0], name="second"),
        Stop(position=[0.6, 1.0, 0.0], tolerance=0.05, name="third"),
    ]
    segments = [mo.Line(tolerance=2e-3), None]
    options = QUICK | {"mesh": 10}
    return mo.time_optimal(two_links, stops, segments=segments, **options), stops, segments


def test_a_tolerance_shortens_the_way(rail):
    for tolerance in (0.1, [0.1]):
        motion = mo.time_optimal(rail, [[0.0], Stop(q=[1.0], tolerance=tolerance)], **QUICK)
        assert motion.duration == pytest.approx(2 * np.sqrt(0.9 / 2.0), rel=1e-3)


def test_a_cycle_with_a_load_one_way_takes_the_closed_form(rail):
    stops = [Stop(q=[0.0], payload=2.0, dwell=0.2, name="a"), Stop(q=[1.0], payload=0.0, name="b")]
    motion = mo.time_optimal(rail, stops, cycle=True, **QUICK)
    loaded, empty = (2 * np.sqrt(mass / 4.0) for mass in (4.0, 2.0))
    assert motion.duration == pytest.approx(0.2 + loaded + empty, rel=1e-3)
    assert [mark.name for mark in motion.marks] == ["a", "b", "a"]
    assert motion.marks[1].time == pytest.approx(0.2 + loaded, rel=1e-3)
    assert mo.certify(rail, motion, via_q=stops, cycle=True).ok
    heavier = [stops[0], Stop(q=[1.0], payload=0.5, name="b")]
    certificate = mo.certify(rail, motion, via_q=heavier, cycle=True)
    assert not certificate.ok
    tells(certificate.verdict, "stored torque")


def test_a_velocity_that_is_asked_for_is_the_velocity(rail):
    motion = mo.time_optimal(rail, [[0.0], Stop(q=[1.0], velocity=[1.0]), [2.0]], **QUICK)
    assert motion.sample(motion.marks[1].time).qd[0, 0] == pytest.approx(1.0, abs=1e-6)
    # to 1 m at 1 m/s with 2 m/s^2: up to the peak, down to 1 m/s; back up and down to rest
    peak = np.sqrt(2.5)
    assert motion.duration == pytest.approx(2 * (peak / 2 + (peak - 1.0) / 2), rel=1e-3)


def test_an_arm_that_moves_already_goes_on_with_its_acceleration():
    rail = slider(mass=2.0, tau_max=4.0, taud_max=10.0)
    whole = mo.time_optimal(rail, [[0.0], [1.5]], **QUICK)
    # later its torque falls as fast as it can: at 1e-5 m/s more it would have to come back
    now = 0.3 * whole.duration
    q, qd, qdd = (row[0] for row in whole.sample([now]))
    stops = [Stop(q=q, velocity=qd, acceleration=qdd), Stop(q=[1.5])]
    rest = mo.time_optimal(rail, stops, **QUICK)
    assert rest.solved
    assert rest.duration == pytest.approx(whole.duration - now, rel=5e-3)
    np.testing.assert_allclose(rest.qdd[0], qdd, atol=1e-5)
    assert mo.certify(rail, rest, via_q=stops).ok
    jumping = mo.certify(rail, rest, via_q=[replace(stops[0], acceleration=-qdd), stops[1]])
    tells(jumping.verdict, "missed", "acceleration", "stop 1")


def test_the_best_order_is_found_and_bounds_leave_others_out(rail):
    slow = rail.with_limits(qd_max=0.5)
    motion = mo.time_optimal(
        slow, [[0.0], [2.0], [1.0], [3.0]], order="free", **(QUICK | {"mesh": 20})
    )
    assert motion.provenance["order"] == [0, 2, 1, 3]
    assert motion.provenance["orders_left_out"] == 1
    (row,) = motion.provenance["orders"]
    assert row["bound"] <= row["duration"] <= 1.01 * row["coarse"] <= 1.01 * row["rested"]


@pytest.mark.thorough
def test_orders_that_coarse_answers_cannot_tell_apart_are_all_refined(rail):
    options = QUICK | {"mesh": 6, "starts": 1}
    motion = mo.time_optimal(rail, [[0.0], [1.0], [1.001], [0.0]], order="free", **options)
    rows = motion.provenance["orders"]
    assert [row["status"] for row in rows] == ["solved", "solved"]
    assert rows[0]["duration"] == motion.duration <= rows[1]["duration"]
    tells(motion.note, "2 solved", "2 of them")


@pytest.mark.thorough
def test_stops_with_a_segment_between_them_stay_together(rail):
    slow = rail.with_limits(qd_max=0.5)
    segments = [None, mo.JointLine(), None, None]
    via_q = [[0.0], [2.0], [1.5], [0.5], [3.0]]
    options = {"order": "free", "mesh": 6, "starts": 1, "compiled": False}
    motion = mo.time_optimal(slow, via_q, segments=segments, **options)
    assert motion.provenance["order"] == [0, 3, 1, 2, 4]
    assert motion.provenance["segments"] == ["free", "free", "JointLine", "free"]
    assert len(motion.provenance["orders"]) + motion.provenance["orders_left_out"] == 2


@pytest.mark.thorough
def test_bounds_of_orders_hold_at_tool_positions(two_links):
    home, end = Stop(q=[0.0, 0.5]), Stop(q=[0.5, 0.9], tolerance=[0.1, 0.0])
    for middle in (
        Stop(position=[1.2, 0.5, 0.0]),
        Stop(position=[1.2, 0.5, 0.0], tolerance=0.05),
    ):
        stops = [home, middle, end]
        bound = least_duration(task_of(two_links, stops))
        motion = mo.time_optimal(two_links, stops, mesh=6, starts=1, compiled=False)
        assert 0.0 < bound <= motion.duration


@pytest.mark.thorough
def test_the_order_of_least_effort_in_a_given_time(rail):
    via_q = [[0.0], [2.0], [1.0], [3.0]]
    options = {"order": "free", "duration": 12.0, "mesh": 6, "starts": 1, "compiled": False}
    motion = mo.time_optimal(rail.with_limits(qd_max=0.5), via_q, **options)
    assert motion.provenance["order"] == [0, 2, 1, 3]
    assert motion.duration == pytest.approx(12.0, rel=1e-6)


def test_least_effort_in_a_given_time_takes_it_all(rail):
    motion = mo.time_optimal(rail, [[0.0], [1.0]], duration=2.0, **QUICK)
    assert motion.solved
    assert motion.duration == pytest.approx(2.0, rel=1e-6)
    # least squared force from rest to rest: the acceleration is 6 d/T^2 (1 - 2 t/T)
    assert motion.tau[0, 0] == pytest.approx(2.0 * 6.0 / 4.0, rel=1e-2)
    late = mo.time_optimal(rail, [[0.0], [1.0]], duration=1.0, **QUICK)
    assert late.status is mo.Status.INFEASIBLE
    tells(late.advice, "1 s", "fastest")


def test_a_tool_line_is_followed_and_certified(two_links, cut):
    motion, stops, segments = cut
    assert motion.solved
    certificate = mo.certify(two_links, motion, via_q=stops, segments=segments)
    assert certificate.ok, certificate.verdict
    line = certificate.segment_checks[0]
    assert line.value <= 2e-3 * (1 + 1e-3)
    t = np.linspace(0.0, motion.marks[1].time, 300)
    tool = np.array(mo.forward_kinematics(two_links).map(300)(motion.sample(t).q.T))
    assert np.abs(tool[0].reshape(300, 4)[:, 3] - 1.2).max() <= 2e-3 * (1 + 1e-3)
    narrow = mo.certify(two_links, motion, via_q=stops, segments=[mo.Line(1e-3), None])
    assert not narrow.ok
    assert "tool line" in narrow.verdict


@pytest.mark.thorough
def test_a_line_between_joint_poses_of_a_small_arm_leaves_the_orientation(two_links):
    stops, line = [[-1.0, 1.2], [0.2, 1.0]], [mo.Line(tolerance=0.01)]
    motion = mo.time_optimal(two_links, stops, segments=line, mesh=8, starts=1, compiled=False)
    (check,) = mo.certify(two_links, motion, via_q=stops, segments=line).segment_checks
    assert motion.solved
    assert check.passed
    assert check.what == "distance"


def test_conditions_that_no_joint_changes_are_left_out(two_links):
    pose = np.array(mo.forward_kinematics(two_links)([0.4, 0.8]))
    there = {"position": pose[:3, 3], "orientation": pose[:3, :3], "free_turn": "z"}
    middle = Stop(**there, velocity=[0.1, 0.0, 0.0], name="b")
    rows = task_of(two_links, [[0.0, 0.5], middle, [0.5, 0.9]]).conditions.ends[1].rows
    assert [row.bounds[0].size for row in rows] == [2, 2]
    up = replace(middle, velocity=[0.0, 0.0, 0.1])
    with refused("velocity", "tool", "stop 'b'", "0.1"):
        mo.time_optimal(two_links, [[0.0, 0.5], up, [0.5, 0.9]], **QUICK)


@pytest.mark.thorough
def test_an_orientation_within_its_tolerance_is_within_reach(two_links):
    pose = np.array(mo.forward_kinematics(two_links)([0.4, 0.8]))
    turn = np.array(mo.forward_kinematics(two_links)([0.0, 0.1]))[:3, :3]
    there = {"position": pose[:3, 3], "orientation": turn @ pose[:3, :3], "name": "there"}
    options = {"mesh": 6, "starts": 1, "compiled": False}
    loose = Stop(**there, orientation_tolerance=0.2)
    motion = mo.time_optimal(two_links, [[0.0, 0.5], loose], **options)
    assert motion.solved
    with refused("stop 'there'", "2.86 deg"):
        mo.time_optimal(two_links, [[0.0, 0.5], replace(loose, orientation_tolerance=0.05)])


def test_every_branch_is_tried_and_told(two_links, cut):
    branches = cut[0].provenance["branches"]
    assert [entry["taken"] for entry in branches] == [True, False]
    assert min(entry["duration"] for entry in branches) == branches[0]["duration"]


@pytest.mark.slow
def test_branches_that_coarse_answers_cannot_tell_apart_are_all_refined(microbot):
    """On 20 intervals two branches differ by 0.1 %, on fine meshes by 0.2 %."""
    stops = [mo.Stop(position=p) for p in ([0.3, 0.2, 0.2], [0.2, -0.3, 0.3])]
    least = min(
        mo.time_optimal(microbot, [stops[0], mo.Stop(q=found.q)], starts=1).duration
        for found in mo.solve_ik_all(microbot, stops[1].position)
    )
    assert mo.time_optimal(microbot, stops, starts=2).duration <= (1.0 + 1e-4) * least


@pytest.mark.thorough
def test_an_arc_goes_through_its_point(two_links):
    start, end, radius = np.array([1.4, -0.4, 0.0]), np.array([1.4, 0.4, 0.0]), 0.4
    stops = [Stop(position=start), Stop(position=end)]
    segments = [mo.Circle(through=[1.0, 0.0, 0.0])]
    options = QUICK | {"mesh": 10, "starts": 1}
    motion = mo.time_optimal(two_links, stops, segments=segments, **options)
    assert mo.certify(two_links, motion, via_q=stops, segments=segments).ok
    poses = np.array(mo.forward_kinematics(two_links).map(len(motion.t))(motion.q.T))
    place = poses.reshape(4, -1, 4)[:2, :, 3].T
    off = np.linalg.norm(place - [1.4, 0.0], axis=1) - radius
    assert np.abs(off).max() < 1.01e-3
    assert place[:, 0].min() == pytest.approx(1.0, abs=1.1e-3)


def test_joint_lines_make_the_arm_stop_at_their_corner(gantry):
    lines = [mo.JointLine(tolerance=1e-4)] * 2
    via_q = [[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]]
    motion = mo.time_optimal(gantry, via_q, segments=lines, mesh=20, compiled=False)
    assert motion.duration == pytest.approx(4.0, rel=3e-3)  # twice 1 m from rest to rest
    off = motion.q[:, 1] - np.minimum(motion.q[:, 0], 2.0 - motion.q[:, 0])
    assert np.abs(off).max() / np.sqrt(2) < 1.01e-4


@pytest.mark.thorough
def test_a_blended_corner_saves_the_time_in_which_both_axes_move(gantry):
    stops, lines = [at(0, 0), at(1, 0, blend=0.2), at(1, 1)], [mo.Line(tolerance=1e-4)] * 2
    options = {"segments": lines, "mesh": 12, "starts": 1, "compiled": False}
    motion = mo.time_optimal(gantry, stops, **options)
    # each axis goes 1 m from rest to rest; the last 0.2 m of one are the first of the other
    assert motion.duration == pytest.approx(4.0 - np.sqrt(2 * 0.2), rel=8e-3)
    tool = np.hypot(motion.q[:, 0] - 1.0, motion.q[:, 1])
    passing = motion.sample([motion.marks[1].time, motion.marks[2].time])
    assert passing.q[0] == pytest.approx([0.8, 0.0], abs=2e-4)
    assert passing.q[1] == pytest.approx([1.0, 0.2], abs=2e-4)
    assert tool.min() > 0.05


@pytest.mark.thorough
def test_a_full_circle_takes_the_closed_form(gantry):
    acceleration, radius = 2.0, 0.5
    tool = mo.limits.tool_acceleration(acceleration)
    robot = gantry.with_limits(qdd_max=10.0, also=[tool])
    circle = mo.Circle(through=[[0, 0, radius], [0, -radius, 0]], tolerance=1e-4)
    options = {"starts": 1, "mesh": 12, "compiled": False}
    stops = [at(0, radius, name="top"), at(0, radius, name="end")]
    motion = mo.time_optimal(robot, stops, segments=[circle], **options)
    # along it s'' = a cos(2 s / r) up to the speed sqrt(a r) at a quarter of pi, where it stays
    speeding_up = 2.6220575542921198  # integral of 1 / sqrt(sin) from 0 to pi / 2
    expected = np.sqrt(radius / acceleration) * (speeding_up + 1.5 * np.pi)
    assert motion.duration == pytest.approx(expected, rel=3e-3)
    assert np.abs(np.hypot(*motion.q.T) - radius).max() < 1.01e-4
    turned = np.unwrap(np.arctan2(motion.q[:, 0], motion.q[:, 1]))
    assert turned[-1] - turned[0] == pytest.approx(2 * np.pi, abs=1e-3)
    assert [mark.name for mark in motion.marks] == ["top", "top, 1/2 of the circle", "end"]
    # again and again, without a rest
    stops, options = [at(0, radius, velocity="any")], options | {"mesh": 6}
    motion = mo.time_optimal(robot, stops, segments=[circle], cycle=True, **options)
    assert motion.duration == pytest.approx(2 * np.pi * np.sqrt(radius / acceleration), rel=2e-3)
    twice = task_of(robot, stops, segments=[replace(circle, turns=1)], cycle=True)
    turned = [told[0].length / radius for told in twice.curves if told is not None]
    assert turned == pytest.approx([4 * np.pi / 3] * 3)


def test_a_straight_corner_is_passed_and_a_bent_one_is_cut(two_links):
    lines = [mo.Line(tolerance=2e-3)] * 2
    task = lambda y: task_of(  # noqa: E731
        two_links,
        [
            Stop(position=[1.2, -0.5, 0.0]),
            Stop(position=[1.2 + y, 0.0, 0.0], blend=0.2, name="corner"),
            Stop(position=[1.2, 0.5, 0.0]),
        ],
        segments=lines,
    )
    assert [type(kind) for kind in task(0.0).segments] == [mo.Line] * 2
    assert task(0.0).stops[1].velocity == "any"
    assert [type(kind).__name__ for kind in task(0.05).segments] == ["Line", "Corner", "Line"]


@pytest.mark.parametrize(
    ("stops", "options", "said"),
    [
        ([Stop(position=[3, 0, 0], name="far"), [0, 0]], {}, ("stop 'far'", "1.2 m")),
        (
            [Stop(position=[1.2, -0.5, 0.0], name="a"), Stop(position=[2.0, 0.5, 0.0], name="b")],
            {"segments": [mo.Line()]},
            ("stop 'b'", "262 mm"),
        ),
        (
            [Stop(position=[0.1, 1.0, 0.0], name="a"), Stop(position=[0.1, -1.0, 0.0], name="b")],
            {"segments": [mo.Line()]},
            ("tool line", "stop 'a'", "stop 'b'", "0.38", "46.2 mm"),
        ),
        (
            [[0.0, 0.0], [0.0, 0.0]],
            {"cycle": True},
            ("'stop 1' and 'stop 2'", "same place", "cycle"),
        ),
        (
            [Stop(position=[1.2, -0.5, 0.0], payload=9.0, name="a"), [-np.pi / 2, 0.0]],
            {},
            ("stop 'a'", "9 kg", "at rest", "'joint 1'", "-60 to 60 N m"),
        ),
        (
            [[0.0, 1.0], Stop(q=[0.0, 0.0], velocity=[9.0, 0.0])],
            {},
            ("velocity", "'stop 2'", "'joint 1'", "9,", "-3 to 3 rad/s"),
        ),
        (
            [
                Stop(position=[1.2, -0.5, 0.0]),
                Stop(position=[1.2, 0.5, 0.0], blend=0.1, name="b"),
                Stop(position=[1.2, -0.4, 0.0]),
            ],
            {"segments": [mo.Line()] * 2},
            ("corner 'b'", "blend"),
        ),
        (
            [Stop(q=[0.0, 1.0], payload=1.0, name="a"), [0.0, 0.0]],
            {"cycle": True},
            ("stop 'a'", "1 kg", "cycle", "payload 0"),
        ),
        ([[0.0, 0.0], [1.0, 0.0]], {"segments": []}, ("segments", "1 entries", "not 0")),
        (
            [Stop(position=[1.2, 0.5, 0.0], name="a"), Stop(position=[1.2, 0.5, 0.0], name="b")],
            {"segments": [mo.Circle(through=[1.0, 0.0, 0.0])]},
            ("tool circle", "stop 'a'", "stop 'b'", "through", "two points"),
        ),
        (
            [Stop(position=[1.2, 0.5, 0.0], name="a"), [0.0, 0.0]],
            {"segments": [mo.JointLine()]},
            ("joint line", "stop 'a'", "'stop 2'", "q,"),
        ),
        ([[0.0, 0.0], [1.0, 0.0]], {"order": "any"}, ("order", "given, free", "'any'")),
        (
            [Stop(position=[1.2, -0.5, 0.0], tolerance=5.0, name="a"), [0.0, 0.0]],
            {},
            ("tolerance", "stop 'a'", "5 m", "tenth", "1.8 m"),
        ),
        (
            [Stop(position=[1.2, -0.5, 0.0], tolerance=[5.0, 0.1, 0.1], name="a"), [0.0, 0.0]],
            {},
            ("tolerance", "stop 'a'", "5 m", "1.8 m"),
        ),
        (
            [Stop(position=[1.2, -0.5, 0.0], payload=1e6, name="a"), [0.0, 0.0]],
            {},
            ("payload", "stop 'a'", "1e+06 kg", "1000 times", "2 kg"),
        ),
        (
            [Stop(q=[1.0, 0.5], tolerance=[7.0, 0.1], name="a"), [0.0, 0.0]],
            {},
            ("tolerance", "stop 'a'", "7 rad", "whole turn"),
        ),
        (
            [[0.0, 1.0], Stop(position=[1.2, 0.0, 0.0], velocity=[90, 0, 0]), [0.0, 0.0]],
            {},
            ("velocity", "'stop 2'", "90 m/s", "7.8 m/s"),
        ),
        (
            [[0.0, 1.0], Stop(position=[1.2, 0.0, 0.0], velocity=[6, 0, 0]), [0.0, 0.0]],
            {},
            ("'stop 2'", "1.98 m/s", "not 6 m/s"),
        ),
        ([[0.0, 0.0], [1.0, 0.0]], {"duration": 0.1}, ("duration", "0.3333 s", "not 0.1 s")),
        ([[0.0, 0.0]], {"cycle": True}, ("cycle", "two stops")),
    ],
)
def test_what_cannot_be_is_said_in_words_of_the_task(two_links, stops, options, said):
    with refused(*said):
        mo.time_optimal(two_links, stops, **options, **QUICK)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({}, ("q", "position", "neither")),
        ({"q": [0.0], "dwell": 1.0, "velocity": "any"}, ("dwell", "1 s", "at rest")),
        ({"position": [0, 0, 0], "free_turn": "z"}, ("orientation", "turn")),
        (
            {"position": [0, 0, 0], "orientation": np.ones((3, 3))},
            ("orientation", "rotation", "0.001", "mirrors"),
        ),
        ({"q": [0.0], "tolerance": -1.0}, ("tolerance", "0,", "not -1.0")),
        (
            {"q": [0.0], "tolerance": [[0.0], "a"]},
            ("tolerance", "array of numbers", "[[0.0], 'a']"),
        ),
        ({"q": [0.0], "payload": -1.0}, ("mass", "payload", "0 kg", "-1.0")),
        ({"q": [0.0], "dwell": 1e9}, ("dwell", "86400 s", "1000000000.0")),
    ],
)
def test_a_stop_that_says_nothing_sensible_is_refused(keys, said):
    with refused(*said):
        Stop(**keys)


def test_a_front_goes_from_the_fastest_to_the_closed_form_of_the_calmest(rail):
    front = mo.tasks.time_effort_front(rail, [[0.0], [1.0]], slacks=(0.1, 0.5), **QUICK)
    assert front.certified
    shortest = np.sqrt(2.0)
    assert [p.duration for p in front.points] == pytest.approx(
        [shortest, 1.1 * shortest, 1.5 * shortest], rel=1e-3
    )
    # least effort: 12 m^2 d^2 / (T^3 F^2); the fastest uses its force all the time but where it
    # switches, which takes two intervals of the mesh
    least = 12 * 4.0 / (16.0 * front.points[2].duration ** 3)
    assert (1 - 2 / QUICK["mesh"]) * shortest < front.points[0].effort < 1.001 * shortest
    assert front.points[2].effort == pytest.approx(least, rel=1e-3)
    assert front.points[1].effort > front.points[2].effort
    assert front.points[2].peak_torque == pytest.approx(6 * 2.0 / (2.25 * 2.0) / 4.0, rel=1e-2)
    assert len(front.plot()) == 2


def test_a_front_of_torque_takes_the_closed_form_until_the_arm_cannot_be_held(rail):
    front = mo.tasks.time_torque_front(
        rail, [[0.0], [1.0]], shares=(0.5, 0.8), mesh=20, starts=1, compiled=False
    )
    assert front.certified
    shortest = np.sqrt(2.0)
    assert [p.duration * np.sqrt(p.peak_torque) for p in front.points] == pytest.approx(
        [shortest] * 3, rel=3e-3
    )
    assert [p.peak_torque for p in front.points] == pytest.approx([1.0, 0.8, 0.5], rel=1e-3)
    robot, via_q = pendulum(tau_max=20.0, qd_max=5.0), [[0.0], [np.pi / 6]]
    options = {"mesh": 10, "starts": 1, "compiled": False}
    front = mo.tasks.time_torque_front(robot, via_q, shares=(0.5, 0.2), **options)
    assert len(front.points) == 2
    tells(front.ended, "4.905 N m", "'joint 1'")


@pytest.mark.parametrize(
    ("kind", "curve"),
    [
        (mo.Line(tolerance=0.02), Straight((0.0, 0.0, 0.0), (0.3, 0.0, 0.1))),
        (
            mo.Circle(through=[0.2, 0.1, 0.0], tolerance=0.02),
            CircleArc.through(np.zeros(3), np.array([0.2, 0.1, 0.0]), np.array([0.3, 0.3, 0.0])),
        ),
    ],
)
def test_a_tube_ends_within_a_ball_of_its_tolerance(kind, curve):
    around = np.random.default_rng(0).uniform(-0.03, 0.03, (100, 3))
    dense = curve.points(np.linspace(0.0, 1.0, 2001))
    kept = []
    for point in np.vstack([around, curve.points(np.ones(1)) + around]):
        tool = np.eye(4)
        tool[:3, 3] = point
        distance = np.linalg.norm(dense - point, axis=1).min()
        values = [
            (np.array(limit.expression(SimpleNamespace(tool=tool))).ravel(), limit)
            for limit in curve_limits(kind, curve, None)
        ]
        inside = all(
            (v <= lim.upper).all() and (lim.lower is None or (v >= lim.lower).all())
            for v, lim in values
        )
        assert not inside or distance < 1.001 * kind.tolerance
        kept.append((inside, distance < 0.9 * kind.tolerance))
    inside, near = np.array(kept).T
    assert (inside & near).sum() > 0.8 * near.sum()


def test_without_time_for_a_search_segments_go_from_rest_to_rest(rail):
    stops = [Stop(q=[0.0]), Stop(q=[0.5], dwell=0.3, payload=2.0), Stop(q=[1.5])]
    task = task_of(rail, stops, None)
    settings = mo.planning.TimeOptimalSettings(compiled=False)
    with deadline.within(60.0):
        known = problem_of(task, settings).fallback
    assert known is not None
    tells(known.made_from, "rests", "every stop")
    motion = known.motion
    assert motion.duration == pytest.approx(2 * np.sqrt(0.5 / 2.0) + 0.3 + 2.0, rel=1e-3)
    assert mo.certify(rail, motion, via_q=stops).ok


# in motion at nearly one place ----------------------------------------------------------------


PLACE, VELOCITY = np.array([0.27, 0.8, -0.24]), np.array([1.8, 1.7, -2.0])


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize("apart", [0.0, 1e-8])
def test_how_near_the_places_are_does_not_decide_how_an_arm_in_motion_stops(microbot, apart):
    """Sweeping out and back takes the same time, however near it comes to where it started."""
    stops = [mo.Stop(q=PLACE, velocity=VELOCITY), mo.Stop(q=PLACE + apart)]
    motion = mo.time_optimal(microbot, stops, starts=1, **QUICK)
    assert motion.solved
    assert motion.duration == pytest.approx(0.7228, rel=5e-3)
    assert mo.certify(microbot, motion, via_q=stops).ok


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("way", "end", "duration"),
    [
        (1e-5, VELOCITY, 1e-5),  # it only goes on; below, rounding exceeds accelerations
        # it goes round
        pytest.param(-1e-8, VELOCITY, 1.1639, marks=pytest.mark.thorough),
        pytest.param(0.0, -VELOCITY, 0.6190, marks=pytest.mark.thorough),
    ],
)
@pytest.mark.slow
def test_an_arm_in_motion_may_end_in_motion_near_by(microbot, way, end, duration):
    stops = [mo.Stop(q=PLACE, velocity=VELOCITY), mo.Stop(q=PLACE + way * VELOCITY, velocity=end)]
    motion = mo.time_optimal(microbot, stops, starts=1, **QUICK)
    assert motion.solved
    assert motion.duration == pytest.approx(duration, rel=5e-3)
    assert mo.certify(microbot, motion, via_q=stops).ok


def test_an_arm_that_need_not_move_is_refused(microbot):
    with refused("'stop 1' and 'stop 2'", "same place"):
        mo.time_optimal(microbot, [mo.Stop(q=PLACE, velocity=VELOCITY)] * 2)
    stops = [mo.Stop(q=PLACE, velocity=VELOCITY), mo.Stop(q=PLACE), mo.Stop(q=PLACE + 0.1)]
    with refused("'stop 1' and 'stop 2'", "same place"):
        mo.time_optimal(microbot, stops)


def test_typical_durations_of_joints_in_motion_are_those_of_a_double_integrator():
    robot = slider(qdd_max=2.0)
    family = LimitFamily.of(robot)

    def lasts(way, start, end):
        scale = TaskScale.of(family, np.array([[0.0], [way]]), np.array([[start], [end]]))
        return scale.durations[0]

    assert lasts(1.0, 0.0, 0.0) == pytest.approx(2.0 * np.sqrt(0.5))
    assert lasts(0.0, 1.0, 0.0) == pytest.approx(0.5 + 2.0 * np.sqrt(0.25 / 2.0))
    assert lasts(0.0, 1.0, -1.0) == pytest.approx(1.0)
    assert lasts(1e-6, 1.0, 1.0) == pytest.approx(1e-6, rel=1e-3)
    assert lasts(-1.0, 1.0, 1.0) == pytest.approx((2.0 * np.sqrt(3.0) + 2.0) / 2.0)


# tool lines under limits of the tool -----------------------------------------------------------


SQUARE = [Stop(position=p) for p in ([1.2, 0.2, 0.0], [1.2, 0.9, 0.0], [0.3, 1.4, 0.0])]
LINES = [mo.Line(tolerance=2e-3), None]


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize(
    "limit", [mo.limits.tool_speed(1.0), mo.limits.tool_acceleration(4.0), mo.limits.power(60.0)]
)
def test_a_tool_line_under_a_limit_of_the_tool_is_solved_from_the_first_start(two_links, limit):
    limits = two_links.with_limits(also=[limit]).limits
    motion = mo.time_optimal(two_links, SQUARE, limits, segments=LINES, starts=1, **QUICK)
    assert motion.solved
    assert mo.certify(two_links, motion, limits, via_q=SQUARE, segments=LINES).ok
    assert motion.outcome.ledger[0].cost_after is not None


@pytest.mark.thorough
@pytest.mark.parametrize("speed", [0.3, 1.0, 5.0])
def test_a_way_that_rests_at_every_stop_is_known_along_tool_lines_too(two_links, speed):
    limits = two_links.with_limits(also=[mo.limits.tool_speed(speed)]).limits
    task = task_of(two_links, SQUARE, limits, segments=LINES)
    known = problem_of(task, mo.planning.TimeOptimalSettings(**QUICK)).fallback
    assert known is not None
    assert mo.certify(two_links, known.motion, limits, via_q=SQUARE, segments=LINES).ok
    assert known.motion.duration >= 1.6 / speed


def test_shapes_that_follow_one_another_are_slowed_down_by_one_factor():
    """The peak velocity of a quintic over 1 m is 1.875 m over its duration."""
    families = [LimitFamily.of(slider(qd_max=1.0, tau_max=1e3))] * 2
    shapes = [mo.quintic([[0.0], [1.0]], [0.0, T]) for T in (1.5, 3.0)]
    slower = slowed_together(families, shapes, 5e-4)
    assert slower is not None
    assert [shape.duration for shape in slower] == pytest.approx([1.875, 3.75], rel=1e-3)
    assert slowed_together(families, slower, 5e-4) == slower  # within limits as they are
    shapes = [mo.quintic([[0.0], [1.0]], [0.0, 1.0])] * 2
    assert slowed_together(families, shapes, 5e-4) is None  # it was nowhere near its limits


@pytest.mark.parametrize("distance", [0.3, 2.0])
def test_one_joint_takes_its_lower_bound_from_rest_to_rest(distance):
    """Under a velocity and an acceleration limit: d / v + v / a, or 2 sqrt(d / a) below v."""
    rail = slider(mass=1.0, tau_max=100.0, qd_max=1.5).with_limits(qdd_max=4.0)
    task = task_of(rail, [[0.0], [distance]])
    (way,) = ways_through(task)
    exact = 2.0 * np.sqrt(0.3 / 4.0) if distance == 0.3 else 2.0 / 1.5 + 1.5 / 4.0
    assert bound_of(task, way) == pytest.approx(exact, rel=1e-12)
    motion = mo.time_optimal(rail, [[0.0], [distance]])
    assert exact * (1.0 - 1e-6) <= motion.duration <= exact * (1.0 + 1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_no_motion_beats_its_lower_bound(two_links, seed):
    robot = two_links.with_limits(tau_max=np.inf, qdd_max=[6.0, 9.0])
    via = np.random.default_rng(seed).uniform(-1.5, 1.5, (3, 2))
    task = task_of(robot, via)
    (way,) = ways_through(task)
    duration = mo.time_optimal(robot, via, **QUICK).duration
    assert 0.5 * duration < bound_of(task, way) <= duration


# tool lines through singular places ------------------------------------------------------------


def over_the_shoulder(y):
    return [Stop(position=[3.0, y, 4.0]), Stop(position=[-3.0, y, 4.0])]


def turns_of_the_first_joint(robot, stops, tolerance):
    task = task_of(robot, stops, segments=[mo.Line(tolerance=tolerance)])
    return [float(np.ptp(way.paths[0][:, 0])) for way in ways_through(task)]


@pytest.mark.parametrize(
    ("tolerance", "share"),
    [
        (1e-3, 0.0),
        *(
            pytest.param(*case, marks=pytest.mark.thorough)
            for case in ((1e-3, 1e-3), (1e-3, -0.8), (5e-3, 0.75))
        ),
        (1e-5, -0.3),
    ],
)
def test_what_is_singular_within_the_tolerance_of_a_line_is_no_obstacle(microbot, tolerance, share):
    """The line through the axis of the waist is within the tolerance of all others."""
    stops = over_the_shoulder(share * tolerance)
    assert min(turns_of_the_first_joint(microbot, stops, tolerance)) < 0.1


@pytest.mark.thorough
def test_a_line_beside_a_singular_place_takes_as_long_as_that_through_it(microbot):
    durations = []
    for y in (0.0, 3e-4):
        stops, lines = over_the_shoulder(y), [mo.Line(tolerance=1e-3)]
        motion = mo.time_optimal(microbot, stops, segments=lines, mesh=12, starts=1)
        assert mo.certify(microbot, motion, via_q=stops, segments=lines).ok
        durations.append(motion.duration)
    assert durations[1] <= 1.005 * durations[0]


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize("beside", [-2e-4, 3e-4])
def test_a_six_joint_arm_passes_its_shoulder_within_the_tolerance(beside):
    """The arm of a UR5e stands over the axis of its base 0.1333 m beside it."""
    robot, down = mo.load_robot("ur5e"), np.diag([1.0, -1.0, -1.0])
    y = 0.1333 + beside
    stops = [Stop(position=[x, y, 0.3], orientation=down) for x in (0.4, -0.4)]
    turns = turns_of_the_first_joint(robot, stops, 1e-3)
    assert min(turns) < 0.2  # where the line itself turns the base by nearly half a turn


def test_a_line_beside_the_tolerance_goes_round(microbot):
    assert min(turns_of_the_first_joint(microbot, over_the_shoulder(2e-3), 1e-3)) > 3.0
