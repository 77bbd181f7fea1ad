"""Public names, each imported at its first access."""

from ._process import (
    entry as entry,
)
from ._program import (
    main as main,
)
