"""Independent proof of a motion: re-simulation, dense limits, optimality."""

from __future__ import annotations

from dataclasses import dataclass

from microbot_ocp.checks import FloatArray


@dataclass(frozen=True, eq=False)
class LimitCheck:
    """How one kind of limit is used along a motion, on a dense grid.

    Attributes
    ----------
    quantity : "q", "qd", "qdd", "tau" or "taud"
    utilisation : array [n]
        Largest share of the limit that each joint uses: 1 is the limit, NaN where there is none.
        For q it is the place between the limits, 0 in the middle.
    violation : float
        Worst relative violation, 0 where none: excess over the limit, divided by the limit (by the
        range for q).
    joint, time, value, limit, unit
        Where the worst utilisation is: joint name, s, value and limit in ``unit``.
    """

    quantity: str
    utilisation: FloatArray
    violation: float
    joint: str
    time: float
    value: float
    limit: float
    unit: str


@dataclass(frozen=True, eq=False)
class Certificate:
    """What was checked of a motion, and the verdict.

    Attributes
    ----------
    label : str
    ok : bool
        Whether every check passed.
    verdict : str
        The result in words.
    limit_checks : tuple of LimitCheck
        One for every kind of limit that the robot has.
    final_position_error, final_velocity_error : float
        Largest joint error after re-simulation from the motion's own torque, rad and rad/s.
    resimulation_status : str
        "ok", or why the integrator stopped.
    grid_step : float
        Longest step of the dense grid, s.
    grid_ratio : float
        Dense grid points to each mesh interval, at least.
    condition_peak, condition_time : float
        Largest condition number of the mass matrix along the way and when, s.
    saturated_fraction : float
        Share of the time in which at least one limit is used to 99 % or more.
    """

    label: str
    ok: bool
    verdict: str
    limit_checks: tuple[LimitCheck, ...]
    final_position_error: float
    final_velocity_error: float
    resimulation_status: str
    grid_step: float
    grid_ratio: float
    condition_peak: float
    condition_time: float
    saturated_fraction: float
