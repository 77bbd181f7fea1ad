"""CasADi functions of inverse kinematics: compiled descent, two small NLPs, error measures.

Positions are divided by the arm's reach, so that a metre and a radian have comparable weights. A
target is a row [3] (position in the base frame, m) or [12] (position, then the columns of the
rotation).

Sources: damping by the squared error after Sugihara, "Solvability-unconcerned inverse kinematics by
the Levenberg-Marquardt method", IEEE Transactions on Robotics 27(5), 2011.

Theory: docs/theory/kinematics.md, equation (5).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.fast_calls import FastCall, deferred_call
from microbot_ocp._base.ipopt import ipopt
from microbot_ocp._base.quasi_random import evenly_spread_step
from microbot_ocp._base.threads import cached_in_thread
from microbot_ocp.robot import Robot, forward_kinematics, jacobian, solve_symmetric

TINY = np.finfo(float).tiny  # summand that keeps a divisor above zero
RANK_TOLERANCE = 1e-5  # singular value that counts as zero, per largest

IPOPT_OPTIONS = {
    "tol": 1e-12,
    "max_iter": 100,
    "bound_relax_factor": 0.0,
}


@lru_cache(maxsize=64)
def reach(robot: Robot) -> float:
    """Return the sum of the link lengths, m, an upper bound of the reach; 1 if all are zero."""
    total = np.abs(robot.a).sum() + np.abs(robot.d).sum() + np.linalg.norm(robot.tool[:3, 3])
    return float(total) if total > ROUNDING else 1.0


@lru_cache(maxsize=64)
def joint_scale(robot: Robot) -> FloatArray:
    """Return the unit of every joint [n]: a radian, or the reach for a prismatic joint."""
    return np.where(np.array(robot.joint_types) == "revolute", 1.0, reach(robot))


def _residual(
    robot: Robot, q: ca.SX, target: ca.SX, weight: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Return the scaled error, its Jacobian, distance (m) and angle (rad) to the target."""
    pose, full = forward_kinematics(robot)(q), jacobian(robot)(q)
    offset = target[:3] - pose[:3, 3]
    error, slope = offset / reach(robot), full[:3, :] / reach(robot)
    angle = ca.SX(0)
    if target.numel() == 12:
        turn = ca.reshape(target[3:], 3, 3) @ pose[:3, :3].T
        sine = ca.inv_skew(turn - turn.T) / 2
        length = ca.sqrt(ca.dot(sine, sine) + TINY)
        angle = ca.atan2(length, (ca.trace(turn) - 1) / 2)
        # The error is the logarithm of the rotation, angle times axis: with the geometric Jacobian
        # the gradient of half the squared angle is exact for every angle.
        error = ca.vertcat(error, weight * sine * angle / length)
        slope = ca.vertcat(slope, weight * full[3:, :])
    return error, ca.densify(slope), ca.norm_2(offset), angle


class Descent(NamedTuple):
    """Options of a descent; the fields are the last input of :func:`descent`."""

    weight: float = 1.0  # weight of the angle, relative to distance over reach
    attempts: int = 1  # starts; the first is given, later ones are farther and farther from it
    patience: int = 50  # steps of an attempt that does not come close to the target
    polish: int = 4  # smallest number of polishing steps; doubled roots converge slowly
    nearest: int = 0  # steps in which a redundant arm also moves towards the wanted joints


DAMPING = 0.03  # damping per squared error
LEAST_DAMPING = np.finfo(float).eps  # it keeps the matrix regular at singular solutions
ENOUGH = 1e-13  # scaled error of a solution
POLISHING_ERROR = 1e-7  # scaled error below which steps count as polishing
MOST_POLISHING_STEPS = 30  # largest number of polishing steps
CLOSE_ERROR = 1e-3  # scaled error below which an attempt may exceed its patience
MOST_STEPS = 80  # largest number of steps of one attempt
MOST_TOTAL_STEPS = 100_000  # largest number of steps of all attempts
NULL_SPACE_STEP = 1e-6  # null-space step of joints that have arrived, rad


