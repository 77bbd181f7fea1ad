"""From the plan to the arm: what a controller makes of the samples of a motion.

In: a motion, or the rows of anyone's file, and a :class:`Profile` of the controller. Out: the curve
that the drives get as a motion, its certificate, and rows that the controller accepts. Begin with
``_profile.py``; ``_curve.py`` has the rules of interpolation, ``_command.py`` slows a motion down
until they keep the limits, ``_check.py`` judges a file.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
