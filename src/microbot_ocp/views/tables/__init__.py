"""Results as tables: what ``comparison.table()`` returns, and what Jupyter shows.

A table is data (:class:`microbot_ocp.Table`); the terminal, Jupyter, Markdown and CSV have one
writer each.
"""

from microbot_ocp._base import border

__getattr__, __dir__, __all__ = border.attach_stub(__name__, __file__)
