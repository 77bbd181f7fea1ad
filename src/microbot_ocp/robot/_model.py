"""The robot as data: modified Denavit-Hartenberg rows, links, limits. Nothing symbolic here.

Frames follow Craig, *Introduction to Robotics*, 3rd ed., section 3.4: link frame i sits at joint i,
and ``T(i-1, i) = Rot_x(alpha_{i-1}) Trans_x(a_{i-1}) Rot_z(theta_i) Trans_z(d_i)``. The tool frame
follows the last link frame by a constant transform, and frame 0 of the rows follows the base frame
by another (the identity, unless a robot says otherwise).

Axes that are almost but not quite parallel have their common normal far away. Their row has a turn
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
from microbot_ocp._base.checks import FloatArray, InputError, shown, warn_user
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
# rad, where there is no limit to speak of (files have 10 rad); rad/s, ten turns a second
LOOSE = {"q_min": 10 * np.pi, "q_max": 10 * np.pi, "qd_max": 20 * np.pi}


@dataclass(frozen=True, eq=False)
class Robot(HintingOfArms):
    """A serial manipulator: modified-DH rows, links, limits, gravity, base and tool.

    Make one with :meth:`from_dh` or :func:`microbot_ocp.load_robot`. Two robots with the same
    figures are equal and share the functions built for them.

    ``disabled_pairs`` are the pairs of links, by name, that may touch, as an SRDF file lists them;
    None where nothing lists any. ``named_poses`` are its named states [n], rad or m. ``frames`` are
    the links of a URDF file by name: 0 for the base or the number of the joint that moves it, and
    its frame [4,4] in that one.

    Where joints move together, ``coupling`` holds all N joints of the chain. Rows, links and frames
    are N then; names, types and limits are those of the n joints that move on their own.
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
        gravity: ArrayLike = (0.0, 0.0, -9.81),
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
        """Build a robot from a Denavit-Hartenberg table, Craig's modified one by default.

        Parameters
        ----------
        alpha, a, d : array_like [n]
            Twist alpha_{i-1} (rad), link length a_{i-1} (m) and offset d_i (m) of every row; in
            the standard convention alpha_i and a_i.
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
        beta : array_like [n], optional
            Turn about Y of every row, rad: for axes that are almost but not quite parallel.
        shapes : sequence of Shape
            Visual and collision geometry. It plays no part in whether two robots are equal.
        convention : {"modified", "standard"}, optional
            "modified" (proximal): frames at the joints, as in Craig. "standard" (distal): frames
            at the far ends of the links, as in Paul, Spong and Corke; what is given of ``links``,
            ``shapes`` and ``tool`` is then in those frames. The robot itself has modified rows in
            either case. Default "modified", with a warning where a table looks like the other.
        mimic : mapping of str to (str, float, float), optional
            Joints that follow others: name, to the name of the other, the factor and the offset
            (rad or m) of its position. They are no joints of the robot: q, the limits and the
            torques are those of the others. ``limits`` are of all joints here, and the tightest
            hold; of torques those of the joints that are followed, whose drives move both.

        Returns
        -------
        Robot

        Raises
        ------
        InputError
            Rows of different length, wrong counts or shapes, anything not finite; ``beta`` in
            the standard convention; joints that follow each other in a ring, or whose limits leave
            no position.

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
        names = tuple(joint_names or (f"joint {i + 1}" for i in range(count)))
        all_text = all(isinstance(entry, str) and entry for entry in names)
        if not all_text or len(names) != count or len(set(names)) != count:
            raise InputError(f"joint_names must be {count} different names, not {list(names)}")
        for key, text in (("name", name), ("description", description)):
            if not isinstance(text, str):
                raise InputError(f"{key} must be text, not {text!r}")
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
        """Number of links that move, N: that of the joints, unless some follow others."""
        return self.alpha.size

    @property
    def chain(self) -> Robot:
        """The same arm with N joints that all move on their own; itself where all do."""
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
        """Whether each joint [n] moved by a whole turn leaves every link where it is."""
        factors, revolute = self.transmission, np.array(self.chain.joint_types) == "revolute"
        return np.all((revolute[:, None] & (factors % 1.0 == 0.0)) | (factors == 0.0), axis=0)

    @property
    def mimic(self) -> dict[str, tuple[str, float, float]]:
        """Joints that follow others, as :meth:`from_dh` takes them."""
        return {} if self.coupling is None else self.coupling.mimic

    def chain_positions(self, q: FloatArray) -> FloatArray:
        """Return positions [...,N] of all joints, those that follow others too, rad or m."""
        return q if self.coupling is None else self.coupling.positions(q)

    def friction_of(self, kind: str) -> FloatArray:
        """Return sizes [n] of "viscous_friction" or "coulomb_friction" of the joints, SI; zero
        without masses.

        That of joints that follow others comes to their drives by their power.
        """
        if not self.links:
            return np.zeros(self.joint_count)
        power = 2 if kind == "viscous_friction" else 1
        sizes = np.array([getattr(link, kind) for link in self.links])
        return sizes @ np.abs(self.transmission) ** power

    @property
    def has_dynamics(self) -> bool:
        """Whether the links carry masses."""
        return bool(self.links)

    @property
    def rotors(self) -> tuple[tuple[int, Rotor, int], ...]:
        """Joint index, from 0, rotor and number of the link that carries it, 0 for the base."""
        return tuple(
            (joint, link.rotor, joint if link.rotor.carrier is None else link.rotor.carrier)
            for joint, link in enumerate(self.links)
            if link.rotor is not None
        )

    def unit(self, quantity: str, joint: int) -> str:
        """Return the unit of a quantity of the joints, such as ``"tau"``, at joint index ``joint``,
        from 0.
        """
        return getattr(JOINT_QUANTITIES[quantity], self.joint_types[joint])

    def position_text(self, joint: int, value: float, *, with_radians: bool = False) -> str:
        """Return a position of a joint with its unit: degrees of a revolute, metres of a
        prismatic one.
        """
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
            rad, rad/s, rad/s^2 (prismatic: m, ...).
        qddd : array [N,n], optional
            Where the rates of the torques are asked for, too; rad/s^3 (m/s^3).

        Returns
        -------
        dict
            "tau" [N,n], N m (N), and with ``qddd`` "taud" [N,n], N m/s (N/s).

        Raises
        ------
        InputError
            Other shapes, or no numbers.

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
        """Return the same robot with other limits: all of them, or those given by name.

        Parameters
        ----------
        limits : Limits or JointLimits, optional
            In the place of all that the robot has.
        **changes
            ``q_min``, ``q_max``, ``qd_max``, ``qdd_max``, ``qddd_max``, ``tau_max``, ``taud_max``,
            ``qd_min`` and so on, ``also``: in the place of these alone, given as in
            :class:`Limits`: a number for all joints, one a joint, or ``(lower, upper)``, in SI
            units. ``qd_max`` without ``qd_min`` means plus and
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
        """Return the same robot with other links (payload, model mismatch, rotor inertia)."""
        return replace(self, links=checked_links(links, self.link_count))

    def with_payload(
        self,
        mass: float,
        center_of_mass: ArrayLike = (0.0, 0.0, 0.0),
        inertia: ArrayLike | None = None,
    ) -> Robot:
        """Return the same robot holding a mass: part of its last link from then on.

        Parameters
        ----------
        mass : float
            kg; 0 is no payload.
        center_of_mass : array_like [3]
            Where, in the tool frame, m.
        inertia : array_like [3,3], optional
            About its centre of mass, along the axes of the tool frame, kg m^2; a point mass by
            default.

        Raises
        ------
        InputError
            A negative mass, an inertia that no body has, a place that is not finite, a robot
            without masses.

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
        """Return the same robot with these capsules around its links: what may touch obstacles.

        Parameters
        ----------
        capsules : mapping
            Frame, 0 for the base and 1 to n for the links, or the name of a link, to the capsules
            that are rigid in it, in its frame. :func:`~microbot_ocp.fit_capsules` and
            :func:`~microbot_ocp.robot.link_capsules` make such.

        Raises
        ------
        InputError
            A link that the robot does not have, what is no capsule.

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
        """Return the same robot with a part in its gripper, which may touch obstacles, too.

        Its mass is another matter: :meth:`with_payload`.

        Parameters
        ----------
        capsules : Capsule
            Around the part, in the tool frame, m; a sphere is a capsule without length. Without a
            name they are called "part".

        Raises
        ------
        InputError
            What is no capsule, or a robot without capsules of its own.

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
        turn, shift = self.tool[:3, :3], self.tool[:3, 3]
        held = list(self.capsules)
        for entry in capsules:
            if not isinstance(entry, Capsule):
                raise InputError(f"a part must be made of mo.Capsule, not {entry!r}")
            start, end = (turn @ end + shift for end in (entry.start, entry.end))
            held.append((self.link_count, Capsule(start, end, entry.radius, entry.name or "part")))
        return replace(self, capsules=tuple(held))

    def with_gravity(self, gravity: ArrayLike) -> Robot:
        """Return the same robot under another gravity vector [3], m/s^2, in the base frame."""
        return replace(self, gravity=checks.array("gravity", gravity, (3,), "m/s^2"))

    @cached_property
    def chain_digest(self) -> str:
        """Digest of joint types, rows, base and tool, 12 digits: of names, links or limits none."""
        digest = hashlib.sha256(repr(self.joint_types).encode())
        rows = self.alpha, self.a, self.d, self.theta_offset, self.beta
        for item in (*rows, self.base, self.tool):
            digest.update(np.ascontiguousarray(item + 0.0).tobytes())
        return digest.hexdigest()[:12]

    @cached_property
    def _digest(self) -> str:
        digest = hashlib.sha256(repr((self.name, self.joint_types, self.joint_names)).encode())
        rows = self.alpha, self.a, self.d, self.theta_offset
        arrays: list[ArrayLike] = [*rows, self.gravity, self.tool]
        arrays += [bound for key in JOINT_QUANTITIES for bound in self.limits.bounds(key)]
        for link in self.links:
            friction = link.viscous_friction, link.coulomb_friction
            arrays += [(link.mass, link.armature, *friction), link.center_of_mass, link.inertia]
        for joint, rotor, carrier in self.rotors:
            arrays += [(joint, rotor.inertia, rotor.gear_ratio, carrier), rotor.axis]
        arrays += [] if np.array_equal(self.base, np.eye(4)) else [self.base]
        arrays += [self.beta] if self.beta.any() else []
        if self.coupling is not None:
            digest.update(repr((self.coupling.names, self.coupling.types)).encode())
            arrays += [self.coupling.matrix, self.coupling.offsets]
        if self.disabled_pairs is not None:
            digest.update(repr(self.disabled_pairs).encode())
        for frame, capsule in self.capsules:
            digest.update(capsule.name.encode())
            arrays += [(frame, capsule.radius), capsule.start, capsule.end]
        for item in arrays:
            digest.update(np.array(item, dtype=float, order="C").tobytes())
        return digest.hexdigest()

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Robot)
            and self._digest == other._digest
            and self.limits.also == other.limits.also
        )

    def __hash__(self) -> int:
        return hash((self._digest, self.limits.also))


def _columns(**columns: Any) -> dict[str, Any]:
    """Return columns [n] of a table; zero where there is none."""
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


def _joint_limits(limits: Any, count: int) -> JointLimits:
    if not isinstance(limits, Limits | JointLimits):
        raise InputError(f"limits must be Limits, such as Limits(tau_max=100.0), not {limits!r}")
    return limits.for_joints(count)


def _warn_of_degrees(limits: JointLimits, joint_types: Sequence[str], keys: Iterable[str]) -> None:
    """Warn of limits of positions or velocities that look like degrees."""
    turning = [kind == "revolute" for kind in joint_types]
    for key in LOOSE.keys() & keys:
        angles = getattr(limits, key)[turning]
        if hint := checks.degrees_hint(angles, LOOSE[key]):
            warn_user(f"{key} is {angles.tolist()} rad{'/s' * key.startswith('qd')}{hint}")


def _check_units(name: str, table: Mapping[str, FloatArray]) -> None:
    """Refuse angles of more than a turn; warn of lengths that look like millimetres."""
    for key in ("alpha", "theta_offset", "beta"):
        if np.abs(table[key]).max() > 2 * np.pi * (1.0 + 1e-9):
            angles = table[key].tolist()
            raise InputError(
                f"{key} must be within a turn, in rad, not {angles}; of degrees "
                f"np.radians({angles})"
            )
    for key in ("a", "d"):
        if np.abs(table[key]).max() > checks.LONGEST_LINK:
            warn_user(f"{name}: {key} is {table[key].tolist()} m; that looks like millimetres")
