"""Limits along a given path as half planes in u = s'' and x = s'^2.

Along a path q(s) the torque is affine in both: ``tau = M q' u + (M q'' + C(q, q') q') x + g``.
Three batched calls of the inverse dynamics give the coefficients. Other limits are sampled at a few
(u, x) and are half planes if the samples are affine. A limit of the velocity alone bounds s'. All
remaining limits are left to the program on places.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.fast_calls import deferred_call
from microbot_ocp.limits import ROUNDING, LimitFamily, LimitValues, Member
from microbot_ocp.planning.path._curve import PathCurve, samples_along
from microbot_ocp.planning.task import DRY, VISCOUS, dry_friction, frictionless
from microbot_ocp.robot import COULOMB_SMOOTHING, Robot, inverse_dynamics

FAR = 1e12  # finite stand-in for infinity


LATER = "program on places"  # method for limits that reachability cannot keep


@dataclass(frozen=True, eq=False)
class Nodes:
    """Path derivatives at grid points; an inner break has two nodes, one for each side."""

    position: FloatArray
    tangent: FloatArray
    curvature: FloatArray
    right: np.ndarray  # node of the end of every interval; its start is the node of its own index


def nodes_of(path: PathCurve, s: FloatArray) -> Nodes:
    """Return position, tangent and curvature at grid points s [N+1], which include every break.

    The grid may begin and end inside of the path.
    """
    inner = np.searchsorted(s, path.breaks[1:-1])
    inner = inner[(inner > 0) & (inner < s.size)]
    # Nodes for the left side of inner breaks are appended behind the regular ones.
    tables = path.on_both_sides(s, inner)
    right = np.arange(1, s.size)
    right[inner - 1] = s.size + np.arange(inner.size)
    return Nodes(*tables, right=right)


class Coefficients(NamedTuple):
    """A limited quantity ``per_u u + per_x x + constant``, each [N,k], and its bounds [N,k]."""

    per_u: FloatArray
    per_x: FloatArray
    constant: FloatArray
    lower: FloatArray
    upper: FloatArray

    @classmethod
    def within(
        cls, bounds: Member | LimitValues, per_u: Any, per_x: Any, constant: Any
    ) -> Coefficients:
        """Return the coefficients of a quantity with the bounds of a limit at every node."""
        every = (np.broadcast_to(b, per_u.shape) for b in (bounds.lower, bounds.upper))
        return cls(per_u, per_x, constant, *every)


@dataclass(frozen=True, eq=False)
class PathLimits:
    """The limits of a robot at the nodes of a path, by the method that keeps them.

    Attributes
    ----------
    half_planes : mapping from the key of a limit to Coefficients
    speed : mapping from the key of a limit to array [N,k]
        Largest x = s'^2 allowed by each component.
    later : tuple of str
        Keys of the other limits, such as jerk or power, for the program on places.
    """

    family: LimitFamily
    half_planes: dict[str, Coefficients]
    speed: dict[str, FloatArray]
    later: tuple[str, ...]

    @classmethod
    def of(cls, family: LimitFamily, nodes: Nodes, fast: bool) -> PathLimits:
        """Classify the limits of a family along a path; raise InputError for limits of means."""
        family.refuse_means()
        half_planes, later = {}, []
        for member in family:
            key = member.key
            if key == "tau":
                torque = torque_coefficients(family.robot, nodes, fast)
                half_planes[key] = Coefficients.within(member, *torque)
            elif key == "qdd":
                shape = nodes.tangent, nodes.curvature, np.zeros_like(nodes.tangent)
                half_planes[key] = Coefficients.within(member, *shape)
            elif member.order == 2 and (planes := _half_planes(family, key, nodes)) is not None:
                half_planes[key] = planes
            elif member.order > 1:
                later.append(key)
        return cls(family, half_planes, _speed_limits(family, nodes), tuple(later))


def largest_speeds(family: LimitFamily, curve: PathCurve, s: FloatArray) -> FloatArray:
    """Return the limits of s' [N] at places s; infinite without a limit."""
    nodes = nodes_of(curve, s)
    most = least_bound(_speed_limits(family, nodes), nodes, s.size)
    return np.where(most < FAR, np.sqrt(most), np.inf)


