"""Pictures, tables and recordings; nothing here is imported unless it is asked for.

``plots`` needs matplotlib, ``recording`` needs rerun, ``tables`` needs rich.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
