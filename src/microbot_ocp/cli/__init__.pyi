"""Public names, loaded on first use."""

from ._process import (
    entry as entry,
)
from ._program import (
    main as main,
)
