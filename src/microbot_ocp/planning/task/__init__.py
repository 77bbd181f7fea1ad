"""The task of a motion: stops, segments between them, payloads, and input checks.

Input: via points or stops with their limits. Output: a checked :class:`Task` with typical
durations. ``_task.py`` is the entry point. ``_stops.py`` and ``_segments.py`` are the user's input,
``_blending.py`` cuts blended corners, ``_checks.py`` rejects bad input before a solver starts,
``_scale.py`` estimates durations, ``_friction.py`` rounds dry friction off for programs,
``_robust.py`` bounds torques of uncertain arms, ``_ending.py`` states the outcome of a solve.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
