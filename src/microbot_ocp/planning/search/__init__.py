"""The fastest motion through via points or stops, with or without obstacles.

Comes in: a task. Goes out: a motion with what was tried. Begin with :func:`time_optimal` in
``_time_optimal.py`` and :func:`fastest_through` in ``_through_stops.py``; ``_strategies.py`` is the
table of what is tried and ``_search.py`` its loop, which says which answer is better, too.
``_problem.py`` is a task as the search sees it, ``_starts.py`` says what it starts from,
``_branches.py`` has ways through stops. ``_among_obstacles.py`` and ``_stops_among.py`` give it
ways around obstacles, from which ``_guided.py`` goes on; ``_result.py`` makes the motion of its
answer, also the one of least effort, ``_orders.py`` compares orders of stops, ``_prepared.py``
solves again with other numbers.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
