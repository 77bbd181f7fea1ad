"""The fastest motion through via points or stops, with or without obstacles.

Comes in: a task. Goes out: a motion with what was tried. Begin with :func:`time_optimal` in
``_time_optimal.py``; ``_free_search.py`` is the search, ``_stop_search.py`` the same through stops,
``_among_obstacles.py`` and ``_stops_among.py`` start from ways around obstacles, ``_orders.py``
compares orders of stops, ``_prepared.py`` solves again with other numbers.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
