"""Accelerations that torque allows everywhere in a region: proved by branch and bound.

A robot, a region of its joints, speeds and payloads come in; out come limits of the accelerations
(and jerks) within which no motion asks for more than the torques, for planners that know no torque.
Begin at ``_limits.py``; the bounds are in ``_forms.py``, the search in ``_search.py``.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