def least_bound(bounds: Mapping[str, FloatArray], nodes: Nodes, count: int) -> FloatArray:
    """Return the least x [N+1] of all bounds at the grid points, over both sides of breaks."""
    per_node = np.full(len(nodes.tangent), FAR)
    for bound in bounds.values():
        per_node = np.minimum(per_node, bound.min(axis=1))
    return np.minimum(per_node[:count], np.append(FAR, per_node[nodes.right]))


def _speed_limits(family: LimitFamily, nodes: Nodes) -> dict[str, FloatArray]:
    """Return the largest x = s'^2 [N,k] that velocity limits allow, by their keys."""
    return {
        key: _velocity_bound(family, nodes) if key == "qd" else speed_bound(family, key, nodes)
        for key in family.of_order(1)
    }


def limits_kept_by(limits: PathLimits) -> dict[str, list[str]]:
    """Return the names of limits by the method that keeps them."""
    names = {
        "reachability": list(limits.half_planes),
        "speed bound": list(limits.speed),
        LATER: list(limits.later),
    }
    return {how: [limits.family[key].name for key in keys] for how, keys in names.items()}


def _along(family: LimitFamily, nodes: Nodes, key: str, u: Any, v: Any) -> LimitValues:
    """Return the values of a limit at the nodes for s'' = u and s' = v, numbers or [N]."""
    samples = samples_along((nodes.position, nodes.tangent, nodes.curvature), (v, u))
    return family.values(samples, [key])[key]


def torque_coefficients(robot: Robot, nodes: Nodes, fast: bool) -> tuple[FloatArray, ...]:
    """Return the torque per u, per x and at rest, each [N,n]; dry friction counts as at rest.

    docs/theory/path_timing.md, equation (2).
    """
    tau = deferred_call(inverse_dynamics(frictionless(robot)), compiled=fast)
    q, tangent, curvature = nodes.position, nodes.tangent, nodes.curvature
    zero = np.zeros_like(q)
    at_rest = tau(q, zero, zero)
    per_u, per_x = tau(q, zero, tangent) - at_rest, tau(q, tangent, curvature) - at_rest
    return per_u, per_x, at_rest + dry_friction(robot) * np.sign(nodes.tangent)


TRIED_RATES = ((-3.0, 0.7), (2.0, 1.9), (50.0, 4.0))  # s'' and s' at which a half plane is tested


def _half_planes(family: LimitFamily, key: str, nodes: Nodes) -> Coefficients | None:
    """Return a limit as half planes, or None if it is not affine in u and x."""
    rest = _along(family, nodes, key, 0.0, 0.0)
    with_u = _along(family, nodes, key, 1.0, 0.0)
    with_x = _along(family, nodes, key, 0.0, 1.0)
    per_u, per_x = with_u.value - rest.value, with_x.value - rest.value
    size = 1.0 + np.abs(rest.value) + np.abs(per_u) + np.abs(per_x)
    # Three samples determine the plane; further ones test that the limit is affine.
    for u, v in TRIED_RATES:
        tried = _along(family, nodes, key, u, v)
        line = rest.value + u * per_u + v**2 * per_x
        if np.any(np.abs(tried.value - line) > ROUNDING * size * (1 + abs(u) + v**2)):
            return None
        for bound, usual in ((tried.lower, rest.lower), (tried.upper, rest.upper)):
            if not np.array_equal(bound, usual):
                return None
    return Coefficients.within(rest, per_u, per_x, rest.value)


SCANNED_SPEEDS = 50  # speeds of the scan for the first that breaks a limit
BISECTIONS = 60  # halvings of the interval found by the scan


def speed_bound(family: LimitFamily, key: str, nodes: Nodes) -> FloatArray:
    """Find the largest x [N,1] up to which every speed keeps a limit, by bisection."""

    def within(v: FloatArray) -> np.ndarray:
        use = family[key].use(_along(family, nodes, key, 0.0, v)).max(axis=1)
        return use <= 1.0 + ROUNDING

    count = len(nodes.position)
    low, high = np.zeros(count), np.full(count, np.inf)
    # The scan finds the first speed that breaks the limit, bisection its exact value.
    fastest = np.sqrt(FAR)
    for v in np.geomspace(1.0 / fastest, fastest, SCANNED_SPEEDS):
        good, unknown = within(np.full(count, v)), np.isinf(high)
        low, high = np.where(unknown & good, v, low), np.where(unknown & ~good, v, high)
    free = np.isinf(high)
    high = np.where(free, low, high)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        good = within(middle)
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    return np.where(free, FAR, low**2)[:, None]


