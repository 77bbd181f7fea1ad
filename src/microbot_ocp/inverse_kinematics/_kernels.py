"""The CasADi functions of inverse kinematics: a damped step for batches, two small NLPs, measures.

Positions are divided by the arm's reach, so that a metre and a radian weigh alike. A target is a
row [3] (position in the base frame, m) or [12] (position, then the columns of the rotation).

Sources: damping by the squared error after Sugihara, "Solvability-unconcerned inverse kinematics by
the Levenberg-Marquardt method", IEEE Transactions on Robotics 27(5), 2011.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.fast_calls import FastCall, fast_call
from microbot_ocp.robot import Robot, forward_kinematics, jacobian

# Share of the squared error in the damping: of 0.03 to 1, and of powers 1 to 2, the one that
# brought most starts home within 15 steps, for three and for six joints.
DAMPING = 0.1
FLOOR = 1e-15  # keeps the matrix regular at singular solutions, yet lets nearly singular ones home
REDUNDANT_FLOOR = 1e-12
RANK_TOLERANCE = 1e-5  # singular value relative to the largest
IPOPT_OPTIONS = {
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-12,
    "ipopt.acceptable_tol": 1e-9,
    "ipopt.max_iter": 100,
    "ipopt.bound_relax_factor": 0.0,
    "print_time": False,
    "calc_lam_p": False,
    "error_on_fail": False,
    "show_eval_warnings": False,
}


@lru_cache(maxsize=64)
def reach(robot: Robot) -> float:
    """Sum of the lengths of the chain, m: no position is farther from the base; 1 for none."""
    total = np.abs(robot.a).sum() + np.abs(robot.d).sum() + np.linalg.norm(robot.tool[:3, 3])
    return float(total) if total > 1e-9 else 1.0


@lru_cache(maxsize=64)
def joint_scale(robot: Robot) -> FloatArray:
    """Unit of every joint [n]: a radian, or the reach for a prismatic joint."""
    turns = np.array(robot.joint_types) == "revolute"
    return np.where(turns, 1.0, reach(robot))


def _residual(
    robot: Robot, q: ca.SX, target: ca.SX, weight: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Scaled error and its Jacobian, distance (m) and angle (rad) to the target."""
    pose, full = forward_kinematics(robot)(q), jacobian(robot)(q)
    offset = target[:3] - pose[:3, 3]
    error, slope = offset / reach(robot), full[:3, :] / reach(robot)
    angle = ca.SX(0)
    if target.numel() == 12:
        turn = ca.reshape(target[3:], 3, 3) @ pose[:3, :3].T
        sine = ca.inv_skew(turn - turn.T) / 2
        length = ca.sqrt(ca.dot(sine, sine) + 1e-40)  # never zero: the quotient below stays 1
        angle = ca.atan2(length, (ca.trace(turn) - 1) / 2)
        # Logarithm of the turn: with the geometric Jacobian the gradient of half the squared angle
        # is exact, however large the angle.
        error = ca.vertcat(error, weight * sine * angle / length)
        slope = ca.vertcat(slope, weight * full[3:, :])
    return error, ca.densify(slope), ca.norm_2(offset), angle


