"""Dynamics of a serial chain as CasADi functions, by recursive Newton-Euler.

``M(q) qdd + C(q, qd) qd + g(q) + friction(qd) = tau``

Sources: Craig, *Introduction to Robotics*, 3rd ed., section 6.5 (recursive Newton-Euler in link
frames; the moment balance is ``n_i = N_i + R n_{i+1} + Pc_i x F_i + P_{i+1} x (R f_{i+1})``);
Featherstone, *Rigid Body Dynamics Algorithms*, chapter 6 (composite rigid bodies).
Joint friction is ``viscous qd + coulomb tanh(qd / 0.01)``: a sign function smoothed to be
differentiable, within 1 % of its full value beyond 0.027 rad/s (m/s). Armature adds to the diagonal
of M. A rotor of inertia J that spins G times as fast as joint j, about the axis a of a link with
angular velocity omega, adds the angular momentum ``J G qd_j a`` to that of the link; its rate of
change is a moment on the link, and ``J G (a . omega_dot + G qdd_j)`` is the torque at the joint.

Theory: docs/theory/dynamics.md, equations (2) to (8).
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NoReturn

import casadi as ca

from microbot_ocp._base.checks import InputError
from microbot_ocp.robot._function import function_maker, robot_function, symbols
from microbot_ocp.robot._kinematics import (
    chain_motion,
    constant,
    constant_transform,
    forward_kinematics,
    frames,
    jacobian,
    joint_transform,
    link_poses,
    selection,
)
from microbot_ocp.robot._model import Robot

COULOMB_SMOOTHING = 0.01  # rad/s or m/s; at this speed tanh is 76 % of the Coulomb friction


def _require_links(robot: Robot) -> None:
    if not robot.has_dynamics:
        raise InputError(f"robot {robot.name!r} has no links with masses, so it has no dynamics")


def _cross(left: ca.SX, right: ca.SX) -> ca.SX:
    return ca.sparsify(ca.cross(ca.densify(left), ca.densify(right)))


def friction_torque(robot: Robot, qd: ca.SX) -> ca.SX:
    """Return friction torques [n], each a function of the speed of its own joint."""
    kinds = (robot.friction_of(kind) for kind in ("viscous_friction", "coulomb_friction"))
    viscous, coulomb = map(constant, kinds)
    return viscous * qd + coulomb * ca.tanh(qd / COULOMB_SMOOTHING)


def _newton_euler(robot: Robot, q: ca.SX, qd: ca.SX, qdd: ca.SX, *, friction: bool = True) -> ca.SX:
    """Return joint torques [n] by the outward and inward recursions of Craig, section 6.5."""
    _require_links(robot)
    if robot.coupling is not None:
        motion = chain_motion(robot, q, qd, qdd)
        total = selection(robot).T @ _newton_euler(robot.chain, *motion, friction=False)
        return total + friction_torque(robot, qd) if friction else total
    count = robot.joint_count
    # Gravity acts as an upward acceleration of the base, here expressed in frame 0 of the rows.
    acceleration = ca.sparsify(constant_transform(robot.base)[0].T @ constant(-robot.gravity))
    omega, omega_dot = ca.SX(3, 1), ca.SX(3, 1)
    turns, steps, forces, moments, spins = [], [], [], [], [(omega, omega_dot)]
    for joint, link in enumerate(robot.links):
        turn, step = joint_transform(robot, joint, q[joint])
        # Craig (6.47): acceleration of this origin by the rotation of the link before.
        acceleration = turn.T @ (
            acceleration + _cross(omega_dot, step) + _cross(omega, _cross(omega, step))
        )
        omega, omega_dot = turn.T @ omega, turn.T @ omega_dot
        speed = ca.sparsify(ca.vertcat(0, 0, qd[joint]))
        change = ca.sparsify(ca.vertcat(0, 0, qdd[joint]))
        if robot.joint_types[joint] == "revolute":
            omega_dot = omega_dot + _cross(omega, speed) + change
            omega = omega + speed
        else:
            acceleration = acceleration + 2 * _cross(omega, speed) + change
        com = constant(link.center_of_mass)
        inertia = constant(link.inertia)
        # Craig (6.48) to (6.50): acceleration of the centre of mass, force, and moment.
        at_com = acceleration + _cross(omega_dot, com) + _cross(omega, _cross(omega, com))
        force = link.mass * at_com
        moment = inertia @ omega_dot + _cross(omega, inertia @ omega) + _cross(com, force)
        turns.append(turn)
        steps.append(step)
        forces.append(force)
        moments.append(moment)
        spins.append((omega, omega_dot))
    torque: list[ca.SX] = [link.armature * qdd[joint] for joint, link in enumerate(robot.links)]
    # Theory (5): the spin J G qd_j a of a rotor adds to the angular momentum of its carrier.
    for joint, rotor, carrier in robot.rotors:
        omega, omega_dot = spins[carrier]
        axis = constant(rotor.axis)
        spin = rotor.inertia * rotor.gear_ratio
        torque[joint] += spin * (ca.dot(axis, omega_dot) + rotor.gear_ratio * qdd[joint])
        if carrier:
            change = qdd[joint] * axis + qd[joint] * _cross(omega, axis)
            moments[carrier - 1] = moments[carrier - 1] + spin * change
    # Craig (6.51) to (6.53): the loads of outer links are carried inward, joint by joint.
    force, moment = ca.SX(3, 1), ca.SX(3, 1)
    for joint in reversed(range(count)):
        if joint + 1 < count:
            carried = turns[joint + 1] @ force
            moment = turns[joint + 1] @ moment + _cross(steps[joint + 1], carried)
            force = carried
        force = forces[joint] + force
        moment = moments[joint] + moment
        torque[joint] += _axis_component(robot, joint, force, moment)
    total = ca.vertcat(*torque)
    return total + friction_torque(robot, qd) if friction else total


def _mass_matrix(robot: Robot, q: ca.SX) -> ca.SX:
    """Return the mass matrix [n,n] by composite rigid bodies, carried inward in link frames."""
    _require_links(robot)
    if robot.coupling is not None:
        inner = _mass_matrix(robot.chain, *chain_motion(robot, q))
        return selection(robot).T @ inner @ selection(robot)
    count = robot.joint_count
    transforms = [joint_transform(robot, joint, q[joint]) for joint in range(count)]
    matrix = ca.SX(count, count)
    mass, first, second = ca.SX(0), ca.SX(3, 1), ca.SX(3, 3)
    for joint in reversed(range(count)):
        link = robot.links[joint]
        com = constant(link.center_of_mass)
        # All three sums refer to the origin of this link frame.
        inertia = constant(link.inertia) + link.mass * _parallel_axis(com)
        mass, first, second = mass + link.mass, first + link.mass * com, second + inertia
        # Theory (6): force and moment that accelerate the composite body by 1 about or along Z.
        axis = constant([0, 0, 1])
        if robot.joint_types[joint] == "revolute":
            force, moment = _cross(axis, first), second @ axis
        else:
            force, moment = mass * axis, _cross(first, axis)
        matrix[joint, joint] = (
            _axis_component(robot, joint, force, moment) + robot.links[joint].armature
        )
        # The load at each inner joint is an entry M_ij, j < i.
        for outer in range(joint, 0, -1):
            turn, step = transforms[outer]
            force = turn @ force
            moment = turn @ moment + _cross(step, force)
            entry = _axis_component(robot, outer - 1, force, moment)
            matrix[joint, outer - 1] = matrix[outer - 1, joint] = entry
        turn, step = transforms[joint]
        turned = turn @ first
        second = turn @ second @ turn.T
        second = second + _shift(turned, step) + mass * _parallel_axis(step)
        first = turned + mass * step
    # Theory (5): J G^2 on the diagonal, J G a . Z_i for each revolute joint that turns the carrier.
    for joint, rotor, carrier in robot.rotors:
        spin = rotor.inertia * rotor.gear_ratio
        matrix[joint, joint] += spin * rotor.gear_ratio
        axis = constant(rotor.axis)
        for outer in range(carrier - 1, -1, -1):
            if robot.joint_types[outer] == "revolute":
                coupling = spin * ca.densify(axis)[2]
                matrix[outer, joint] += coupling
                matrix[joint, outer] += coupling
            axis = transforms[outer][0] @ axis
    return matrix


def _parallel_axis(offset: ca.SX) -> ca.SX:
    """Return the inertia of a unit mass at ``offset``: |r|^2 I - r r'."""
    return ca.sparsify(ca.dot(offset, offset) * ca.SX.eye(3) - offset @ offset.T)


