"""One question for thousands of tasks: cases in, a Parquet data set of what became of each out.

Begin with :func:`sweep`. :class:`Cases` says what varies, ``_solve`` does one case, ``_process``
guards it, ``_run`` spreads cases over the workers of dask.distributed, :class:`Sweep` reads what
became of them.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
