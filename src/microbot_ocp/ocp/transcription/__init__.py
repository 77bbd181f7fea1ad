"""From a problem and a mesh to a nonlinear program in stages.

Comes in: a problem, a scheme, a mesh. Goes out: a ``Program`` with functions and bounds.
Begin with ``_transcription.py``; ``_kernels.py`` builds one interval by the formulas of
``schemes/``, ``_table.py`` says what every row and variable is, ``_layout.py`` where it stands, and
``_assembly.py`` puts the intervals together.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
