"""Sweeps: thousands of tasks solved by several methods, with a Parquet data set as the result.

Begin with :func:`sweep`. :class:`Cases` declares the varied quantities, ``_solve`` solves one case,
``_process`` isolates it in a process, ``_run`` distributes cases over the workers of
dask.distributed, :class:`Sweep` reads the results.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