def _velocity_bound(family: LimitFamily, nodes: Nodes) -> FloatArray:
    """Return the largest x [N,n] that the joints' velocity limits allow."""
    member, tangent = family["qd"], nodes.tangent
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = np.where(tangent > 0, member.upper, member.lower) / tangent
        return np.minimum(np.where(np.abs(tangent) > 0, np.square(limit), np.inf), FAR)


NEGLIGIBLE = 1e-12  # value that counts as zero, per largest one


@dataclass(frozen=True, eq=False)
class LimitRows:
    """Limits ``lower <= per_u u + per_x x <= upper`` at nodes, one column per limit."""

    per_u: FloatArray
    per_x: FloatArray
    lower: FloatArray
    upper: FloatArray
    right: np.ndarray
    names: tuple[tuple[str, int], ...]  # key of the limit and component of each column

    @classmethod
    def of(cls, nodes: Nodes, limits: PathLimits) -> LimitRows:
        parts, names = [], []
        for key, planes in limits.half_planes.items():
            bounded = np.flatnonzero(
                (np.isfinite(planes.lower) | np.isfinite(planes.upper)).any(axis=0)
            )
            lower, upper = planes.lower - planes.constant, planes.upper - planes.constant
            parts.append(np.array([planes.per_u, planes.per_x, lower, upper])[..., bounded])
            names += [(key, int(j)) for j in bounded]
        tables = np.concatenate([np.zeros((4, len(nodes.position), 0)), *parts], axis=2)
        per_u = np.abs(tables[0])
        # Rounding leaves tiny coefficients of u where a joint's inertia along the path vanishes.
        tables[0, per_u < NEGLIGIBLE * per_u.max(axis=0, initial=0.0)] = 0.0
        return cls(*tables, right=nodes.right, names=tuple(names))

    @property
    def torques(self) -> tuple[np.ndarray, np.ndarray]:
        """Indices of the columns of torques, and their joints."""
        columns = [(i, j) for i, (key, j) in enumerate(self.names) if key == "tau"]
        table = np.array(columns, dtype=int).reshape(-1, 2)
        return table[:, 0], table[:, 1]

    def with_friction(self, nodes: Nodes, robot: Robot, x: FloatArray) -> LimitRows:
        """Return the rows with friction, linearised in x around the last timing.

        Friction depends on v = sqrt(x); its tangent in x has the slope df/dv / (2 v).
        docs/theory/path_timing.md, "Reachability".
        """
        at_nodes = np.zeros(len(self.per_u))
        at_nodes[: x.size], at_nodes[self.right] = x, x[1:]
        # A floor of x keeps the slope finite at stops.
        v = np.sqrt(np.maximum(at_nodes, ROUNDING * max(float(x.max()), NEGLIGIBLE)))[:, None]
        columns, joints = self.torques
        tangent = nodes.tangent[:, joints]
        viscous, dry = (robot.friction_of(kind)[joints] for kind in (VISCOUS, DRY))
        share = np.tanh(tangent * v / COULOMB_SMOOTHING)
        slope = tangent * (viscous + dry * (1.0 - share**2) / COULOMB_SMOOTHING) / (2.0 * v)
        # The coefficients already contain the full dry friction, which is subtracted here.
        constant = viscous * tangent * v + dry * (share - np.sign(tangent)) - slope * v**2
        # Friction is full right after a stop and zero at the stop: limits hold with both values.
        still = at_nodes[:, None] <= NEGLIGIBLE * float(x.max())
        least, most = np.minimum(constant, 0.0), np.maximum(constant, 0.0)
        per_x, lower, upper = self.per_x.copy(), self.lower.copy(), self.upper.copy()
        per_x[:, columns] += np.where(still, 0.0, slope)
        lower[:, columns] -= np.where(still, least, constant)
        upper[:, columns] -= np.where(still, most, constant)
        return replace(self, per_x=per_x, lower=lower, upper=upper)
