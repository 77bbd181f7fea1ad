"""Independent check of a motion: re-simulation, every limit on a dense grid, and clearance.

The input is a motion with its limits, stops and scene; the result is a :class:`Certificate`, a list
of checks (``_certificate.py``). Begin with :func:`certify` in ``_certification.py``;
``_resimulation.py`` integrates the motion from its own torque, ``_task_certificate.py`` checks
stops, segments and payloads.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
