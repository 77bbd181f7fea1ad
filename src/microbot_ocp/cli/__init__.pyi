"""Public names; loaded when they are first asked for."""

from ._process import (
    entry as entry,
)
from ._program import (
    main as main,
)
