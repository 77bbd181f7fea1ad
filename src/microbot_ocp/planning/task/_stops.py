"""Stops of a task: pose, tolerance, velocity and payload of the arm.

The conditions at the via points of a free motion follow at the end of the module.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, naming
from microbot_ocp.robot import Capsule, Link, Robot, checked_rotations, forward_kinematics

AXES = ("x", "y", "z")
SHAPE = ("start", "end", "radius", "name")  # fields of a part's capsule


EXACT_TOLERANCE = 1e-6  # largest tolerance that counts as zero, rad (m)

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Payload:
    """Payload of the tool.

    Parameters
    ----------
    mass : float
        Mass, kg; 0 for an empty tool.
    center_of_mass : array_like [3]
        Centre of mass in the tool frame, m.
    inertia : array_like [3,3], optional
        Inertia about the centre of mass, along the axes of the tool frame, kg m^2; a point mass by
        default.
    shape : Capsule, mapping or sequence of them, optional
        Capsules around the part in the tool frame, m, or their fields ``start``, ``end``,
        ``radius`` and ``name`` ("part" by default). Among obstacles the part keeps clear from this
        stop on. Allowed contacts are pairs in the scene's ``ignore``: ``[("part", "table")]``.

    Raises
    ------
    InputError
        A negative mass, numbers that are not finite, or an inertia that no body has.
    """

    mass: float
    center_of_mass: Any = (0.0, 0.0, 0.0)
    inertia: Any = None
    shape: Any = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", _capsules(self.shape))
        checks.number("mass of the payload", self.mass, "kg", at_least=0.0)
        center = checks.array("center_of_mass of the payload", self.center_of_mass, (3,), "m")
        object.__setattr__(self, "center_of_mass", tuple(center.tolist()))
        if self.inertia is not None:
            held = Link(self.mass, center, self.inertia, name="payload")
            object.__setattr__(self, "inertia", tuple(map(tuple, held.inertia.tolist())))

    def on(self, robot: Robot) -> Robot:
        """Return the robot with this payload in its tool."""
        if self.mass:
            robot = robot.with_payload(self.mass, self.center_of_mass, self.inertia)
        return robot.with_part(*self.shape) if self.shape and robot.capsules else robot


POSE_JOINTS = 6  # smallest number of joints that can hold any orientation
LONGEST_DWELL = 86_400.0  # longest dwell, s: a day


@dataclass(frozen=True)
class Stop:
    """A stop of the arm: a joint pose, a tool position or a tool pose.

    Parameters
    ----------
    q : array_like [n], optional
        Joint positions, rad (prismatic: m); excludes ``position``.
    position : array_like [3], optional
        Position of the tool's origin in the base frame, m.
    orientation : array_like [3,3], optional
        Rotation of the tool in the base frame; without it any orientation is allowed.
    tolerance : float or array_like
        Allowed distance from the pose. A number is the radius of a ball: of the tool's origin, m,
        at most a tenth of the reach, or of the joints, rad. An array is a box with one half width
        per coordinate (base frame) or joint; an infinite one leaves the coordinate free.
    orientation_tolerance : float
        Largest angle to the orientation, rad.
    free_turn : str, optional
        "x", "y" or "z": axis of the tool about which any turn is allowed.
    velocity : str or array_like, optional
        "rest", "any", or a velocity: of the joints [n], rad/s, for a stop with ``q``, otherwise of
        the tool's origin [3] in the base frame, m/s. Default: rest at the ends of a task and at
        stops with a dwell or a new payload, any velocity elsewhere. Under limits of the torque rate
        or the jerk the arm rests without acceleration. At the ends of a moving start or goal the
        acceleration is free unless it is given.
    acceleration : array_like [n], optional
        Joint accelerations at a stop with ``q`` and ``velocity``, rad/s^2. They apply under limits
        of the torque rate or the jerk; without such limits the acceleration may jump.
    dwell : float
        Time of rest at the stop, s; at most a day.
    payload : Payload or float, optional
        Payload from this stop on; a number is a point mass at the tool's origin, kg. Default: the
        payload before the stop.
    blend : float
        Distance from a corner between two tool lines within which it is cut, m. The arm passes the
        stop itself only if the lines continue straight.
    name : str
        Name in messages, marks and tables; default "stop 1" and so on.

    Raises
    ------
    InputError
        Neither or both of ``q`` and ``position``, wrong shapes, a matrix that is no rotation, or a
        dwell at a velocity.

    Examples
    --------
    >>> stop = Stop(position=[0.4, 0.2, 0.3], tolerance=0.01, dwell=0.5, payload=2.0, name="pick")
    >>> stop.payload.mass, stop.tolerance
    (2.0, 0.01)
    """

    q: Any = None
    position: Any = None
    orientation: Any = None
    tolerance: Any = 0.0
    orientation_tolerance: float = 0.0
    free_turn: str | None = None
    velocity: Any = None
    acceleration: Any = None
    dwell: float = 0.0
    payload: Any = None
    blend: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        put = object.__setattr__
        where = f"stop {self.name!r}" if self.name else "a stop"
        if (self.q is None) == (self.position is None):
            both_or_neither = "neither" if self.q is None else "both"
            raise InputError(f"{where} must have a q or a position, not {both_or_neither}")
        for key, shape, unit in (("q", (None,), "rad"), ("position", (3,), "m")):
            if getattr(self, key) is not None:
                given = checks.array(f"{key} of {where}", getattr(self, key), shape, unit)
                put(self, key, tuple(given.tolist()))
        if self.q is not None and (
            self.orientation is not None or self.free_turn or self.orientation_tolerance
        ):
            raise InputError(f"{where} is a joint pose: an orientation is of a tool position")
        if self.orientation is not None:
            put(self, "orientation", _rotation(f"orientation of {where}", self.orientation))
        elif self.free_turn or self.orientation_tolerance:
            raise InputError(f"{where} has no orientation of which a turn could be free")
        if self.free_turn is not None:
            checks.one_of(f"free_turn of {where}", self.free_turn, AXES)
        put(self, "tolerance", self._checked_tolerance(where))
        sizes = {"orientation_tolerance": ("rad", 1.5), "dwell": ("s", LONGEST_DWELL)}
        for key, (unit, most) in {**sizes, "blend": ("m", None)}.items():
            checks.number(f"{key} of {where}", getattr(self, key), unit, at_least=0.0, at_most=most)
        if self.payload is not None and not isinstance(self.payload, Payload):
            with naming(f"{where}: "):
                put(self, "payload", Payload(self.payload))
        self._check_velocity(where)

    def _checked_tolerance(self, where: str) -> Any:
        size = 3 if self.q is None else len(self.q)
        if checks.numbers(f"tolerance of {where}", self.tolerance).ndim == 0:
            return checks.number(f"tolerance of {where}", self.tolerance, at_least=0.0)
        given = checks.array(f"tolerance of {where}", self.tolerance, (size,), finite=False)
        if np.any(np.isnan(given)) or np.any(given < 0):
            raise InputError(f"tolerance of {where} must be at least 0, not {given.tolist()}")
        return tuple(given.tolist())

    def _check_velocity(self, where: str) -> None:
        rests = bool(self.dwell)
        if self.velocity is None or isinstance(self.velocity, str):
            if self.velocity is not None:
                checks.one_of(f"velocity of {where}", self.velocity, ("rest", "any"))
            moves = self.velocity == "any"
        else:
            size = 3 if self.q is None else len(self.q)
            given = checks.array(f"velocity of {where}", self.velocity, (size,))
            object.__setattr__(self, "velocity", tuple(given.tolist()))
            moves = bool(np.any(given))
        if self.acceleration is not None:
            if self.q is None or not isinstance(self.velocity, tuple):
                raise InputError(f"{where} has an acceleration: it needs a q and a velocity, too")
            given = checks.array(
                f"acceleration of {where}", self.acceleration, (len(self.q),), "rad/s^2"
            )
            object.__setattr__(self, "acceleration", tuple(given.tolist()))
        if rests and moves:
            raise InputError(f"{where} has a dwell of {self.dwell:g} s, so it is at rest there")
        if self.blend and (rests or self.payload is not None or self.velocity is not None):
            raise InputError(f"{where} is a blended corner: no dwell, payload or velocity there")

    @property
    def free_axis(self) -> int | None:
        """Index of the tool's axis about which any turn is allowed, or None."""
        return None if self.free_turn is None else AXES.index(self.free_turn)

    @property
    def box(self) -> FloatArray | None:
        """Half widths of the tolerance per coordinate or joint; None for a ball."""
        if isinstance(self.tolerance, tuple):
            return np.array(self.tolerance)
        # A scalar tolerance is a ball, except zero, which is a box without width: equations instead
        # of a ball of radius zero, whose gradient vanishes.
        size = 3 if self.q is None else len(self.q)
        return np.zeros(size) if self.tolerance <= EXACT_TOLERANCE else None

    @property
    def slack(self) -> FloatArray:
        """Largest distance of every coordinate or joint from the middle of the tolerance."""
        return np.broadcast_to(np.array(self.tolerance), (3 if self.q is None else len(self.q),))

    def pose(self, robot: Robot) -> tuple[FloatArray, FloatArray | None]:
        """Return position [3], m, and rotation [3,3] of the tool in the middle of the tolerance.

        A joint pose has a rotation only for an arm of six or more joints, which can hold one.
        """
        if self.q is not None:
            tool = np.array(forward_kinematics(robot)(np.array(self.q)))
            holds = robot.joint_count >= POSE_JOINTS
            return tool[:3, 3], tool[:3, :3] if holds else None
        turned = None if self.orientation is None else np.array(self.orientation)
        return np.array(self.position), turned

    def named(self, name: str) -> Stop:
        """Return the stop with a name, unless it has one."""
        return self if self.name else replace(self, name=name)


