"""Dry friction at reversals of a joint: both of its torques are kept within the limits.

At a reversal the torque jumps by twice the friction within milliseconds, unseen between two mesh
points. Near a reversal the limits therefore hold with the friction of both directions. Near means:
the velocity is below the joint's change of velocity until the next check of limits. This window,
and the cost of the caution, shrink with the mesh. Its edges are smooth for Newton's method, so that
a part of the friction is missed; the certificate checks the exact torque.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Sized
from dataclasses import replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.outcome import Advice
from microbot_ocp.limits import LimitFamily
from microbot_ocp.ocp import Phase, PhaseSolution, Solution
from microbot_ocp.ocp.transcription import Guess, Meshes, Transcription, mesh_of
from microbot_ocp.robot import COULOMB_SMOOTHING, Robot

WINDOW, SMOOTHING = "friction window", "friction smoothing"  # names of phase parameters


WINDOW_REACH = 0.3  # width of a window, share of the interval
COARSE_SMOOTHING = 0.2  # smoothing on coarse meshes, share of the typical velocity

LEAST_REACH = 0.1 * COULOMB_SMOOTHING  # rad/s
LEAST_REVERSAL = 2.0 * COULOMB_SMOOTHING  # smallest change of velocity of a reversal, rad/s


VISCOUS, DRY = "viscous_friction", "coulomb_friction"  # fields of a link


def dry_friction(robot: Robot) -> FloatArray:
    """Return the dry friction [n] of the joints, N m (N); zero without masses."""
    return robot.friction_of(DRY)


def has_windows(family: LimitFamily) -> bool:
    """Return True if torques or torque rates of joints with dry friction are limited."""
    return bool(dry_friction(family.robot).any()) and bool({"tau", "taud"} & set(family.keys))


@lru_cache(maxsize=64)
def frictionless(robot: Robot, kinds: tuple[str, ...] = (VISCOUS, DRY)) -> Robot:
    """Return the robot with joints without these kinds of friction."""
    if not any(robot.friction_of(kind).any() for kind in kinds):
        return robot
    return robot.with_links([replace(link, **dict.fromkeys(kinds, 0.0)) for link in robot.links])


def without_dry_friction(robot: Robot) -> Robot:
    """Return the robot with joints without dry friction."""
    return frictionless(robot, (DRY,))


# Width of the smooth edge of a window, share of the reach. In the middle half falls short of the
# friction by 0.1 %; with an edge of 0.5, by 1.3 %, which torque limits notice.
EDGE_WIDTH = 0.3
MOST_FRICTION = 0.9  # dry friction up to which limits are tightened, share of a torque limit


def windowed_torques(
    phase: Phase,
    robot: Robot,
    state: Sequence[ca.MX],
    torques: Callable[..., Any],
    held: Sequence[ca.MX] = (),
) -> tuple[dict[str, ca.MX], ca.MX]:
    """Return the torque and torque rate to be limited, by key, and the torque itself.

    Parameters
    ----------
    phase : Phase
        Phase that receives the parameters of the window.
    robot : Robot
    state : sequence of MX
        Expressions q, qd, qdd and qddd [n].
    torques : callable
        Torque and torque rate without dry friction, of the state and of ``held``.
    held : sequence of MX
        Further arguments of ``torques``.
    """
    _, qd, qdd, _ = state
    window, smoothing = phase.parameter(WINDOW, 0.0), phase.parameter(SMOOTHING, COULOMB_SMOOTHING)
    tau, taud = torques(*state, *held)
    at_drives, whole = torque_at_drives(robot, tau, qd, qdd, window, smoothing)
    torque_values = {"tau": at_drives}
    if taud is not None:
        torque_values["taud"] = taud + friction_rate(robot, qd, qdd, smoothing)
    return torque_values, tau + whole


def torque_at_drives(
    robot: Robot, tau: Any, qd: Any, qdd: Any, window: Any, smoothing: Any
) -> tuple[Any, Any]:
    """Return the torque [n] to be limited, and the dry friction [n].

    In the window, limits L about a middle M apply to ``M + (tau - M) / (1 - half / L)``: ``tau`` is
    the mean of the torques of both directions, ``half`` half of their difference. This keeps both
    within L, with constant bounds.

    Parameters
    ----------
    robot : Robot
    tau : expression [n]
        Torque without dry friction.
    qd, qdd : expressions [n]
    window : expression
        Time until the next check of limits, s.
    smoothing : expression
        Velocity within which the friction changes its sign, rad/s (m/s).
    """
    size = dry_friction(robot)
    # The joint changes its velocity by |qdd| * window until the next check of limits. The root
    # keeps a slope at qdd = 0. Outside of the window ahead = behind = sign(qd); inside ahead = 1
    # and behind = -1, so that half is the friction and the mean torque is free of it.
    near = ca.sqrt((qdd * window) ** 2 + LEAST_REACH**2)
    width = smoothing + EDGE_WIDTH * near
    far = (1.0 + EDGE_WIDTH**2) * near
    ahead, behind = ca.tanh((qd + far) / width), ca.tanh((qd - far) / width)
    bounds = robot.limits.bounds("tau")
    drawn = np.isfinite(bounds).all(axis=0) & (size < MOST_FRICTION * 0.5 * (bounds[1] - bounds[0]))
    low, high = (np.where(drawn, bound, sign) for bound, sign in zip(bounds, (-1, 1), strict=True))
    middle, range_ = ca.DM(0.5 * (low + high)), ca.DM(0.5 * (high - low))
    mean = tau + ca.DM(np.where(drawn, 0.5 * size, 0.0)) * (ahead + behind)
    half = ca.DM(np.where(drawn, 0.5 * size, 0.0)) * (ahead - behind)
    whole = ca.DM(size) * ca.tanh(qd / smoothing)
    at_drives = middle + (mean - middle) / (1.0 - half / range_)
    return at_drives + ca.DM(np.where(drawn, 0.0, 1.0)) * whole, whole


def friction_rate(robot: Robot, qd: Any, qdd: Any, smoothing: Any) -> Any:
    """Return the rate [n] of the dry friction, N m/s (N/s)."""
    return ca.DM(dry_friction(robot)) / smoothing * (1.0 - ca.tanh(qd / smoothing) ** 2) * qdd


def reversals(velocity: FloatArray, joints: np.ndarray) -> np.ndarray:
    """Return a mask of intervals [N] in which a given joint reverses, starts or stops.

    ``velocity`` [N+1,n] holds values at mesh points.
    """
    speeds = velocity[:, joints]
    turns = (speeds[:-1] * speeds[1:] <= 0.0) & (np.abs(np.diff(speeds, axis=0)) > LEAST_REVERSAL)
    return np.any(turns, axis=1)


def rates_at_reversals(family: LimitFamily, solution: Solution) -> tuple[Advice, ...]:
    """Return advice on joints with a torque rate limit at reversals with dry friction."""
    if "taud" not in family:
        return ()
    robot: Robot = family.robot
    limited = np.isfinite(robot.limits.taud_max) | np.isfinite(robot.limits.taud_min)
    turning = [
        name
        for joint, name in enumerate(robot.joint_names)
        if limited[joint]
        and dry_friction(robot)[joint] > 0.0
        and any(reversals(p["qd"], np.array([joint])).any() for p in solution.phases)
    ]
    if not turning:
        return ()
    names = ", ".join(turning)
    sentence = (
        f"Where {names} turns back dry friction lets the torque jump: its rate is limited at mesh "
        "points only, so look at the certificate."
    )
    return (Advice("friction", sentence, names),)


def with_windows(
    joints: np.ndarray,
    transcription: Transcription,
    meshes: Meshes,
    start: Mapping[str, Guess] | Solution,
) -> Transcription:
    """Return kernels with windows, s, that fit the intervals in which joints reverse.

    Parameters
    ----------
    joints : array of bool [n]
        Mask of the joints with dry friction.
    transcription : Transcription
    meshes : Meshes
        Meshes of all phases.
    start : mapping or Solution
        Start of the solve.
    """
    names = [phase.name for phase in transcription.problem.phases]
    given = list(meshes) if isinstance(meshes, Sized) else [meshes] * len(names)
    values = {}
    for name, phase_mesh in zip(names, given, strict=True):
        mesh = mesh_of(phase_mesh)
        if isinstance(start, Solution):
            before = start[name]
            duration = before.duration
            if np.array_equal(before.mesh, mesh):
                values[name] = {WINDOW: _window_of(before)}
                continue
            columns = (np.interp(mesh, before.mesh, column) for column in before["qd"].T)
            velocity = np.column_stack(list(columns))
        else:
            guess, duration = start[name].values["qd"], float(start[name].duration or 1.0)
            velocity = np.asarray(guess(mesh)) if callable(guess) else np.asarray(guess)
        steps = np.diff(mesh)
        # The window fits the longest interval with a reversal, or else the shortest interval.
        spans = steps[reversals(velocity, joints)]
        span = duration * float(spans.max() if spans.size else steps.min())
        values[name] = {WINDOW: WINDOW_REACH * span}
    return transcription.with_parameters(values)


def _window_of(phase: PhaseSolution) -> float:
    assert phase.layout is not None
    windows = (p.value[0] for p in phase.layout.phase.parameters if p.name == WINDOW)
    return float(next(windows, 0.0))


def rounded(transcription: Transcription, velocity: FloatArray) -> Transcription:
    """Return kernels with friction rounded off for coarse meshes, by typical velocities [n]."""
    smoothing = max(COULOMB_SMOOTHING, COARSE_SMOOTHING * float(velocity.min()))
    names = [phase.name for phase in transcription.problem.phases]
    return transcription.with_parameters({name: {SMOOTHING: smoothing} for name in names})
