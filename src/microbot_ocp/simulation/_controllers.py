"""Joint controllers as frozen settings; each returns its torque as a CasADi expression.

A closed loop is therefore one differential equation, integrated by one call; see
:func:`microbot_ocp.track`. Sources: Craig, *Introduction to Robotics*, 3rd ed., chapter 10
(computed torque: sections 10.3 to 10.5); Siciliano et al., *Robotics: Modelling, Planning and
Control*, section 8.5 (PD with gravity compensation).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar, NamedTuple, Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.robot import JointLimits, Limits, Robot, gravity_torque, inverse_dynamics

Saturation = bool | ArrayLike | tuple[ArrayLike, ArrayLike] | Limits | JointLimits


class Reference(NamedTuple):
    """Reference position, velocity and acceleration at one instant, SX [n] each."""

    q: ca.SX
    qd: ca.SX
    qdd: ca.SX


class Controller(Protocol):
    """Interface of a controller for :func:`microbot_ocp.track`; any object with it may be used."""

    @property
    def label(self) -> str:
        """Short name, used in tables and legends."""
        ...

    def torque(self, model: Robot, reference: Reference, q: ca.SX, qd: ca.SX) -> ca.SX:
        """Return the torque SX [n] from model, reference and measured state."""
        ...


@dataclass(frozen=True, eq=False)
class ComputedTorque:
    """Computed-torque control: inverse dynamics of the model at a corrected acceleration.

    ``tau = M(q) (qdd_d + kv (qd_d - qd) + kp (q_d - q)) + C(q, qd) qd + g(q)`` (Craig, section
    10.4). With an exact model the error of every joint obeys ``e'' + kv e' + kp e = 0``.

    Parameters
    ----------
    kp : float or array_like [n]
        Position gains, 1/s^2, above zero.
    kv : float or array_like [n], optional
        Velocity gains, 1/s, above zero; default ``2 sqrt(kp)``, critically damped.

    Raises
    ------
    InputError
        A gain is not above zero.

    Examples
    --------
    >>> ComputedTorque(kp=100.0).kv.tolist()
    [20.0]
    """

    kp: ArrayLike
    kv: ArrayLike | None = None
    label: ClassVar[str] = "computed torque"

    def __post_init__(self) -> None:
        kp = _vector("kp", self.kp, "1/s^2", above=0.0)
        kv = 2.0 * np.sqrt(kp) if self.kv is None else _vector("kv", self.kv, "1/s", above=0.0)
        object.__setattr__(self, "kp", kp)
        object.__setattr__(self, "kv", kv)

    def torque(self, model: Robot, reference: Reference, q: ca.SX, qd: ca.SX) -> ca.SX:
        """Return the torque SX [n], N m (N)."""
        pull = _per_joint("kp", self.kp, model) * (reference.q - q)
        damping = _per_joint("kv", self.kv, model) * (reference.qd - qd)
        return inverse_dynamics(model)(q, qd, reference.qdd + damping + pull)


@dataclass(frozen=True, eq=False)
class PDGravity:
    """Proportional-derivative control of every joint with gravity compensation.

    ``tau = kp (q_d - q) + kv (qd_d - qd) + g(q)`` (Siciliano et al., section 8.5.1).

    Parameters
    ----------
    kp : float or array_like [n]
        Stiffnesses, N m/rad (N/m), above zero.
    kv : float or array_like [n]
        Damping, N m s/rad (N s/m), above zero.

    Raises
    ------
    InputError
        A gain is not above zero.
    """

    kp: ArrayLike
    kv: ArrayLike
    label: ClassVar[str] = "PD + gravity"

    def __post_init__(self) -> None:
        object.__setattr__(self, "kp", _vector("kp", self.kp, "N m/rad", above=0.0))
        object.__setattr__(self, "kv", _vector("kv", self.kv, "N m s/rad", above=0.0))

    def torque(self, model: Robot, reference: Reference, q: ca.SX, qd: ca.SX) -> ca.SX:
        """Return the torque SX [n], N m (N)."""
        spring = _per_joint("kp", self.kp, model) * (reference.q - q)
        damper = _per_joint("kv", self.kv, model) * (reference.qd - qd)
        return spring + damper + gravity_torque(model)(q)


@dataclass(frozen=True, eq=False)
class Feedforward:
    """Feedforward: the model's torque for the reference, without feedback."""

    label: ClassVar[str] = "feedforward only"

    def torque(self, model: Robot, reference: Reference, q: ca.SX, qd: ca.SX) -> ca.SX:
        """Return the torque SX [n], N m (N)."""
        return inverse_dynamics(model)(*reference)


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """White Gaussian noise on the measurements of a sampled controller, fixed by its seed.

    Parameters
    ----------
    q, qd : float or array_like [n]
        Standard deviations of the measured position, rad (m), and velocity, rad/s (m/s).
    seed : int
        Seed of numpy's default generator, at least 0.
    """

    q: ArrayLike = 0.0
    qd: ArrayLike = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name, unit in (("q", "rad"), ("qd", "rad/s")):
            spread = _vector(f"noise {name}", getattr(self, name), unit, at_least=0.0)
            object.__setattr__(self, name, spread)
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or self.seed < 0:
            raise InputError(f"seed must be a whole number of at least 0, not {self.seed!r}")

    def draw(self, rows: int, joints: int) -> FloatArray:
        """Return errors [rows, 2 joints] of the measured positions and velocities."""
        spread = [widened(f"noise {k}", getattr(self, k), joints) for k in ("q", "qd")]
        normal = np.random.default_rng(self.seed).normal(size=(rows, 2 * joints))
        return normal * np.concatenate(spread)


