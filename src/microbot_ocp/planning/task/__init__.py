"""What a motion is asked for: stops, what lies between them, payloads, checks at the border.

Comes in: via points or stops with their limits. Goes out: a :class:`Task`, checked, with typical
durations. Begin with ``_task.py``; ``_stops.py`` and ``_segments.py`` are what a user writes,
``_blending.py`` cuts blended corners, ``_checks.py`` refuses what no solver should see,
``_scale.py`` estimates durations, ``_friction.py`` rounds dry friction off for programs, and
``_ending.py`` says how a solve ended.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
