"""The same task by every method, fronts, and the files that tasks and cells are kept in.

Comes in: a robot and via points, or a file. Goes out: a :class:`Comparison` with motions and
certificates. Begin with :func:`compare` in ``_comparison.py``; ``_front.py`` weighs time against
effort or torque, ``_task_file.py`` and ``_cell_file.py`` read what ``_folder.py`` and ``_saved.py``
write.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
