"""Public names; loaded when they are first asked for."""

from ._app import (
    main as main,
)
from ._entry import (
    entry as entry,
)
