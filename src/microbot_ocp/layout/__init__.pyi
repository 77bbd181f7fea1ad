"""Public names; loaded when they are first asked for."""

from ._design import (
    Design as Design,
    design as design,
)
from ._search import (
    DesignSettings as DesignSettings,
)
