"""Public names; loaded when they are first asked for."""

from ._interactive_task import (
    InteractiveTask as InteractiveTask,
    Setting as Setting,
)
from ._local_page import local_page as local_page
from ._newest_only import NewestOnly as NewestOnly
from ._plot import LivePlot as LivePlot
from ._streams import (
    connected as connected,
    parse_address as parse_address,
    served as served,
    server as server,
    spawned as spawned,
)
from ._terminal import (
    show_progress as show_progress,
    spoken_progress as spoken_progress,
)
from ._viewer import (
    LOOPBACK as LOOPBACK,
    find_viewer as find_viewer,
    wait_for_viewer as wait_for_viewer,
)
