"""The arm in motion: open loop from torques, closed loop under a controller.

Every simulation is one call of one integrator on the whole grid; see :mod:`microbot_ocp.driven`.
"""

from microbot_ocp.simulation.closed_loop import track
from microbot_ocp.simulation.formula import motion_from_formula
from microbot_ocp.simulation.open_loop import simulate
from microbot_ocp.simulation.result import Simulation, Tracking

__all__ = ["Simulation", "Tracking", "motion_from_formula", "simulate", "track"]