@lru_cache(maxsize=64)
def descent(robot: Robot, width: int) -> FastCall:
    """Return damped Gauss-Newton steps within bounds towards a target of ``width`` 3 or 12.

    Returns
    -------
    callable
        ``(state[n+3], target, wanted[n], lower[n], upper[n], low[n], high[n], settings[5]) ->
        state[n+3], going[1], error[1]``. The state starts as joint positions and three zeros, which
        count the steps of the attempt, its polishing steps, and the attempts. Joints that press
        against a bound stay fixed in a step. New attempts start between ``wanted`` and a point in
        ``low`` to ``high``. ``error`` is the scaled error of the returned joints; ``settings`` are
        the fields of :class:`Descent`.
    """
    count = robot.joint_count
    state, target = ca.SX.sym("state", count + 3), ca.SX.sym("target", width)
    wanted, settings = ca.SX.sym("wanted", count), ca.SX.sym("settings", len(Descent()))
    lower, upper = ca.SX.sym("lower", count), ca.SX.sym("upper", count)
    low, high = ca.SX.sym("low", count), ca.SX.sym("high", count)
    q, steps, small, attempt = state[:count], state[count], state[count + 1], state[count + 2]
    weight, attempts, patience, polish, nearest = ca.vertsplit(settings)
    error, slope, distance, angle = _residual(robot, q, target, weight)
    size = ca.sqrt((distance / reach(robot)) ** 2 + (weight * angle) ** 2)
    scale = ca.DM(joint_scale(robot))
    slope = slope @ ca.diag(scale)
    pull = slope.T @ error

    def beyond(step: ca.SX) -> ca.SX:
        return ca.logic_or(ca.logic_and(q <= lower, step < 0), ca.logic_and(q >= upper, step > 0))

    # Active set: joints at a bound whose gradient step points outwards are fixed in this step.
    held = beyond(pull)
    # Sugihara's damping, lambda = w |e|^2 + floor, vanishes at a solution: the end is quadratic.
    damping = DAMPING * ca.dot(error, error) + LEAST_DAMPING
    sought = ca.logic_and(attempt < 1, steps < nearest)

    def step_of_others(held: ca.SX) -> tuple[ca.SX, ca.SX]:
        missing = (1 - held) * (wanted - q) / scale
        return _step(slope @ ca.diag(1 - held), error, damping, missing, sought)

    if slope.size1() < count:  # the null-space step may press further joints against their bounds
        held = ca.if_else(sought, beyond(step_of_others(ca.SX.zeros(count))[0]), held)
    move, apart = step_of_others(held)
    # A step of at most half a turn keeps the linear model from spinning joints.
    move *= scale * ca.fmin(1, np.pi / (ca.norm_inf(move) + TINY))
    small += size < POLISHING_ERROR
    exact = ca.logic_and(size <= ENOUGH, small >= polish)
    solved = ca.logic_or(
        ca.logic_and(exact, apart < NULL_SPACE_STEP), small >= MOST_POLISHING_STEPS + nearest
    )
    lost = ca.logic_or(ca.logic_and(steps >= patience, size > CLOSE_ERROR), steps >= MOST_STEPS)
    again = ca.logic_and(lost, attempt + 1 < attempts)
    step = ca.DM(evenly_spread_step(count))
    # New starts move from the wanted joints into the whole range within four attempts.
    place = 0.5 + attempt * step
    share = ca.fmin(1, (attempt + 1) / 4)
    fresh = (1 - share) * wanted + share * (low + (high - low) * (place - ca.floor(place)))
    following = ca.if_else(again, fresh, ca.fmin(ca.fmax(q + move, lower), upper))
    going = ca.logic_not(ca.logic_or(solved, ca.logic_and(lost, ca.logic_not(again))))
    counts = ca.if_else(again, ca.vertcat(0, 0, attempt + 1), ca.vertcat(steps + 1, small, attempt))
    function = ca.Function(
        f"ik_descent_{width}",
        [state, target, wanted, lower, upper, low, high, settings],
        [ca.densify(ca.if_else(going, ca.vertcat(following, counts), state)), going, size],
        ["state", "target", "wanted", "lower", "upper", "low", "high", "settings"],
        ["next", "going", "error"],
    )
    return deferred_call(function, MOST_TOTAL_STEPS, alike=False)


