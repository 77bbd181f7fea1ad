"""Limits along a given path as half planes in u = s'' and x = s'^2.

Along a path q(s) the torque is affine in both: ``tau = M q' u + (M q'' + C(q, q') q') x + g``. The
coefficients come from three batched calls of the inverse dynamics.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.fast_calls import buffered_call
from microbot_ocp.planning._curve import Curve
from microbot_ocp.robot import JointLimits, Robot, inverse_dynamics

FAR = 1e12  # stands for "no such limit"


@dataclass(frozen=True, eq=False)
class Nodes:
    """Path derivatives and torque coefficients at grid points; breaks stand there twice."""

    position: FloatArray
    tangent: FloatArray
    curvature: FloatArray
    left: np.ndarray  # index of the start of every interval
    right: np.ndarray  # index of its end


def nodes_of(path: Curve, s: FloatArray) -> Nodes:
    """Position, tangent and curvature at grid points s [N+1], among them every break."""
    inner = np.flatnonzero(np.isin(s, path.breaks[1:-1]))
    # the left side of every inner break follows behind the regular nodes
    sides = path.evaluate(s), path.evaluate(s[inner], from_left=True)
    tables = [np.vstack(pair) for pair in zip(*sides, strict=True)]
    right = np.arange(1, s.size)
    right[inner - 1] = s.size + np.arange(inner.size)
    return Nodes(*tables, left=np.arange(s.size - 1), right=right)


def torque_coefficients(robot: Robot, nodes: Nodes, fast: bool) -> tuple[FloatArray, ...]:
    """Torque per u, per x and at rest, each [N,n]; Coulomb friction counts as at rest."""
    smooth = robot.with_links(
        [replace(k, viscous_friction=0.0, coulomb_friction=0.0) for k in robot.links]
    )
    tau = buffered_call(inverse_dynamics(smooth, compiled=fast).map(len(nodes.position)))
    q, tangent, curvature = nodes.position.T, nodes.tangent.T, nodes.curvature.T
    zero = np.zeros_like(q)
    at_rest = tau(q, zero, zero).T
    per_u = tau(q, zero, tangent).T - at_rest
    per_x = tau(q, tangent, curvature).T - at_rest
    coulomb = np.array([link.coulomb_friction for link in robot.links])
    return per_u, per_x, at_rest + coulomb * np.sign(nodes.tangent)


@dataclass(frozen=True, eq=False)
class LimitRows:
    """Limits ``lower <= per_u u + per_x x <= upper`` at nodes, one column a limit."""

    per_u: FloatArray
    per_x: FloatArray
    lower: FloatArray
    upper: FloatArray
    left: np.ndarray
    right: np.ndarray
    torque_joints: np.ndarray

    @classmethod
    def of(
        cls, nodes: Nodes, coefficients: tuple[FloatArray, ...], limits: JointLimits
    ) -> LimitRows:
        per_u, per_x, at_rest = coefficients
        torque = np.flatnonzero(np.isfinite(limits.tau_min) | np.isfinite(limits.tau_max))
        bounded = np.flatnonzero(np.isfinite(limits.qdd_min) | np.isfinite(limits.qdd_max))
        zero = np.zeros((per_u.shape[0], bounded.size))
        return cls(
            per_u=np.hstack([per_u[:, torque], nodes.tangent[:, bounded]]),
            per_x=np.hstack([per_x[:, torque], nodes.curvature[:, bounded]]),
            lower=np.hstack(
                [limits.tau_min[torque] - at_rest[:, torque], zero + limits.qdd_min[bounded]]
            ),
            upper=np.hstack(
                [limits.tau_max[torque] - at_rest[:, torque], zero + limits.qdd_max[bounded]]
            ),
            left=nodes.left,
            right=nodes.right,
            torque_joints=torque,
        )

    def with_viscous(
        self, nodes: Nodes, viscous: FloatArray, x: FloatArray, limits: JointLimits
    ) -> LimitRows:
        """Viscous friction ``f q' sqrt(x)``, linear in x around the timing found last."""
        at_nodes = self._spread(x)
        root = np.sqrt(np.maximum(at_nodes, 1e-9 * max(float(x.max()), 1e-12)))[:, None]
        joints = self.torque_joints
        slope = viscous[joints] * nodes.tangent[:, joints] / (2 * root)
        per_x, lower, upper = self.per_x.copy(), self.lower.copy(), self.upper.copy()
        per_x[:, : joints.size] += slope
        constant = slope * root**2
        lower[:, : joints.size] -= constant
        upper[:, : joints.size] -= constant
        return replace(self, per_x=per_x, lower=lower, upper=upper)

    def _spread(self, x: FloatArray) -> FloatArray:
        """Values at grid points, repeated for the left sides of breaks."""
        full = np.zeros(self.per_u.shape[0])
        full[: x.size] = x
        full[self.right] = x[1:]
        return full

    def half_planes(self, step: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """``p x_i + q x_{i+1} <= h``, each [N, 4 rows], at both ends of every interval."""
        half = 1.0 / (2.0 * step)[:, None]
        at_left = self.per_u[self.left] * half
        at_right = self.per_u[self.right] * half
        p = np.hstack([self.per_x[self.left] - at_left, -at_right])
        q = np.hstack([at_left, self.per_x[self.right] + at_right])
        low = np.hstack([self.lower[self.left], self.lower[self.right]])
        high = np.hstack([self.upper[self.left], self.upper[self.right]])
        return np.hstack([p, -p]), np.hstack([q, -q]), np.hstack([high, -low])


def speed_bounds(nodes: Nodes, limits: JointLimits, count: int) -> FloatArray:
    """Largest x [N+1] that the velocity limits leave at the grid points."""
    tangent = nodes.tangent
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = np.where(tangent > 0, limits.qd_max, limits.qd_min) / tangent
        per_joint = np.where(np.abs(tangent) > 0, np.square(limit), np.inf)
    per_node = np.minimum(per_joint.min(axis=1), FAR)
    result = per_node[:count].copy()
    np.minimum.at(result, np.arange(1, count), per_node[nodes.right])
    return result
