"""The fastest motion through via points or stops, with or without obstacles.

Input: a task. Output: a motion with the record of its search. Entry points:
:func:`time_optimal` in ``_time_optimal.py`` and :func:`fastest_through` in ``_through_stops.py``.
``_queue.py`` is the loop of every search: candidates of rising accuracy, the most promising
first. ``_problem.py`` states a task as a program, ``_branches.py`` finds ways through stops.
``_starts.py`` solves from initial guesses on coarse meshes, ``_refinement.py`` refines these
answers, and ``_search.py`` holds and ranks them. ``_legs.py`` holds paths around obstacles,
``_among_obstacles.py`` plans them, and ``_guided.py`` searches from them. ``_result.py`` returns
the motion, also that of least effort; ``_fronts.py`` gives fronts of motions, ``_orders.py``
compares orders of stops, and ``_prepared.py`` solves again with other numbers.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
