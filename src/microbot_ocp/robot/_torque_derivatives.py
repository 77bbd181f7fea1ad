"""First and second derivatives of joint torques and their rates, by analytical formulas.

The chain is a set of mass points at r, with velocities r' due to the joint velocities qd, and
virtual velocities r* due to virtual joint velocities nu. The virtual power ``nu . tau`` is the sum
of ``m r* . (r'' - g)``. Its derivatives with respect to a joint need only the moments of the links
outward of the joint, formed by r, r' and r* with r, and the wrench at the joint. The screw S of
joint k has the rates of change

``S* = w x S``, ``S' = v x S``, ``S'' = a x S + v x S'``

by the virtual velocity w, the velocity v and the acceleration a of the link inward of it. Every
entry of the second derivative is the sum of a few scalar products of S, S*, S' and S'' of an inner
joint with six vectors of an outer one. A torque rate is the time derivative of these expressions by
one sweep of forward differentiation, so third derivatives never appear. With 7 joints the formulas
have half of the operations of automatic differentiation.

A rotation of the outer chain is equivalent to a change of the motion of its base: Carpentier and
Mansard, "Analytical derivatives of rigid body dynamics algorithms", RSS 2018; Singh, Russell and
Wensing, "Efficient analytical derivatives of rigid-body dynamics using spatial vector algebra",
IEEE RA-L 7(2), 2022.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate, combinations_with_replacement, product
from typing import NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp.robot._dynamics import friction_torque
from microbot_ocp.robot._kinematics import constant_transform, joint_transform
from microbot_ocp.robot._model import Robot

FROM_JOINTS = 6  # automatic derivatives of fewer joints have fewer operations
_UNIT = ca.SX.eye(3)


class _SpatialVector(NamedTuple):
    """A screw (angular, linear) or a wrench (moment, force), about the base origin."""

    angular: ca.SX
    linear: ca.SX

    def __add__(self, other: _SpatialVector) -> _SpatialVector:  # type: ignore[override]
        return _SpatialVector(self.angular + other.angular, self.linear + other.linear)

    def times(self, factor: ca.SX | float) -> _SpatialVector:
        return _SpatialVector(factor * self.angular, factor * self.linear)

    def dot(self, other: _SpatialVector) -> ca.SX:
        return ca.dot(self.angular, other.angular) + ca.dot(self.linear, other.linear)

    def motion_cross(self, other: _SpatialVector) -> _SpatialVector:
        """Return the rate of a screw that moves with this one."""
        linear = ca.cross(self.angular, other.linear) + ca.cross(self.linear, other.angular)
        return _SpatialVector(ca.cross(self.angular, other.angular), linear)

    def force_cross(self, other: _SpatialVector) -> _SpatialVector:
        """Return the rate of a wrench that moves with this screw."""
        angular = ca.cross(self.angular, other.angular) + ca.cross(self.linear, other.linear)
        return _SpatialVector(angular, ca.cross(self.angular, other.linear))

    def moments(self, first: ca.SX, second: ca.SX) -> ca.SX:
        """Return the sum [3,3] of m x(r) r', x(r) = v + w x r, from the sums of m r and m r r'."""
        return self.linear @ first.T + ca.skew(self.angular) @ second

    def momentum(self, mass: ca.SX, first: ca.SX) -> ca.SX:
        """Return the sum of m x(r) over points r with the velocity x(r) of this screw: [3]."""
        return mass * self.linear + ca.cross(self.angular, first)


def _axial(matrix: ca.SX) -> ca.SX:
    """Return the sum of r x y from a matrix, the sum of y r'."""
    return ca.vertcat(
        matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]
    )