def _capsules(given: Any) -> tuple[Capsule, ...]:
    """Return the capsules of a part's shape."""
    entries = given if isinstance(given, list | tuple) else (given,) if given is not None else ()
    capsules = []
    for entry in entries:
        if isinstance(entry, Mapping):
            for key in entry:
                checks.one_of("key of the shape of the payload", key, SHAPE)
            for key in SHAPE[:3]:
                if key not in entry:
                    raise InputError(f"{key} of the shape of the payload is missing")
            entry = Capsule(**entry)
        if not isinstance(entry, Capsule):
            raise InputError(
                f"shape of the payload must be made of mo.Capsule, not {checks.shown(entry)}"
            )
        capsules.append(entry if entry.name else replace(entry, name="part"))
    return tuple(capsules)


def _rotation(name: str, given: Any) -> tuple[Numbers, ...]:
    matrix = checked_rotations(name, checks.array(name, given, (3, 3)))
    return tuple(tuple(row) for row in matrix.tolist())


# conditions ---------------------------------------------------------------------------------------

Bounds = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class Row:
    """A condition on the state at a via point: ``expression(q, qd)`` [k] within bounds [k]."""

    name: str
    expression: Callable[[Any, Any], Any]
    bounds: Bounds


@dataclass(frozen=True)
class EndConditions:
    """Conditions at one via point.

    Attributes
    ----------
    q, qd : (lower, upper), each [n]
        Bounds; infinite for a free joint.
    rows : tuple of Row
        Further conditions.
    qdd : (lower, upper), each [n], optional
        Bounds of the acceleration; None leaves it free.
    acceleration_jumps : bool
        True if the acceleration may jump at the via point.
    """

    q: Bounds
    qd: Bounds
    rows: tuple[Row, ...] = ()
    qdd: Bounds | None = None
    acceleration_jumps: bool = False


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions of a whole motion.

    Attributes
    ----------
    robots : tuple of Robot, one per segment
        Robot with the limits of the segment.
    ends : tuple of EndConditions, one per via point
        Conditions at the via points.
    closed : tuple of str
        Keys of "q", "qd", "qdd" that return to their initial values.
    """

    robots: tuple[Robot, ...]
    ends: tuple[EndConditions, ...]
    closed: tuple[str, ...] = ()

    @property
    def velocities(self) -> FloatArray:
        """Velocities [m,n] at the via points; zero if they are not given."""
        bounds = [np.array(end.qd) for end in self.ends]
        return np.array([np.where(low == high, low, 0.0) for low, high in bounds])