def _shift(first: ca.SX, step: ca.SX) -> ca.SX:
    """Return the change of an inertia by a first moment when the origin moves by ``-step``."""
    outer = first @ step.T
    return ca.sparsify(2 * ca.dot(first, step) * ca.SX.eye(3) - outer - outer.T)


def _axis_component(robot: Robot, joint: int, force: ca.SX, moment: ca.SX) -> ca.SX:
    along = moment if robot.joint_types[joint] == "revolute" else force
    return ca.densify(along)[2]


@function_maker
def inverse_dynamics(robot: Robot, *, compiled: bool = False) -> ca.Function:
    """Return the joint torques of a motion, by recursive Newton-Euler (Craig, section 6.5).

    Returns
    -------
    casadi.Function
        ``(q[n], qd[n], qdd[n]) -> tau[n]``, rad, rad/s, rad/s^2 -> N m (prismatic: m -> N).

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> tau = mo.inverse_dynamics(mo.load_robot("microbot"))
    >>> [round(v, 6) for v in tau([0, 0, 0], [0, 0, 0], [0, 0, 0]).full().ravel().tolist()]
    [0.0, 196.0, 78.4]
    """
    state = symbols(robot, "q", "qd", "qdd")
    tau = _newton_euler(robot, *state.values())
    return robot_function("inverse_dynamics", state, {"tau": tau}, compiled)


