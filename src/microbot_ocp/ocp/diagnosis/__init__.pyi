"""Public names, loaded on first use."""

from ._advice import (
    POOR as POOR,
    advice as advice,
    falls_for_ever as falls_for_ever,
)
from ._explain import (
    Explanation as Explanation,
    Relaxation as Relaxation,
    explain as explain,
)
from ._finiteness import (
    START_OFFSET as START_OFFSET,
    NotFinite as NotFinite,
    finite_start as finite_start,
    singular as singular,
)
from ._kinks import (
    kinks as kinks,
    unheld as unheld,
)
from ._redundancy import (
    independent as independent,
)
