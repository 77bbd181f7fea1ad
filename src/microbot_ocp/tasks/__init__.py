"""Comparison of methods on one task, fronts of time against effort, and task files.

Input: a robot and via points, or a file. Output: a :class:`Comparison` with motions and
certificates. Begin with :func:`compare` in ``_comparison.py``. ``_front.py`` weighs time against
effort or torque, ``_task_file.py`` and ``_cell_file.py`` read tasks, ``_folder.py`` writes the
folder of a comparison and ``_saved.py`` reads it.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
