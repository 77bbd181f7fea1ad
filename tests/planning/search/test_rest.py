"""At rest an arm holds itself: torques of limited rate begin and end at what gravity asks for."""

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import sampled, tells
from microbot_ocp.planning import straight_path, time_optimal_path
from planning.shared import ARM_VIA, VIA_Q, VIA_T, arm, slider

STEP = 1e-4  # s
QUICK = {"mesh": 20, "starts": 1}


def largest_step(robot: mo.Robot, motion: mo.Motion) -> float:
    """Change of a torque within a step by what its rate allows, before and after it as well."""
    t = np.append(np.arange(0.0, motion.duration, STEP), motion.duration)
    dynamics, states = mo.inverse_dynamics(robot), motion.sample(t)
    tau = np.array(dynamics(*(part.T for part in states))).T
    holding = [np.array(mo.gravity_torque(robot)(states.q[k])).T for k in (0, -1)]
    change = np.abs(np.diff(np.vstack([holding[0], tau, holding[1]]), axis=0))
    return float((change / (robot.limits.taud_max * STEP)).max())


def microbot(share: float) -> mo.Robot:
    return mo.load_robot("microbot").with_limits(taud_max=share * np.array([1000, 1250, 500]))


def two_links(share: float) -> mo.Robot:
    return arm(tau_max=[60.0, 25.0], taud_max=share * np.array([400.0, 150.0]))


CASES = [
    (two_links(1.0), ARM_VIA),
    *(
        pytest.param(case, marks=pytest.mark.thorough)
        for case in (
            (two_links(0.3), ARM_VIA),
            *((microbot(share), VIA_Q) for share in (1.0, 0.3)),
        )
    ),
]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: f"{case[0].name}")
def free(request):
    """A robot whose torque rates are limited, points and the free motion through them."""
    robot, via_q = request.param
    return robot, via_q, mo.time_optimal(robot, via_q, **QUICK)


@pytest.mark.thorough
@pytest.mark.slow
def test_free_motions_leave_from_the_torques_that_hold_the_arm(free):
    robot, _, motion = free
    assert motion.solved
    assert largest_step(robot, motion) < 1.005


@pytest.mark.thorough
@pytest.mark.slow
def test_certificates_agree_whatever_they_are_told_of_the_task(free):
    robot, via_q, motion = free
    for more in ({}, {"via_q": via_q}, {"via_q": [mo.Stop(q=q) for q in via_q]}):
        assert mo.certify(robot, motion, **more).ok
    assert mo.certify(robot, time_optimal_path(robot, mo.spline(via_q, VIA_T))).ok


@pytest.mark.thorough
@pytest.mark.parametrize("share", [1.0, 0.3])
def test_certificates_agree_on_what_was_planned_through_stops(share):
    robot, stops = microbot(share), [mo.Stop(q=q) for q in VIA_Q]
    motion = mo.time_optimal(robot, stops)
    for more in ({}, {"via_q": VIA_Q}, {"via_q": stops}):
        assert mo.certify(robot, motion, **more).ok


@pytest.mark.thorough
def test_the_panda_leaves_from_the_torques_that_hold_it():
    robot = mo.load_robot("panda")
    ends = [[0, -0.5, 0, -2, 0, 1.5, 0.8], [0.6, 0.2, -0.3, -1.6, 0.4, 1.8, 0.2]]
    for motion in (mo.time_optimal(robot, ends), time_optimal_path(robot, straight_path(ends))):
        assert motion.solved
        assert largest_step(robot, motion) < 1.005


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize(
    "stop", [{"dwell": 0.3}, pytest.param({"velocity": "rest"}, marks=pytest.mark.thorough)]
)
def test_stops_and_dwells_are_passed_with_the_torques_that_hold_the_arm(stop):
    robot = two_links(1.0)
    stops = [mo.Stop(q=q, **(stop if k == 1 else {})) for k, q in enumerate(ARM_VIA)]
    motion = mo.time_optimal(robot, stops, **QUICK)
    assert motion.solved
    assert largest_step(robot, motion) < 1.005
    np.testing.assert_allclose(motion.sample(motion.marks[1].time).qdd, 0.0, atol=1e-9)


