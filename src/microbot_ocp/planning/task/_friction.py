"""Dry friction where a joint turns back: both of its torques are kept within the limits.

There the torque jumps by twice the friction within milliseconds, unseen between two points of a
mesh. So near a reversal, where the velocity is less than the joint gains until the next point at
which limits are looked at, the limits hold with the friction of both directions. That window
shrinks with the mesh, and with it what the caution costs. Its edges are smooth, for the sake of
Newton's method, and let a part of the friction pass; the certificate sees to the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Sized
from dataclasses import dataclass, replace
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

WINDOW, SMOOTHING = "friction window", "friction smoothing"  # parameters of a phase


@dataclass(frozen=True)
class FrictionWindows:
    """Settings of the windows in which dry friction turns over.

    Attributes
    ----------
    reach : of a window, as a share of the interval
    spread : of the reach by which the jump is smoothed over: Newton's method needs it
    most : share of a torque limit that friction may take for its limits to be drawn in
    rounded : of the typical velocity: smoothing on coarse meshes
    """

    reach: float = 0.3
    spread: float = 0.5
    most: float = 0.9
    rounded: float = 0.2


FRICTION_WINDOWS = FrictionWindows()

LEAST_REACH = 0.1 * COULOMB_SMOOTHING  # rad/s
MOVES = 2.0 * COULOMB_SMOOTHING  # change of a velocity within an interval that is a reversal


VISCOUS, DRY = "viscous_friction", "coulomb_friction"  # of a link


def friction(robot: Robot, kind: str) -> FloatArray:
    """Return sizes [n] of one kind of friction, SI; zero without masses."""
    return robot.friction_of(kind)


def dry_friction(robot: Robot) -> FloatArray:
    """Return sizes [n] of dry friction, N m (N); zero without masses."""
    return friction(robot, DRY)


def has_windows(family: LimitFamily) -> bool:
    """Return whether torques of joints with dry friction are limited."""
    return bool(dry_friction(family.robot).any()) and bool({"tau", "taud"} & set(family.keys))


@lru_cache(maxsize=64)
def frictionless(robot: Robot, kinds: tuple[str, ...] = (VISCOUS, DRY)) -> Robot:
    """Return the same robot, its joints without friction of these kinds."""
    if not any(friction(robot, kind).any() for kind in kinds):
        return robot
    return robot.with_links([replace(link, **dict.fromkeys(kinds, 0.0)) for link in robot.links])


def without_dry_friction(robot: Robot) -> Robot:
    """Return the same robot, its joints without dry friction."""
    return frictionless(robot, (DRY,))


def kept_torques(
    phase: Phase,
    robot: Robot,
    state: Sequence[ca.MX],
    torques: Callable[..., Any],
    held: Sequence[ca.MX] = (),
) -> tuple[dict[str, ca.MX], ca.MX]:
    """Return the torque and torque rate to be limited, by key, and the torque itself.

    With friction within the window, limits L about a middle M are kept in the form
    ``M + (tau - M) / (1 - half / L)``, where ``tau`` is the mean of the two torques there and
    ``half`` half of their difference.

    Parameters
    ----------
    phase : Phase
        Gets the parameters that say how wide the window is.
    robot : Robot
    state : q, qd, qdd and qddd as expressions [n]
    torques : callable
        Torque and torque rate without dry friction, of the state (and of ``held``).
    held : further arguments of ``torques``
    """
    size = dry_friction(robot)
    _, qd, qdd, _ = state
    window, smoothing = phase.parameter(WINDOW, 0.0), phase.parameter(SMOOTHING, COULOMB_SMOOTHING)
    near = ca.sqrt((qdd * window * phase.duration) ** 2 + LEAST_REACH**2)
    width = smoothing + FRICTION_WINDOWS.spread * near
    far = (1.0 + FRICTION_WINDOWS.spread**2) * near
    ahead, behind = ca.tanh((qd + far) / width), ca.tanh((qd - far) / width)
    tau, taud = torques(*state, *held)
    bounds = robot.limits.bounds("tau")
    drawn = np.isfinite(bounds).all(axis=0) & (
        size < FRICTION_WINDOWS.most * 0.5 * (bounds[1] - bounds[0])
    )
    low, high = (np.where(drawn, bound, sign) for bound, sign in zip(bounds, (-1, 1), strict=True))
    middle, range_ = ca.DM(0.5 * (low + high)), ca.DM(0.5 * (high - low))
    mean = tau + ca.DM(np.where(drawn, 0.5 * size, 0.0)) * (ahead + behind)
    half = ca.DM(np.where(drawn, 0.5 * size, 0.0)) * (ahead - behind)
    values_at_drives = middle + (mean - middle) / (1.0 - half / range_)
    whole = ca.DM(size) * ca.tanh(qd / smoothing)
    torque_values = {"tau": values_at_drives + ca.DM(np.where(drawn, 0.0, 1.0)) * whole}
    if taud is not None:
        slope = ca.DM(size) / smoothing * (1.0 - ca.tanh(qd / smoothing) ** 2)
        torque_values["taud"] = taud + slope * qdd
    return torque_values, tau + whole


def reversals(velocity: FloatArray, joints: np.ndarray) -> np.ndarray:
    """Return intervals [N] inside which one of these joints turns back, starts or stops.

    From velocities [N+1,n].
    """
    speeds = velocity[:, joints]
    turns = (speeds[:-1] * speeds[1:] <= 0.0) & (np.abs(np.diff(speeds, axis=0)) > MOVES)
    return np.any(turns, axis=1)


def rates_at_reversals(family: LimitFamily, solution: Solution) -> tuple[Advice, ...]:
    """Return advice on joints whose torque rate is limited where dry friction lets the torque
    jump.
    """
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
    """Return kernels whose windows fit those intervals of a mesh inside which joints turn back.

    Parameters
    ----------
    joints : which joints [n] have dry friction
    transcription : Transcription
    meshes : of all phases
    start : from where the solve starts
    """
    names = [phase.name for phase in transcription.problem.phases]
    given = list(meshes) if isinstance(meshes, Sized) else [meshes] * len(names)
    values = {}
    for name, phase_mesh in zip(names, given, strict=True):
        mesh = mesh_of(phase_mesh)
        if isinstance(start, Solution):
            before = start[name]
            if np.array_equal(before.mesh, mesh):
                values[name] = {WINDOW: _window_of(before)}
                continue
            columns = (np.interp(mesh, before.mesh, column) for column in before["qd"].T)
            velocity = np.column_stack(list(columns))
        else:
            guess = start[name].values["qd"]
            velocity = np.asarray(guess(mesh)) if callable(guess) else np.asarray(guess)
        steps = np.diff(mesh)
        spans = steps[reversals(velocity, joints)]
        values[name] = {
            WINDOW: FRICTION_WINDOWS.reach * float(spans.max() if spans.size else steps.min())
        }
    return transcription.with_parameters(values)


def _window_of(phase: PhaseSolution) -> float:
    assert phase.layout is not None
    windows = (p.value[0] for p in phase.layout.phase.parameters if p.name == WINDOW)
    return float(next(windows, 0.0))


def rounded(transcription: Transcription, velocity: FloatArray) -> Transcription:
    """Return kernels with friction rounded off as coarse meshes need it, for typical velocities
    [n].
    """
    smoothing = max(COULOMB_SMOOTHING, FRICTION_WINDOWS.rounded * float(velocity.min()))
    names = [phase.name for phase in transcription.problem.phases]
    return transcription.with_parameters({name: {SMOOTHING: smoothing} for name in names})