@dataclass
class _Moments:
    """Sums over the mass points of links: mass moments, moments of velocities, and the wrench."""

    mass: ca.SX
    first: ca.SX  # sum of m r
    second: ca.SX  # sum of m r r'
    velocity: ca.SX  # sum of m r'; the next is the sum of m r' r^T
    velocities: ca.SX
    virtual: ca.SX  # sum of m r*; the next is the sum of m r* r^T
    virtuals: ca.SX
    both: ca.SX  # sum of m r' x r*
    wrench: _SpatialVector

    def __add__(self, other: _Moments) -> _Moments:
        return _Moments(*(mine + vars(other)[name] for name, mine in vars(self).items()))

    def inertia(self, x: _SpatialVector) -> _SpatialVector:
        """Return the wrench for an acceleration screw x."""
        turned = ca.trace(self.second) * x.angular - self.second @ x.angular
        return _SpatialVector(
            ca.cross(self.first, x.linear) + turned, x.momentum(self.mass, self.first)
        )

    def coriolis(self, x: _SpatialVector) -> _SpatialVector:
        """Return the wrench's derivative with respect to the velocity, in the direction x."""
        turned = ca.trace(self.velocities) * x.angular - self.velocities @ x.angular
        return _SpatialVector(2 * turned, 2 * ca.cross(x.angular, self.velocity))

    def coriolis_transposed(self, x: _SpatialVector) -> _SpatialVector:
        turned = ca.trace(self.velocities) * x.angular - self.velocities.T @ x.angular
        return _SpatialVector(2 * (ca.cross(self.velocity, x.linear) + turned), ca.SX.zeros(3))

    def centripetal(self, x: _SpatialVector) -> _SpatialVector:
        """Return the derivative of the centripetal virtual power, quadratic in velocity."""
        symmetric = self.virtuals + self.virtuals.T - 2 * ca.trace(self.virtuals) * _UNIT
        angular = ca.cross(x.linear, self.virtual) + symmetric @ x.angular
        return _SpatialVector(angular, ca.cross(self.virtual, x.angular))


class _Link(NamedTuple):
    screw: _SpatialVector  # S
    rate: _SpatialVector  # S'
    second_rate: _SpatialVector  # S''
    virtual: _SpatialVector  # S*
    outside: _Moments  # sums over this link and all links outward


def _chain(
    robot: Robot, q: ca.SX, qd: ca.SX, qdd: ca.SX, nu: ca.SX, payload: ca.SX | None
) -> list[_Link]:
    rotation, origin = (ca.densify(part) for part in constant_transform(robot.base))
    zero, upward = ca.SX.zeros(3), ca.SX(ca.DM(-robot.gravity))
    v, a, w = _SpatialVector(zero, zero), _SpatialVector(zero, upward), _SpatialVector(zero, zero)
    screws: list[tuple[_SpatialVector, _SpatialVector, _SpatialVector, _SpatialVector]] = []
    moments_of: list[_Moments] = []
    for k, link in enumerate(robot.links):
        turn, step = joint_transform(robot, k, q[k])
        origin, rotation = origin + rotation @ step, rotation @ turn
        axis = ca.densify(rotation[:, 2])
        revolute = robot.joint_types[k] == "revolute"
        # Screw about the base origin: (z, p x z) of a revolute, (0, z) of a prismatic joint.
        screw = (
            _SpatialVector(axis, ca.cross(origin, axis)) if revolute else _SpatialVector(zero, axis)
        )
        rate = v.motion_cross(screw)
        screws.append(
            (screw, rate, a.motion_cross(screw) + v.motion_cross(rate), w.motion_cross(screw))
        )
        # The rates above need the motion inward of the joint; the sums below that of the link.
        v, w = v + screw.times(qd[k]), w + screw.times(nu[k])
        a = a + screw.times(qdd[k]) + rate.times(qd[k])
        center = ca.DM(link.center_of_mass)
        mass, local = ca.SX(link.mass), ca.SX(link.mass * center)
        # The second moment about the centre is tr(I)/2 - I for an inertia I.
        spread = ca.SX(ca.DM(0.5 * np.trace(link.inertia) * np.eye(3) - link.inertia))
        held = ca.SX(3, 3)
        if payload is not None and k == robot.joint_count - 1:
            tool = ca.DM(robot.tool[:3, 3])
            mass, local = mass + payload, local + payload * tool
            held = payload * tool @ tool.T
        arm = rotation @ local
        first = mass * origin + arm
        about_origin = spread + link.mass * center @ center.T + held
        crossed = arm @ origin.T
        second = rotation @ about_origin @ rotation.T + crossed + crossed.T
        second = second + mass * origin @ origin.T
        velocities, virtuals = v.moments(first, second), w.moments(first, second)
        velocity, virtual = v.momentum(mass, first), w.momentum(mass, first)
        # r* is w(r), so the sum of m r' x r* follows from the moment of r* with r.
        both = ca.cross(v.linear, virtual) + _axial(virtuals @ ca.skew(v.angular).T)
        # Mass points have r'' = a(r) + omega x r'; the spatial acceleration a contains -g.
        force = a.momentum(mass, first) + ca.cross(v.angular, velocity)
        moment = _axial(a.moments(first, second) + ca.skew(v.angular) @ velocities)
        wrench = _SpatialVector(moment, force)
        sums = mass, first, second, velocity, velocities, virtual, virtuals, both, wrench
        moments_of.append(_Moments(*sums))
    # A joint moves its link and all outward links, so their sums belong to it.
    outside = [*accumulate(reversed(moments_of), lambda outer, inner: inner + outer)]
    return [_Link(*parts, moments) for parts, moments in zip(screws, outside[::-1], strict=True)]


