"""The robot as data: modified Denavit-Hartenberg rows, links, limits. Nothing symbolic here.

Frames follow Craig, *Introduction to Robotics*, 3rd ed., section 3.4: link frame i sits at joint i,
and ``T(i-1, i) = Rot_x(alpha_{i-1}) Trans_x(a_{i-1}) Rot_z(theta_i) Trans_z(d_i)``. The tool frame
follows the last link frame by a constant transform, and frame 0 of the rows follows the base frame
by another (the identity, unless a robot says otherwise).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError

JointType = Literal["revolute", "prismatic"]
LimitArgument = ArrayLike | tuple[ArrayLike, ArrayLike]

# Quantity name -> (unit for a revolute joint, unit for a prismatic joint).
LIMIT_UNITS: dict[str, tuple[str, str]] = {
    "q": ("rad", "m"),
    "qd": ("rad/s", "m/s"),
    "qdd": ("rad/s^2", "m/s^2"),
    "tau": ("N m", "N"),
    "taud": ("N m/s", "N/s"),
}


def dh_transform(alpha: float, a: float, d: float, theta: float) -> FloatArray:
    """Homogeneous transform [4,4] of one modified-DH row (Craig, equation 3.6)."""
    ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
    matrix = np.array(
        [
            [ct, -st, 0.0, a],
            [st * ca, ct * ca, -sa, -sa * d],
            [st * sa, ct * sa, ca, ca * d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    return matrix + 0.0  # no -0.0, which would be printed and written


def _point_mass() -> FloatArray:
    return np.zeros((3, 3))


def _identity() -> FloatArray:
    return _rigid_transform("base", None)


@dataclass(frozen=True, eq=False)
class Link:
    """One rigid link with what its joint carries.

    Parameters
    ----------
    mass : float
        Mass, kg, above zero.
    center_of_mass : array_like [3]
        Centre of mass in the link frame, m.
    inertia : array_like [3,3], optional
        Inertia tensor about the centre of mass in the link frame, kg m^2 (default: a point mass).
    armature : float
        Rotor inertia as seen at the joint, kg m^2 (kg for a prismatic joint).
    viscous_friction : float
        Joint friction proportional to speed, N m s/rad (N s/m).
    coulomb_friction : float
        Joint friction of constant size, N m (N); smoothed over 0.01 rad/s (m/s) around rest.
    name : str, optional
        Name of the link.

    Raises
    ------
    InputError
        Mass not above zero, an inertia that is not symmetric, not positive semi-definite or breaks
        the triangle inequality, negative friction, anything not finite.
    """

    mass: float
    center_of_mass: FloatArray
    inertia: FloatArray = field(default_factory=_point_mass)
    armature: float = 0.0
    viscous_friction: float = 0.0
    coulomb_friction: float = 0.0
    name: str | None = None

    def __post_init__(self) -> None:
        label = f"link {self.name!r}" if self.name else "link"
        put = object.__setattr__
        put(self, "mass", checks.number(f"mass of {label}", self.mass, "kg", above=0.0))
        put(
            self,
            "center_of_mass",
            checks.array(f"center_of_mass of {label}", self.center_of_mass, (3,), "m"),
        )
        inertia = checks.array(f"inertia of {label}", self.inertia, (3, 3), "kg m^2")
        _check_inertia(label, inertia)
        put(self, "inertia", inertia)
        for name, unit in (
            ("armature", "kg m^2"),
            ("viscous_friction", "N m s/rad"),
            ("coulomb_friction", "N m"),
        ):
            value = checks.number(f"{name} of {label}", getattr(self, name), unit, at_least=0.0)
            put(self, name, value)


def _check_inertia(label: str, inertia: FloatArray) -> None:
    size = max(float(np.abs(inertia).max()), 1e-12)
    if np.abs(inertia - inertia.T).max() > 1e-9 * size:
        raise InputError(f"inertia of {label} must be symmetric, not {inertia.tolist()} kg m^2")
    principal = np.linalg.eigvalsh(inertia)
    if principal[0] < -1e-9 * size:
        raise InputError(
            f"inertia of {label} must be positive semi-definite, but a principal moment is "
            f"{principal[0]:.6g} kg m^2"
        )
    if principal[0] + principal[1] < principal[2] - 1e-6 * size:
        raise InputError(
            f"inertia of {label} breaks the triangle inequality: principal moments "
            f"{principal[0]:.6g} + {principal[1]:.6g} < {principal[2]:.6g} kg m^2, which no "
            "rigid body has"
        )


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of every joint; whatever is not given is unlimited.

    Each argument is a scalar (all joints alike) or a list or array [n] (one value a joint).
    ``qd_max``, ``qdd_max``, ``tau_max`` and ``taud_max`` mean plus and minus, unless given as a
    tuple ``(lower, upper)`` of such, or with their ``qd_min`` and so on. A robot holds its limits
    as arrays [n]:
    ``robot.limits.q_min``, ``q_max``, ``qd_min``, ``qd_max``, ``qdd_min``, ... in rad, rad/s,
    rad/s^2, N m, N m/s (prismatic joints: m, m/s, m/s^2, N, N/s).

    Examples
    --------
    >>> limits = Limits(qd_max=2.0, tau_max=[400.0, 500.0, 200.0]).for_joints(3)
    >>> limits.tau_min.tolist()
    [-400.0, -500.0, -200.0]
    """

    q_min: LimitArgument = -np.inf
    q_max: LimitArgument = np.inf
    qd_max: LimitArgument = np.inf
    qdd_max: LimitArgument = np.inf
    tau_max: LimitArgument = np.inf
    taud_max: LimitArgument = np.inf
    qd_min: ArrayLike | None = None
    qdd_min: ArrayLike | None = None
    tau_min: ArrayLike | None = None
    taud_min: ArrayLike | None = None

    def for_joints(self, count: int) -> JointLimits:
        """Return the limits as arrays [count], checked.

        Raises
        ------
        InputError
            Wrong length, NaN, a lower limit above its upper one, or a rate or torque range
            without zero inside.
        """
        arrays: dict[str, FloatArray] = {}
        for quantity in LIMIT_UNITS:
            lower, upper = self._pair(quantity, count)
            arrays[f"{quantity}_min"], arrays[f"{quantity}_max"] = lower, upper
            unit = _either_unit(quantity)
            crossed = np.flatnonzero((lower > upper) | (lower == np.inf) | (upper == -np.inf))
            if crossed.size:
                j = crossed[0]
                raise InputError(
                    f"{quantity}_min of joint {j + 1} must be finite or -inf and at most its "
                    f"{quantity}_max of {upper[j]:g} {unit}, not {lower[j]:g}"
                )
            if quantity != "q":
                outside = np.flatnonzero((lower > 0) | (upper < 0))
                if outside.size:
                    j = outside[0]
                    raise InputError(
                        f"{quantity}_max of joint {j + 1} must leave room for zero, not "
                        f"[{lower[j]:g}, {upper[j]:g}] {unit} (a tuple means "
                        "(lower, upper); give one value a joint as a list)"
                    )
        return JointLimits(**arrays)

    def _pair(self, quantity: str, count: int) -> tuple[FloatArray, FloatArray]:
        name = f"{quantity}_max"
        if quantity == "q":
            for side, value in (("q_min", self.q_min), (name, self.q_max)):
                if isinstance(value, tuple):
                    raise InputError(
                        f"{side} must be a number or a list with one value a joint, not the tuple "
                        f"{value}: q_min and q_max are the pair"
                    )
            return _per_joint("q_min", self.q_min, count), _per_joint(name, self.q_max, count)
        value = getattr(self, name)
        explicit_lower = getattr(self, f"{quantity}_min")
        if isinstance(value, tuple):
            if len(value) != 2:
                raise InputError(
                    f"{name} as a tuple must be (lower, upper), not {len(value)} entries; give "
                    "one value a joint as a list"
                )
            if explicit_lower is not None:
                raise InputError(
                    f"{quantity}_min is given twice: as {explicit_lower!r} and in the tuple {name}"
                )
            return _per_joint(name, value[0], count), _per_joint(name, value[1], count)
        upper = _per_joint(name, value, count)
        if explicit_lower is not None:
            return _per_joint(f"{quantity}_min", explicit_lower, count), upper
        negative = np.flatnonzero(upper < 0)
        if negative.size:
            j = negative[0]
            raise InputError(
                f"{name} of joint {j + 1} must be at least 0 {_either_unit(quantity)}, "
                f"not {upper[j]:g}"
            )
        return -upper, upper


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of every joint as arrays [n], lower and upper; made by :meth:`Limits.for_joints`."""

    q_min: FloatArray
    q_max: FloatArray
    qd_min: FloatArray
    qd_max: FloatArray
    qdd_min: FloatArray
    qdd_max: FloatArray
    tau_min: FloatArray
    tau_max: FloatArray
    taud_min: FloatArray
    taud_max: FloatArray

    def bounds(self, quantity: str) -> tuple[FloatArray, FloatArray]:
        """Lower and upper arrays [n] of ``q``, ``qd``, ``qdd``, ``tau`` or ``taud``."""
        return getattr(self, f"{quantity}_min"), getattr(self, f"{quantity}_max")

    def for_joints(self, count: int) -> JointLimits:
        """Return itself, once the width is checked."""
        if self.q_min.shape != (count,):
            raise InputError(f"limits are for {self.q_min.size} joints, but the robot has {count}")
        return self

    def as_dict(self) -> dict[str, list[float]]:
        """Plain lists, for JSON and TOML."""
        return {f.name: getattr(self, f.name).tolist() for f in fields(self)}


def _changed(limits: JointLimits, changes: Mapping[str, Any]) -> Limits:
    """Limits with some replaced; of a pair that has a new upper one alone, both are new."""
    given: dict[str, Any] = {}
    for quantity in LIMIT_UNITS:
        low, high = f"{quantity}_min", f"{quantity}_max"
        lower, upper = limits.bounds(quantity)
        if quantity == "q" or low in changes:
            given[low], given[high] = changes.get(low, lower), changes.get(high, upper)
        else:
            given[high] = changes.get(high, (lower, upper))
    return Limits(**given)


def _per_joint(name: str, value: Any, count: int) -> FloatArray:
    if np.ndim(np.asarray(value, dtype=object)) == 0:
        value = [value] * count
    return checks.array(name, value, (count,), finite=False)


def _either_unit(quantity: str) -> str:
    revolute, prismatic = LIMIT_UNITS[quantity]
    return f"{revolute} (prismatic: {prismatic})"


@dataclass(frozen=True, eq=False)
class Robot:
    """A serial manipulator: modified-DH rows, links, limits, gravity, base and tool.

    Make one with :meth:`from_dh` or :func:`microbot_ocp.load_robot`. Two robots with the same
    figures are equal and share the functions built for them.
    """

    name: str
    alpha: FloatArray
    a: FloatArray
    d: FloatArray
    theta_offset: FloatArray
    joint_types: tuple[JointType, ...]
    joint_names: tuple[str, ...]
    links: tuple[Link, ...]
    limits: JointLimits
    gravity: FloatArray
    tool: FloatArray
    description: str = ""
    base: FloatArray = field(default_factory=_identity)
    _digest: str = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_digest", self._make_digest())

    @classmethod
    def from_dh(
        cls,
        alpha: ArrayLike,
        a: ArrayLike,
        d: ArrayLike,
        theta_offset: ArrayLike | None = None,
        joint_type: Sequence[str] | str = "revolute",
        links: Sequence[Link] | None = None,
        limits: Limits | JointLimits | None = None,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        tool: ArrayLike | None = None,
        name: str = "robot",
        joint_names: Sequence[str] | None = None,
        description: str = "",
        base: ArrayLike | None = None,
    ) -> Robot:
        """Build a robot from Craig's modified-DH table.

        Parameters
        ----------
        alpha, a, d : array_like [n]
            Twist alpha_{i-1} (rad), link length a_{i-1} (m) and offset d_i (m) of every row.
        theta_offset : array_like [n], optional
            Added to the joint angle (for a prismatic joint: the constant angle), rad.
        joint_type : str or sequence of str
            "revolute" or "prismatic" for each joint; q of a prismatic joint adds to d.
        links : sequence of Link, optional
            One link a joint; without them the robot has kinematics only.
        limits : Limits, optional
            Limits of the joints; without them none.
        gravity : array_like [3]
            Acceleration of free fall in the base frame, m/s^2.
        tool : array_like [4,4] or [4], optional
            Tool frame in the last link frame: a homogeneous transform, or a DH row
            (alpha, a, d, theta).
        name : str
            Name of the robot.
        joint_names : sequence of str, optional
            Different names of the joints; default "joint 1" and so on.
        description : str
            What the robot is, in a sentence.
        base : array_like [4,4] or [4], optional
            Frame 0 of the rows in the base frame, given as ``tool`` is; default the identity.
            Poses, Jacobians and gravity are in the base frame.

        Returns
        -------
        Robot

        Raises
        ------
        InputError
            Rows of different length, wrong counts or shapes, anything not finite.

        Examples
        --------
        >>> robot = Robot.from_dh(alpha=[0.0, 0.0], a=[0.0, 1.0], d=[0.0, 0.0], name="planar")
        >>> robot.joint_count
        2
        """
        rows = {"alpha": (alpha, "rad"), "a": (a, "m"), "d": (d, "m")}
        table = {k: checks.array(k, v, (None,), u) for k, (v, u) in rows.items()}
        count = table["alpha"].size
        if count == 0:
            raise InputError("alpha must have at least one row, not 0")
        for key, column in table.items():
            if column.size != count:
                raise InputError(
                    f"the DH columns differ in length: alpha has {count} rows, {key} has "
                    f"{column.size}"
                )
        offset = np.zeros(count) if theta_offset is None else theta_offset
        if not isinstance(joint_type, str | list | tuple):
            raise InputError(f"joint_type must be text or a list of text, not {joint_type!r}")
        types = (joint_type,) * count if isinstance(joint_type, str) else tuple(joint_type)
        if len(types) != count:
            raise InputError(f"joint_type has {len(types)} entries for {count} joints")
        for entry in types:
            checks.one_of("joint_type", entry, ("revolute", "prismatic"))
        names = tuple(joint_names or (f"joint {i + 1}" for i in range(count)))
        all_text = all(isinstance(entry, str) for entry in names)
        if not all_text or len(names) != count or len(set(names)) != count:
            raise InputError(f"joint_names must be {count} different names, not {list(names)}")
        for key, text in (("name", name), ("description", description)):
            if not isinstance(text, str):
                raise InputError(f"{key} must be text, not {text!r}")
        return cls(
            name=name,
            alpha=table["alpha"],
            a=table["a"],
            d=table["d"],
            theta_offset=checks.array("theta_offset", offset, (count,), "rad"),
            joint_types=types,  # type: ignore[arg-type]
            joint_names=names,
            links=_chain(links, count) if links else (),
            limits=_joint_limits(Limits() if limits is None else limits, count),
            gravity=checks.array("gravity", gravity, (3,), "m/s^2"),
            tool=_rigid_transform("tool", tool),
            description=description,
            base=_rigid_transform("base", base),
        )

    def __repr__(self) -> str:
        return f"<Robot {self.name!r}: {self.joint_count} joints>"

    def _repr_html_(self) -> str:
        from microbot_ocp.views.notebook import _html as jupyter

        return jupyter.robot(self)

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return self.alpha.size

    @property
    def has_dynamics(self) -> bool:
        """Whether the links carry masses."""
        return bool(self.links)

    def unit(self, quantity: str, joint: int) -> str:
        """Unit of ``q``, ``qd``, ``qdd``, ``tau`` or ``taud`` at joint index ``joint`` (from 0)."""
        return LIMIT_UNITS[quantity][self.joint_types[joint] == "prismatic"]

    def with_limits(
        self,
        limits: Limits | JointLimits | None = None,
        *,
        q_min: ArrayLike | None = None,
        q_max: ArrayLike | None = None,
        qd_max: LimitArgument | None = None,
        qdd_max: LimitArgument | None = None,
        tau_max: LimitArgument | None = None,
        taud_max: LimitArgument | None = None,
        qd_min: ArrayLike | None = None,
        qdd_min: ArrayLike | None = None,
        tau_min: ArrayLike | None = None,
        taud_min: ArrayLike | None = None,
    ) -> Robot:
        """Return the same robot with other limits: all of them, or those given by name.

        Parameters
        ----------
        limits : Limits or JointLimits, optional
            In the place of all that the robot has.
        q_min, q_max, qd_max, qdd_max, tau_max, taud_max, qd_min, qdd_min, tau_min, taud_min
            In the place of these alone, given as in :class:`Limits`: a number for all joints, one a
            joint, or ``(lower, upper)``, in SI units. ``qd_max`` without ``qd_min`` means plus and
            minus; ``qd_min`` without ``qd_max`` leaves the upper limit as it is.

        Raises
        ------
        InputError
            Both ways at once, wrong length, NaN, a lower limit above its upper one, a negative
            bound.

        Examples
        --------
        >>> import microbot_ocp as mo
        >>> robot = mo.load_robot("microbot").with_limits(qdd_max=40.0)
        >>> robot.limits.qdd_min.tolist(), robot.limits.tau_max.tolist()
        ([-40.0, -40.0, -40.0], [400.0, 500.0, 200.0])
        """
        named = {
            "q_min": q_min, "q_max": q_max, "qd_min": qd_min, "qd_max": qd_max,
            "qdd_min": qdd_min, "qdd_max": qdd_max, "tau_min": tau_min, "tau_max": tau_max,
            "taud_min": taud_min, "taud_max": taud_max,
        }  # fmt: skip
        changes = {name: value for name, value in named.items() if value is not None}
        if limits is None:
            limits = _changed(self.limits, changes)
        elif changes:
            raise InputError(f"give limits or {', '.join(changes)}, not both")
        return replace(self, limits=_joint_limits(limits, self.joint_count))

    def with_links(self, links: Sequence[Link]) -> Robot:
        """Return the same robot with other links (payload, model mismatch, rotor inertia)."""
        return replace(self, links=_chain(links, self.joint_count))

    def with_payload(self, mass: float, center_of_mass: ArrayLike = (0.0, 0.0, 0.0)) -> Robot:
        """Return the same robot holding a point mass: part of its last link from then on.

        Parameters
        ----------
        mass : float
            kg; 0 is no payload.
        center_of_mass : array_like [3]
            Where, in the tool frame, m.

        Raises
        ------
        InputError
            A negative mass, a place that is not finite, a robot without masses.

        Examples
        --------
        >>> import microbot_ocp as mo
        >>> loaded = mo.load_robot("microbot").with_payload(3.0)
        >>> loaded.links[-1].mass, loaded.links[-1].center_of_mass.tolist()
        (5.0, [4.0, 0.0, 0.0])
        """
        load = checks.number("mass of the payload", mass, "kg", at_least=0.0)
        place = checks.array("center_of_mass of the payload", center_of_mass, (3,), "m")
        if not self.has_dynamics:
            raise InputError(f"robot {self.name!r} has no links with masses to add a payload to")
        if load == 0.0:
            return self
        last = self.links[-1]
        held = self.tool[:3, :3] @ place + self.tool[:3, 3]
        total = last.mass + load
        center = (last.mass * last.center_of_mass + load * held) / total
        inertia = last.inertia + last.mass * _of_unit_mass(last.center_of_mass - center)
        inertia = inertia + load * _of_unit_mass(held - center)
        loaded = replace(last, mass=total, center_of_mass=center, inertia=inertia)
        return self.with_links([*self.links[:-1], loaded])

    def with_gravity(self, gravity: ArrayLike) -> Robot:
        """Return the same robot under another gravity vector [3], m/s^2, in the base frame."""
        return replace(self, gravity=checks.array("gravity", gravity, (3,), "m/s^2"))

    def _make_digest(self) -> str:
        digest = hashlib.sha256(repr((self.name, self.joint_types, self.joint_names)).encode())
        arrays = [self.alpha, self.a, self.d, self.theta_offset, self.gravity, self.tool]
        arrays += [getattr(self.limits, f.name) for f in fields(self.limits)]
        for link in self.links:
            scalars = [
                link.mass,
                link.armature,
                link.viscous_friction,
                link.coulomb_friction,
            ]
            arrays += [np.array(scalars), link.center_of_mass, link.inertia]
        if not np.array_equal(self.base, np.eye(4)):
            arrays.append(self.base)
        for item in arrays:
            digest.update(np.ascontiguousarray(item, dtype=float).tobytes())
        return digest.hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Robot) and self._digest == other._digest

    def __hash__(self) -> int:
        return hash(self._digest)


def _of_unit_mass(offset: FloatArray) -> FloatArray:
    """Inertia [3,3] of a unit mass at ``offset``."""
    return offset @ offset * np.eye(3) - np.outer(offset, offset)


def _chain(links: Any, count: int) -> tuple[Link, ...]:
    chain = tuple(links)
    if len(chain) != count:
        raise InputError(f"links has {len(chain)} entries for {count} joints")
    for entry in chain:
        if not isinstance(entry, Link):
            raise InputError(f"links must hold Link objects, not {entry!r}")
    return chain


def _joint_limits(limits: Any, count: int) -> JointLimits:
    if not isinstance(limits, Limits | JointLimits):
        raise InputError(f"limits must be Limits, such as Limits(tau_max=100.0), not {limits!r}")
    return limits.for_joints(count)


def _rigid_transform(name: str, value: ArrayLike | None) -> FloatArray:
    """Read-only homogeneous transform [4,4] from one, from a DH row [4], or the identity."""
    if value is None:
        matrix = np.eye(4)
    elif np.ndim(np.asarray(value, dtype=object)) == 1:
        row = checks.array(name, value, (4,))
        matrix = dh_transform(*row)
    else:
        matrix = np.array(checks.array(name, value, (4, 4)))
        rotation = matrix[:3, :3]
        if (
            np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6
            or np.linalg.det(rotation) < 0
            or np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-9
        ):
            raise InputError(
                f"{name} must be a homogeneous transform (rotation of determinant +1, last row "
                f"0 0 0 1), not {matrix.tolist()}"
            )
    matrix.setflags(write=False)
    return matrix
