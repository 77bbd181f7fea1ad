"""Robots as data: modified Denavit-Hartenberg rows, links, limits, without symbolic expressions.

Frames follow Craig, *Introduction to Robotics*, 3rd ed., section 3.4: link frame i sits at joint i,
and ``T(i-1, i) = Rot_x(alpha_{i-1}) Trans_x(a_{i-1}) Rot_z(theta_i) Trans_z(d_i)``. The tool frame
follows the last link frame by a constant transform, and frame 0 of the rows follows the base frame
by another, by default the identity.

Axes that are almost but not quite parallel have a distant common normal. Their row has a rotation
``Rot_y(beta)`` after ``Trans_x(a)`` instead (Hayati and Mirmirani, 1985, *Improving the absolute
positioning accuracy of robot manipulators*, Journal of Robotic Systems 2); elsewhere beta is zero.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Unpack, get_args

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError, shown, warn_user
from microbot_ocp._base.foreign_words import HintingOfArms, our_name
from microbot_ocp._base.showing import view_for
from microbot_ocp.limits import JOINT_QUANTITIES, JointLimits, LimitChanges, Limits
from microbot_ocp.robot._convention import Convention, as_modified, doubts
from microbot_ocp.robot._coupling import Coupling, Mimic, coupling_of
from microbot_ocp.robot._links import Link, Rotor, checked_links, combined
from microbot_ocp.robot._shapes import Capsule, Shape, checked_shapes
from microbot_ocp.robot._transforms import rigid_transform

if TYPE_CHECKING:
    from microbot_ocp.robot._dynamics import MotionState

JointType = Literal["revolute", "prismatic"]
GRAVITY = (0.0, 0.0, -9.81)  # usual acceleration of free fall in the base frame, m/s^2
# Larger limits in rad or rad/s look like degrees: files have up to 10 rad; ten turns a second.
LOOKS_LIKE_DEGREES = {"q_min": 10 * np.pi, "q_max": 10 * np.pi, "qd_max": 20 * np.pi}


@dataclass(frozen=True, eq=False)
class Robot(HintingOfArms):
    """A serial manipulator: modified-DH rows, links, limits, gravity, base and tool.

    :meth:`from_dh` or :func:`microbot_ocp.load_robot` make one. Robots with equal data are equal
    and share the functions built for them.

    ``disabled_pairs`` are pairs of names of links that may touch, as in an SRDF file, or None.
    ``named_poses`` are the named states [n] of an SRDF file, rad or m. ``frames`` has for each
    named link of a URDF file the number of the joint that moves it, 0 for the base, and its frame
    [4,4] in that joint's frame.

    If some joints follow others, ``coupling`` holds all N joints of the chain. Rows, links and
    frames are those of N joints; names, types and limits are those of the n independent joints.
    """

    name: str
    alpha: FloatArray
    a: FloatArray
    d: FloatArray
    theta_offset: FloatArray
    beta: FloatArray
    joint_types: tuple[JointType, ...]
    joint_names: tuple[str, ...]
    links: tuple[Link, ...]
    limits: JointLimits
    gravity: FloatArray
    tool: FloatArray
    description: str = field(default="", compare=False)
    base: FloatArray = field(default_factory=lambda: rigid_transform("base", None))
    shapes: tuple[Shape, ...] = ()
    capsules: tuple[tuple[int, Capsule], ...] = ()
    disabled_pairs: tuple[tuple[str, str], ...] | None = None
    named_poses: Mapping[str, FloatArray] = field(default_factory=dict, compare=False)
    frames: Mapping[str, tuple[int, FloatArray]] = field(default_factory=dict, compare=False)
    coupling: Coupling | None = None

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
        gravity: ArrayLike = GRAVITY,
        tool: ArrayLike | None = None,
        name: str = "robot",
        joint_names: Sequence[str] | None = None,
        description: str = "",
        base: ArrayLike | None = None,
        beta: ArrayLike | None = None,
        shapes: Sequence[Shape] = (),
        convention: Convention | None = None,
        mimic: Mimic | None = None,
    ) -> Robot:
        """Return a robot from a Denavit-Hartenberg table, by default Craig's modified one.

        Parameters
        ----------
        alpha, a, d : array_like [n]
            Twist alpha_{i-1} (rad), link length a_{i-1} (m) and offset d_i (m) of every row; in
            the standard convention alpha_i and a_i.
        theta_offset : array_like [n], optional
            Offset of the joint angle (for a prismatic joint: the constant angle), rad.
        joint_type : str or sequence of str
            "revolute" or "prismatic" for each joint; q of a prismatic joint adds to d.
        links : sequence of Link, optional
            One link per joint; without them the robot has kinematics only.
        limits : Limits, optional
            Limits of the joints; by default none.
        gravity : array_like [3]
            Acceleration of free fall in the base frame, m/s^2.
        tool : array_like [4,4] or [4], optional
            Tool frame in the last link frame: a homogeneous transform, or a DH row
            (alpha, a, d, theta).
        name : str
            Name of the robot.
        joint_names : sequence of str, optional
            Names of the joints, all different; default "joint 1" and so on.
        description : str
            Description of the robot in a sentence.
        base : array_like [4,4] or [4], optional
            Frame 0 of the rows in the base frame, in a form of ``tool``; default the identity.
            Poses, Jacobians and gravity are in the base frame.
        beta : array_like [n], optional
            Rotation about Y in every row, rad, for axes that are almost but not quite parallel.
        shapes : sequence of Shape
            Visual and collision geometry, which the comparison of robots ignores.
        convention : {"modified", "standard"}, optional
            Frames of the table, ``links``, ``shapes`` and ``tool``: "modified" (proximal) at the
            joints, as in Craig, or "standard" (distal) at the far ends of the links, as in Paul,
            Spong and Corke. The robot has modified rows in either case. Default "modified", with
            a warning if the table looks like a standard one.
        mimic : mapping of str to (str, float, float), optional
            Joints that follow others: each name with its driving joint, the factor and the offset
            (rad or m) of its position. q, limits and torques of the robot exclude them. Here
            ``limits`` includes them, and the tightest limits hold; torque limits are those of the
            driving joints, whose drives move both.

        Returns
        -------
        Robot

        Raises
        ------
        InputError
            Rows of different lengths, wrong counts or shapes, or values that are not finite;
            ``beta`` in the standard convention; joints that follow each other in a ring, or whose
            position limits exclude each other.

        Examples
        --------
        >>> robot = Robot.from_dh(alpha=[0.0, 0.0], a=[0.0, 1.0], d=[0.0, 0.0], name="planar")
        >>> robot.joint_count
        2

        The same arm from the other convention:

        >>> standard = Robot.from_dh(
        ...     [0.0, 0.0], [1.0, 0.0], [0.0, 0.0], name="planar", convention="standard"
        ... )
        >>> standard == robot
        True

        A telescope, whose second slide goes as far as the first:

        >>> mast = Robot.from_dh(
        ...     *[[0.0, 0.0]] * 3, joint_type="prismatic", joint_names=["lift", "second"],
        ...     limits=Limits(q_min=0.0, q_max=[0.5, 0.4]), mimic={"second": ("lift", 1.0, 0.0)},
        ... )
        >>> mast.joint_names, mast.link_count, mast.limits.q_max.tolist()
        (('lift',), 2, [0.4])
        """
        table = _columns(alpha=alpha, a=a, d=d, theta_offset=theta_offset, beta=beta)
        count = table["alpha"].size
        types: tuple[JointType, ...] = _joint_types(joint_type, count)
        names = _joint_names(joint_names, count)
        if convention is not None:
            checks.one_of("convention", convention, ("modified", "standard"))
        _check_units(name, table)
        joint_limits = _joint_limits(Limits() if limits is None else limits, count)
        _warn_of_degrees(joint_limits, types, ("q_min", "q_max"))
        tool_pose, geometry = rigid_transform("tool", tool), checked_shapes(shapes, count)
        chain = checked_links(links, count) if links else ()
        if convention != "modified":
            placed = base is not None or tool is not None
            rows = table["alpha"], table["a"]
            if odd := doubts(convention or "modified", *rows, types, placed=placed):
                warn_user(f"{name}: {odd}")
        if convention == "standard":
            if table["beta"].any():
                raise InputError("beta is for modified rows: give it without convention='standard'")
            rows, chain, geometry, end = as_modified(table["alpha"], table["a"], chain, geometry)
            table["alpha"], table["a"] = rows
            tool_pose = rigid_transform("tool", end @ tool_pose)
        coupling = coupling_of(names, types, mimic) if mimic else None
        if coupling:
            names = tuple(names[k] for k in coupling.rows)
            types = tuple(types[k] for k in coupling.rows)
            joint_limits = coupling.joined(joint_limits)
        return cls(
            name=name,
            joint_types=types,
            joint_names=names,
            links=chain,
            limits=joint_limits,
            gravity=checks.array("gravity", gravity, (3,), "m/s^2"),
            tool=tool_pose,
            description=description,
            base=rigid_transform("base", base),
            shapes=geometry,
            coupling=coupling,
            **table,
        )

    def __repr__(self) -> str:
        return f"<Robot {self.name!r}: {self.joint_count} joints>"

    def __str__(self) -> str:
        return str(view_for(self, "table")(self))

    def _repr_html_(self) -> str:
        return view_for(self, "table")(self)._repr_html_()

    @property
    def joint_count(self) -> int:
        """Number of joints n, without those that follow others."""
        return len(self.joint_names)

    @property
    def link_count(self) -> int:
        """Number of moving links N, equal to that of joints unless some follow others."""
        return self.alpha.size

    @property
    def chain(self) -> Robot:
        """Robot with N independent joints; this one if no joint follows another."""
        return self if self.coupling is None else self._uncoupled

    @cached_property
    def _uncoupled(self) -> Robot:
        chain = self.coupling
        assert chain is not None
        limits = chain.spread(self.limits)
        names, types = chain.names, chain.types
        change: dict[str, Any] = {"joint_names": names, "joint_types": types, "limits": limits}
        return replace(self, coupling=None, named_poses={}, **change)

    @cached_property
    def transmission(self) -> FloatArray:
        """Factors [N,n] from the speeds of the joints to those of all joints of the chain."""
        return np.eye(self.link_count) if self.coupling is None else self.coupling.matrix

    @property
    def joint_frames(self) -> tuple[int, ...]:
        """Numbers of the link frames at the n joints: 1 to n, unless some joints follow others."""
        rows = range(self.link_count) if self.coupling is None else self.coupling.rows
        return tuple(row + 1 for row in rows)

    @cached_property
    def whole_turns(self) -> np.ndarray:
        """Mask [n] of the joints that move every link back to its place in a whole turn."""
        factors, revolute = self.transmission, np.array(self.chain.joint_types) == "revolute"
        return np.all((revolute[:, None] & (factors % 1.0 == 0.0)) | (factors == 0.0), axis=0)

    @property
    def mimic(self) -> dict[str, tuple[str, float, float]]:
        """Joints that follow others, in the form of :meth:`from_dh`."""
        return {} if self.coupling is None else self.coupling.mimic

    def chain_positions(self, q: FloatArray) -> FloatArray:
        """Return positions [...,N] of all joints, including those that follow others, rad or m."""
        return q if self.coupling is None else self.coupling.positions(q)

    def friction_of(self, kind: str) -> FloatArray:
        """Return "viscous_friction" or "coulomb_friction" of the joints [n], SI; 0 without masses.

        Friction of joints that follow others is referred to their drives by equal power.
        """
        if not self.links:
            return np.zeros(self.joint_count)
        # Power is conserved: viscous friction scales with the square of the factor, Coulomb
        # friction with its magnitude.
        power = 2 if kind == "viscous_friction" else 1
        sizes = np.array([getattr(link, kind) for link in self.links])
        return sizes @ np.abs(self.transmission) ** power

    @property
    def has_dynamics(self) -> bool:
        """True if the links have masses."""
        return bool(self.links)

    @property
    def rotors(self) -> tuple[tuple[int, Rotor, int], ...]:
        """Joint index from 0, rotor, and number of its carrier, 0 for the base, of each rotor."""
        return tuple(
            (joint, link.rotor, joint if link.rotor.carrier is None else link.rotor.carrier)
            for joint, link in enumerate(self.links)
            if link.rotor is not None
        )

    def unit(self, quantity: str, joint: int) -> str:
        """Return the unit of a joint quantity, such as ``"tau"``, at joint index from 0."""
        return getattr(JOINT_QUANTITIES[quantity], self.joint_types[joint])

    def position_text(self, joint: int, value: float, *, with_radians: bool = False) -> str:
        """Return a joint position with its unit: degrees (revolute) or metres (prismatic)."""
        if not 0 <= joint < self.joint_count:
            raise InputError(f"joint must be from 0 to {self.joint_count - 1}, not {shown(joint)}")
        value = float(value)
        if self.joint_types[joint] == "prismatic":
            return f"{value:.6g} m"
        degrees = f"{np.degrees(value):.6g} deg"
        return f"{degrees} ({value:.6g} rad)" if with_radians else degrees

    def motion_state(
        self, q: Any, qd: Any, qdd: Any, qddd: Any, torques: Any = None
    ) -> MotionState:
        """Return quantities of a motion of this robot as CasADi expressions, for limits."""
        from microbot_ocp.robot._dynamics import MotionState

        return MotionState(self, q, qd, qdd, qddd, torques)

    def torques_along(
        self, q: FloatArray, qd: FloatArray, qdd: FloatArray, qddd: FloatArray | None = None
    ) -> dict[str, FloatArray]:
        """Return joint torques of inverse dynamics along many samples.

        Parameters
        ----------
        q, qd, qdd : array [N,n]
            Positions, velocities and accelerations, rad, rad/s, rad/s^2 (prismatic: m, ...).
        qddd : array [N,n], optional
            Jerks, needed for torque rates, rad/s^3 (m/s^3).

        Returns
        -------
        dict
            Torques "tau" [N,n], N m (N), and with ``qddd`` their rates "taud" [N,n], N m/s (N/s).

        Raises
        ------
        InputError
            An array has a wrong shape or is not numeric.

        Examples
        --------
        >>> import microbot_ocp as mo
        >>> found = mo.load_robot("microbot").torques_along(*np.zeros((3, 2, 3)))
        >>> found["tau"][0].round(6).tolist()
        [0.0, 196.0, 78.4]
        """
        from microbot_ocp._base.fast_calls import deferred_call
        from microbot_ocp.robot._dynamics import inverse_dynamics, torque_and_rate

        given = {"q": q, "qd": qd, "qdd": qdd} | ({} if qddd is None else {"qddd": qddd})
        states = [checks.numbers(name, value) for name, value in given.items()]
        for name, state in zip(given, states, strict=True):
            if state.ndim != 2 or state.shape != (len(states[0]), self.joint_count):
                raise InputError(
                    f"{name} must have shape [N, {self.joint_count}], with the same N as the "
                    f"others, not {list(state.shape)}"
                )
        if qddd is None:
            return {"tau": deferred_call(inverse_dynamics(self))(*states)}
        tau, taud = deferred_call(torque_and_rate(self))(*states)
        return {"tau": tau, "taud": taud}

    def with_limits(
        self, limits: Limits | JointLimits | None = None, **changes: Unpack[LimitChanges]
    ) -> Robot:
        """Return the robot with other limits: a whole set, or some by name.

        Parameters
        ----------
        limits : Limits or JointLimits, optional
            Limits that replace all limits of the robot.
        **changes
            Limits by name, which replace only these: ``q_min``, ``q_max``, ``qd_max``, ``qdd_max``,
            ``qddd_max``, ``tau_max``, ``taud_max``, ``qd_min`` and so on, ``also``. Values as in
            :class:`Limits`: a number for all joints, one per joint, or ``(lower, upper)``, in SI
            units. ``qd_max`` without ``qd_min`` bounds both directions; ``qd_min`` without
            ``qd_max`` leaves the upper limit unchanged.

        Raises
        ------
        InputError
            Both ``limits`` and ``changes``, a wrong length, NaN, a lower limit above the upper
            one, or a negative bound.

        Examples
        --------
        >>> import microbot_ocp as mo
        >>> robot = mo.load_robot("microbot").with_limits(qdd_max=40.0)
        >>> robot.limits.qdd_min.tolist(), robot.limits.tau_max.tolist()
        ([-40.0, -40.0, -40.0], [400.0, 500.0, 200.0])
        """
        for name in changes:
            if asked := our_name(name, LimitChanges.__annotations__):
                raise InputError(f"there is no limit {name!r}{asked}")
            checks.one_of("limit", name, LimitChanges.__annotations__)
        given = {name: value for name, value in changes.items() if value is not None}
        if limits is None:
            limits = self.limits.changed(given)
        elif given:
            raise InputError(f"give limits or {', '.join(given)}, not both")
        joint_limits = _joint_limits(limits, self.joint_count)
        _warn_of_degrees(joint_limits, self.joint_types, given)
        return replace(self, limits=joint_limits)

    def with_links(self, links: Sequence[Link]) -> Robot:
        """Return the robot with other links (payload, model mismatch, rotor inertia)."""
        return replace(self, links=checked_links(links, self.link_count))

    def with_payload(
        self,
        mass: float,
        center_of_mass: ArrayLike = (0.0, 0.0, 0.0),
        inertia: ArrayLike | None = None,
    ) -> Robot:
        """Return the robot with a payload, which becomes part of its last link.

        Parameters
        ----------
        mass : float
            Mass, kg; 0 is no payload.
        center_of_mass : array_like [3]
            Centre of mass in the tool frame, m.
        inertia : array_like [3,3], optional
            Inertia about the centre of mass along the axes of the tool frame, kg m^2; default a
            point mass.

        Raises
        ------
        InputError
            A negative mass, an inertia that no rigid body has, a centre that is not finite, or a
            robot without masses.

        Examples
        --------
        >>> import microbot_ocp as mo
        >>> loaded = mo.load_robot("microbot").with_payload(3.0)
        >>> loaded.links[-1].mass, loaded.links[-1].center_of_mass.tolist()
        (5.0, [4.0, 0.0, 0.0])
        """
        load = checks.number("mass of the payload", mass, "kg", at_least=0.0)
        place = checks.array("center_of_mass of the payload", center_of_mass, (3,), "m")
        if load == 0.0:
            return self
        if not self.has_dynamics:
            raise InputError(f"robot {self.name!r} has no links with masses to add a payload to")
        tensor = np.zeros((3, 3)) if inertia is None else np.asarray(inertia, dtype=float)
        tensor = Link(load, place, tensor, name="payload").inertia
        last, turn = self.links[-1], self.tool[:3, :3]
        held = load, turn @ place + self.tool[:3, 3], turn @ tensor @ turn.T
        parts = [(last.mass, last.center_of_mass, last.inertia), held]
        total, center, whole = combined(parts, np.zeros(3))
        loaded = replace(last, mass=total, center_of_mass=center, inertia=whole)
        return self.with_links([*self.links[:-1], loaded])

    def with_capsules(self, capsules: Mapping[Any, Sequence[Capsule]]) -> Robot:
        """Return the robot with these capsules around its links, for collision avoidance.

        Parameters
        ----------
        capsules : mapping
            Capsules that are rigid in a frame, by the frame's number, 0 for the base and 1 to n
            for the links, or by the name of a link. :func:`~microbot_ocp.fit_capsules` and
            :func:`~microbot_ocp.robot.link_capsules` return such mappings.

        Raises
        ------
        InputError
            The robot has no such link, or an entry is no capsule.

        Examples
        --------
        >>> import microbot_ocp as mo
        >>> robot = mo.load_robot("planar_2r")
        >>> padded = robot.with_capsules({2: [mo.Capsule([0, 0, 0], [0.3, 0, 0], 0.05)]})
        >>> padded.capsules[0][0], padded.capsules[0][1].name
        (2, 'link 2')
        """
        numbers = {link.name: k + 1 for k, link in enumerate(self.links) if link.name}
        placed: list[tuple[int, Capsule]] = []
        for key, entries in capsules.items():
            frame = numbers.get(key, key) if isinstance(key, str) else key
            if not isinstance(frame, int | np.integer) or not 0 <= frame <= self.link_count:
                raise InputError(
                    f"capsules must be of frames 0 (base) to {self.link_count} or links "
                    f"{sorted(numbers)}, not {key!r}"
                )
            usual = f"link {frame}" if frame else "base"
            for entry in entries:
                if not isinstance(entry, Capsule):
                    raise InputError(f"capsules of {key!r} must be mo.Capsule, not {entry!r}")
                named = entry if entry.name else replace(entry, name=usual)
                placed.append((int(frame), named))
        return replace(self, capsules=tuple(sorted(placed, key=lambda pair: pair[0])))

    def with_part(self, *capsules: Capsule) -> Robot:
        """Return the robot with a part in its gripper, which collision avoidance includes.

        The mass of the part is added by :meth:`with_payload`.

        Parameters
        ----------
        capsules : Capsule
            Capsules around the part, in the tool frame, m; a sphere is a capsule of length zero.
            Their default name is "part".

        Raises
        ------
        InputError
            An entry is no capsule, or the robot has no capsules.

        Examples
        --------
        >>> import microbot_ocp as mo
        >>> robot = mo.load_robot("planar_2r")
        >>> robot = robot.with_capsules(mo.robot.link_capsules(robot))
        >>> robot.with_part(mo.Capsule([0, 0, 0], [0.1, 0, 0], 0.05)).capsules[-1][1].name
        'part'
        """
        if not self.capsules:
            raise InputError("a robot needs capsules of its own first: robot.with_capsules(...)")
        held = list(self.capsules)
        for entry in capsules:
            if not isinstance(entry, Capsule):
                raise InputError(f"a part must be made of mo.Capsule, not {entry!r}")
            part = replace(entry.moved(self.tool), name=entry.name or "part", excess=0.0)
            held.append((self.link_count, part))
        return replace(self, capsules=tuple(held))

    def with_gravity(self, gravity: ArrayLike) -> Robot:
        """Return the robot under another gravity vector [3], m/s^2, in the base frame."""
        return replace(self, gravity=checks.array("gravity", gravity, (3,), "m/s^2"))

    @cached_property
    def without_limits(self) -> Robot:
        """Robot without limits; robots that differ in limits alone share its functions."""
        return replace(self, limits=Limits().for_joints(self.joint_count))

    @cached_property
    def chain_digest(self) -> str:
        """Digest of joint types, rows, base and tool, 12 digits, without names, links, limits."""
        rows = self.alpha, self.a, self.d, self.theta_offset, self.beta
        numbers = (item + 0.0 for item in (*rows, self.base, self.tool))
        return _digest_of(self.joint_types, numbers)[:12]

    @cached_property
    def _digest(self) -> str:
        texts: list[Any] = [self.name, self.joint_types, self.joint_names, self.disabled_pairs]
        rows = self.alpha, self.a, self.d, self.theta_offset, self.beta + 0.0
        arrays: list[ArrayLike] = [*rows, self.gravity, self.tool, self.base + 0.0]
        arrays += [bound for key in JOINT_QUANTITIES for bound in self.limits.bounds(key)]
        for link in self.links:
            friction = link.viscous_friction, link.coulomb_friction
            arrays += [(link.mass, link.armature, *friction), link.center_of_mass, link.inertia]
        for joint, rotor, carrier in self.rotors:
            arrays += [(joint, rotor.inertia, rotor.gear_ratio, carrier), rotor.axis]
        if self.coupling is not None:
            texts += [self.coupling.names, self.coupling.types]
            arrays += [self.coupling.matrix, self.coupling.offsets]
        for frame, capsule in self.capsules:
            texts.append(capsule.name)
            arrays += [(frame, capsule.radius), capsule.start, capsule.end]
        return _digest_of(texts, arrays)

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Robot)
            and self._digest == other._digest
            and self.limits.also == other.limits.also
        )

    def __hash__(self) -> int:
        return hash((self._digest, self.limits.also))


def _digest_of(texts: Any, arrays: Iterable[ArrayLike]) -> str:
    digest = hashlib.sha256(repr(texts).encode())
    for item in arrays:
        digest.update(np.array(item, dtype=float, order="C").tobytes())
    return digest.hexdigest()


def _columns(**columns: Any) -> dict[str, Any]:
    """Return columns [n] of a table; missing ones are zero."""
    count = checks.array("alpha", columns["alpha"], (None,), "rad").size
    if count == 0:
        raise InputError("alpha must have at least one row, not 0")
    table = {}
    for key, values in columns.items():
        unit = "m" if key in ("a", "d") else "rad"
        column = checks.array(key, np.zeros(count) if values is None else values, (None,), unit)
        if column.size != count:
            raise InputError(
                f"the DH columns differ in length: alpha has {count} rows, {key} has {column.size}"
            )
        table[key] = column
    return table


def _joint_types(joint_type: Any, count: int) -> tuple[JointType, ...]:
    if not isinstance(joint_type, str | list | tuple):
        raise InputError(f"joint_type must be text or a list of text, not {joint_type!r}")
    types: Any = (joint_type,) * count if isinstance(joint_type, str) else tuple(joint_type)
    if len(types) != count:
        raise InputError(f"joint_type has {len(types)} entries for {count} joints")
    for entry in types:
        checks.one_of("joint_type", entry, get_args(JointType))
    return types


def _joint_names(given: Sequence[str] | None, count: int) -> tuple[str, ...]:
    names = tuple(given or (f"joint {i + 1}" for i in range(count)))
    all_text = all(isinstance(entry, str) and entry for entry in names)
    if not all_text or len(names) != count or len(set(names)) != count:
        raise InputError(f"joint_names must be {count} different names, not {list(names)}")
    return names


def _joint_limits(limits: Any, count: int) -> JointLimits:
    if not isinstance(limits, Limits | JointLimits):
        raise InputError(f"limits must be Limits, such as Limits(tau_max=100.0), not {limits!r}")
    return limits.for_joints(count)


def _warn_of_degrees(limits: JointLimits, joint_types: Sequence[str], keys: Iterable[str]) -> None:
    """Warn about limits of positions or velocities that look like degrees."""
    turning = [kind == "revolute" for kind in joint_types]
    for key in LOOKS_LIKE_DEGREES.keys() & keys:
        angles = getattr(limits, key)[turning]
        if hint := checks.degrees_hint(angles, LOOKS_LIKE_DEGREES[key]):
            warn_user(f"{key} is {angles.tolist()} rad{'/s' * key.startswith('qd')}{hint}")


def _check_units(name: str, table: Mapping[str, FloatArray]) -> None:
    """Raise InputError for angles beyond a turn; warn about lengths that look like millimetres."""
    for key in ("alpha", "theta_offset", "beta"):
        if np.abs(table[key]).max() > 2 * np.pi * (1.0 + ROUNDING):
            angles = table[key].tolist()
            raise InputError(
                f"{key} must be within a turn, in rad, not {angles}; of degrees "
                f"np.radians({angles})"
            )
    for key in ("a", "d"):
        if np.abs(table[key]).max() > checks.LONGEST_LINK:
            warn_user(f"{name}: {key} is {table[key].tolist()} m; that looks like millimetres")
