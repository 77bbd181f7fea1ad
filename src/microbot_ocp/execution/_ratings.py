"""Ratings of drives and gears over a cycle of a motion, as opposed to limits at an instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.table import Column, Table
from microbot_ocp.execution._load import given_task, refuse_other_arm, torques_through
from microbot_ocp.motion import Motion, State, quadrature
from microbot_ocp.planning.task import Segment
from microbot_ocp.robot import Robot


@dataclass(frozen=True, eq=False)
class Ratings:
    """Load of each joint over a cycle of a motion and a dwell at its end.

    Attributes
    ----------
    robot : Robot
        Arm that executes the motion.
    duration, dwell : float
        Duration of the motion, and of the rest after it, s.
    rms_torque : array [n]
        Root-mean-square torque, N m (N); it heats the motor.
    holding_torque : array [n]
        Torque in the dwell, N m (N).
    cubic_torque : array [n]
        Cube root of the mean of the torque's cube, weighted by the speed, N m (N); it wears the
        gear. Zero for a joint that does not move.
    peak_torque, peak_speed, mean_speed : array [n]
        Peak torque, N m (N); peak and mean speed, rad/s (m/s).
    peak_power : array [n]
        Largest power drawn, W.
    energy_drawn, energy_returned : array [n]
        Energy per cycle, J, both at least 0.
    """

    robot: Robot
    duration: float
    dwell: float
    rms_torque: FloatArray
    holding_torque: FloatArray
    cubic_torque: FloatArray
    peak_torque: FloatArray
    peak_speed: FloatArray
    mean_speed: FloatArray
    peak_power: FloatArray
    energy_drawn: FloatArray
    energy_returned: FloatArray

    @property
    def mean_power(self) -> float:
        """Mean power of all joints over the cycle, drawn minus returned, W."""
        energy = float((self.energy_drawn - self.energy_returned).sum())
        return energy / (self.duration + self.dwell)

    def least_dwell(self, rms_max: ArrayLike) -> float:
        """Return the shortest dwell, s, that keeps every joint at or below its rated torque.

        Parameters
        ----------
        rms_max : float or array_like [n]
            Rated (root mean square) torques, N m (N).

        Raises
        ------
        InputError
            A rating is not above 0 or the number of ratings is wrong, or holding the arm alone
            exceeds the rating of a joint, so that no dwell is long enough.

        Examples
        --------
        >>> import microbot_ocp as mo
        >>> robot = mo.load_robot("microbot").with_gravity([0.0, 0.0, 0.0])
        >>> shape = mo.cubic([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]], [0.0, 1.0])
        >>> motion = mo.Motion.from_polynomial(robot, shape, label="cubic")
        >>> found = mo.execution.ratings(robot, motion)
        >>> round(found.least_dwell(0.5 * found.rms_torque.max()), 6)
        3.0
        """
        count = self.rms_torque.size
        given = np.full(count, rms_max) if np.ndim(rms_max) == 0 else rms_max
        rated = checks.array("rms_max", given, (count,), "N m")
        if not np.all(rated > 0.0):
            raise InputError(f"rms_max must be above 0 N m, not {rms_max}")
        whole = self.duration + self.dwell
        # The integral of tau^2 over the motion: a dwell d gives (square + d holding^2) / (T + d).
        square = self.rms_torque**2 * whole - self.holding_torque**2 * self.dwell
        missing = square - rated**2 * self.duration
        spare = rated**2 - self.holding_torque**2
        never = np.flatnonzero((missing > 0.0) & (spare <= 0.0))
        if never.size:
            joint = int(never[0])
            raise InputError(
                f"no dwell keeps {self.robot.joint_names[joint]!r} at its rated "
                f"{rated[joint]:.4g} {self.robot.unit('tau', joint)}: holding the arm takes "
                f"{self.holding_torque[joint]:.4g}"
            )
        needed = np.where(missing > 0.0, missing / np.where(spare > 0.0, spare, 1.0), 0.0)
        return float(needed.max())

    def table(self) -> Table:
        """Return a table with one row per joint."""

        def unit(key: str) -> str:
            every = range(self.rms_torque.size)
            return " or ".join(dict.fromkeys(self.robot.unit(key, joint) for joint in every))

        shown = {
            "r.m.s.": (unit("tau"), self.rms_torque),
            "cubic mean": (unit("tau"), self.cubic_torque),
            "peak": (unit("tau"), self.peak_torque),
            "peak speed": (unit("qd"), self.peak_speed),
            "peak power": ("W", self.peak_power),
            "drawn": ("J", self.energy_drawn),
            "returned": ("J", self.energy_returned),
        }
        columns = [Column(name, unit, ".4g") for name, (unit, _) in shown.items()]
        values = (array.tolist() for _, array in shown.values())
        rows = [list(row) for row in zip(self.robot.joint_names, *values, strict=True)]
        note = f"{self.duration:.4g} s and a dwell of {self.dwell:.4g} s: {self.mean_power:.4g} W"
        return Table([Column("joint", left=True), *columns], rows, notes=[note])


def ratings(
    robot: Robot,
    motion: Motion,
    dwell: float = 0.0,
    *,
    via_q: Sequence[Any] | None = None,
    segments: Sequence[Segment] | None = None,
    cycle: bool = False,
) -> Ratings:
    """Evaluate the load of drives and gears along a motion with a dwell after it.

    Parameters
    ----------
    robot : Robot
        Arm with masses.
    motion : Motion
        Motion of one cycle.
    dwell : float
        Rest at the end of the motion in each cycle, s; the arm is held against gravity, with its
        payload there.
    via_q, segments, cycle
        Stops of the motion, see :func:`certify`; torques are computed with the payload at each
        time.

    Returns
    -------
    Ratings
        Torques, speeds, powers and energy of every joint over the cycle.

    Raises
    ------
    InputError
        The number of joints differs, the robot has no masses, the dwell is negative, or the torques
        of the motion are not those of the robot; give the stops if its payload changes on the way.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> shape = mo.quintic([[0.0, 0.0, 0.0], [0.5, 0.8, 0.4]], [0.0, 2.0])
    >>> motion = mo.Motion.from_polynomial(robot, shape, label="quintic")
    >>> found = mo.execution.ratings(robot, motion, 1.0)
    >>> bool((found.rms_torque <= found.peak_torque).all())
    True
    """
    checks.joints("motion", motion.joint_count, robot)
    if not robot.has_dynamics:
        raise InputError(f"robot {robot.name!r} has no masses, so no torques follow from it")
    rest = checks.number("dwell", dwell, "s", at_least=0.0)
    task = given_task(robot, None, via_q, segments, cycle)
    refuse_other_arm(robot, motion, task)
    torque = torques_through(robot, motion, task)
    t, weight = quadrature(motion.t)
    state = motion.sample(t)
    tau, speed = torque(t, state), np.abs(state.qd)
    power = tau * state.qd
    end = motion.q[-1:]
    holding = np.abs(torque(motion.t[-1:], State(end, 0.0 * end, 0.0 * end))[0])
    whole, way = motion.duration + rest, weight @ speed
    wear = weight @ (speed * np.abs(tau) ** 3)
    at_samples = torque(motion.t, State(motion.q, motion.qd, motion.qdd))
    return Ratings(
        robot=robot,
        duration=motion.duration,
        dwell=rest,
        rms_torque=np.sqrt((weight @ tau**2 + rest * holding**2) / whole),
        holding_torque=holding,
        cubic_torque=np.cbrt(wear / np.where(way > 0.0, way, 1.0)),
        peak_torque=np.maximum(np.abs(at_samples).max(axis=0), np.abs(tau).max(axis=0)),
        peak_speed=np.maximum(np.abs(motion.qd).max(axis=0), speed.max(axis=0)),
        mean_speed=way / whole,
        peak_power=np.maximum((at_samples * motion.qd).max(axis=0), power.max(axis=0)),
        energy_drawn=weight @ np.maximum(power, 0.0),
        energy_returned=weight @ np.maximum(-power, 0.0),
    )
