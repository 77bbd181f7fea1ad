"""The best timing of a path by toppra, with pinocchio's inverse dynamics."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import toppra
from scipy.interpolate import PPoly
from toppra.algorithm import TOPPRA
from toppra.constraint import JointTorqueConstraint, JointVelocityConstraint

import microbot_ocp as mo
from external.pinocchio_model import pinocchio_model
from microbot_ocp.motion import PiecewisePolynomial


class PolynomialPath(toppra.interpolator.AbstractGeometricPath):
    """A piecewise polynomial as toppra's path: no spline of its own stands between."""

    def __init__(self, polynomial: PiecewisePolynomial) -> None:
        highest_first = np.transpose(polynomial.coefficients, (1, 0, 2))[::-1]
        position = PPoly(np.ascontiguousarray(highest_first), polynomial.breaks)
        self._derivatives = (position, position.derivative(1), position.derivative(2))

    def __call__(self, path_positions: float | np.ndarray, order: int = 0) -> np.ndarray:
        return self._derivatives[order](path_positions)

    @property
    def dof(self) -> int:
        return self._derivatives[0].c.shape[2]

    @property
    def path_interval(self) -> np.ndarray:
        return self._derivatives[0].x[[0, -1]]

    @property
    def waypoints(self) -> tuple[np.ndarray, np.ndarray]:
        breaks = self._derivatives[0].x
        return breaks, self(breaks)


def even_grid(path: PiecewisePolynomial, intervals: int) -> np.ndarray:
    """Points [intervals+1] at equal steps of the path parameter."""
    return np.linspace(path.breaks[0], path.breaks[-1], intervals + 1)


def graded_grid(path: PiecewisePolynomial, intervals: int) -> np.ndarray:
    """Points [intervals+1], dense at both ends.

    Where the path itself starts at rest, at q'(s) = 0, a start with s' = 0 wastes the time of the
    first interval; there it is short.
    """
    share = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, intervals + 1)))
    return path.breaks[0] + path.duration * share


def toppra_problem(
    robot: mo.Robot,
    path: PiecewisePolynomial,
    grid: np.ndarray,
) -> TOPPRA:
    """Torque and velocity limits of the robot, torques by toppra's default: at the grid points.

    Its other scheme takes the curvature after a break of the path for the one before, too.
    """
    model = pinocchio_model(robot)
    data = model.createData()

    def inverse_dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return pin.rnea(model, data, q, qd, qdd)

    torque = JointTorqueConstraint(
        inverse_dynamics,
        np.column_stack(robot.limits.bounds("tau")),
        np.zeros(robot.joint_count),
    )
    velocity = JointVelocityConstraint(np.column_stack(robot.limits.bounds("qd")))
    return TOPPRA(
        [torque, velocity],
        PolynomialPath(path),
        gridpoints=grid,
        solver_wrapper="seidel",
        parametrizer="ParametrizeConstAccel",
    )


def toppra_duration(
    robot: mo.Robot,
    path: PiecewisePolynomial,
    grid: np.ndarray,
) -> float:
    """Duration in s of the best timing that starts and ends at rest."""
    trajectory = toppra_problem(robot, path, grid).compute_trajectory(0.0, 0.0)
    if trajectory is None:
        raise RuntimeError("toppra found no timing of this path")
    return float(trajectory.duration)
