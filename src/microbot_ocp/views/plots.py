"""Figures: every function takes axes or makes them, and returns them.

``mo.plots`` is this module. None touches pyplot or the user's style; :func:`save` writes files, and
the last line of a Jupyter cell shows the figure of the axes it holds.

Examples
--------
>>> import microbot_ocp as mo
>>> robot = mo.load_robot("microbot")
>>> shape = mo.cubic([[0.0, 0.0, 0.0], [0.5, 0.8, 0.4]], [0.0, 3.0])
>>> motion = mo.Motion.from_polynomial(robot, shape, label="cubic")
>>> axes = mo.plots.motion(robot, motion)
>>> axes.shape, axes[0, 1].get_ylabel(), axes[2, 0].get_ylabel()
((3, 3), '', 'torque [N m]')
"""

from __future__ import annotations

from microbot_ocp.views.arm_plots import arms
from microbot_ocp.views.comparison_plots import comparison
from microbot_ocp.views.curves import Curve, curves
from microbot_ocp.views.limit_plots import limit_use, saturation
from microbot_ocp.views.motion_plots import motion, simulation
from microbot_ocp.views.page import AxesGrid, figure_of, save, styled, write
from microbot_ocp.views.path_plots import paths
from microbot_ocp.views.phase_plots import phase_plane
from microbot_ocp.views.report import report, report_figure
from microbot_ocp.views.solution_plots import solution
from microbot_ocp.views.tracking_plots import tracking

__all__ = [
    "AxesGrid",
    "Curve",
    "arms",
    "comparison",
    "curves",
    "figure_of",
    "limit_use",
    "motion",
    "paths",
    "phase_plane",
    "report",
    "report_figure",
    "saturation",
    "save",
    "simulation",
    "solution",
    "styled",
    "tracking",
    "write",
]