@function_maker
def mass_matrix(robot: Robot, *, compiled: bool = False) -> ca.Function:
    """Return the mass matrix ``(q[n]) -> M[n,n]``, kg m^2, with rotor inertia on the diagonal."""
    state = symbols(robot, "q")
    return robot_function("mass_matrix", state, {"M": _mass_matrix(robot, **state)}, compiled)


@function_maker
def coriolis_matrix(robot: Robot, *, compiled: bool = False) -> ca.Function:
    """Return the Coriolis and centrifugal matrix ``(q[n], qd[n]) -> C[n,n]`` (Christoffel symbols).

    With this choice ``dM/dt - 2 C`` is skew-symmetric. Friction is not included.
    """
    state = symbols(robot, "q", "qd")
    q, qd = state.values()
    matrix = ca.densify(_mass_matrix(robot, q))
    rate = ca.jtimes(matrix, q, qd)
    slope = ca.jacobian(matrix @ qd, q)
    return robot_function("coriolis_matrix", state, {"C": (rate + slope - slope.T) / 2}, compiled)


@function_maker
def gravity_torque(robot: Robot, *, compiled: bool = False) -> ca.Function:
    """Return the torque that holds the arm still: ``(q[n]) -> tau[n]``, N m."""
    state, zero = symbols(robot, "q"), ca.SX(robot.joint_count, 1)
    tau = _newton_euler(robot, state["q"], zero, zero, friction=False)
    return robot_function("gravity_torque", state, {"tau": tau}, compiled)