@pytest.mark.slow
def test_a_prepared_solver_leaves_from_the_torques_that_hold_the_arm():
    robot = two_links(1.0)
    motion = mo.TimeOptimalSolver(robot, ARM_VIA[:2], **QUICK)()
    assert motion.solved
    assert largest_step(robot, motion) < 1.01


@pytest.mark.parametrize(
    "path",
    sampled(
        [
            straight_path(ARM_VIA),
            mo.cubic(ARM_VIA, [0.0, 1.0, 2.0]),
            mo.quintic(ARM_VIA, [0.0, 1.0, 2.0]),
            mo.spline(ARM_VIA, [0.0, 1.0, 2.0]),
        ],
        2,
    ),
    ids=["corner", "cubic", "quintic", "spline"],
)
@pytest.mark.parametrize("share", [0.25, pytest.param(1.0, marks=pytest.mark.thorough)])
def test_timed_paths_leave_and_stop_with_the_torques_that_hold_the_arm(path, share):
    robot = two_links(share)
    motion = time_optimal_path(robot, path)
    assert motion.solved
    tells(motion.provenance["method"], "program", "places")
    assert largest_step(robot, motion) < 1.005


@pytest.mark.thorough
def test_one_way_has_one_duration_whatever_parameter_describes_it():
    """A cubic and a quintic of one segment are straight lines with other parameters."""
    robot = arm(tau_max=[60.0, 25.0], taud_max=[400.0, 150.0])
    shapes = straight_path(ARM_VIA[:2]), *(f(ARM_VIA[:2], [0, 1]) for f in (mo.cubic, mo.quintic))
    durations = [time_optimal_path(robot, shape).duration for shape in shapes]
    assert durations == pytest.approx([durations[0]] * 3, rel=1e-4)


@pytest.mark.thorough
def test_a_tool_line_of_a_task_leaves_from_the_torques_that_hold_the_arm():
    robot = microbot(0.5)
    ends = [VIA_Q[1], VIA_Q[1] + [0.2, 0.2, -0.2]]
    stops = [mo.Stop(q=q) for q in ends]
    motion = mo.time_optimal(robot, stops, segments=[mo.Line(tolerance=0.002)])
    assert motion.solved
    assert largest_step(robot, motion) < 1.005


@pytest.mark.slow
@pytest.mark.parametrize(
    "limits",
    [
        pytest.param({"qddd_max": 4.0}, marks=pytest.mark.thorough),
        {"taud_max": 8.0},
        pytest.param({"qddd_max": 400.0}, marks=pytest.mark.thorough),
    ],
)
def test_limits_of_rates_alone_take_the_closed_form(limits):
    """Jerk +j, -j, +j for a quarter, a half and a quarter of the time."""
    robot = slider(2.0, **limits)
    jerk = limits.get("qddd_max", limits.get("taud_max", 0.0) / 2.0)
    expected = (32.0 * 1.5 / jerk) ** (1.0 / 3.0)
    line = [[0.0], [1.5]]
    motions = [
        mo.time_optimal(robot, line),
        mo.TimeOptimalSolver(robot, line)(),
        *(time_optimal_path(robot, path) for path in (straight_path(line), mo.cubic(line, [0, 1]))),
        time_optimal_path(robot, mo.quintic(line, [0.0, 1.0])),
    ]
    assert [motion.status for motion in motions] == ["solved"] * 5
    assert [m.duration for m in motions] == pytest.approx([expected] * 5, rel=1e-4)


def test_a_straight_line_of_several_joints_takes_what_ruckig_says():
    ruckig = pytest.importorskip("ruckig")
    limits = {"qd_max": [1.0, 2.0], "qdd_max": 2 * [4.0], "qddd_max": 2 * [30.0]}
    robot = arm(**limits)
    problem = ruckig.InputParameter(2)
    problem.current_position, problem.target_position = ARM_VIA[0].tolist(), ARM_VIA[1].tolist()
    names = "max_velocity", "max_acceleration", "max_jerk"
    for name, values in zip(names, limits.values(), strict=True):
        setattr(problem, name, values)
    problem.synchronization = ruckig.Synchronization.Phase  # along the line
    trajectory = ruckig.Trajectory(2)
    ruckig.Ruckig(2).calculate(problem, trajectory)
    motion = time_optimal_path(robot, straight_path(ARM_VIA[:2]))
    assert motion.duration == pytest.approx(trajectory.duration, rel=1e-4)
