"""Figures: every function draws on given or new axes and returns them.

``mo.plots`` is this module. No function uses pyplot or changes the user's style. :func:`save`
writes files, and axes in the last line of a Jupyter cell show their figure.

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

from microbot_ocp._base import border
from microbot_ocp._base.needed import needed

needed("matplotlib", "figures need")
__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
