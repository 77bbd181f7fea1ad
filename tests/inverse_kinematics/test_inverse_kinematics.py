"""Inverse kinematics against the closed form of the course report, and against itself backwards."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

import microbot_ocp as mo
from helpers import batch, random_robot, refused, sampled, tells
from microbot_ocp import Status
from microbot_ocp.inverse_kinematics import _kernels, _search, branches_by_nlp, elbow_arm_branches

SHOULDER = np.array([0.0, 0.0, 2.0])
# course report, part 2, recomputed
TARGET = (3.0, -1.0, 4.5)
REPORT_BRANCHES = [
    (-18.4349, 105.8439, -111.3819),
    (-18.4349, -29.1863, 111.3819),
    (161.5651, 74.1561, 111.3819),
    (161.5651, -150.8137, -111.3819),
]


@pytest.fixture(scope="module")
def puma() -> mo.Robot:
    """Puma 560 as in Craig, section 3.7, with the usual lengths; no limits."""
    return mo.Robot.from_dh(
        alpha=np.radians([0, -90, 0, -90, 90, -90]),
        a=[0, 0, 0.4318, 0.0203, 0, 0],
        d=[0, 0, 0.15005, 0.4318, 0, 0],
        name="spherical-wrist arm",
    )


@pytest.fixture(scope="module")
def seven() -> mo.Robot:
    """A 7R arm with the lengths and limits of the Panda (maker's modified-DH table)."""
    return mo.Robot.from_dh(
        alpha=np.radians([0, -90, 90, 90, -90, 90, 90]),
        a=[0, 0, 0, 0.0825, -0.0825, 0, 0.088],
        d=[0.333, 0, 0.316, 0, 0.384, 0, 0],
        tool=(0, 0, 0.107, 0),
        limits=mo.Limits(
            q_min=[-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973],
            q_max=[2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973],
        ),
        name="seven-joint arm",
    )


def gaps(q: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Largest joint difference modulo a turn, to each row."""
    return np.abs((q - others + np.pi) % (2 * np.pi) - np.pi).max(axis=-1)


def same_set(
    solutions: tuple[mo.inverse_kinematics.IKSolution, ...], expected: np.ndarray, within: float
) -> bool:
    """Every expected row met once, and nothing else."""
    if len(solutions) != len(expected):
        return False
    found = np.array([solution.q for solution in solutions])
    return all((gaps(row, found) < within).sum() == 1 for row in expected)


def directions(count: int, seed: int = 0) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def poses(robot: mo.Robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    matrices = batch(mo.forward_kinematics(robot), q)
    return matrices[:, :3, 3], matrices[:, :3, :3]


def limited(robot: mo.Robot, q_min: object, q_max: object) -> mo.Robot:
    return robot.with_limits(mo.Limits(q_min=q_min, q_max=q_max))  # type: ignore[arg-type]


# ---- the course report


def test_all_branches_are_the_four_of_the_report(microbot: mo.Robot) -> None:
    solutions = mo.solve_ik_all(microbot, TARGET)
    assert same_set(solutions, np.radians(REPORT_BRANCHES), 1e-6)
    for solution in solutions:
        assert solution.status is Status.SOLVED
        assert solution.solved
        assert solution.position_error < 1e-8
        assert solution.orientation_error == 0.0
        assert solution.self_motion == 0
        assert not solution.singular
        assert solution.pose[:3, 3] == pytest.approx(TARGET, abs=1e-8)
        assert solution.advice.count(".") == 1  # nothing is to be added


def test_the_nlp_finds_the_same_branches(microbot: mo.Robot) -> None:
    found = branches_by_nlp(microbot, TARGET)
    assert len(found) == 4
    for row in np.radians(REPORT_BRANCHES):
        assert gaps(row, found).min() < 1e-6


def test_closed_form_is_in_the_order_of_the_report() -> None:
    assert np.degrees(elbow_arm_branches(TARGET)) == pytest.approx(
        np.array(REPORT_BRANCHES), abs=5e-5
    )


@pytest.mark.parametrize(("position", "said"), [((7.01, 0, 2), "7.01 m"), ((0, 0, 2.5), "0.5 m")])
def test_closed_form_refuses_what_is_out_of_reach(position: tuple[float, ...], said: str) -> None:
    with refused("position", "between 1 and 7 m", said):
        elbow_arm_branches(position)


# ---- every branch, none missed and none doubled


@pytest.mark.slow
def test_a_thousand_targets_have_the_branches_of_the_closed_form(microbot: mo.Robot) -> None:
    radius = np.random.default_rng(1).uniform(1.0, 7.0, (1000, 1))
    targets = SHOULDER + radius * directions(1000)
    for target, solutions in zip(
        targets, mo.inverse_kinematics.solve_ik_batch(microbot, targets), strict=True
    ):
        assert same_set(solutions, elbow_arm_branches(target), 1e-6), target
        assert max(solution.position_error for solution in solutions) < 1e-8


@pytest.mark.parametrize("edge", [1.0, 7.0])
def test_branches_close_to_the_edges_are_told_apart(microbot: mo.Robot, edge: float) -> None:
    inward = 10 ** np.random.default_rng(2).uniform(-6, -1, (100, 1)) * (1 if edge == 1.0 else -1)
    targets = SHOULDER + (edge + inward) * directions(100)
    for target, solutions in zip(
        targets, mo.inverse_kinematics.solve_ik_batch(microbot, targets), strict=True
    ):
        assert same_set(solutions, elbow_arm_branches(target), 1e-5), target


@pytest.mark.slow
@pytest.mark.parametrize("count", [0, 1, 2])
def test_random_three_joint_arms_come_back_to_where_they_were(count: int) -> None:
    rng = np.random.default_rng(count)
    lengths = rng.uniform(-1, 1, (2, 3))
    robot = mo.Robot.from_dh(rng.uniform(-3, 3, 3), *lengths, tool=(0, 0.7, 0, 0))
    q = rng.uniform(-np.pi, np.pi, (100, 3))
    for row, solutions in zip(
        q, mo.inverse_kinematics.solve_ik_batch(robot, poses(robot, q)[0]), strict=True
    ):
        assert len(solutions) in (2, 4)  # odd numbers only on a fold
        assert sum(gaps(s.q, row) < 1e-6 for s in solutions) == 1


@pytest.mark.slow
def test_a_spherical_wrist_has_eight_branches(puma: mo.Robot) -> None:
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (200, 6))
    for row, solutions in zip(
        q, mo.inverse_kinematics.solve_ik_batch(puma, *poses(puma, q)), strict=True
    ):
        assert len(solutions) == 8
        assert sum(gaps(s.q, row) < 1e-6 for s in solutions) == 1
        assert max(s.position_error for s in solutions) < 1e-8
        assert max(s.orientation_error for s in solutions) < 1e-8
        found = np.array([s.q for s in solutions])
        assert min(np.sort(gaps(s.q, found))[1] for s in solutions) > 1e-3


@pytest.mark.slow
def test_branches_of_a_general_six_joint_arm_are_even_in_number() -> None:
    robot = random_robot("rrrrrr")
    q = np.random.default_rng(4).uniform(-np.pi, np.pi, (40, 6))
    for row, solutions in zip(
        q, mo.inverse_kinematics.solve_ik_batch(robot, *poses(robot, q)), strict=True
    ):
        assert len(solutions) % 2 == 0
        assert len(solutions) <= 16
        assert sum(gaps(s.q, row) < 1e-6 for s in solutions) == 1


@given(q=st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_forward_kinematics_of_a_solution_is_the_target(
    microbot: mo.Robot, q: tuple[float, ...]
) -> None:
    target = poses(microbot, np.array([q]))[0][0]
    for solution in mo.solve_ik_all(microbot, target):
        assert solution.solved
        reached = np.array(mo.forward_kinematics(microbot)(solution.q))
        assert np.linalg.norm(reached[:3, 3] - target) < 1e-8
        assert np.linalg.norm(solution.pose - reached) < 1e-12


@pytest.mark.slow
def test_prismatic_joints_have_branches_too() -> None:
    scara = mo.Robot.from_dh(
        alpha=[0, 0, 0, np.pi],
        a=[0, 0.4, 0.3, 0],
        d=[0.4, 0, 0, 0],
        joint_type=["revolute", "revolute", "revolute", "prismatic"],
        limits=mo.Limits(q_min=[-2, -2.5, -6.3, 0], q_max=[2, 2.5, 6.3, 0.2]),
    )
    (position,), (turn,) = poses(scara, np.array([[0.3, 0.8, 1.0, 0.1]]))
    solutions = mo.solve_ik_all(scara, position, turn)
    assert [s.status for s in solutions] == [Status.SOLVED] * 2
    assert sorted(round(s.q[1], 6) for s in solutions) == [-0.8, 0.8]
    assert all(s.q[3] == pytest.approx(0.1) for s in solutions)
    beyond = mo.solve_ik(scara, position - [0, 0, 0.3], turn)
    assert beyond.status is Status.LIMITS
    assert beyond.position_error == pytest.approx(0.2, abs=1e-8)
    tells(beyond.advice, "0.2 m", "36.35 deg", "joint 4")


# ---- limits and seeds


def test_branches_outside_the_limits_are_left_out(microbot: mo.Robot) -> None:
    solutions = mo.solve_ik_all(limited(microbot, -np.pi / 2, np.radians(120)), TARGET)
    assert same_set(solutions, np.radians(REPORT_BRANCHES[1:2]), 1e-6)


def test_branches_lie_within_limits_nearest_to_their_middle(microbot: mo.Robot) -> None:
    shifted = limited(microbot, [2 * np.pi, -2 * np.pi, 1.0], [6 * np.pi, 4 * np.pi, 11.0])
    middle = np.array([4 * np.pi, np.pi, 6.0])
    solutions = mo.solve_ik_all(shifted, TARGET)
    assert same_set(solutions, np.radians(REPORT_BRANCHES), 1e-6)
    for solution in solutions:
        assert np.all(np.abs(solution.q - middle) <= np.pi + 1e-9)
    distances = [np.linalg.norm(solution.q - middle) for solution in solutions]
    assert distances == sorted(distances)


def test_limits_that_prevent_the_target_are_named(microbot: mo.Robot) -> None:
    robot = limited(microbot, [-1, -0.5, 0], [1, 0.5, 1])
    (solution,) = mo.solve_ik_all(robot, TARGET)
    assert solution.status is Status.LIMITS
    tells(solution.advice, f"{solution.position_error:.6g} m", "elbow")
    assert np.all(solution.q >= robot.limits.q_min)
    assert np.all(solution.q <= robot.limits.q_max)
    grid = np.linspace(robot.limits.q_min, robot.limits.q_max, 25).T
    every = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
    best = np.linalg.norm(poses(robot, every)[0] - TARGET, axis=1).min()
    assert best - 0.2 < solution.position_error <= best + 1e-9


def test_limits_that_cut_off_a_continuum_are_named(microbot: mo.Robot) -> None:
    (solution,) = mo.solve_ik_all(limited(microbot, [-1, -0.1, -1], [1, 0.1, 1]), [0, 0, 5])
    assert solution.status is Status.LIMITS


@pytest.mark.parametrize("branch", range(4))
def test_seed_picks_the_nearest_branch(microbot: mo.Robot, branch: int) -> None:
    wanted = np.radians(REPORT_BRANCHES[branch])
    for shift in ([0.2, -0.2, 0.3], [-0.3, 0.1, 0.2]):
        found = mo.solve_ik(microbot, TARGET, seed=wanted + shift)
        assert found.q == pytest.approx(wanted, abs=1e-6)


def test_seed_picks_the_turn_as_well(microbot: mo.Robot) -> None:
    wanted = np.radians(REPORT_BRANCHES[0]) + np.array([2 * np.pi, 0.0, 2 * np.pi])
    found = mo.solve_ik(microbot, TARGET, seed=wanted - 0.1)
    assert found.q == pytest.approx(wanted, abs=1e-6)


def test_without_a_seed_the_most_central_branch_is_taken(microbot: mo.Robot) -> None:
    first = mo.solve_ik_all(microbot, TARGET)[0]
    assert mo.solve_ik(microbot, TARGET).q == pytest.approx(first.q, abs=1e-9)


def random_arm(count: int, seed: int) -> mo.Robot:
    """An arm of revolute joints with any twists and lengths."""
    rng = np.random.default_rng(seed)
    twists, lengths = rng.uniform(-np.pi, np.pi, count), rng.uniform(-0.5, 0.5, (2, count))
    return mo.Robot.from_dh(twists, *lengths, tool=(0, 0.1, 0, 0.1), name=f"random {count}R")


def reachable(robot: mo.Robot, count: int, seed: int) -> tuple[np.ndarray, ...]:
    """Joints within limits, the poses there, and other joints within limits."""
    low, high = np.maximum(robot.limits.q_min, -np.pi), np.minimum(robot.limits.q_max, np.pi)
    q, other = np.random.default_rng(seed).uniform(low, high, (2, count, robot.joint_count))
    return (q, *poses(robot, q), other)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["microbot", "puma560", "ur5e", "panda", "stanford"])
def test_no_reachable_target_is_missed_from_anywhere(name: str) -> None:
    robot = mo.load_robot(name)
    _, positions, turns, seeds = reachable(robot, 300, seed=9)
    orientations = turns if robot.joint_count > 3 else None
    for found in mo.inverse_kinematics.solve_ik_each(robot, positions, orientations, seeds):
        assert found.solved
        assert found.position_error < 1e-8
        assert found.orientation_error < 1e-8
        assert np.all(found.q >= robot.limits.q_min)
        assert np.all(found.q <= robot.limits.q_max)


@pytest.mark.slow
@pytest.mark.parametrize("count", [pytest.param(6, marks=pytest.mark.thorough), 7])
def test_no_reachable_target_of_a_random_arm_is_missed(count: int) -> None:
    robot = limited(random_arm(count, seed=12), -2.5, 2.5)
    _, positions, turns, seeds = reachable(robot, 200, seed=13)
    assert all(
        s.solved for s in mo.inverse_kinematics.solve_ik_each(robot, positions, turns, seeds)
    )


def test_each_of_many_targets_is_solved_as_if_it_were_alone() -> None:
    robot = mo.load_robot("ur5e")
    q, positions, turns, _ = reachable(robot, 20, seed=10)
    seeds = q + 0.05
    together = mo.inverse_kinematics.solve_ik_each(robot, positions, turns, seeds)
    for row, position, turn, seed, found in zip(q, positions, turns, seeds, together, strict=True):
        assert found.q == pytest.approx(row, abs=1e-6)
        alone = mo.solve_ik(robot, position, turn, seed)
        np.testing.assert_array_equal(found.q, alone.q)
        assert found.advice == alone.advice


def test_a_target_out_of_reach_among_many_is_diagnosed(microbot: mo.Robot) -> None:
    near, far = mo.inverse_kinematics.solve_ik_each(microbot, [TARGET, (9, 0, 2)], seeds=[0, 1, -1])
    assert near.solved
    assert far.status is Status.OUT_OF_REACH
    assert far.position_error == pytest.approx(2.0, abs=1e-8)
    assert mo.inverse_kinematics.solve_ik_each(microbot, [TARGET])[0].solved


def test_a_redundant_arm_moves_no_farther_than_it_must(seven: mo.Robot) -> None:
    """Near the seed no other solution is nearer to it by more than a share."""
    q = np.array([0.2, -0.4, 0.3, -1.9, 0.1, 1.7, 0.6])
    (position,), (turn,) = poses(seven, q[None])
    wanted = q + 0.2 * np.random.default_rng(11).normal(size=7)
    found = mo.solve_ik(seven, position, turn, seed=wanted)
    jacobian = np.array(mo.jacobian(seven)(found.q))
    along = np.linalg.svd(jacobian)[2][6]
    assert abs(along @ (wanted - found.q)) < 1e-4  # nothing left to gain beside the task


# ---- out of reach


@pytest.mark.parametrize(
    "target",
    [(20, 5, 2), (7.5, 0, 2), (0, 0, 9.5), (-3, 4, -7), (0.5, 0, 2), (0.3, 0.2, 2.1), (0, 0, 2)],
)
def test_distance_missed_is_exact(microbot: mo.Robot, target: tuple[float, ...]) -> None:
    """The microbot reaches what is 1 to 7 m from its shoulder."""
    radius = float(np.linalg.norm(np.array(target) - SHOULDER))
    for solution in (mo.solve_ik(microbot, target), *mo.solve_ik_all(microbot, target)):
        assert solution.status is Status.OUT_OF_REACH
        assert not solution.solved
        assert solution.position_error == pytest.approx(max(radius - 7, 1 - radius), abs=1e-8)
        tells(solution.advice, f"{solution.position_error:.6g} m")
        assert np.linalg.norm(solution.pose[:3, 3] - target) == pytest.approx(
            solution.position_error, abs=1e-12
        )


def test_a_thousandth_of_a_millimetre_decides(microbot: mo.Robot) -> None:
    inside, outside = (mo.solve_ik_all(microbot, [7 + x, 0, 2]) for x in (-1e-6, 1e-6))
    assert len(inside) == 4
    assert len(outside) == 1
    assert outside[0].status is Status.OUT_OF_REACH
    assert outside[0].position_error == pytest.approx(1e-6, abs=1e-9)


def test_orientation_out_of_freedom_is_missed_by_the_least_angle(microbot: mo.Robot) -> None:
    solution = mo.solve_ik(microbot, TARGET, np.eye(3))
    assert solution.status is Status.ORIENTATION_MISSED
    assert solution.position_error < 1e-8
    turns = [s.pose[:3, :3] for s in mo.solve_ik_all(microbot, TARGET)]
    angles = [np.arccos((np.trace(turn) - 1) / 2) for turn in turns]
    assert solution.orientation_error == pytest.approx(min(angles), abs=1e-9)
    tells(solution.advice, "orientation", "90.72 deg")


def test_orientation_that_happens_to_fit_is_reached(microbot: mo.Robot) -> None:
    q = np.array([[0.3, 0.4, 0.5]])
    (position,), (turn,) = poses(microbot, q)
    (solution,) = mo.solve_ik_all(microbot, position, turn)
    assert solution.solved
    assert solution.q == pytest.approx(q[0], abs=1e-9)


def test_far_pose_keeps_its_orientation(puma: mo.Robot) -> None:
    """The wrist is free to turn at the end of a stretched arm."""
    solution = mo.solve_ik(puma, [2, 0, 0.5], np.eye(3))
    assert solution.status is Status.OUT_OF_REACH
    assert solution.orientation_error < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", sampled(["stanford", "panda", "ur5e", "puma560"], 4))
def test_every_answer_for_far_targets_is_a_nearest_pose(name: str) -> None:
    """No small move of joints within their limits brings the tool nearer."""
    robot = mo.load_robot(name)
    low, high = robot.limits.q_min, robot.limits.q_max
    rng = np.random.default_rng(8)
    for direction in directions(6, seed=8):
        target = 3.0 * direction
        solution = mo.solve_ik(robot, target)
        assert solution.status in (Status.OUT_OF_REACH, Status.LIMITS)
        around = np.clip(solution.q + rng.normal(size=(500, low.size)) * 0.01, low, high)
        nearby = np.linalg.norm(poses(robot, around)[0] - target, axis=1)
        assert nearby.min() > solution.position_error - 1e-8


# ---- singular targets


def test_stretched_arm_has_doubled_roots_given_once(microbot: mo.Robot) -> None:
    solutions = mo.solve_ik_all(microbot, [7, 0, 2])
    assert len(solutions) == 2
    expected = np.array([[0, 0, 0], [np.pi, np.pi, 0]])
    assert same_set(solutions, expected, 1e-4)
    for solution in solutions:
        assert solution.solved
        assert solution.singular
        assert solution.self_motion == 0
        assert solution.position_error < 1e-8
        assert "singular" in solution.advice


@pytest.mark.parametrize(("height", "count"), [(5.0, 2), (6.5, 2), (9.0, 1), (3.0, 1)])
def test_target_on_the_axis_of_joint_1_is_a_continuum(
    microbot: mo.Robot, height: float, count: int
) -> None:
    """Any waist angle will do; its other branch is the same continuum turned by half a turn."""
    solutions = mo.solve_ik_all(microbot, [0, 0, height])
    assert len(solutions) == count
    for solution in solutions:
        assert solution.solved
        assert solution.self_motion == 1
        assert solution.q[0] == pytest.approx(0.0, abs=1e-6)  # the most central member
        assert "continuum" in solution.advice


def test_seed_is_kept_along_a_continuum(microbot: mo.Robot) -> None:
    found = mo.solve_ik(microbot, [0, 0, 5], seed=[1.234, 0.2, 2.0])
    assert found.solved
    assert found.q[0] == pytest.approx(1.234, abs=1e-6)


@pytest.mark.parametrize("offset", [1e-6, 1e-4])
def test_next_to_the_axis_there_are_four_branches(microbot: mo.Robot, offset: float) -> None:
    solutions = mo.solve_ik_all(microbot, [offset, 0, 5])
    assert same_set(solutions, elbow_arm_branches([offset, 0, 5]), 1e-4)


def test_stretched_wrist_is_a_continuum_beside_isolated_branches(puma: mo.Robot) -> None:
    q = np.array([[0.3, -0.5, 0.2, 0.4, 0.0, 0.7]])
    (position,), (turn,) = poses(puma, q)
    solutions = mo.solve_ik_all(puma, position, turn)
    assert {s.self_motion for s in solutions} == {0, 1}
    assert sum(s.self_motion == 0 for s in solutions) == 6
    for solution in solutions:
        assert solution.solved
        if solution.self_motion:
            assert solution.q[4] == pytest.approx(0.0, abs=1e-6)
            fourth_and_sixth = (solution.q[3] + solution.q[5]) % (2 * np.pi)
            assert fourth_and_sixth == pytest.approx(1.1, abs=1e-6)


# ---- redundant arms


def test_a_slide_along_a_self_motion_ends_at_its_nearest_joints_or_at_a_limit() -> None:
    panda = mo.load_robot("panda")
    bounds = panda.limits.bounds("q")
    q = np.random.default_rng(42).uniform(*bounds, (40, 7))
    poses = mo.fast_call(mo.forward_kinematics(panda))(q)
    targets = np.hstack([poses[:, :3, 3], poses[:, :3, :3].swapaxes(1, 2).reshape(-1, 9)])
    ended, errors = _search.descend(panda, q, targets, bounds, _search.SLIDE, _search.middle(panda))
    assert np.all(errors < _search.goal(panda))
    low, high = (np.isclose(ended, bound, rtol=0, atol=1e-12) for bound in bounds)
    assert (low | high).any(axis=1).sum() > 3
    for row in ended:
        jacobian = _kernels.scaled_jacobian(panda, row[None], 12)[0]
        along = np.linalg.svd(jacobian)[2][-1]
        along *= np.sign(along @ (_search.middle(panda) - row))
        at = np.isclose(row, np.where(along > 0, bounds[1], bounds[0]), rtol=0, atol=1e-12)
        assert abs(along @ (_search.middle(panda) - row)) < 1e-5 or at.any()


def test_redundant_arm_has_representatives_with_self_motion(seven: mo.Robot) -> None:
    rng = np.random.default_rng(6)
    q = rng.uniform(seven.limits.q_min, seven.limits.q_max, (4, 7))
    for position, turn in zip(*poses(seven, q), strict=True):
        solutions = mo.solve_ik_all(seven, position, turn)
        assert solutions
        for solution in solutions:
            assert solution.solved
            assert solution.self_motion == 1
            assert solution.position_error < 1e-8
            assert solution.orientation_error < 1e-8
            assert np.all(solution.q >= seven.limits.q_min)
            assert np.all(solution.q <= seven.limits.q_max)


def test_redundant_arm_stays_at_its_seed(seven: mo.Robot) -> None:
    q = np.array([[0.2, -0.4, 0.3, -1.9, 0.1, 1.7, 0.6]])
    (position,), (turn,) = poses(seven, q)
    assert mo.solve_ik(seven, position, turn, seed=q[0]).q == pytest.approx(q[0], abs=1e-6)
    nudged = q[0] + 0.05
    near = mo.solve_ik(seven, position, turn, seed=nudged)
    assert np.linalg.norm(near.q - nudged) <= np.linalg.norm(q[0] - nudged) + 1e-9


def test_redundant_arm_beyond_its_limits_says_so(seven: mo.Robot) -> None:
    q = np.array([[0.0, 0.3, 0.0, 1.5, 0.0, 1.0, 0.0]])  # elbow bent the wrong way
    tight = limited(seven, seven.limits.q_min / 4 - 0.1, np.minimum(seven.limits.q_max / 4, -0.0))
    (position,), (turn,) = poses(seven, q)
    (solution,) = mo.solve_ik_all(tight, position, turn)
    assert solution.status is Status.LIMITS
    assert solution.q.max() <= 0.0


def test_planar_arm_moves_within_itself() -> None:
    planar = mo.Robot.from_dh([0, 0, 0], [0, 1, 1], [0, 0, 0], tool=(0, 0.5, 0, 0))
    solutions = mo.solve_ik_all(planar, [1, 1, 0])
    assert all(s.solved and s.self_motion == 1 for s in solutions)
    (above,) = mo.solve_ik_all(planar, [1, 1, 0.3])
    assert above.status is Status.OUT_OF_REACH
    assert above.position_error == pytest.approx(0.3, abs=1e-8)


# ---- other arms


@pytest.mark.slow
@pytest.mark.parametrize("name", mo.packaged_robots())
def test_packaged_robots_come_back_to_their_seed(name: str) -> None:
    robot = mo.load_robot(name)
    low, high = np.maximum(robot.limits.q_min, -3.0), np.minimum(robot.limits.q_max, 3.0)
    q = np.random.default_rng(7).uniform(low, high, (4, robot.joint_count))
    for row, position, turn in zip(q, *poses(robot, q), strict=True):
        for orientation in (None, turn):
            found = mo.solve_ik(robot, position, orientation, seed=row)
            assert found.solved
            assert found.q == pytest.approx(row, abs=1e-6)


@pytest.mark.slow
def test_single_joints() -> None:
    crank = mo.Robot.from_dh([0], [0], [0], tool=(0, 1, 0, 0))
    assert mo.solve_ik(crank, [0, 1, 0]).q == pytest.approx([np.pi / 2])
    assert mo.solve_ik(crank, [0, 2, 1]).position_error == pytest.approx(np.sqrt(2), abs=1e-8)
    slide = mo.Robot.from_dh([0], [0], [0], joint_type="prismatic", limits=mo.Limits(0, 1))
    assert mo.solve_ik(slide, [0, 0, 0.4]).q == pytest.approx([0.4])
    beyond = mo.solve_ik(slide, [0, 0, 1.4])
    assert beyond.status is Status.LIMITS
    assert beyond.q == pytest.approx([1.0])
    beside = mo.solve_ik(slide, [0.1, 0, 0.4])
    assert beside.status is Status.OUT_OF_REACH
    assert beside.position_error == pytest.approx(0.1, abs=1e-8)


@pytest.mark.slow
def test_wrist_without_lengths() -> None:
    wrist = mo.Robot.from_dh(np.radians([0, -90, 90]), [0, 0, 0], [0, 0, 0])
    (_,), (turn,) = poses(wrist, np.array([[0.3, 0.4, 0.5]]))
    assert len(mo.solve_ik_all(wrist, [0, 0, 0], turn)) == 2
    assert mo.solve_ik(wrist, [0, 0, 0]).self_motion == 3
    assert mo.solve_ik(wrist, [0, 0, 1]).position_error == pytest.approx(1.0)


def test_locked_joint(microbot: mo.Robot) -> None:
    at, other = np.radians(REPORT_BRANCHES[0][0]), 0.5
    exact = np.arctan2(-1, 3)
    assert abs(exact - at) < 1e-6
    held = limited(microbot, [exact, -3, -3], [exact, 3, 3])
    assert same_set(mo.solve_ik_all(held, TARGET), np.radians(REPORT_BRANCHES[:2]), 1e-6)
    away = mo.solve_ik(limited(microbot, [other, -3, -3], [other, 3, 3]), TARGET)
    assert away.status is Status.LIMITS
    # distance of the target from the plane of the arm
    assert away.position_error == pytest.approx(np.sqrt(10) * np.sin(other - exact), abs=1e-8)


@pytest.mark.parametrize(("q_min", "q_max"), [(-np.inf, np.inf), ([5, -np.inf, -np.inf], np.inf)])
def test_open_limits(microbot: mo.Robot, q_min: object, q_max: object) -> None:
    solutions = mo.solve_ik_all(limited(microbot, q_min, q_max), TARGET)
    assert same_set(solutions, np.radians(REPORT_BRANCHES), 1e-6)
    for solution in solutions:  # as near to the allowed value nearest to zero as turns allow
        near = max(0.0, np.atleast_1d(q_min)[0])
        assert 0 <= abs(solution.q[0] - near) < 2 * np.pi


# ---- lines


@pytest.mark.parametrize("branch", range(4))
def test_line_is_followed_on_the_branch_of_the_seed(microbot: mo.Robot, branch: int) -> None:
    line = np.linspace(TARGET, [-3, 2, 1.5], 200)
    path = mo.follow_ik(microbot, line, seed=np.radians(REPORT_BRANCHES[branch]))
    assert path.solved
    assert path.jumps == ()
    assert path.position_error.max() < 1e-8
    assert path.largest_step < 0.1
    assert path.q[0] == pytest.approx(np.radians(REPORT_BRANCHES[branch]), abs=1e-6)
    assert np.sign(path.q[:, 2]).tolist() == [np.sign(path.q[0, 2])] * 200
    assert poses(microbot, path.q)[0] == pytest.approx(line, abs=1e-8)


def test_line_across_the_axis_goes_over_the_top(microbot: mo.Robot) -> None:
    path = mo.follow_ik(microbot, np.linspace([3, 0, 4.5], [-3, 0, 4.5], 101))
    assert path.solved
    assert path.largest_step < 0.1
    assert np.ptp(path.q[:, 0]) < 1e-6


@pytest.mark.parametrize("offset", [1e-3, 1e-5])
def test_line_close_to_the_axis_turns_the_waist_fast(microbot: mo.Robot, offset: float) -> None:
    path = mo.follow_ik(microbot, np.linspace([3, offset, 4.5], [-3, offset, 4.5], 101))
    assert path.solved
    assert np.ptp(path.q[:, 0]) == pytest.approx(np.pi, abs=1e-2)
    assert "singular" in path.advice


def test_two_turns_start_where_the_limits_leave_room(microbot: mo.Robot) -> None:
    angle = np.linspace(0, 4 * np.pi - 0.01, 300)
    circle = np.column_stack([4 * np.cos(angle), 4 * np.sin(angle), np.full(300, 2.0)])
    path = mo.follow_ik(microbot, circle)
    assert path.solved
    assert abs(path.q[-1, 0] - path.q[0, 0]) == pytest.approx(4 * np.pi - 0.01, abs=1e-6)
    assert np.abs(path.q).max() <= 2 * np.pi + 1e-9


def test_line_out_of_reach_is_reported_row_by_row(microbot: mo.Robot) -> None:
    line = np.linspace([5, 0, 2], [9, 0, 2], 21)
    path = mo.follow_ik(microbot, line)
    assert not path.solved
    assert path.status is Status.OUT_OF_REACH
    assert path.statuses[:11] == (Status.SOLVED,) * 11
    assert path.statuses[11:] == (Status.OUT_OF_REACH,) * 10
    assert path.position_error[11:] == pytest.approx(line[11:, 0] - 7, abs=1e-8)
    tells(path.advice, "10 of 21", "row 11", "row 20", "2 m")


def test_line_whose_branch_meets_a_limit_tells_the_jump(microbot: mo.Robot) -> None:
    robot = limited(microbot, [-2, -1, -3], [2, 2, 3])
    path = mo.follow_ik(robot, np.linspace(TARGET, [-3, -1, 4.5], 100))
    assert not path.solved
    assert path.jumps
    assert "jump" in path.advice


def test_pose_line_of_a_six_joint_arm(puma: mo.Robot) -> None:
    ends = np.array([[0.1, -0.6, 0.3, 0.2, 0.5, 0.1], [0.7, -0.9, 0.5, 0.6, 0.9, -0.3]])
    (first, last), (turn, _) = poses(puma, ends)
    line, turns = np.linspace(first, last, 60), np.broadcast_to(turn, (60, 3, 3))
    path = mo.follow_ik(puma, line, turns, seed=ends[0])
    assert path.solved
    assert path.orientation_error.max() < 1e-8
    assert path.q[0] == pytest.approx(ends[0], abs=1e-6)
    assert path.largest_step < 0.1


def test_line_of_a_redundant_arm_stays_close(seven: mo.Robot) -> None:
    q = np.array([[0.2, -0.4, 0.3, -1.9, 0.1, 1.7, 0.6]])
    (position,), (turn,) = poses(seven, q)
    line = np.linspace(position, position + np.array([0.1, 0.1, -0.1]), 40)
    path = mo.follow_ik(seven, line, np.broadcast_to(turn, (40, 3, 3)), seed=q[0])
    assert path.solved
    assert path.largest_step < 0.05


# ---- answers and arguments


def test_every_status_has_a_sentence() -> None:
    for status in Status:
        assert status.sentence.endswith(".")
        assert len(status.sentence) > 20


def test_answers_cannot_be_written_to(microbot: mo.Robot) -> None:
    solution = mo.solve_ik(microbot, TARGET)
    for array in (solution.q, solution.pose, mo.follow_ik(microbot, [TARGET]).q):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    assert solution.solve_time > 0


REFLECTION = np.diag([1.0, 1.0, -1.0])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"position": [1, 2]}, ("position", "[3]", "[2]")),
        ({"position": [1, 2, np.nan]}, ("position", "[2]", "nan m")),
        ({"position": "here"}, ("position", "numbers", "'here'")),
        ({"orientation": np.eye(4)}, ("orientation", "[3, 3]", "[4, 4]")),
        ({"orientation": 2 * np.eye(3)}, ("orientation", "rotation", "0.001", "3 off")),
        ({"orientation": REFLECTION}, ("orientation", "rotation", "mirrors")),
        ({"orientation": np.full((3, 3), np.inf)}, ("orientation", "[0, 0]", "inf")),
        ({"seed": [0, 0]}, ("seed", "[3]", "[2]")),
        ({"seed": [0, 0, np.inf]}, ("seed", "[2]", "inf rad")),
        ({"robot": "microbot"}, ("robot", "Robot", "'microbot'", "mo.load_robot")),
    ],
)
def test_bad_input_is_one_clear_sentence(
    microbot: mo.Robot, arguments: dict[str, object], said: tuple[str, ...]
) -> None:
    given_all: dict[str, object] = {"robot": microbot, "position": TARGET, **arguments}
    with refused(*said):
        mo.solve_ik(**given_all)  # type: ignore[arg-type]
    if "seed" not in arguments:
        with refused(*said):
            mo.solve_ik_all(**given_all)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("positions", "orientations", "said"),
    [
        ([1, 2, 3], None, ("positions", "[any, 3]", "not [3]")),
        (np.zeros((0, 3)), None, ("positions", "one row", "not 0")),
        ([TARGET], [np.eye(3)] * 2, ("orientations", "[1, 3, 3]", "[2, 3, 3]")),
        ([TARGET] * 2, [np.eye(3), REFLECTION], ("orientations[1]", "rotation", "mirrors")),
    ],
)
def test_bad_lines_are_refused(
    microbot: mo.Robot, positions: object, orientations: object, said: tuple[str, ...]
) -> None:
    for solve in (mo.follow_ik, mo.inverse_kinematics.solve_ik_batch):
        with refused(*said):
            solve(microbot, positions, orientations)  # type: ignore[operator]