PULL_ERROR = 0.1  # scaled error below which steps also move towards wanted joints


def _step(
    slope: ca.SX, error: ca.SX, damping: ca.SX, missing: ca.SX, sought: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Return the step, and the size of its null-space part, 0 unless ``sought``.

    With fewer equations than joints the smaller normal equations are solved:
    (J J^T + lambda I) y = e - J b, step = J^T y + b. The null-space part b moves towards the
    wanted joints, which are ``missing`` [n] away, while it is ``sought``.
    """
    rows, count = slope.shape
    if rows >= count:
        matrix = slope.T @ slope + damping * ca.SX.eye(count)
        return solve_symmetric(matrix, ca.densify(slope.T @ error)), ca.SX(0)
    # Far from the target the pull would fight the task, so it grows only as the error falls.
    share = sought / (1 + ca.dot(error, error) / PULL_ERROR**2)
    beside = missing * share * ca.fmin(1, 1 / (ca.norm_2(missing) + TINY))
    matrix = slope @ slope.T + damping * ca.SX.eye(rows)
    move = slope.T @ solve_symmetric(matrix, error - slope @ beside) + beside
    return move, ca.if_else(sought, ca.norm_inf(move), 0)


@lru_cache(maxsize=64)
def pose_of(robot: Robot) -> FastCall:
    """Return ``(q[n] or [N,n]) -> T[4,4] or [N,4,4]``, tool in base."""
    return deferred_call(forward_kinematics(robot), alike=False)


def scaled_jacobian(robot: Robot, q: FloatArray, width: int) -> FloatArray:
    """Return Jacobians [N,m,n] of the task (m = 3 or 6), scaled by reach and joint units."""
    full = deferred_call(jacobian(robot), alike=False)(q)
    full = full.reshape(len(q), 6, robot.joint_count) * joint_scale(robot)
    full[:, :3] /= reach(robot)
    return full[:, :3] if width == 3 else full


@lru_cache(maxsize=64)
def generic_rank(robot: Robot, width: int) -> int:
    """Return the rank of the task's Jacobian away from singularities."""
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (8, robot.joint_count))
    values = np.linalg.svd(scaled_jacobian(robot, q, width), compute_uv=False)
    return int((values > RANK_TOLERANCE * values[:, :1]).sum(axis=1).max())


@cached_in_thread(maxsize=64)
def nearest_pose_nlp(robot: Robot, width: int) -> ca.Function:
    """Return the NLP of the nearest pose: least squared distance and angle within joint limits.

    Its parameters are the target and the weight of the angle (0: position only).
    """
    q, target = ca.SX.sym("q", robot.joint_count), ca.SX.sym("target", width)
    weight = ca.SX.sym("weight")
    pose = forward_kinematics(robot)(q)
    cost = ca.sumsqr((target[:3] - pose[:3, 3]) / reach(robot))
    if width == 12:
        turn = ca.reshape(target[3:], 3, 3) @ pose[:3, :3].T
        # 3 - trace = 2 (1 - cos angle) is smooth and has its minimum at angle zero.
        cost += weight**2 * (3 - ca.trace(turn))
    program = {"x": q, "p": ca.vertcat(target, weight), "f": cost}
    return ipopt("nearest_pose", program, IPOPT_OPTIONS)


@cached_in_thread(maxsize=64)
def nearest_joints_nlp(robot: Robot, width: int, rank: int) -> ca.Function:
    """Return the NLP of the nearest joints: on a continuum of solutions, within joint limits.

    Only ``rank`` combinations of the task's equations are constraints, those independent at the
    start; more would make the Jacobian of the constraints singular. Its parameters are target,
    wanted q [n], and combinations [rank,m] by columns.
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
    return ipopt("nearest_joints", program, IPOPT_OPTIONS)
