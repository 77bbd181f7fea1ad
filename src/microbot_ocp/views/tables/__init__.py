"""Tables of results, such as ``comparison.table()``, and their display.

A table is data (:class:`microbot_ocp.Table`); the terminal, Jupyter, Markdown and CSV have one
writer each.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
