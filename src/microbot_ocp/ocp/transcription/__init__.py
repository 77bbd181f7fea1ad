"""Transcription of a problem on a mesh to a nonlinear program in stages.

Input: a problem, a scheme, a mesh. Output: a ``Program`` with functions and bounds. Begin with
``_transcription.py``; ``_kernels.py`` builds one interval by the formulas of ``schemes/``,
``_table.py`` describes every row and variable, ``_layout.py`` gives their places in the program,
and ``_assembly.py`` combines the intervals.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
