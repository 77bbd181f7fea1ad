"""Textbook trajectories through via points, and the shortest duration of any of them."""

from microbot_ocp.baselines.cubic import cubic
from microbot_ocp.baselines.lspb import lspb
from microbot_ocp.baselines.quintic import quintic
from microbot_ocp.baselines.scaling import Scaled, shortest_duration
from microbot_ocp.baselines.spline import spline

__all__ = ["Scaled", "cubic", "lspb", "quintic", "shortest_duration", "spline"]