@function_maker
def bias_torque(robot: Robot, *, compiled: bool = False) -> ca.Function:
    """Return the torque without acceleration, C qd + g + friction: ``(q[n], qd[n]) -> tau[n]``."""
    state = symbols(robot, "q", "qd")
    tau = _newton_euler(robot, state["q"], state["qd"], ca.SX(robot.joint_count, 1))
    return robot_function("bias_torque", state, {"tau": tau}, compiled)


def solve_symmetric(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Return the solution of ``matrix x = right`` for a positive definite matrix, by L D L'."""
    return ca.ldl_solve(right, *ca.ldl(ca.densify(matrix), False))


@function_maker
def forward_dynamics(robot: Robot, *, compiled: bool = False) -> ca.Function:
    """Return the accelerations that torques cause: ``(q[n], qd[n], tau[n]) -> qdd[n]``.

    The result is undefined where the mass matrix is singular (massless directions, as the Microbot
    standing straight up): see :func:`mass_matrix_condition`, or give the links ``armature``.
    """
    state = symbols(robot, "q", "qd", "tau")
    q, qd, tau = state.values()
    bias = _newton_euler(robot, q, qd, ca.SX(robot.joint_count, 1))
    qdd = solve_symmetric(_mass_matrix(robot, q), tau - bias)
    return robot_function("forward_dynamics", state, {"qdd": qdd}, compiled)


@function_maker
def mass_matrix_condition(robot: Robot, *, compiled: bool = False) -> ca.Function:
    """Return the 1-norm condition number of the mass matrix: ``(q[n]) -> condition``."""
    state = symbols(robot, "q")
    matrix = ca.densify(_mass_matrix(robot, **state))
    inverse = solve_symmetric(matrix, ca.SX.eye(robot.joint_count))
    condition = ca.norm_inf(ca.sum1(ca.fabs(matrix))) * ca.norm_inf(ca.sum1(ca.fabs(inverse)))
    condition = ca.if_else(condition > 0, condition, ca.inf)  # a zero pivot may give 0/0
    return robot_function("mass_matrix_condition", state, {"condition": condition}, compiled)


@function_maker
def energy(robot: Robot, *, compiled: bool = False) -> ca.Function:
    """Return the mechanical energy: ``(q[n], qd[n]) -> kinetic, potential``, J.

    The potential energy is zero at the base origin; kinetic energy includes rotor inertia.
    """
    state = symbols(robot, "q", "qd")
    q, qd = state.values()
    kinetic = 0.5 * ca.dot(qd, ca.densify(_mass_matrix(robot, q)) @ qd)
    gravity, potential = constant(robot.gravity), ca.SX(0)
    for link, (rotation, origin) in zip(robot.links, frames(robot, q), strict=False):
        com = origin + rotation @ constant(link.center_of_mass)
        potential = potential - link.mass * ca.dot(gravity, com)
    energies = {"kinetic": kinetic, "potential": potential}
    return robot_function("energy", state, energies, compiled)


@function_maker
def torque_and_rate(robot: Robot) -> ca.Function:
    """Return the torque and its exact time derivative along a motion.

    Returns
    -------
    casadi.Function
        ``(q[n], qd[n], qdd[n], qddd[n]) -> tau[n], taud[n]``, N m and N m/s.
    """
    state = symbols(robot, "q", "qd", "qdd", "qddd")
    every = [*state.values()]
    tau = inverse_dynamics(robot)(*every[:3])
    taud = ca.densify(ca.jtimes(tau, ca.vertcat(*every[:3]), ca.vertcat(*every[1:])))
    return ca.Function("torque_and_rate", every, [tau, taud], [*state], ["tau", "taud"])


# Quantities for limits ----------------------------------------------------------------------------


class MotionState:
    """Quantities of a motion at one instant; each is built at its first use.

    Attributes
    ----------
    q, qd, qdd, qddd : expression [n]
        Joint positions and their derivatives, rad, rad/s, rad/s^2, rad/s^3 (prismatic: m, ...).
    tau, taud : expression [n]
        Joint torques and their time derivatives, N m and N m/s (N, N/s).
    tool : expression [4,4]
        Pose of the tool in the base frame.
    tool_velocity, tool_acceleration, tool_jerk : expression [6]
        Velocity, acceleration and jerk of the tool's origin: linear (m/s, m/s^2, m/s^3), followed
        by angular (rad/s, ...), in the base frame.
    link_poses : tuple of expression [4,4]
        Poses of the base and of link frames 1 to N in the base frame.
    """

    def __init__(
        self, robot: Robot, q: Any, qd: Any, qdd: Any, qddd: Any, torques: ca.Function | None = None
    ) -> None:
        """Use ``torques``, a function of equal arguments, instead of :func:`torque_and_rate`."""
        self.robot, self.q, self.qd, self.qdd, self.qddd = robot, q, qd, qdd, qddd
        self._torques = torques

    def __getattr__(self, name: str) -> NoReturn:
        raise AttributeError(
            f"a motion's state has no {name!r}, it has q, qd, qdd, qddd, tau, taud, tool, "
            "tool_velocity, tool_acceleration, tool_jerk, link_poses"
        )

    @cached_property
    def _torque_and_rate(self) -> Any:
        torques = self._torques or torque_and_rate(self.robot)
        return torques(self.q, self.qd, self.qdd, self.qddd)

    @cached_property
    def tau(self) -> Any:
        """Joint torques [n], N m (N)."""
        if self._torques is None and "_torque_and_rate" not in self.__dict__:
            return inverse_dynamics(self.robot)(self.q, self.qd, self.qdd)
        return self._torque_and_rate[0]

    @cached_property
    def taud(self) -> Any:
        """Time derivatives of the joint torques [n], N m/s (N/s)."""
        return self._torque_and_rate[1]

    @cached_property
    def tool(self) -> Any:
        """Pose of the tool [4,4], m."""
        return forward_kinematics(self.robot)(self.q)

    @cached_property
    def link_poses(self) -> tuple[Any, ...]:
        """Poses [4,4] of the base and every link frame, m."""
        return tuple(ca.horzsplit(link_poses(self.robot)(self.q), 4))

    @cached_property
    def tool_velocity(self) -> Any:
        """Velocity of the tool [6], m/s and rad/s."""
        return jacobian(self.robot)(self.q) @ self.qd

    @cached_property
    def tool_acceleration(self) -> Any:
        """Acceleration of the tool [6], m/s^2 and rad/s^2."""
        return tool_acceleration(self.robot)(self.q, self.qd, self.qdd)

    @cached_property
    def tool_jerk(self) -> Any:
        """Jerk of the tool [6], m/s^3 and rad/s^3."""
        return tool_jerk(self.robot)(self.q, self.qd, self.qdd, self.qddd)


@function_maker
def tool_acceleration(robot: Robot) -> ca.Function:
    """Return the tool's acceleration: ``(q[n], qd[n], qdd[n]) -> a[6]``, linear and angular."""
    q, qd, _ = state = [*symbols(robot, "q", "qd", "qdd").values()]
    return _derivative("tool_acceleration", jacobian(robot)(q) @ qd, state)


@function_maker
def tool_jerk(robot: Robot) -> ca.Function:
    """Return the tool's jerk: ``(q[n], qd[n], qdd[n], qddd[n]) -> j[6]``, linear and angular."""
    *before, _ = state = [*symbols(robot, "q", "qd", "qdd", "qddd").values()]
    return _derivative("tool_jerk", tool_acceleration(robot)(*before), state)


def _derivative(name: str, value: Any, state: list[ca.SX]) -> ca.Function:
    """Return the time derivative of an expression of all parts of a state but the last."""
    change = ca.jtimes(value, ca.vertcat(*state[:-1]), ca.vertcat(*state[1:]))
    return ca.Function(name, state, [ca.densify(change)])
