"""Acceleration limits that keep every torque within its limit, proved by branch and bound.

The input is a robot, a region of joint positions, largest speeds and payloads. The output is a box
of accelerations (and of jerks) for planners that do not compute torques: no motion inside of the
box needs more torque than the joints have.

Start reading at ``_limits.py``. The bounds are in ``_forms.py`` and ``_demand.py``, the search is
in ``_search.py``.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
