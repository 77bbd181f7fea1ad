"""One question for thousands of tasks: cases in, a Parquet data set of what became of each out.

Begin with :func:`sweep`. :class:`Cases` says what varies, ``_solve`` does one case, ``_process``
guards it, ``_run`` spreads cases over the workers of dask.distributed, :class:`Sweep` reads what
became of them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