def _solve_positive(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Solve a small symmetric positive definite system by L D L', written out."""
    count = right.numel()
    lower = [[ca.SX(0)] * count for _ in range(count)]
    pivot: list[ca.SX] = []
    for j in range(count):
        pivot.append(matrix[j, j] - sum((lower[j][k] ** 2 * pivot[k] for k in range(j)), ca.SX(0)))
        for i in range(j + 1, count):
            known = sum((lower[i][k] * lower[j][k] * pivot[k] for k in range(j)), ca.SX(0))
            lower[i][j] = (matrix[i, j] - known) / pivot[j]
    answer = [right[i] for i in range(count)]
    for i in range(count):
        answer[i] -= sum((lower[i][k] * answer[k] for k in range(i)), ca.SX(0))
    answer = [value / pivot[i] for i, value in enumerate(answer)]
    for i in reversed(range(count)):
        answer[i] -= sum((lower[k][i] * answer[k] for k in range(i + 1, count)), ca.SX(0))
    return ca.vertcat(*answer)


@lru_cache(maxsize=64)
def descent_step(robot: Robot, width: int) -> FastCall:
    """One damped Gauss-Newton step for targets of ``width`` 3 or 12.

    Returns
    -------
    callable
        ``(q[n], target, lower[n], upper[n], weight[1]) -> step[n], error[2]``: the step leaves
        joints alone that a limit holds back; error is the distance (m) and angle (rad) at ``q``.
    """
    count = robot.joint_count
    q, target = ca.SX.sym("q", count), ca.SX.sym("target", width)
    lower, upper = ca.SX.sym("lower", count), ca.SX.sym("upper", count)
    weight = ca.SX.sym("weight")
    error, slope, distance, angle = _residual(robot, q, target, weight)
    scale = ca.DM(joint_scale(robot))
    slope = slope @ ca.diag(scale)
    descent = slope.T @ error
    held = ca.logic_or(ca.logic_and(q <= lower, descent < 0), ca.logic_and(q >= upper, descent > 0))
    slope = slope @ ca.diag(1 - held)
    floor = REDUNDANT_FLOOR if count > generic_rank(robot, width) else FLOOR
    damping = DAMPING * ca.dot(error, error) + floor
    matrix = slope.T @ slope + damping * ca.SX.eye(count)
    step = _solve_positive(ca.densify(matrix), ca.densify(slope.T @ error))
    step = step * ca.fmin(1, np.pi / (ca.norm_inf(step) + 1e-300)) * scale
    function = ca.Function(
        f"ik_step_{width}",
        [q, target, lower, upper, weight],
        [ca.densify(step), ca.vertcat(distance, angle)],
        ["q", "target", "lower", "upper", "weight"],
        ["step", "error"],
    )
    return fast_call(function)


@lru_cache(maxsize=64)
def pose_of(robot: Robot) -> FastCall:
    """``(q[n] or [N,n]) -> T[4,4] or [N,4,4]``, tool in base."""
    return fast_call(forward_kinematics(robot))


@lru_cache(maxsize=64)
def _jacobian_of(robot: Robot) -> FastCall:
    return fast_call(jacobian(robot))


def scaled_jacobian(robot: Robot, q: FloatArray, width: int) -> FloatArray:
    """Jacobians [N,m,n] of the task (m = 3 or 6), positions by the reach, joints by their unit."""
    full = np.reshape(_jacobian_of(robot)(q), (len(q), 6, robot.joint_count)) * joint_scale(robot)
    full[:, :3] /= reach(robot)
    return full[:, :3] if width == 3 else full


@lru_cache(maxsize=64)
def generic_rank(robot: Robot, width: int) -> int:
    """Rank of the task's Jacobian away from singularities."""
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (8, robot.joint_count))
    values = np.linalg.svd(scaled_jacobian(robot, q, width), compute_uv=False)
    return int((values > RANK_TOLERANCE * values[:, :1]).sum(axis=1).max())


@lru_cache(maxsize=64)
def nearest_pose_nlp(robot: Robot, width: int) -> ca.Function:
    """NLP: the least squared distance, then the least angle, within limits on q.

    Parameters of the NLP: target, then the weight of the angle (0: the position alone).
    """
    q, target = ca.SX.sym("q", robot.joint_count), ca.SX.sym("target", width)
    weight = ca.SX.sym("weight")
    pose = forward_kinematics(robot)(q)
    cost = ca.sumsqr((target[:3] - pose[:3, 3]) / reach(robot))
    if width == 12:
        turn = ca.reshape(target[3:], 3, 3) @ pose[:3, :3].T
        cost += weight**2 * (3 - ca.trace(turn))  # 2 (1 - cos angle): smooth, least where it is
    program = {"x": q, "p": ca.vertcat(target, weight), "f": cost}
    return ca.nlpsol("nearest_pose", "ipopt", program, IPOPT_OPTIONS)


@lru_cache(maxsize=64)
def nearest_joints_nlp(robot: Robot, width: int, rank: int) -> ca.Function:
    """NLP: on a continuum of solutions the one nearest to wanted joint positions, within limits.

    Of the task's equations only ``rank`` combinations are imposed, those that are independent at
    the start: more would leave the constraints without a regular Jacobian. Parameters of the NLP:
    target, wanted q [n], combinations [rank,m] by columns.
    """
    q, target = ca.SX.sym("q", robot.joint_count), ca.SX.sym("target", width)
    wanted = ca.SX.sym("wanted", robot.joint_count)
    pose = forward_kinematics(robot)(q)
    equations = (target[:3] - pose[:3, 3]) / reach(robot)
    if width == 12:
        turn = ca.reshape(target[3:], 3, 3) @ pose[:3, :3].T
        equations = ca.vertcat(equations, ca.inv_skew(turn - turn.T) / 2)
    combinations = ca.SX.sym("combinations", rank, equations.numel())
    program = {
        "x": q,
        "p": ca.vertcat(target, wanted, ca.vec(combinations)),
        "f": ca.sumsqr((q - wanted) / ca.DM(joint_scale(robot))) / 2,
        "g": combinations @ equations,
    }
    return ca.nlpsol("nearest_joints", "ipopt", program, IPOPT_OPTIONS)