def torque_derivatives(
    robot: Robot, *, rates: bool = False, payload: bool = False
) -> tuple[ca.Function, ca.Function] | None:
    """Return first and second derivatives of the torques, or None if automatic ones are smaller.

    Parameters
    ----------
    robot : Robot
    rates : bool
        True for torques stacked with torque rates, as in :func:`torque_and_rate`; False for
        torques alone.
    payload : bool
        True to add the mass of a point at the tool, kg, as the last argument; derivatives with
        respect to it are zero.

    Returns
    -------
    tuple of casadi.Function
        With arguments a = q, qd, qdd (qddd, payload): ``first_derivatives(a...) -> values,
        Jacobian`` and ``second_derivatives(a..., weights) -> gradient, Hessian`` of the weighted
        sum of all values.
    """
    return _derivatives(robot, rates, payload) if has_torque_derivatives(robot) else None


def has_torque_derivatives(robot: Robot) -> bool:
    """Return True if :func:`torque_derivatives` are smaller than automatic ones."""
    alone = robot.coupling is None and not robot.rotors
    return robot.joint_count >= FROM_JOINTS and alone


@lru_cache(maxsize=16)
def _derivatives(robot: Robot, rates: bool, payload: bool) -> tuple[ca.Function, ca.Function]:
    n = robot.joint_count
    names = "q", "qd", "qdd", "qddd", "nu", "pull"
    q, qd, qdd, qddd, nu, pull = (ca.SX.sym(name, n) for name in names)
    held = [ca.SX.sym("payload")] if payload else []
    first, second = _terms(robot, q, qd, qdd, nu, *held)
    state, weights, values, slopes = [q, qd, qdd], nu, [first[()]], [first]
    if rates:
        change = _along(state, [qd, qdd, qddd], first)
        values.append(first[(0,)] @ qd + first[(1,)] @ qdd + first[(2,)] @ qddd)
        slopes.append({(k,): _of_rate((k,), first, change) for k in range(4)})
        # d/dt (nu . tau) = nu . taud + nud . tau: pull = nud weights the torques, nu their rates.
        change = _along([*state, nu], [qd, qdd, qddd, pull], second)
        weights = ca.vertcat(pull, nu)
        keys = [*product(range(4)), *combinations_with_replacement(range(4), 2)]
        second = {key: _of_rate(key, second, change) for key in keys}
        state = [*state, qddd]
    inputs, orders = [*state, *held], range(len(state))
    size = sum(k.shape[0] for k in inputs)
    matrix = ca.SX(size, size)
    for i, k in combinations_with_replacement(orders, 2):
        block = second.get((i, k), ca.SX(n, n))
        matrix[i * n : (i + 1) * n, k * n : (k + 1) * n] = block
        matrix[k * n : (k + 1) * n, i * n : (i + 1) * n] = block.T
    rows = ca.blockcat([[terms.get((k,), ca.SX(n, n)) for k in orders] for terms in slopes])
    rows = ca.horzcat(rows, ca.SX(rows.shape[0], len(held)))
    slope = ca.densify(ca.vertcat(*(second[(k,)] for k in orders), ca.SX(len(held), 1)))
    return (
        ca.Function("first_derivatives", inputs, ca.cse([ca.densify(ca.vertcat(*values)), rows])),
        ca.Function("second_derivatives", [*inputs, weights], ca.cse([slope, matrix])),
    )


# A term by the orders of the variables of its derivative: (0, 1) is that by q and qd.
Terms = dict[tuple[int, ...], ca.SX]


def _of_rate(key: tuple[int, ...], terms: Terms, change: Terms) -> ca.SX:
    """Return a derivative of df/dt from derivatives of f, ``terms``, and their rates of change.

    The derivative of df/dt by qdd is the rate of change of that of f by qdd, plus that by qd.
    """
    zero = ca.SX(1, 1)

    def term(known: Terms, key: tuple[int, ...]) -> ca.SX:
        return known[key] if key in known else known.get(key[::-1], zero).T

    lower = ((*key[:p], order - 1, *key[p + 1 :]) for p, order in enumerate(key) if order)
    return term(change, key) + sum((term(terms, each) for each in lower), zero)