# The gains of these controllers are inputs of the loop, so one compiled loop serves all gains.
GAINS: dict[type, tuple[str, ...]] = {
    kind: tuple(field.name for field in fields(kind))
    for kind in (ComputedTorque, PDGravity, Feedforward)
}


def gains_of(controller: Controller, joints: int) -> FloatArray:
    """Return all gains of a controller listed in ``GAINS`` as one vector."""
    names = GAINS[type(controller)]
    return np.concatenate([[], *(widened(k, getattr(controller, k), joints) for k in names)])


def with_gains(kind: type, gains: ca.SX, joints: int) -> Controller:
    """Return a controller whose gains are expressions."""
    controller = object.__new__(kind)
    for name, values in zip(GAINS[kind], ca.vertsplit(gains, joints), strict=False):
        object.__setattr__(controller, name, values)
    return controller


def saturate(tau: ca.SX, lower: FloatArray, upper: FloatArray) -> ca.SX:
    """Return the torque SX [n] limited to [lower, upper]; infinite limits add no operation."""
    for bound, cut in ((lower, ca.fmax), (upper, ca.fmin)):
        limited = np.isfinite(bound)
        if limited.any():
            entries = [cut(tau[j], bound[j]) if limited[j] else tau[j] for j in range(bound.size)]
            tau = ca.vertcat(*entries)
    return tau


def torque_limits(saturation: Saturation, robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper torque [n] of a ``saturation`` argument; True means the robot's."""
    if isinstance(saturation, bool):
        none = np.full(robot.joint_count, np.inf)
        return robot.limits.bounds("tau") if saturation else (-none, none)
    if not isinstance(saturation, Limits | JointLimits):
        saturation = Limits(tau_max=saturation)
    return saturation.for_joints(robot.joint_count).bounds("tau")


def widened(name: str, value: ArrayLike, count: int) -> FloatArray:
    """Return a vector [1] or [count] as an array [count]."""
    vector = np.asarray(value, dtype=float)
    if vector.size not in (1, count):
        raise InputError(f"{name} has {vector.size} entries for {count} joints")
    return np.broadcast_to(vector, (count,))


def _vector(name: str, value: ArrayLike, unit: str, **bound: float) -> FloatArray:
    if np.ndim(np.asarray(value, dtype=object)) == 0:
        value = [value]  # type: ignore[list-item]
    vector = checks.array(name, value, (None,), unit)
    if vector.size == 0:
        raise InputError(f"{name} must hold at least one value")
    for joint, entry in enumerate(vector):
        of_joint = f" of joint {joint + 1}" if vector.size > 1 else ""
        checks.number(f"{name}{of_joint}", float(entry), unit, **bound)
    return vector


def _per_joint(name: str, value: ArrayLike | None, model: Robot) -> ca.DM | ca.SX:
    assert value is not None  # set by the constructor
    if isinstance(value, ca.SX):
        return value
    return ca.DM(widened(name, value, model.joint_count))
