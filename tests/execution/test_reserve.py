"""The reserve for feedback: what the search promises, MuJoCo's arms must keep."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.mujoco_arms import with_small_bodies

import microbot_ocp as mo
from helpers import refused, tells

pytest.importorskip("mujoco")
from benchmarks.plants import BOUND, GAIN, RATE, played

LOOP = mo.ComputedTorque(kp=1.0)
VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])


@pytest.mark.thorough
@pytest.mark.slow
def test_arms_of_mujoco_follow_with_the_reserve_and_not_without():
    robot = with_small_bodies(mo.load_robot("microbot"))
    plants = mo.execution.differing_plants(robot, mass=0.05, count=2)
    loop = mo.ComputedTorque(kp=GAIN)
    found = mo.smallest_reserve(robot, VIA_Q, loop, plants, BOUND, sample_rate=RATE)
    assert found.solved
    assert 0.0 < found.reserve < 0.1
    assert mo.certify(robot, found.motion, robot.limits.with_reserve(found.reserve)).ok
    others = mo.execution.differing_plants(robot, mass=0.05, count=5, seed=1)
    assert max(played(robot, found.motion, plant)[0] for plant in others) < BOUND
    assert max(played(robot, found.ideal, plant)[0] for plant in plants) > 10 * BOUND


@pytest.mark.thorough
@pytest.mark.slow
def test_of_one_joint_the_answer_is_known():
    """An arm heavier by 5 % needs 5 % more torque."""
    link = mo.Link(1.0, np.array([0.5, 0.0, 0.0]), 0.1 * np.eye(3))
    limits = mo.Limits(tau_max=10.0)
    robot = mo.Robot.from_dh(
        [0.0], [0.0], [0.0], links=[link], limits=limits, gravity=[0, 0, 0], tool=[0, 1.0, 0, 0]
    )
    plants = mo.execution.differing_plants(robot, mass=0.05, count=0)
    q = [[0.0], [1.0]]
    loop = mo.ComputedTorque(kp=400.0)
    found = mo.smallest_reserve(robot, q, loop, plants, 5e-3, accuracy=0.005, sample_rate=1000.0)
    assert found.solved
    assert found.motion.duration == pytest.approx(
        found.ideal.duration / np.sqrt(1.0 - found.reserve), rel=1e-4
    )
    assert 0.03 < found.reserve < 0.06
    by_motion = mo.smallest_reserve(
        robot, found.ideal, loop, plants, 5e-3, accuracy=0.005, sample_rate=1000.0
    )
    assert by_motion.reserve == pytest.approx(found.reserve, abs=0.006)


def test_dry_friction_that_turns_over_is_no_reason_to_call_an_arm_lost():
    """A simulation takes too many steps to its usual tolerance, which the bound does not ask."""
    link = mo.Link(1.0, [0.5, 0.0, 0.0], 0.1 * np.eye(3), coulomb_friction=4.0)
    robot = mo.Robot.from_dh(
        [0.0], [0.0], [0.0], links=[link], limits=mo.Limits(tau_max=10.0), gravity=[0, 0, 0]
    )
    plants = mo.execution.differing_plants(robot, friction=0.3, count=0)
    shape = mo.shortest_duration(robot, mo.quintic([[0.0], [1.0], [0.2]], [0.0, 1.0, 2.0]))
    motion = mo.Motion.from_polynomial(robot, shape.polynomial, label="quintic")
    loop = mo.ComputedTorque(kp=400.0)
    found = mo.smallest_reserve(
        robot, lambda reserve: motion, loop, plants, 0.05, sample_rate=500.0
    )
    assert found.solved, found.table()


@pytest.mark.thorough
def test_no_reserve_keeps_what_the_controller_does_not(microbot):
    plants = mo.execution.differing_plants(microbot, mass=0.2, count=0)
    shape = mo.quintic(VIA_Q[[0, 2]], [0.0, 4.0])
    motion = mo.Motion.from_polynomial(microbot, shape, label="quintic")
    loop = mo.ComputedTorque(kp=1.0)
    found = mo.smallest_reserve(
        microbot, lambda reserve: motion, loop, plants, 1e-3, accuracy=0.3, sample_rate=200.0
    )
    assert not found.solved
    assert np.isnan(found.reserve)
    tells(found.advice, "controller itself")
    assert len(found.table().rows) == len(found.trials) == 3
    drawn = found.plot()
    assert drawn.shape == (2,)
    assert [axes.get_ylabel() for axes in drawn.flat] == ["error of the tool [mm]", "duration [s]"]


@pytest.mark.parametrize(
    "where",
    ["free", *(pytest.param(w, marks=pytest.mark.thorough) for w in ("prepared", "stops")), "path"],
)
def test_every_planner_keeps_the_share_back(microbot, where):
    reserve = [0.1, 0.2, 0.3]
    tight = microbot.limits.with_reserve(reserve)
    given = {"mesh": 20, "starts": 1, "reserve": reserve}
    if where == "free":
        motion = mo.time_optimal(microbot, VIA_Q, **given)
    elif where == "stops":
        motion = mo.time_optimal(microbot, [mo.Stop(q=tuple(q)) for q in VIA_Q], **given)
    elif where == "prepared":
        motion = mo.TimeOptimalSolver(microbot, VIA_Q, mesh=20, starts=1)(reserve=reserve)
    else:
        path = mo.straight_path(VIA_Q)
        motion = mo.time_optimal_path(microbot, path, reserve=reserve)
    certificate = mo.certify(microbot, motion, tight)
    assert certificate.ok
    torque = next(check for check in certificate.limit_checks if check.quantity == "tau")
    assert torque.utilisation.max() > 0.98


def test_a_delay_of_one_sample_is_a_step_of_the_torque(microbot):
    start = {"q0": [0.1, 0.0, 0.0], "sample_rate": 100.0, "step": 1e-2, "saturation": False}
    still = mo.quintic([[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0]], [0.0, 1.0])
    loop = mo.ComputedTorque(kp=100.0)
    late = mo.track(microbot, still, loop, delay=1, **start)
    law = mo.inverse_dynamics(microbot)
    error, rate = late.error[:-1], late.reference.qd[:-1] - late.qd[:-1]
    asked = late.reference.qdd[:-1] + 20.0 * rate + 100.0 * error
    wanted = np.array(law(late.q[:-1].T, late.qd[:-1].T, asked.T)).T
    np.testing.assert_allclose(late.tau[1:-1], wanted[:-1], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(late.tau[0], wanted[0], rtol=1e-9)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda r: r.limits.with_reserve(1.0), ("reserve", "share", "below 1", "not 1.0")),
        (lambda r: r.limits.with_reserve([0.1, 0.2]), ("reserve", "[3]", "[2]")),
        (
            lambda r: mo.time_optimal(r, VIA_Q, reserve=-0.1),
            ("reserve", "share", "at least 0", "-0.1"),
        ),
        (lambda r: mo.execution.differing_plants(r, mass=2.0), ("mass", "at most 1", "2.0")),
        (
            lambda r: mo.execution.differing_plants(r, payload=(-1.0, 0.0)),
            ("payload", "at least 0 kg", "-1.0"),
        ),
        (
            lambda r: mo.smallest_reserve(r, VIA_Q, mo.ComputedTorque(kp=1.0), [], 0.1),
            ("plants", "at least one"),
        ),
        (
            lambda r: mo.compare(r, VIA_Q, trackable={"controller": LOOP}),
            ("trackable", "controller, plants", "bound"),
        ),
        (
            lambda r: mo.compare(
                r, VIA_Q, trackable={"controller": LOOP, "plants": [r], "bound": 0.1, "gain": 1.0}
            ),
            ("trackable", "loop", "sample_rate", "'gain'"),
        ),
        (
            lambda r: mo.smallest_reserve(r, VIA_Q, LOOP, [mo.load_robot("ur5e")], 0.1),
            ("plant", "6 joints", "robot has 3"),
        ),
        (
            lambda r: mo.track(r, mo.cubic(VIA_Q, [0, 1, 2]), mo.ComputedTorque(kp=1.0), delay=1),
            ("delay", "sample_rate"),
        ),
    ],
)
def test_what_is_no_reserve(microbot, call, said):
    with refused(*said):
        call(microbot)


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize(
    ("mass", "bound"),
    [
        (0.05, 0.01),
        *(pytest.param(0.2, bound, marks=pytest.mark.thorough) for bound in (0.02, 0.04)),
    ],
)
def test_the_bound_holds_until_the_arm_has_settled(mass, bound):
    """A grip follows the end of a motion; the tool was 45 mm off after it with a bound of 40."""
    link = mo.Link(1.0, np.array([0.5, 0.0, 0.0]), 0.1 * np.eye(3))
    limits = mo.Limits(tau_max=10.0)
    robot = mo.Robot.from_dh(
        [0.0], [0.0], [0.0], links=[link], limits=limits, gravity=[0, 0, 0], tool=[0, 1.0, 0, 0]
    )
    plants = mo.execution.differing_plants(robot, mass=mass, count=0)
    loop = mo.ComputedTorque(kp=400.0)
    found = mo.smallest_reserve(robot, [[0.0], [1.0]], loop, plants, bound, sample_rate=1000.0)
    assert found.solved
    motion, after, within = found.motion, 0.0, 0.0
    t = np.append(motion.t, motion.duration + np.array([1e-6, 3.0]))
    still = [
        np.vstack([column, np.zeros((2, 1))]) for column in (motion.qd, motion.qdd, motion.tau)
    ]
    q = np.vstack([motion.q, motion.q[[-1, -1]]])
    held = mo.Motion(t, q, *still, label="held")
    for plant in plants:
        run = mo.track(robot, held, loop, plant=plant, sample_rate=1000.0)
        off = np.abs(2.0 * np.sin(0.5 * (run.q - run.reference.q)))  # of a tool 1 m away
        moving = run.t <= motion.duration
        within, after = max(within, off[moving].max()), max(after, off[~moving].max())
    assert after > within  # so that this is about what follows the end
    assert after <= 1.01 * bound
