"""Public names, loaded on first use."""

from ._cell_file import (
    Cell as Cell,
    CellFile as CellFile,
    is_cell_file as is_cell_file,
    read_cell as read_cell,
    request_cell as request_cell,
)
from ._comparison import (
    OUTPUTS as OUTPUTS,
    Comparison as Comparison,
    Entry as Entry,
    Progress as Progress,
    Step as Step,
    compare as compare,
)
from ._controller import (
    controller_duration as controller_duration,
)
from ._front import (
    Front as Front,
    FrontPoint as FrontPoint,
    time_effort_front as time_effort_front,
    time_torque_front as time_torque_front,
)
from ._methods import (
    METHODS as METHODS,
)
from ._saved import (
    load_comparison as load_comparison,
    named_robot as named_robot,
)
from ._task_file import (
    COMMON as COMMON,
    KEYS as KEYS,
    TaskFile as TaskFile,
    read_task as read_task,
    robot_from as robot_from,
)
