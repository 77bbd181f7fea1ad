"""Public names; loaded when they are first asked for."""

from ._live import (
    parse_address as parse_address,
)
from ._local_page import (
    local_page as local_page,
)
from ._newest_only import (
    LatestWins as LatestWins,
)
from ._plot import (
    LivePlot as LivePlot,
)
from ._terminal import (
    show_progress as show_progress,
)