def _along(names: list[ca.SX], rates: list[ca.SX], terms: Terms) -> Terms:
    """Return time derivatives of all terms."""
    flat = ca.vertcat(*(ca.vec(ca.densify(term)) for term in terms.values()))
    change = ca.jtimes(flat, ca.vertcat(*names), ca.vertcat(*rates))
    edges = np.cumsum([0, *(term.numel() for term in terms.values())]).tolist()
    return {
        name: ca.reshape(change[a:b], *term.shape)
        for (name, term), a, b in zip(terms.items(), edges[:-1], edges[1:], strict=True)
    }


def _terms(
    robot: Robot, q: ca.SX, qd: ca.SX, qdd: ca.SX, nu: ca.SX, payload: ca.SX | None = None
) -> tuple[Terms, Terms]:
    """Return torques with their Jacobians, and first and second derivatives of nu . tau.

    The second derivatives with respect to qd and qdd, and twice to qdd, are zero.
    """
    links = _chain(robot, q, qd, qdd, nu, payload)
    n = robot.joint_count
    armature = ca.SX(ca.DM([link.armature for link in robot.links]))
    friction = friction_torque(robot, qd)
    slope = ca.jacobian(friction, qd)
    tau, by_q, by_qd, by_qdd = friction + armature * qdd, ca.SX(n, 1), slope.T @ nu, armature * nu
    tau_q, tau_qd, tau_qdd = ca.SX(n, n), slope, ca.diag(armature)
    q_q, q_qd, qd_qd, q_qdd = ca.SX(n, n), ca.SX(n, n), ca.jacobian(by_qd, qd), ca.SX(n, n)
    for k, (screw, rate, second_rate, virtual, outside) in enumerate(links):
        momentum, wrench = _SpatialVector(_axial(outside.virtuals), outside.virtual), outside.wrench
        gyration = _SpatialVector(2 * outside.both, ca.SX.zeros(3))
        # All entries are scalar products of vectors of the outer joint k with S, S', S'' and S* of
        # the inner joints i.
        with_screw = outside.inertia(screw)
        coriolis, backward = outside.coriolis(screw), outside.coriolis_transposed(screw)
        carried = screw.force_cross(momentum)
        with_virtual = outside.inertia(virtual) + carried
        with_rate = (
            outside.coriolis_transposed(virtual)
            + rate.force_cross(momentum)
            + screw.force_cross(gyration)
            + outside.centripetal(rate)
        )
        change = screw.force_cross(wrench) + outside.inertia(second_rate) + outside.coriolis(rate)
        drag = outside.inertia(rate).times(2) + coriolis
        curvature = carried + outside.centripetal(screw)
        tau[k] += screw.dot(wrench)
        by_q[k] = virtual.dot(wrench) + second_rate.dot(momentum) + rate.dot(gyration)
        by_qd[k] += 2 * rate.dot(momentum) + screw.dot(gyration)
        by_qdd[k] += screw.dot(momentum)
        for i, inner in enumerate(links[: k + 1]):
            across = inner.screw.dot(with_screw)
            bend = inner.screw.dot(curvature)
            tau_q[i, k] = inner.screw.dot(change)
            tau_qd[i, k] += inner.screw.dot(drag)
            tau_qdd[i, k] += across
            qd_qd[i, k] += bend
            q_q[i, k] = (
                inner.virtual.dot(change)
                + inner.second_rate.dot(with_virtual)
                + inner.rate.dot(with_rate)
            )
            q_qd[i, k] = inner.virtual.dot(drag) + inner.rate.dot(curvature)
            q_qdd[i, k] = inner.virtual.dot(with_screw)
            # The entries [k, i] follow: symmetric blocks are copied, others have further products.
            if i < k:
                tau_qdd[k, i], qd_qd[k, i], q_q[k, i] = across, bend, q_q[i, k]
                tau_q[k, i] = inner.second_rate.dot(with_screw) + inner.rate.dot(backward)
                tau_qd[k, i] = 2 * inner.rate.dot(with_screw) + inner.screw.dot(backward)
                q_qd[k, i] = 2 * inner.rate.dot(with_virtual) + inner.screw.dot(with_rate)
                q_qdd[k, i] = inner.screw.dot(with_virtual)
    gradient = {(0,): by_q, (1,): by_qd, (2,): by_qdd}
    hessian = {(0, 0): q_q, (0, 1): q_qd, (1, 1): qd_qd, (0, 2): q_qdd}
    return {(): tau, (0,): tau_q, (1,): tau_qd, (2,): tau_qdd}, gradient | hessian
