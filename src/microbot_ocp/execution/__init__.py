"""Execution of a motion's samples by a robot controller.

The input is a motion or the rows of a trajectory file, and the :class:`Profile` of a controller.
The results are the executed motion, its certificate, and rows that the controller accepts. Begin
with ``_profile.py``; ``_curve.py`` holds the interpolation rules, ``_command.py`` slows a motion
down until its execution keeps the limits, ``_check.py`` certifies a file.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
