"""What a limit may speak of: the quantities of a motion at one instant, as CasADi expressions."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, NoReturn

import casadi as ca

from microbot_ocp.robot._dynamics import inverse_dynamics, torque_and_rate
from microbot_ocp.robot._function import symbols
from microbot_ocp.robot._kinematics import forward_kinematics, jacobian, link_poses

if TYPE_CHECKING:
    from microbot_ocp.robot._model import Robot


class MotionState:
    """Quantities of a motion at one instant; each is built when it is first asked for.

    Attributes
    ----------
    q, qd, qdd, qddd : expression [n]
        Joint positions and their derivatives, rad, rad/s, rad/s^2, rad/s^3 (prismatic: m, ...).
    tau, taud : expression [n]
        Joint torques and their time derivatives, N m and N m/s (N, N/s).
    tool : expression [4,4]
        Pose of the tool in the base frame.
    tool_velocity, tool_acceleration, tool_jerk : expression [6]
        Of the tool's origin, linear (m/s, m/s^2, m/s^3), then angular (rad/s, ...), in the base
        frame.
    link_poses : tuple of expression [4,4]
        Poses of the base and of link frames 1 to n in the base frame.
    """

    def __init__(
        self, robot: Robot, q: Any, qd: Any, qdd: Any, qddd: Any, torques: ca.Function | None = None
    ) -> None:
        """``torques`` may replace :func:`torque_and_rate`: a function of the same arguments."""
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
        """Joint torques [n]."""
        if self._torques is None and "_torque_and_rate" not in self.__dict__:
            return inverse_dynamics(self.robot)(self.q, self.qd, self.qdd)
        return self._torque_and_rate[0]

    @cached_property
    def taud(self) -> Any:
        """Time derivatives of the joint torques [n]."""
        return self._torque_and_rate[1]

    @cached_property
    def tool(self) -> Any:
        """Pose of the tool [4,4]."""
        return forward_kinematics(self.robot)(self.q)

    @cached_property
    def link_poses(self) -> tuple[Any, ...]:
        """Poses [4,4] of the base and every link frame."""
        return tuple(ca.horzsplit(link_poses(self.robot)(self.q), 4))

    @cached_property
    def tool_velocity(self) -> Any:
        """Velocity of the tool [6]."""
        return jacobian(self.robot)(self.q) @ self.qd

    @cached_property
    def tool_acceleration(self) -> Any:
        """Acceleration of the tool [6]."""
        return tool_acceleration(self.robot)(self.q, self.qd, self.qdd)

    @cached_property
    def tool_jerk(self) -> Any:
        """Jerk of the tool [6]."""
        return tool_jerk(self.robot)(self.q, self.qd, self.qdd, self.qddd)


@lru_cache(maxsize=64)
def tool_acceleration(robot: Robot) -> ca.Function:
    """Return acceleration of the tool: ``(q[n], qd[n], qdd[n]) -> a[6]``, linear, then angular."""
    q, qd, _ = state = _symbols(robot, "q", "qd", "qdd")
    return _derivative("tool_acceleration", jacobian(robot)(q) @ qd, state)


@lru_cache(maxsize=64)
def tool_jerk(robot: Robot) -> ca.Function:
    """Return jerk of the tool: ``(q[n], qd[n], qdd[n], qddd[n]) -> j[6]``, linear, then angular."""
    *before, _ = state = _symbols(robot, "q", "qd", "qdd", "qddd")
    return _derivative("tool_jerk", tool_acceleration(robot)(*before), state)


def _symbols(robot: Robot, *names: str) -> tuple[Any, ...]:
    return tuple(symbols(robot, *names).values())


def _derivative(name: str, value: Any, state: tuple[Any, ...]) -> ca.Function:
    """Return the derivative by the time of what depends on all of a state but its last part."""
    change = ca.jtimes(value, ca.vertcat(*state[:-1]), ca.vertcat(*state[1:]))
    return ca.Function(name, state, [ca.densify(change)])
