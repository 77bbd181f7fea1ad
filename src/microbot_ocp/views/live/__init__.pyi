"""Public names, loaded on first use."""

from ._interactive_task import (
    InteractiveTask as InteractiveTask,
    NewestOnly as NewestOnly,
    Setting as Setting,
)
from ._streams import (
    connected as connected,
    local_page as local_page,
    parse_address as parse_address,
    served as served,
    server as server,
    spawned as spawned,
)
from ._terminal import show_progress as show_progress, spoken_progress as spoken_progress
from ._viewer import (
    LOOPBACK as LOOPBACK,
    find_viewer as find_viewer,
    wait_for_viewer as wait_for_viewer,
)
